"""Scenes in which every type of module stands once: of what every scene is made, to be compiled before there is one."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle
from typing import get_args

from hapsim.scene import DamperScheme, Scene, SchemeName, parse_scene
from hapsim.scene.choices import WITH_CUTOFF

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
  spring: {{type: spring, between: [ball, wall], stiffness: 1}}
  damper: {{type: damper, between: [bell, hand], damping: 1}}
  buffer: {{type: buffer, between: [hand, wall], stiffness: 1}}
  curve: {{type: nonlinear, between: [hand, wall], force_over_distance: [[0, 0], [1, 1]],
           force_over_velocity: [[0, 0], [1, 1]]}}
  rub: {{type: friction, between: [hand, wall], force: 1, stiffness: 1}}
  pick: {{type: plectrum, between: [hand, ball], stiffness: 1, release: 1}}
"""


_HELD = ("ball", "gut.0", "bar.0", "skin.0.0")


def scenes_with_every_module(precision: str) -> Iterator[Scene]:
    """Two for each scheme; in one of them damping joins the modes, which the exact scheme then moves as one matrix."""
    for scheme in get_args(SchemeName):
        for damping in (0, 1):
            text = _TEXT.format(precision=precision, scheme=scheme, damping=damping)
            yield parse_scene(text + "".join(_links_with_every_damper()), "every module")


def _links_with_every_damper() -> Iterator[str]:
    """Visco-elastic links, the first of which hold a point of each kind that can be held."""
    for damper, held in zip(get_args(DamperScheme), cycle(_HELD), strict=False):
        cutoff = ", cutoff: 10" if damper in WITH_CUTOFF else ""
        yield f"  {damper}: {{type: viscoelastic, between: [hand, {held}], stiffness: 1, damper: {damper}{cutoff}}}\n"
