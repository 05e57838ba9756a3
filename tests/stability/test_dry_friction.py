"""Dry friction in the device: a loop without enough damping rests when touched and grows when pushed.

To a swing of amplitude A at w dry friction fc is, by its describing function, a damping of 4 fc/(pi w A). Where the
loop's own damping b is negative the two are equal at the amplitude A = 4 fc/(pi w |b|): smaller ones die, larger grow.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.theory import Configuration

sys.path.insert(0, str(Path(__file__).parent))
from hands import RATE, hand_scene, ran, spring

MASS = 0.2
CASES = [
    (200.0, 1.0, 0.10, 0.01),
    (200.0, 1.0, 0.25, 0.01),
    (2000.0, 0.0, 0.5, 0.01),
    (2000.0, 0.37, 1.0, 0.1),
    (2000.0, 1.0, 1.0, 0.01),
    (2000.0, 1.0, 2.5, 1.0),
]
TICKS = 80_000


def threshold(stiffness: float, delay: float, friction: float, coulomb: float) -> tuple[float, float]:
    """(m, radians per sample): the amplitude at which dry friction makes up for the loop's lack of damping."""
    configuration = Configuration(mass=MASS, rate=RATE, friction=friction, delay=delay)
    k, b = configuration.equivalent(stiffness, 0.0)
    assert b < 0.0  # the loop is unstable, as far as linear theory goes
    w = math.sqrt(k / MASS)
    return 4.0 * coulomb / (math.pi * w * -b), w / RATE


def last_swing(stiffness: float, delay: float, friction: float, coulomb: float, start: float) -> float:
    """m: how far a hand, released at `start`, swings in the end."""
    scene = hand_scene(
        {"touch": spring(stiffness)},
        device={"mass": MASS, "friction": friction, "delay": delay, "force_limit": 1000.0},
        mock={"coulomb": coulomb, "initial": {"position": start}, "quantum": 1e-9 * max(start, 1e-5) / 1e-5},
    )
    return float(np.abs(ran(scene, TICKS).position[-2000:, 0]).max())


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(("stiffness", "delay", "friction", "coulomb"), CASES)
def test_the_threshold_is_that_of_the_describing_function(
    stiffness: float, delay: float, friction: float, coulomb: float, figures: Any
) -> None:
    """Within an eighth of the radians per sample: what the describing function leaves out is of that order."""
    amplitude, theta = threshold(stiffness, delay, friction, coulomb)
    dies, grows = 1.0 - 0.15 * theta, 1.0 + 0.05 * theta
    below, above = (last_swing(stiffness, delay, friction, coulomb, factor * amplitude) for factor in (dies, grows))
    assert below <= 1.001 * coulomb / stiffness  # where the spring cannot overcome it any more
    assert above > 1.5 * amplitude
    for _ in range(3):
        between = 0.5 * (dies + grows)
        if last_swing(stiffness, delay, friction, coulomb, between * amplitude) < between * amplitude:
            dies = between
        else:
            grows = between
    figures.note(
        f"dry friction, wT = {theta:.2f}, delay {delay:g}, {coulomb:g} N: the threshold is "
        f"{1.0 - grows:.2%} to {1.0 - dies:.2%} below the describing function's"
    )


def test_the_threshold_grows_with_the_friction_and_nothing_stays_stable_for_all() -> None:
    for coulomb in (0.01, 0.1, 1.0):
        amplitude, _ = threshold(2000.0, 1.0, 1.0, coulomb)
        assert last_swing(2000.0, 1.0, 1.0, coulomb, 0.9 * amplitude) <= 1.001 * coulomb / 2000.0
        assert last_swing(2000.0, 1.0, 1.0, coulomb, 1.1 * amplitude) > 10.0 * amplitude
