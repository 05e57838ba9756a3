"""Play of a transmission: its two states, and the oscillation between them beside the mock's."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.cli.check import prediction_document
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.errors import UsageError
from hapsim.prediction import Prediction, predict
from hapsim.prediction.backlash import free_network
from hapsim.prediction.drives import drive_sentences
from hapsim.prediction.first_help import first_help
from hapsim.prediction.linear import linear_scene, network_of
from hapsim.prediction.verdict_words import margin_summary
from hapsim.prediction.warnings import warnings_about
from hapsim.scene import Scene, parse_scene
from hapsim.scene.section import Table
from tests.backlash_scenes import backlash_scene, compared


def scene_of(belt: str, damping: float, mass: str = "200 g", more: str = "") -> Scene:
    return parse_scene(f"""
version: 1
rate: 1000
device: {{clock: lockstep, mass: {mass}, friction: 1, transmission: {{stiffness: 20 N/mm, damping: 3, {belt}}}}}
modules:
  hand: {{type: device, channel: 0}}
  ground: {{type: ground}}
  spring: {{type: viscoelastic, between: [hand, ground], stiffness: 1000, damping: {damping}}}
{more}
""")


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("number", [3, 6, 100])
def test_the_swing_in_the_play_is_that_of_the_mock(number: int) -> None:
    """More of them, and those at rest: tools/bench/backlash."""
    case = compared(backlash_scene(np.random.default_rng([0, number])))
    assert case is not None
    assert case.simulated > 0
    assert case.predicted == pytest.approx(case.simulated, rel=0.05)


@pytest.fixture(scope="module")
def growing() -> Prediction:
    """Prediction of a motor that grows in its play."""
    return predict(scene_of("motor_mass: 4 g, backlash: 0.2 mm", 3))


def test_a_motor_that_grows_in_its_play_is_unstable_with_a_swing(growing: Prediction) -> None:
    prediction = growing
    assert prediction.stable_as_taken
    assert not prediction.stable
    (shaking,) = prediction.states.growing
    alone = predict(
        parse_scene("""
version: 1
rate: 1000
device: {mass: 4 g, friction: 1}
modules:
  hand: {type: device, channel: 0}
  ground: {type: ground}
  spring: {type: viscoelastic, between: [hand, ground], stiffness: 1000, damping: 3}
""")
    )
    assert shaking.growth == pytest.approx(alone.spectral_radius, rel=1e-12)
    assert shaking.state == "hand is in its play"
    assert shaking.swing is not None
    assert 0.2e-3 < shaking.swing.most < 2e-3
    sentence = shaking.sentence(prediction.scene.units)
    assert (
        "grows by 2.7 % per sample while hand is in its play, to an oscillation of 600 µm from end to end" in sentence
    )


@pytest.mark.thorough
def test_what_makes_a_scene_stable_holds_in_the_play_too(growing: Prediction) -> None:
    scene, helps = growing.scene, {one.what: one.factor for one in first_help(growing)}
    assert {"stiffness", "damping", "rate"} <= helps.keys()
    for share, verdict in ((0.999, "stable"), (1.02, "unstable")):
        softer = scene.modules["spring"].model_copy(update={"stiffness": share * helps["stiffness"] * 1000.0})
        changed = {**scene.modules, "spring": softer}
        assert predict(scene.model_copy(update={"modules": Table(changed)})).verdict == verdict
    assert margin_summary(growing).endswith("times the damping of spring, in mesh")


def test_plays_are_in_the_document_of_a_check(growing: Prediction) -> None:
    (play,) = prediction_document(growing)["plays"].values()
    assert play["backlash_m"] == 2e-4
    assert play["motor_m"] == growing.states.growing[0].swing.most  # type: ignore[union-attr]
    assert play["not_worked_out"] == ""


def test_check_warns_of_what_the_mock_cannot_move() -> None:
    scene = scene_of("motor_mass: 50 g", 3, more="mock: {force_noise: {rms: 0.1, band: 1 MHz}}")
    (warning,) = (one for one in warnings_about(scene, predict(scene)) if "mock cannot run" in one)
    with pytest.raises(UsageError, match="smaller band of the noise") as refused:
        assemble_mock(scene)
    assert warning == f"the built-in mock cannot run this scene. {refused.value}."


def test_without_play_and_with_a_heavier_motor_nothing_grows() -> None:
    for belt in ("motor_mass: 4 g", "motor_mass: 50 g, backlash: 0.2 mm"):
        prediction = predict(scene_of(belt, 3))
        assert prediction.stable
        assert prediction.states.growing == []


def test_friction_at_the_handle_does_not_brake_a_free_motor() -> None:
    each = []
    for side in ("motor", "handle"):
        scene = scene_of(f"motor_mass: 4 g, backlash: 0.2 mm, friction_at: {side}", 3)
        free = free_network(network_of(scene, linear_scene(scene))[0], 0)
        assert free is not None
        each.append(free.channel_friction.tolist())
    assert each == [[1.0], [0.0]]


def backlash_line(scene: Scene) -> str:
    return next(one for one in drive_sentences(predict(scene)) if one.startswith("Backlash of hand"))


def test_check_prints_how_far_it_swings_or_why_not() -> None:
    found = backlash_line(scene_of("motor_mass: 20 g, backlash: 0.2 mm, sensor: handle", 14))
    assert found.startswith("Backlash of hand: 0.2 mm; the motor swings in it by 0.2")
    assert "no steady oscillation" in backlash_line(scene_of("motor_mass: 50 g, backlash: 0.2 mm", 3))
    assert "a motion grows in mesh" in backlash_line(scene_of("motor_mass: 20 g, backlash: 0.2 mm", 14))
    wall = "  wall: {type: buffer, between: [hand, ground], stiffness: 500, damping: 1}"
    assert "for one hand with linear links" in backlash_line(
        scene_of("motor_mass: 50 g, backlash: 0.2 mm", 3, more=wall)
    )
