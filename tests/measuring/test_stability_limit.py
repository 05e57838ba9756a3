"""The stability limit on the running system: just below it a ring-down dies away, just above it grows."""

from __future__ import annotations

import itertools
import os
from functools import cache
from typing import Any

import numpy as np
import pytest
from scenes import with_configuration

from hapsim.errors import DeviceError
from hapsim.running import run
from hapsim.theory import Configuration

MASS, RATE = 0.2, 1000.0
DAMPERS = {"backward": None, "centred": None, "filtered": 90.0, "sensed": None}
CONFIGURATIONS = list(
    itertools.product(("zoh", "impulse"), ("ideal", "average"), (0.0, 0.37, 1.0, 1.5, 2.0), DAMPERS, (0.0, 0.02))
)
# A point in each second one, 80: every two of their values meet. HAPSIM_POINTS=3 takes three points in each of all.
POINTS_EACH = int(os.environ.get("HAPSIM_POINTS", "0"))
TICKS = 12_000
BATCHES = 8
START = 8  # samples, for the fast motions to have died away
BLOCK = 20
QUANTUM = 1e-11  # m


@cache
def points() -> list[tuple[Configuration, float, float]]:
    """Configurations, each with a damping and the largest stable stiffness for it."""
    rng = np.random.default_rng(17)
    chosen = []
    for hold, sampling, delay, damper, spring in CONFIGURATIONS:
        values = (hold == "zoh", sampling == "ideal", delay > 1.0, list(DAMPERS).index(damper), spring > 0.0)
        if not POINTS_EACH and sum(values) % 2:
            continue
        configuration = Configuration(
            mass=MASS,
            rate=RATE,
            friction=float(rng.choice([0.0, 0.4])) + 0.1,
            delay=delay,
            hold=hold,
            sampling=sampling,
            stiffness=spring * MASS * RATE**2,
            damper=damper,
            cutoff=DAMPERS[damper],
        )
        for _ in range(POINTS_EACH or 1):
            chosen.append((configuration, *_limit(configuration, rng)))
    return chosen


def _limit(configuration: Configuration, rng: np.random.Generator) -> tuple[float, float]:
    """(B, K): the curve b = 0 where it limits, for a swing of 10 to 200 Hz."""
    while True:
        B = configuration.damping_unit * 10.0 ** rng.uniform(-1.7, -0.1)
        least, most = configuration.stable_stiffness(B)
        if most > max(least, 0.0) and most > 1e-3 * configuration.stiffness_unit:
            return float(B), float(most)


def growth(configuration: Configuration, K: float, B: float) -> float:
    """Returns the logarithm of the growth of a ring-down from its first third to its last."""
    scene = with_configuration(configuration, K, B, velocity=0.01, quantum=QUANTUM, force_limit=1e6)
    try:
        trace = run(scene, duration=TICKS / RATE)
    except DeviceError as error:  # it grew out of the range of its counts
        if error.trace is None:
            raise
        trace = error.trace
    position = _usable(trace.position[START:, 0])
    third = position.size // 3
    first, last = (np.sqrt(np.mean(part**2)) for part in (position[:third], position[-third:]))
    return float(np.log(last / first))


def _usable(position: np.ndarray) -> np.ndarray:
    """Returns the part of a record above the rounding and below the end of the sensor's scale."""
    blocks = np.abs(position[: position.size // BLOCK * BLOCK]).reshape(-1, BLOCK).max(axis=1)
    out = np.flatnonzero((blocks < 3e3 * QUANTUM) | (blocks > 1e-2 * 2.0**31 * QUANTUM))
    return position[: BLOCK * max(int(out[0]) if out.size else blocks.size, 3)]


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("batch", range(BATCHES))
def test_just_below_the_limit_a_ring_down_decays_and_just_above_it_grows(batch: int, figures: Any) -> None:
    for configuration, B, K in points()[batch::BATCHES]:
        below, above = growth(configuration, 0.999 * K, B), growth(configuration, 1.001 * K, B)
        assert below < 0.0 < above, (configuration, B, K, below, above)
        figures.count("points at which 0.999 of the limit dies away and 1.001 grows", 1)
    assert len(points()) >= 80
    assert {configuration.damper for configuration, _, _ in points()} == set(DAMPERS)
