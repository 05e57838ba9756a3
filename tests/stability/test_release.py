"""A hand that lets go: what is left is the device's own mass, and with it another loop.

A spring behind a lag has nearly the same limit at every mass, (b0 + B)/lag. A damper has not: B T/m grows as the hand
leaves, and from a certain lightness on the loop that held with the hand shakes without it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from hapsim import predict
from hapsim.recording.trace import Trace
from hapsim.theory import Configuration

sys.path.insert(0, str(Path(__file__).parent))
from hands import RATE, hand_scene, ran, spring

HELD = 0.25  # kg, device and hand
FRICTION = 1.0


def lightest(K: float, B: float, delay: float) -> float:
    """kg: the mass at which the loop is at its limit; heavier ones are stable, up to that with the hand."""

    def beyond(mass: float) -> float:
        return float(Configuration(mass=mass, rate=RATE, friction=FRICTION, delay=delay).spectral_radius(K, B)) - 1.0

    grid = np.geomspace(0.002, HELD, 80)
    last = int(np.flatnonzero([beyond(mass) > 0.0 for mass in grid])[-1])
    return float(brentq(beyond, grid[last], grid[last + 1], xtol=1e-12))


def released(K: float, B: float, delay: float, mass: float, start: tuple[float, float], ticks: int) -> Trace:
    """A run of a scene that is written for the hand, on a device that has `mass` kg."""
    scene = hand_scene(
        {"touch": spring(K, B)},
        device={"mass": HELD, "friction": FRICTION, "delay": delay, "force_limit": 10.0},
        mock={"mass": mass, "initial": {"position": start[0], "velocity": start[1]}},
    )
    assert predict(scene).stable  # of what the scene says
    return ran(scene, ticks)


def change(trace: Trace) -> float:
    """Logarithm of how much larger the last quarter is than the second."""
    position = trace.position[8:, 0]
    position = position[: int(np.argmax(np.abs(position) > 1e-3)) or None]  # before the force limit has a part in it
    quarters = np.array_split(position, 4)
    return float(np.log(np.std(quarters[-1]) / np.std(quarters[1])))


@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0])
@pytest.mark.parametrize(("K", "B"), [(500.0, 40.0), (2000.0, 60.0)])
def test_the_least_mass_that_holds_is_the_predicted_one(K: float, B: float, delay: float) -> None:
    mass = lightest(K, B, delay)
    assert 0.0 < mass < 0.5 * HELD
    lighter, heavier = (change(released(K, B, delay, factor * mass, (0.0, 1e-4), 2000)) for factor in (0.999, 1.001))
    assert heavier < 0.0 < lighter


def test_a_hand_that_lets_go_in_the_middle_leaves_a_device_that_shakes() -> None:
    """First with the hand; then the device alone, from where the hand had brought it and as fast."""
    K, B, delay = 2000.0, 40.0, 1.0
    alone = 0.9 * lightest(K, B, delay)
    held = released(K, B, delay, HELD, (1e-3, 0.0), 200)
    assert change(held) < -0.5
    x = held.position[-3:, 0]
    after = released(K, B, delay, alone, (float(x[-1]), float(x[-1] - x[-2]) * RATE), 600)
    assert np.abs(after.position[-50:, 0]).max() > 10.0 * np.abs(x).max()
    assert np.abs(after.force).max() <= 10.0  # the guard holds
    assert after.report.limited_ticks > 0


def test_a_spring_alone_has_nearly_the_same_limit_at_every_mass() -> None:
    limits = [
        float(Configuration(mass=mass, rate=RATE, friction=FRICTION, delay=1.0).stable_stiffness(0.0)[1])
        for mass in (0.05, 0.25, 1.0)
    ]
    rule = FRICTION / (1.5 / RATE)
    assert limits == pytest.approx([rule] * 3, rel=0.01)
