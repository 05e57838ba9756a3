"""A force at its limit: the loop feels a smaller gain, so an unstable one may end in a cycle of constant size.

Describing function of saturation at F: a sinusoidal force of amplitude r F passes as N(r) of it. Where the loop is
unstable at its full gain and stable at N, the amplitude settles where N(r) brings (N K, N B) onto the limit of
stability. Where no gain is stable (no friction) it never settles: the force is bounded, the motion is not.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from hapsim.loop.ring import LIMITED
from hapsim.theory import Configuration

sys.path.insert(0, str(Path(__file__).parent))
from hands import RATE, hand_scene, ran, spring, swing

MASS, LIMIT = 0.2, 1.0
LAST = 20_000
# K, B, delay, friction, and how far the first harmonic may be off: the more the deeper it is cut.
CASES = [
    (2000.0, 0.0, 1.0, 2.8, 0.01),
    (2000.0, 0.0, 1.0, 2.0, 0.05),
    (2500.0, 2.0, 1.0, 1.0, 0.08),
    (2000.0, 0.0, 0.0, 0.5, 0.08),
    (3000.0, 0.0, 0.37, 1.0, 0.12),
    (20000.0, 20.0, 1.0, 1.0, 0.3),
]


def gain_of_saturation(ratio: float) -> float:
    """Returns the describing function of saturation for a sinusoid `ratio` >= 1 times the limit."""
    return 2.0 / math.pi * (math.asin(1.0 / ratio) + math.sqrt(1.0 - 1.0 / ratio**2) / ratio)


def predicted_cycle(configuration: Configuration, K: float, B: float) -> tuple[float, float, float, float]:
    """(m, radians per sample, share of the ticks that are cut, gain of the limit)."""
    gain = brentq(lambda g: float(configuration.spectral_radius(g * K, g * B)) - 1.0, 0.02, 1.0, xtol=1e-12)
    theta = abs(np.angle(configuration.poles(gain * K, gain * B)[0]))
    ratio = brentq(lambda r: gain_of_saturation(r) - gain, 1.0, 1e4)
    per_metre = abs(K + B * RATE * (1.0 - np.exp(-1j * theta)))
    return ratio * LIMIT / per_metre, float(theta), 2.0 / math.pi * math.acos(1.0 / ratio), float(gain)


@pytest.mark.parametrize(("K", "B", "delay", "friction", "off"), CASES)
def test_an_unstable_loop_at_its_force_limit_swings_as_its_describing_function_predicts(
    K: float, B: float, delay: float, friction: float, off: float, figures: Any
) -> None:
    configuration = Configuration(mass=MASS, rate=RATE, friction=friction, delay=delay)
    amplitude, theta, share, gain = predicted_cycle(configuration, K, B)
    scene = hand_scene(
        {"touch": spring(K, B)},
        device={"mass": MASS, "friction": friction, "delay": delay, "force_limit": LIMIT},
        mock={"initial": {"velocity": 0.01}},
    )
    trace = ran(scene, 3 * LAST)
    half, before = swing(trace.position[:, 0], LAST)
    assert half == pytest.approx(before, rel=1e-3)
    assert half == pytest.approx(amplitude, rel=off)
    crossings = np.count_nonzero(np.diff(np.sign(trace.position[-LAST:, 0])))
    assert math.pi * crossings / LAST == pytest.approx(theta, rel=off)
    cut = trace.flags & LIMITED > 0
    assert np.mean(cut[-LAST:]) == pytest.approx(share, abs=0.06)
    assert trace.report.limited_ticks == np.count_nonzero(cut)
    assert np.abs(trace.force).max() <= LIMIT
    figures.note(
        f"at the force limit, gain {gain:.2f}: {1e3 * half:.2f} mm, off by {half / amplitude - 1.0:+.1%}, "
        f"the frequency by {math.pi * crossings / LAST / theta - 1.0:+.1%}, "
        f"the share of cut ticks by {np.mean(cut[-LAST:]) - share:+.3f}"
    )


def test_without_friction_the_force_is_bounded_and_the_swing_is_not(figures: Any) -> None:
    scene = hand_scene(
        {"touch": spring(2000.0)},
        device={"mass": MASS, "delay": 1.0, "force_limit": LIMIT},
        mock={"quantum": 1e-9, "initial": {"velocity": 0.01}},
    )
    trace = ran(scene, 180_000)
    blocks = np.abs(trace.position[:, 0]).reshape(18, -1).max(axis=1)
    assert np.all(np.diff(blocks) > 0.05)  # m in each ten seconds
    assert blocks[-1] > 100.0 * LIMIT / 2000.0
    assert np.abs(trace.force).max() <= LIMIT
    assert trace.report.limited_ticks > 0.95 * trace.report.ticks
    figures.note(
        f"at the force limit without friction: {blocks[1]:.2f} m after 20 s, {blocks[17]:.2f} m after 180 s, "
        f"{100.0 * np.mean(np.diff(blocks)):.1f} mm/s"
    )
