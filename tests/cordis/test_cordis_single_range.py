"""The least and the largest numbers of a scene, worked out for the kernel."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.program import Program, compile_scene
from hapsim.cordis.schemes import SCHEMES
from hapsim.errors import UsageError
from hapsim.scene import Scene, parse_scene

SCENE = """\
version: 1
rate: {rate!r}
precision: {precision}
scheme: {scheme}
device: {{mass: 0.2}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground}}
  ball:  {{type: mass, mass: {mass!r}, velocity: {velocity!r}}}
  other: {{type: mass, mass: 0.1}}
  touch: {{type: viscoelastic, between: [hand, ball], stiffness: 1000.0}}
  hold:  {{type: viscoelastic, between: [ball, wall], stiffness: {stiffness!r}, damping: {damping!r}}}
  tie:   {{type: viscoelastic, between: [ball, other], stiffness: 100.0, damping: 1.0}}
"""


def scene_of(precision: str, scheme: str, **numbers: float) -> Scene:
    plain = {"rate": 1000.0, "mass": 0.1, "velocity": 0.0, "stiffness": 1000.0, "damping": 1.0}
    return parse_scene(SCENE.format(precision=precision, scheme=scheme, **(plain | numbers)))


ENDS = {"rate": (1e-12, 1e12), "mass": (1e-12, 1e12), "stiffness": (0.0, 1e12), "damping": (0.0, 1e12)}


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_least_and_largest_numbers_that_a_scene_takes_are_worked_out_or_refused(
    precision: str, scheme: str
) -> None:
    """No infinity, and no warning."""
    refused = 0
    for numbers in product(*ENDS.values()):
        scene = scene_of(precision, scheme, velocity=1e12, **dict(zip(ENDS, numbers, strict=True)))
        program, sentence = program_of(scene)
        refused += program is None
        assert program is not None or "too large for the scene's scheme: try cordis" in sentence
        assert program is None or all(is_finite(one) for one in [program.rows, *(one.numbers for one in program.parts)])
    assert refused == {"midpoint": 1, "exact": 1}.get(scheme, 0)


def program_of(scene: Scene) -> tuple[Program | None, str]:
    try:
        return compile_scene(scene), ""
    except UsageError as error:
        return None, str(error)


def is_finite(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(is_finite, value))
    return np.asarray(value).dtype.kind != "f" or bool(np.isfinite(value).all())
