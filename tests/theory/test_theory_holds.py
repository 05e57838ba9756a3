"""Holds and samplings that hapsim does not ship: on what an entry can say, transfer function and motion agree."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hapsim.holds import HOLDS, Piece, Term
from hapsim.theory import Configuration, Network, solve
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.device_step import device_step
from hapsim.theory.interface import SAMPLINGS, Sampling, damper_named, delay_and_hold, hold_lag, hold_segments
from tests.device_answer import channel_answer
from tests.unshipped_holds import LAGS as UNSHIPPED_LAGS
from tests.unshipped_holds import UNSHIPPED

RATE = 1000.0
MASS = 0.3


LAGS = {"zoh": 0.5, "impulse": 0.0, "ramp": 1.0} | UNSHIPPED_LAGS


#: Samplings that hapsim does not ship either.
WINDOWS = {
    f"the last {window:g}": Sampling((Term(1.0 / window, 0.0, 1), Term(-1.0 / window, window, 1)), window)
    for window in (0.5, 0.3)
}


@pytest.fixture(autouse=True)
def _others_too(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, sampling in WINDOWS.items():
        monkeypatch.setitem(SAMPLINGS, name, sampling)
    for name, hold in UNSHIPPED.items():
        monkeypatch.setitem(HOLDS, name, hold)


@pytest.mark.thorough(keep=10)
@pytest.mark.parametrize("delay", [0.0, 0.3, 0.5, 1.0, 1.7])
@pytest.mark.parametrize("sampling", SAMPLINGS | WINDOWS)
@pytest.mark.parametrize("hold", HOLDS | UNSHIPPED)
def test_its_poles_are_those_of_its_motion(hold: str, sampling: str, delay: float) -> None:
    turn = round(10.0 * delay) % 2
    each = itertools.product((0.0, 2.0), (0.0, 500.0), ("backward", "sensed"))
    # Any two of these meet at every delay, all three at some.
    some = [one for one in each if ((one[0] > 0.0) + (one[1] > 0.0) + (one[2] == "sensed") + turn) % 2 == 0]
    for n, (friction, spring, damper) in enumerate([*some, (500.0, 0.0, "backward")]):
        c = Configuration(MASS, RATE, friction, delay, hold, sampling, spring, damper)
        for K, B in ((3e3, 4.0), (4e4, 30.0), (100.0, -2.0), (1e6, -300.0))[n % 2 :: 2]:
            link = damper_named(damper, None, RATE)
            network = Network(
                RATE, [MASS], [friction], delay, hold, sampling, [], [[0, -1]], [K], [B], [spring], [link]
            )
            found, expected = (poles[np.abs(poles) > 1e-3] for poles in (solve(network).poles, c.poles(K, B)))
            assert found.size == expected.size
            assert np.abs(found[:, None] - expected).min(axis=1).max() < 1e-10


@pytest.mark.parametrize("hold", HOLDS | UNSHIPPED)
def test_its_lag_is_that_of_its_transfer_function(hold: str) -> None:
    theta = 1e-3
    through = delay_and_hold(np.array([theta]), 0.0, hold, "ideal")[0]
    assert abs(through) == pytest.approx(1.0, abs=1e-6)
    assert hold_lag(hold) == pytest.approx(-np.angle(through) / theta, abs=1e-6)


@pytest.mark.parametrize("hold", LAGS)
def test_its_lag_is_to_rounding(hold: str) -> None:
    assert hold_lag(hold) == pytest.approx(LAGS[hold], abs=1e-15)
    assert HOLDS[hold].mean_delay == pytest.approx(LAGS[hold], abs=1e-15)


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("hold", HOLDS | UNSHIPPED)
def test_its_transfer_function_and_its_pieces_in_time_are_the_same_hold(hold: str, fraction: float) -> None:
    """The force in the middle of 20 parts of a period, and the impulses up to there, for each age of a force."""
    told, derived = HOLDS[hold].pieces(fraction), hold_segments(hold, fraction)
    assert sum(piece.duration for piece in told) == pytest.approx(1.0, abs=1e-15)
    assert sum(piece.duration for piece in derived) == pytest.approx(1.0, abs=1e-15)
    for time in np.arange(0.025, 1.0, 0.05):
        np.testing.assert_allclose(force_at(told, time), force_at(derived, time), atol=1e-14)


def force_at(pieces: list[Piece], time: float) -> Floats:
    """(2, 4): the weights of forces and of impulses so far."""
    made, begin = np.zeros((2, 4)), 0.0
    for duration, impulse, level, slope in pieces:
        if begin <= time:
            made[1, : len(impulse)] += impulse
            made[0] = 0.0
            made[0, : len(level)] += level
            made[0, : len(slope)] += np.array(slope) * (time - begin)
        begin += duration
    return made


@pytest.mark.parametrize("sampling", SAMPLINGS | WINDOWS)
@pytest.mark.parametrize("hold", HOLDS | UNSHIPPED)
def test_what_is_read_of_a_force_closes_the_loop_at_its_poles(hold: str, sampling: str) -> None:
    """1 + (K x + B v) T²/m at each, of a spring and a damper that senses."""
    for delay in (0.0, 0.3, 1.7):
        c = Configuration(MASS, RATE, 2.0, delay, hold, sampling, 500.0, "sensed")
        K, B, unit = 4e4, 30.0, MASS * RATE**2
        poles = c.poles(K, B)
        poles = poles[np.abs(poles) > 0.05]
        step = device_step(2.0 / (MASS * RATE), delay, hold, 500.0 / unit, sampling)
        x, v = channel_answer(step, poles, poles - 1.0)
        assert np.abs(1.0 + K / unit * x + B * RATE / unit * v).max() < 1e-8


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("near", [0, 1, 3])
def test_a_delay_next_to_whole_samples_is_one_of_these(hold: str, near: int) -> None:
    """A fraction below 1e-9 has too few digits; a larger one changes as much as it is."""

    def poles_at(off: float) -> Complexes:
        hand = Configuration(mass=MASS, friction=1.0, rate=RATE, delay=max(near + off, 0.0), hold=hold)
        return np.asarray(hand.poles(1000.0, 5.0))

    whole = poles_at(0.0)
    for off in (-0.9e-9, -1e-12, 1e-12, 0.9e-9):
        assert np.array_equal(poles_at(off), whole)
    for off in (-1.1e-9, 1.1e-9):
        assert np.abs(poles_at(off)[:2] - whole[:2]).max() < 1e-8
