"""Scenes of single precision whose numbers are beyond it once they are worked out: a sentence, and no warning."""

from __future__ import annotations

import pytest

from hapsim.cordis.program import compile_scene, parameter_values
from hapsim.cordis.schemes import SCHEMES, without_matrices
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


CASES = [
    *((scheme, {"damping": 3e38}) for scheme in SCHEMES),  # B/T
    *((scheme, {"rate": 1e-6, "velocity": 3e38}) for scheme in SCHEMES),  # v T
    *((scheme, {"mass": 1e-46}) for scheme in without_matrices()),  # T²/m
]


@pytest.mark.parametrize(("scheme", "numbers"), CASES)
def test_what_single_precision_does_not_hold_is_a_sentence(scheme: str, numbers: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=r"precision: found single.* write precision: double"):
        compile_scene(scene_of("single", scheme, **numbers))
    compile_scene(scene_of("double", scheme, **numbers))


def test_a_value_that_single_precision_does_not_hold_is_no_change_of_a_running_scene() -> None:
    scene = scene_of("single", "cordis")
    tie = scene.modules["tie"].model_copy(update={"damping": 3e37})
    with pytest.raises(UsageError, match="precision: found single"):
        parameter_values(scene.model_copy(update={"modules": {**scene.modules, "tie": tie}}))


@pytest.mark.parametrize("numbers", [{"stiffness": 1e308}, {"damping": 1e308}])
def test_modes_that_no_number_holds_are_a_sentence_in_double_precision_too(numbers: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="too large for the scene's scheme"):
        compile_scene(scene_of("double", "exact", **numbers))
