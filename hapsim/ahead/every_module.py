"""Scenes in which every type of module stands once: of what every scene is made, to be compiled before there is one."""

from __future__ import annotations

from collections.abc import Iterator

from hapsim.scene import Scene, parse_scene

SCHEMES = ("cordis", "semi_implicit", "midpoint", "rk4", "exact")

_TEXT = """\
version: 1
rate: 1000
precision: {precision}
scheme: {scheme}
device: {{mass: 1}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  ball: {{type: mass, mass: 1}}
  bell: {{type: cell, mass: 1, stiffness: 1, damping: {damping}}}
  gut: {{type: string, masses: 2, mass: 1, stiffness: 1}}
  bar: {{type: string, masses: 3, mass: 1, stiffness: 1, bending: 1}}
  skin: {{type: membrane, rows: 2, columns: 2, mass: 1, stiffness: 1}}
  backward: {{type: viscoelastic, between: [hand, ball], stiffness: 1}}
  centred: {{type: viscoelastic, between: [hand, gut.0], stiffness: 1, damper: centred}}
  filtered: {{type: viscoelastic, between: [hand, bar.0], stiffness: 1, damper: filtered, cutoff: 10}}
  sensed: {{type: viscoelastic, between: [hand, skin.0.0], stiffness: 1, damper: sensed}}
  spring: {{type: spring, between: [ball, wall], stiffness: 1}}
  damper: {{type: damper, between: [bell, hand], damping: 1}}
  buffer: {{type: buffer, between: [hand, wall], stiffness: 1}}
  curve: {{type: nonlinear, between: [hand, wall], force_over_distance: [[0, 0], [1, 1]],
           force_over_velocity: [[0, 0], [1, 1]]}}
  rub: {{type: friction, between: [hand, wall], force: 1, stiffness: 1}}
  pick: {{type: plectrum, between: [hand, ball], stiffness: 1, release: 1}}
"""


def scenes_with_every_module(precision: str) -> Iterator[Scene]:
    """One for each scheme; and one more where damping joins the modes, which the exact scheme moves as one matrix."""
    for scheme in SCHEMES:
        for damping in (0, 1) if scheme == "exact" else (0,):
            text = _TEXT.format(precision=precision, scheme=scheme, damping=damping)
            yield parse_scene(text, "every module")
