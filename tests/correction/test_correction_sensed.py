"""``correction: sensed`` in virtual time: the hand feels what is predicted, by sensed velocities and accelerations."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hapsim import measure, predict, run
from hapsim.errors import SceneError
from hapsim.scene import Buffer, Initial, Mass, Scene, ViscoElastic, parse_scene
from hapsim.theory import Configuration
from hapsim.theory.interface import Ahead
from tests.measured_scenes import SENSED, fast_scene
from tests.one_hand import document_of, scene_of, touch


def hand_on(*, modules: Any = None, mock: dict[str, Any] | None = None, substeps: int = 1, **device: Any) -> Scene:
    """A hand with a flick on a wall."""
    start = {"initial": {"velocity": 0.1}, "quantum": 1e-10} | (mock or {})
    links = {"touch": touch(2000.0, 5.0)} | (modules or {})
    return scene_of(links, device=SENSED | device, mock=start, substeps=substeps)


@pytest.mark.parametrize(
    "device",
    [
        {},
        {"acceleration_age": 1},
        {"delay": 0.0},
        {"delay": 0.37},
        {"delay": 1.5, "stiffness": 700.0},
        {"delay": 3.0},
        {"delay": 2.0, "acceleration_age": 1},
        {"hold": "ramp"},
        {"sampling": "average"},
    ],
    ids=str,
)
def test_the_hand_feels_what_is_predicted(device: dict[str, Any]) -> None:
    scene = hand_on(**device)
    (felt,), found = predict(scene).felt, measure(scene)
    assert (found.k, found.b) == pytest.approx((felt.k, felt.b), rel=1e-6)
    assert abs(found.k / (2000.0 + device.get("stiffness", 0.0)) - 1.0) < 0.004


def test_an_old_acceleration_is_brought_up_to_date_for_the_declared_mass() -> None:
    true = Configuration(mass=0.4, rate=1000.0, friction=1.0, damper="sensed", ahead=Ahead(1.0, 1, (0.2,)))
    found = measure(hand_on(acceleration_age=1, mock={"mass": 0.4}))
    assert (2.0 * found.k, 2.0 * found.b) == pytest.approx(true.equivalent(2000.0, 5.0), rel=1e-6)


@pytest.mark.parametrize("more", [{}, {"acceleration_age": 1}, {"delay": 1.6}, {"substeps": 4}], ids=str)
def test_a_hand_that_moves_a_mass_feels_what_is_predicted(more: dict[str, Any]) -> None:
    modules = {
        "ball": Mass(mass=0.05),
        "touch": ViscoElastic(between=("hand", "ball"), stiffness=2000.0, damping=3.0),
        "hold": ViscoElastic(between=("ball", "wall"), stiffness=1500.0, damping=1.0),
    }
    scene = hand_on(modules=modules, **more)
    (together,), found = predict(scene).parts, measure(scene)
    assert (found.k, found.b) == pytest.approx((together.own_motion.k, together.own_motion.b), rel=1e-6)


def test_a_contact_answers_the_state_ahead_too() -> None:
    contact = Buffer(between=("hand", "wall"), stiffness=2000.0, damping=5.0, distance=0.002)
    scene = hand_on(modules={"touch": contact}, mock={"initial": Initial()})
    without = scene.model_copy(update={"device": scene.device.model_copy(update={"correction": "none"})})
    felt, plain = (predict(one, at=0.0).felt[0] for one in (scene, without))
    found = measure(scene, at=0.0)
    assert (found.k, found.b) == pytest.approx((felt.k, felt.b), rel=1e-4)
    assert abs(felt.k - 2000.0) < 0.35 * abs(plain.k - 2000.0)


def force_of(noise: dict[str, float]) -> float:
    """Force, N rms, on a hand at rest with this noise."""
    mock = {"initial": Initial(), "quantum": 1e-10, **noise}
    return float(np.std(run(hand_on(mock=mock), duration=8.0).asked_force[2000:, 0]))


def test_the_noise_of_the_force_is_the_predicted_one() -> None:
    robustness = predict(hand_on()).felt[0].robustness
    assert force_of({"noise": 1e-6}) == pytest.approx(1e-6 * robustness.noise_gain, rel=0.05)
    assert force_of({"acceleration_noise": 0.5}) == pytest.approx(0.5 * robustness.acceleration_noise_gain, rel=0.05)


def test_a_soft_scene_is_right_for_any_hand_and_a_stiff_one_is_not() -> None:
    for stiffness, damping, is_right in ((2000.0, 5.0, True), (40000.0, 5.0, False)):
        wall = ViscoElastic(between=("hand", "wall"), stiffness=stiffness, damping=damping)
        (felt,) = predict(hand_on(modules={"touch": wall})).felt
        errors = [
            abs(one.k / stiffness - 1.0) + abs(one.b / (damping + 1.0) - 1.0) for one in map(felt.with_mass, (0.1, 0.4))
        ]
        assert (max(errors) < 0.05) is is_right


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ({"correction": "sensed"}, "without a sensor of the velocity and the acceleration"),
        (SENSED | {"sensors": ["velocity"]}, "without a sensor of the acceleration"),
        (SENSED | {"hold": "impulse"}, "with hold: impulse"),
        (SENSED | {"decimation": "mean"}, "found mean"),
        ({"sensors": ["acceleration"], "acceleration_age": 2}, "a whole number from 0 to 1"),
        ({"acceleration_age": 1}, "an age without the sensor"),
        ({"sensors": ["velocity", "velocity"]}, "a list that names one twice"),
        ({"sensors": "speed"}, "expected a list of velocity or acceleration"),
    ],
)
def test_a_device_without_what_it_needs_is_refused(device: dict[str, Any], words: str) -> None:
    document = document_of({"touch": touch(2000.0, 5.0)}, device=device, substeps=1 + ("decimation" in device))
    with pytest.raises(SceneError, match=words):
        parse_scene(json.dumps(document), "here")


@pytest.mark.parametrize(("delay", "kappa", "ratio"), [(1.6, 0.0327, 1.0), (2.0, 0.0442, 0.84)])
def test_a_motion_that_rings_for_longer_than_the_hand_moves_is_not_the_felt_one(
    delay: float, kappa: float, ratio: float
) -> None:
    """The slowest pair of poles alone would be a spring of 45 and more times the scene's."""
    scene = fast_scene(kappa, ratio, SENSED | {"delay": delay}, {})
    (felt,), found = predict(scene, with_margins=False).felt, measure(scene)
    rings = np.abs(np.angle(felt.poles[:2]))
    assert (rings > 1.0).all()
    assert felt.k == pytest.approx(found.k, rel=2e-3)
    assert felt.b == pytest.approx(found.b, rel=2e-3)
