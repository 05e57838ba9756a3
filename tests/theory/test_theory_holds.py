"""Holds that hapsim does not ship: what an entry of `HOLDS` can say, its transfer function and its motion agree on."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hapsim.theory import Configuration, Network, solve
from hapsim.theory.hand.impedance import late_and_held
from hapsim.theory.interface import HOLDS, Hold, HoldSegment, Term, damper_named

RATE = 1000.0
MASS = 0.3


def straight(fraction: float) -> list[HoldSegment]:
    """On from the newest force, by as much as that differs from the one before (first-order hold)."""
    late = HoldSegment(fraction, level=(0.0, 2.0 - fraction, fraction - 1.0), slope=(0.0, 1.0, -1.0))
    return [late, HoldSegment(1.0 - fraction, level=(1.0,), slope=(1.0, -1.0))]


def from_one_to_the_next(fraction: float) -> list[HoldSegment]:
    """From the force before to the newest, a period late."""
    late = HoldSegment(fraction, level=(0.0, 1.0 - fraction, fraction), slope=(0.0, 1.0, -1.0))
    return [late, HoldSegment(1.0 - fraction, level=(0.0, 1.0), slope=(1.0, -1.0))]


def mean_of_two(fraction: float) -> list[HoldSegment]:
    return [HoldSegment(fraction, level=(0.0, 0.5, 0.5)), HoldSegment(1.0 - fraction, level=(0.5, 0.5))]


def half_as_long(fraction: float) -> list[HoldSegment]:
    """Twice the force for half a period."""
    if fraction < 0.5:
        ends = fraction + 0.5
        return [HoldSegment(fraction), HoldSegment(0.5, level=(2.0,)), HoldSegment(1.0 - ends)]
    ends = fraction - 0.5
    return [HoldSegment(ends, level=(0.0, 2.0)), HoldSegment(0.5), HoldSegment(1.0 - fraction, level=(2.0,))]


def two_blows(fraction: float) -> list[HoldSegment]:
    """A quarter of the impulse at once, the others half a period later."""
    if fraction < 0.5:
        last = HoldSegment(0.5 - fraction, kick=(0.75,))
        return [HoldSegment(fraction), HoldSegment(0.5, kick=(0.25,)), last]
    begin = HoldSegment(fraction - 0.5)
    return [begin, HoldSegment(0.5, kick=(0.0, 0.75)), HoldSegment(1.0 - fraction, kick=(0.25,))]


def blow_and_level(fraction: float) -> list[HoldSegment]:
    return [HoldSegment(fraction, level=(0.0, 0.6)), HoldSegment(1.0 - fraction, kick=(0.4,), level=(0.6,))]


def sawtooth(fraction: float) -> list[HoldSegment]:
    """Half as much again, that goes down to half."""
    late = HoldSegment(fraction, level=(0.0, 0.5 + fraction), slope=(0.0, -1.0))
    return [late, HoldSegment(1.0 - fraction, level=(1.5,), slope=(-1.0,))]


OTHERS = {
    "straight": Hold(
        tuple(Term(weight, lag, i) for i in (1, 2) for lag, weight in enumerate((1.0, -2.0, 1.0))), straight
    ),
    "from one to the next": Hold((Term(1.0, 0.0, 2), Term(-2.0, 1.0, 2), Term(1.0, 2.0, 2)), from_one_to_the_next),
    "mean of two": Hold((Term(0.5, 0.0, 1), Term(-0.5, 2.0, 1)), mean_of_two),
    "half as long": Hold((Term(2.0, 0.0, 1), Term(-2.0, 0.5, 1)), half_as_long),
    "two blows": Hold((Term(0.25, 0.0, 0), Term(0.75, 0.5, 0)), two_blows),
    "blow and level": Hold((Term(0.4, 0.0, 0), Term(0.6, 0.0, 1), Term(-0.6, 1.0, 1)), blow_and_level),
    "sawtooth": Hold((Term(1.5, 0.0, 1), Term(-1.0, 0.0, 2), Term(-0.5, 1.0, 1), Term(1.0, 1.0, 2)), sawtooth),
}
LAGS = {"zoh": 0.5, "impulse": 0.0, "straight": 0.0, "from one to the next": 1.0, "mean of two": 1.0}
LAGS |= {"half as long": 0.25, "two blows": 0.375, "blow and level": 0.3, "sawtooth": 5 / 12}


@pytest.fixture(autouse=True)
def _others_too(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, hold in OTHERS.items():
        monkeypatch.setitem(HOLDS, name, hold)


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.5, 1.0, 1.7])
@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("hold", OTHERS)
def test_its_poles_are_those_of_its_motion(hold: str, sampling: str, delay: float) -> None:
    for friction, spring, damper in itertools.product((0.0, 2.0), (0.0, 500.0), ("backward", "sensed")):
        c = Configuration(MASS, RATE, friction, delay, hold, sampling, spring, damper)
        for K, B in ((3e3, 4.0), (4e4, 30.0), (100.0, -2.0)):
            link = damper_named(damper, None, RATE)
            network = Network(
                RATE, [MASS], [friction], delay, hold, sampling, [], [[0, -1]], [K], [B], [spring], [link]
            )
            found, expected = (poles[np.abs(poles) > 1e-3] for poles in (solve(network).poles, c.poles(K, B)))
            assert found.size == expected.size
            assert np.abs(found[:, None] - expected).min(axis=1).max() < 1e-10


@pytest.mark.parametrize("hold", HOLDS | OTHERS)
def test_its_lag_is_what_its_transfer_function_says(hold: str) -> None:
    theta = 1e-3
    through = late_and_held(np.array([theta]), 0.0, hold, "ideal")[0]
    assert abs(through) == pytest.approx(1.0, abs=1e-6)
    assert HOLDS[hold].lag == pytest.approx(-np.angle(through) / theta, abs=1e-6)
    assert HOLDS[hold].lag == pytest.approx(LAGS[hold], abs=1e-15)


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("hold", HOLDS | OTHERS)
def test_its_mean_force_is_that_of_the_computed_ones(hold: str, fraction: float) -> None:
    segments = HOLDS[hold].segments(fraction)
    given = (sum(kick) + d * sum(level) + 0.5 * d**2 * sum(slope) for d, kick, level, slope in segments)
    assert sum(given) == pytest.approx(1.0, abs=1e-15)
    assert sum(segment.duration for segment in segments) == pytest.approx(1.0, abs=1e-15)
