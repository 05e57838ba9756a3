"""Stiffness over fourteen decades: where the rounding of positions hides a spring, and until where theory keeps its
digits.

In position form a step is x + (x - x_before) - (K T²/m) d. Where (K T²/m) d is less than half the last digit of x it
adds nothing: the mass stands still. Around x = 0 the digits move along with the motion, and that never happens.
"""

from __future__ import annotations

import json
import math
import os
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, ticks_watched
from hapsim.cordis.program import Program, compile_scene, numbers_of, positions_of
from hapsim.scene import parse_scene
from hapsim.theory import Configuration

RATE, MASS, AMPLITUDE = 1000.0, 1e-3, 1e-3
# Two hundred million samples; HAPSIM_POINTS=1 takes it along.
SOFTEST = [("double", 0.0, 1e-14, 1e-4)] if "HAPSIM_POINTS" in os.environ else []


def upward_crossings(program: Program, point: int, centre: float, wanted: int, most: int) -> np.ndarray:
    """Samples at which a point passes `centre` upwards, interpolated: `wanted` of them, in `most` samples."""
    weights = np.zeros(program.rows.shape[1])
    weights[point] = 1.0
    found: list[float] = []
    before, done = float(positions_of(program)[0][point]) - centre, 0
    while len(found) < wanted and done < most:
        watched = np.empty(min(most - done, 1 << 20))
        ticks_watched(program, list(program.rows), weights, watched)
        now = watched - centre
        earlier = np.append(before, now[:-1])
        crossed = np.flatnonzero((earlier < 0.0) & (now >= 0.0))
        found += (done + 1 + crossed - now[crossed] / (now - earlier)[crossed]).tolist()
        before, done = now[-1], done + now.size
    return np.array(found[:wanted])


def frequency_off(kappa: float, precision: str, at: float, periods: float = 4.0) -> float:
    """Returns the relative error of the frequency of a ball on a spring to a wall at `at` m, from arccos(1 - kappa/2);
    NaN if it does not oscillate within some periods."""
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground", "position": at},
        "ball": {"type": "mass", "mass": MASS, "position": at + AMPLITUDE},
        "link": {"type": "viscoelastic", "between": ["ball", "wall"], "stiffness": kappa * MASS * RATE**2},
    }
    document = {"version": 1, "rate": RATE, "precision": precision, "device": {"mass": 0.2}, "modules": modules}
    scene = parse_scene(json.dumps(document))
    program = compile_scene(scene)
    start(program, np.zeros(1))
    period = math.pi / math.asin(0.5 * math.sqrt(kappa))
    found = upward_crossings(program, numbers_of(scene)["ball"], at, 3, int(periods * period) + 10)
    return float((period * (found.size - 1) / (found[-1] - found[0]) - 1.0) if found.size > 1 else np.nan)


@pytest.mark.parametrize(
    ("precision", "at", "kappa", "most"),
    [
        ("double", 0.0, 1e-3, 1e-6),
        ("double", 0.0, 1e-6, 1e-9),
        ("double", 0.0, 1e-9, 1e-9),
        ("double", 0.0, 1e-12, 1e-5),
        *SOFTEST,
        ("double", 1.0, 1e-9, 1e-6),
        ("double", 1.0, 1e-10, 1e-4),
        ("double", 1.0, 1e-11, 1e-3),
        ("double", 1.0, 1e-12, 3e-2),
        ("single", 0.0, 1e-4, 1e-4),
        ("single", 0.0, 1e-6, 2e-2),
        ("single", 0.0, 1e-7, 1e-1),
        ("single", 1.0, 1e-2, 1e-3),
        ("single", 1.0, 1e-3, 3e-2),
        ("single", 1.0, 1e-4, 2e-1),
    ],
)
def test_a_soft_spring_still_rings_at_its_frequency(
    precision: str, at: float, kappa: float, most: float, figures: Any
) -> None:
    off = abs(frequency_off(kappa, precision, at))
    assert off < most
    figures.note(f"K T²/m = {kappa:g}, {precision}, {at:g} m from 0: the frequency is off by {off:.0e}")


@pytest.mark.parametrize(("precision", "digit"), [("double", 2.0**-52), ("single", 2.0**-23)])
def test_next_to_a_large_offset_a_softer_one_stands_still(precision: str, digit: float) -> None:
    """Half a digit of 1 m over the amplitude: below it the mass never moves, ten times above it does."""
    edge = 0.5 * digit / AMPLITUDE
    assert math.isnan(frequency_off(0.9 * edge, precision, 1.0, 2.0))
    assert abs(frequency_off(10.0 * edge, precision, 1.0)) < 0.05


@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 2.0])
@pytest.mark.parametrize("decade", range(-12, 1, 2))
def test_a_predicted_limit_is_one_over_twelve_decades(decade: int, delay: float) -> None:
    """The device's friction makes the limit: the loop's poles are inside the circle just below it, outside above."""
    friction = 10.0**decade * (delay + 0.5) * 0.2 * RATE
    configuration = Configuration(mass=0.2, rate=RATE, friction=friction, delay=delay)
    _, most = configuration.stable_stiffness(0.0)
    kappa, _ = configuration.normalised(most, 0.0)
    assert 0.1 * 10.0**decade < kappa < 4.0
    assert configuration.is_stable(0.999 * most, 0.0)
    assert not configuration.is_stable(1.001 * most, 0.0)
    _, below = configuration.equivalent(0.999 * most, 0.0)
    _, above = configuration.equivalent(1.001 * most, 0.0)
    if np.isfinite(below + above):
        # At the limit both are nothing beside the friction that they are the difference to.
        assert 0.0 < below < 2e-2 * friction
        assert -2e-2 * friction < above < 0.0
