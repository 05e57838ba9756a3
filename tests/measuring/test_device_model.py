"""The model that a device is fitted with, beside the same equation stepped very finely."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hapsim.holds import HOLDS
from hapsim.measuring.converters import Converters
from hapsim.measuring.device_model import sampled_motion

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
