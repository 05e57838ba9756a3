"""A hold is an entry of HOLDS and nothing else: predicted, run, measured, identified, corrected and drawn. And the
model that a device is fitted with, beside the same equation stepped very finely."""

from __future__ import annotations

import math

import numpy as np
import pytest
from unshipped_holds import UNSHIPPED

import hapsim
from hapsim.holds import HOLDS
from hapsim.measuring.converters import Converters
from hapsim.measuring.device_motion import sampled_motion
from hapsim.prediction.predict_impedance import predict_impedance
from hapsim.scene import Scene
from tests.one_hand import scene_of, touch

SCENE = scene_of({"touch": touch(2000.0, 5.0)}, device={"delay": 1.3})
EVERY = [*HOLDS, "sawtooth", "two blows"]


@pytest.fixture(params=EVERY)
def held(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Scene:
    if request.param in UNSHIPPED:
        monkeypatch.setitem(HOLDS, request.param, UNSHIPPED[request.param])
    return with_device(SCENE, hold=request.param)


def with_device(scene: Scene, **values: object) -> Scene:
    return scene.model_copy(update={"device": scene.device.model_copy(update=values)})


@pytest.mark.thorough(keep=6)
@pytest.mark.parametrize("correction", ["none", "poles", "predictor"])
def test_a_hold_is_predicted_and_measured_alike_whatever_corrects_it(held: Scene, correction: str) -> None:
    scene = with_device(held, correction=correction)
    predicted, found = hapsim.predict(scene, with_margins=False).felt[0], hapsim.measure(scene)
    assert (found.k, found.b) == pytest.approx((predicted.k, predicted.b), rel=3e-7)
    if correction != "none":
        assert (found.k, found.b) == pytest.approx((2000.0, 6.0), rel=3e-7)


def test_the_ramp_feels_as_linear_interpolation_does() -> None:
    """Computed apart from hapsim, by the recurrence of a force that moves linearly to the new one."""
    scene = with_device(SCENE, hold="ramp", delay=1.0)
    found = hapsim.predict(scene, with_margins=False).felt[0]
    assert (found.k, found.b) == pytest.approx((2086.89017115, 1.94232467956), rel=1e-11)


def test_the_impedance_is_measured_as_it_is_predicted(held: Scene) -> None:
    found = hapsim.measure_impedance(held)
    predicted = predict_impedance(held, found.frequency)
    for kind in ("device", "rendered", "closed_loop"):
        circles = getattr(found, kind)
        assert np.all(np.abs(circles.value - getattr(predicted, kind)) <= circles.uncertainty)


FRICTION, STIFFNESS, STEPS = 0.03, 0.02, 1000


def stepped(force: np.ndarray, delay: float, converters: Converters) -> np.ndarray:
    """Positions in sample periods, by the midpoint rule: a push at a time, or a blow."""
    x = v = 0.0
    seen = []
    for n in range(force.size):
        area = 0.0
        for i in range(STEPS):
            since = n + i / STEPS - delay
            number = math.floor(since + 1e-9)
            acts, last = (force[i] if i >= 0 else 0.0 for i in (number, number - 1))
            if converters.hold == "ramp":
                acts = last + (acts - last) * (since + 0.5 / STEPS - number)
            if converters.hold == "impulse":
                if number >= 0 and abs(since - number) < 0.5 / STEPS:
                    v += acts
                acts = 0.0
            half_x, half_v = x + 0.5 * v / STEPS, v + 0.5 * (acts - FRICTION * v - STIFFNESS * x) / STEPS
            x, v = x + half_v / STEPS, v + (acts - FRICTION * half_v - STIFFNESS * half_x) / STEPS
            area += half_x / STEPS
        seen.append(area if converters.sampling == "average" else x)
    return np.array(seen)


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 2.6])
def test_the_answer_to_a_record_of_forces_is_that_of_the_equation(hold: str, sampling: str, delay: float) -> None:
    force = np.random.default_rng(3).normal(size=25)
    converters = Converters(hold, sampling)
    motion = sampled_motion(FRICTION, STIFFNESS, delay, converters)
    before = np.concatenate([np.zeros(5), force])
    lates = range(motion.whole_delay, motion.whole_delay + len(motion.gains))
    forces = [before[5 - late : before.size - late] for late in lates]
    expected = stepped(force, delay, converters)
    assert np.max(np.abs(motion.answer_to(forces) - expected)) < 1e-5 * np.max(np.abs(expected))


def test_a_free_motion_and_one_under_a_constant_force_are_those_of_the_equation() -> None:
    motion = sampled_motion(FRICTION, STIFFNESS, 0.5, Converters("zoh", "ideal"))
    n = np.arange(1, 21)
    swing = math.sqrt(STIFFNESS - 0.25 * FRICTION**2)
    decay, phase = np.exp(-0.5 * FRICTION * n), swing * n
    pushed = decay * np.sin(phase) / swing
    pulled = decay * np.cos(phase) + 0.5 * FRICTION * pushed
    assert motion.free(20) == pytest.approx(np.column_stack([pulled, pushed]), abs=1e-12)
    assert motion.answer_at_once(np.ones(20)) == pytest.approx((1.0 - pulled) / STIFFNESS, abs=1e-11)
