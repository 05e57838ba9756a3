"""A coarse encoder: between two counts the force jumps, and a hand that cannot be held there never comes to rest.

The sensed position changes by the quantum D, a spring's force by K D. The bound of Abbott and Okamura (2005) for a
spring behind a zero-order hold, K <= min(2 b/T, 2 fc/D), and the boundary of Diolaiti et al. (2006) between rest and
cycle, fc/(K D) = 1/2, are the worst case: a wall halfway between two counts.
"""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hands import hand_scene, ran, spring, swing

MASS, PERIOD = 0.2, 1e-3
STIFFNESS = 2000.0
LAST = 10_000


def counts_of_the_end(
    quantum: float,
    *,
    friction: float,
    coulomb: float = 0.0,
    delay: float = 1.0,
    wall: float = 0.5,
    damping: float = 0.0,
    start: float = 20.0,
) -> np.ndarray:
    """The last sensed positions of a long run, in counts; `wall` and `start` are in counts too."""
    # The force's own steps are far finer than those that the encoder makes of it.
    most = 100.0 * (STIFFNESS + damping / PERIOD) * quantum
    scene = hand_scene(
        {"wall": {"type": "ground", "position": wall * quantum}, "touch": spring(STIFFNESS, damping)},
        device={"mass": MASS, "friction": friction, "delay": delay, "force_limit": most},
        mock={"quantum": quantum, "coulomb": coulomb, "initial": {"position": start * quantum}},
    )
    return ran(scene, 60_000).position_counts[-LAST:, 0]


def lag(delay: float) -> float:
    """s: of the delay and of the hold."""
    return (delay + 0.5) * PERIOD


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("delay", "margin", "quantum"),
    [(0.0, 1.2, 1e-6), (0.0, 4.0, 1e-4), (0.37, 1.2, 1e-5), (0.37, 4.0, 1e-6), (1.0, 1.2, 1e-4), (1.0, 4.0, 1e-5)],
)
def test_between_two_counts_a_hand_rests_only_where_dry_friction_holds_half_a_step(
    delay: float, margin: float, quantum: float
) -> None:
    friction, bound = margin * STIFFNESS * lag(delay), 0.5 * STIFFNESS * quantum
    held = counts_of_the_end(quantum, friction=friction, coulomb=1.001 * bound, delay=delay)
    cycling = counts_of_the_end(quantum, friction=friction, coulomb=0.999 * bound, delay=delay)
    assert np.unique(held).size == 1
    assert np.unique(cycling).tolist() == [0, 1]
    assert np.count_nonzero(np.diff(cycling)) > LAST // 20


@pytest.mark.parametrize("wall", [0.1, 0.25, 0.4])
def test_elsewhere_it_takes_what_the_nearest_count_is_off(wall: float) -> None:
    """K |wall - count|, at most the K D/2 of the sources: that one is enough for every wall and needed by one."""
    quantum, needed = 1e-5, wall * STIFFNESS * 1e-5
    friction = 2.0 * STIFFNESS * lag(1.0)
    held = counts_of_the_end(quantum, friction=friction, coulomb=1.001 * needed, wall=wall)
    cycling = counts_of_the_end(quantum, friction=friction, coulomb=0.999 * needed, wall=wall)
    assert np.unique(held).size == 1
    assert np.unique(cycling).size == 2


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(("delay", "margin"), list(itertools.product((0.0, 0.37, 1.0), (1.2, 2.0, 4.0))))
def test_without_dry_friction_the_cycle_is_a_quantum_large_whatever_the_quantum(delay: float, margin: float) -> None:
    """Describing function of a relay of K D/2 behind the lag: w² = (b/m)/lag. The counter-test to 'fine enough'."""
    friction = margin * STIFFNESS * lag(delay)
    predicted = math.sqrt(friction / MASS / lag(delay)) / (2.0 * math.pi)
    for quantum in (1e-6, 1e-5, 1e-4):
        counts = counts_of_the_end(quantum, friction=friction, delay=delay)
        half, before = swing(counts, LAST // 2)
        assert 0.5 <= half <= 2.5
        assert half == before
        crossings = np.count_nonzero(np.diff(np.sign(counts - 0.5)))
        assert 0.5 * crossings / (LAST * PERIOD) == pytest.approx(predicted, rel=0.2)


def test_on_a_count_it_rests_without_any_dry_friction_where_damping_is_ample() -> None:
    for start in (3.3, 20.0, 100.0):
        ample, scant = (
            counts_of_the_end(1e-5, friction=margin * STIFFNESS * lag(1.0), wall=0.0, start=start)
            for margin in (2.0, 1.05)
        )
        assert np.unique(ample).tolist() == [0]
        assert 1.0 <= swing(scant, LAST // 2)[0] <= 10.0  # it is linearly stable all the same


def test_a_simulated_damper_makes_the_step_larger_and_the_bound_of_a_spring_too_small() -> None:
    """A change of one count is a force of B D/T for a sample. The sources' bound has no damper in it."""
    quantum, bound = 1e-5, 0.5 * STIFFNESS * 1e-5
    rest = counts_of_the_end(quantum, friction=1.0, coulomb=2.0 * bound, damping=10.0)
    cycle = counts_of_the_end(quantum, friction=1.0, coulomb=1.001 * bound, damping=10.0)
    assert np.unique(rest).size == 1
    assert np.unique(cycle).tolist() == [0, 1]


def test_the_two_conditions_fail_apart() -> None:
    """Dry friction enough for the encoder but too little damping for the delay: at rest if touched, off if thrown."""
    bound = 0.5 * STIFFNESS * 1e-5
    touched, thrown = (counts_of_the_end(1e-5, friction=1.0, coulomb=1.05 * bound, start=start) for start in (5.0, 9.0))
    assert np.unique(touched).size == 1
    assert swing(thrown, LAST // 2)[0] > 100.0
