"""A contact from one side, hit at speed: what a bounce gives back, beside an event-by-event calculation of its own.

In touch a spring behind a lag is a negative damper, and half a swing of it is a bounce. Without friction the speed
after it is exp(-pi b/(2 m w)) times the speed before, with the (k, b) of the loop in touch, to the second order of wT.

With a damper in the contact, stability in touch says too little: the force never pulls, so what the damper would take
back as the hand leaves is not taken. Passivity (Colgate and Schenkel 1997) does bound a bounce, of any hand.
"""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim import predict
from hapsim.scene import Scene
from hapsim.theory import Configuration

sys.path.insert(0, str(Path(__file__).parent))
from hands import RATE, contact, hand_scene, ran

MASS, SPEED = 0.2, 0.1
PERIOD = 1.0 / RATE
PHASES = 5
CASES = list(itertools.product((200.0, 2000.0, 20000.0), (0.0, 0.37, 1.0)))


def thrown_at_a_wall(K: float, B: float, delay: float, friction: float, start: float) -> Scene:
    """A hand above a wall at 0, moving towards it."""
    return hand_scene(
        {"touch": contact(K, B)},
        device={"mass": MASS, "friction": friction, "delay": delay, "force_limit": 100.0},
        mock={"quantum": 1e-10, "initial": {"position": start, "velocity": -SPEED}},
    )


def calculated(
    K: float, B: float, delay: float, friction: float, start: float, ticks: int
) -> tuple[np.ndarray, np.ndarray]:
    """(positions, forces) at the samples, from the motion under a constant force and nothing of hapsim's."""
    whole = math.floor(delay)
    first = (delay - whole) * PERIOD
    positions, forces = [start], [0.0] * (whole + 2)
    x, v = start, -SPEED
    for _ in range(ticks):
        depth, growth = -positions[-1], 0.0 if len(positions) < 2 else positions[-2] - positions[-1]
        forces.append(max(0.0, K * depth + B * RATE * growth) if depth > 0.0 else 0.0)
        for force, lasts in ((forces[-2 - whole], first), (forces[-1 - whole], PERIOD - first)):
            if friction == 0.0:
                x, v = x + v * lasts + 0.5 * force / MASS * lasts**2, v + force / MASS * lasts
            else:
                ending, left = force / friction, math.exp(-friction / MASS * lasts)
                x, v = x + ending * lasts + (v - ending) * MASS / friction * (1.0 - left), ending + (v - ending) * left
        positions.append(x)
    return np.array(positions[:-1]), np.array(forces[whole + 2 :])


def starts() -> list[float]:
    """m: contact is made at every phase of a sample."""
    return [(1.0 + (i + 0.5) / PHASES) * SPEED * PERIOD for i in range(PHASES)]


def given_back(K: float, B: float, delay: float, friction: float) -> np.ndarray:
    """The speed after a bounce over the speed before it, as hapsim runs it, at every phase."""
    ticks = 60 + math.ceil(1.2 * math.pi * math.sqrt(MASS / K) * RATE + 3.0 * delay)
    found = []
    for start in starts():
        position = ran(thrown_at_a_wall(K, B, delay, friction, start), ticks).position[:, 0]
        left = 1 + int(np.flatnonzero(position < 0.0)[-1]) + math.ceil(delay) + 1
        found.append((position[left + 4] - position[left]) / (4.0 * PERIOD) / SPEED)
    return np.array(found)


@pytest.mark.thorough(keep=6)
@pytest.mark.parametrize(("K", "delay"), CASES)
@pytest.mark.parametrize(("B", "friction"), [(0.0, 0.0), (0.0, 2.0), (20.0, 0.5)])
def test_a_bounce_is_the_calculated_one(K: float, delay: float, B: float, friction: float) -> None:
    for start in starts()[::3]:
        trace = ran(thrown_at_a_wall(K, B, delay, friction, start), 300)
        position, force = calculated(K, B, delay, friction, start, 300)
        # Rounded positions and forces, multiplied by the loop's gain.
        assert np.abs(trace.position[:, 0] - position).max() < 1e-8
        assert np.abs(trace.force[:, 0] - force).max() < 1e-8 * max(K, B * RATE)


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(("K", "delay"), CASES)
def test_without_friction_every_bounce_is_faster_as_half_a_swing_in_touch_grows(
    K: float, delay: float, figures: Any
) -> None:
    k, b = Configuration(mass=MASS, rate=RATE, delay=delay).equivalent(K, 0.0)
    predicted = math.exp(-0.5 * math.pi * b / math.sqrt(MASS * k))
    found = given_back(K, 0.0, delay, 0.0)
    assert found.min() > 1.0
    off = 0.2 * K * PERIOD**2 / MASS + 1e-4
    assert found.mean() == pytest.approx(predicted, rel=off)
    assert np.ptp(found) <= 0.4 * K * PERIOD**2 / MASS  # what the phase of the contact makes of it
    figures.note(f"without friction, K = {K:g}, delay {delay:g}: a bounce is {found.mean() - 1.0:.1%} faster")


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(("K", "delay"), CASES)
def test_no_bounce_on_a_passive_wall_is_faster(K: float, delay: float) -> None:
    needed = float(Configuration(mass=MASS, rate=RATE, delay=delay).needed_friction(K, 0.0))
    assert given_back(K, 0.0, delay, 1.001 * needed).max() < 1.0
    assert given_back(K, 0.0, delay, 0.4 * needed).max() > 1.0


def test_passivity_asks_for_hardly_more_than_one_bounce_of_a_slow_swing_does() -> None:
    """And for a stiff wall for much more: it is for every hand, this one is known."""
    soft, stiff = (float(given_back(K, 0.0, 0.0, 0.8 * K * PERIOD / 2.0).max()) for K in (200.0, 20000.0))
    assert soft > 1.0
    assert stiff < 1.0


@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0])
def test_a_contact_that_is_stable_while_touched_may_throw_the_hand_back_faster(delay: float, figures: Any) -> None:
    B = 40.0
    configuration = Configuration(mass=MASS, rate=RATE, delay=delay)
    _, most = configuration.stable_stiffness(B)
    K = 0.9 * float(most)
    assert configuration.spectral_radius(K, B) < 0.99
    assert not configuration.is_passive(K, B)
    most_given_back = given_back(K, B, delay, 0.0).max()
    assert most_given_back > 1.05
    figures.note(f"stable while touched, delay {delay:g}: a bounce gives back {most_given_back:.2f} times the speed")
    assert given_back(0.5 * float(most), B, delay, 0.0).max() < 0.9


def sprung_back(K: float, B: float, friction: float) -> Scene:
    """A hand that a spring in the device brings back to the wall, each time as fast as it left."""
    return hand_scene(
        {"touch": contact(K, B)},
        device={"mass": MASS, "friction": friction, "delay": 1.0, "stiffness": 200.0, "force_limit": 1e5},
        mock={"quantum": 1e-8, "initial": {"position": 1e-3, "velocity": -SPEED}},
    )


def test_thrown_again_and_again_it_flies_ever_faster_though_the_contact_is_stable_in_touch() -> None:
    """`check` says of it that it is stable, and that it is not passive. Friction that makes it passive ends it."""
    B = 40.0
    configuration = Configuration(mass=MASS, rate=RATE, delay=1.0, stiffness=200.0)
    K = 0.9 * float(configuration.stable_stiffness(B)[1])
    (felt,) = predict(sprung_back(K, B, 0.0)).felt
    assert felt.stable
    assert felt.passive is False
    heights = []
    for friction in (0.0, 1.001 * float(configuration.needed_friction(K, B))):
        position = ran(sprung_back(K, B, friction), 4000).position[:, 0]
        heights.append([float(part.max()) for part in np.array_split(position, 4)])
    flying, resting = heights
    assert flying[3] > 1.5 * flying[1] > 1.5 * flying[0]
    assert resting[3] < 1e-2 * resting[0]
