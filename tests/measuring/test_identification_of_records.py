"""Identification of records: known motions, gaps, offsets, growth, silence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from records import QUANTUM, trace_of
from scenes import one_spring

import hapsim
from hapsim.errors import UsageError
from hapsim.loop.ring import BRIDGED, LATE_FORCE, OFF_GRID, ROWS, UNSENT
from hapsim.measuring.measure_trace import measure_trace
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.scene import Scene


@pytest.mark.parametrize("ratio", [0.02, 0.3, 0.9, 1.5])
def test_a_known_oscillation_is_read_off_without_any_simulator(ratio: float) -> None:
    """A sampled real spring: s from m s² + b s + k, the position written down in closed form."""
    mass, frequency, n = 0.5, 90.0, np.arange(1500)
    s = frequency * (-ratio + np.array([1, -1]) * np.sqrt(complex(ratio**2 - 1)))
    motion = np.real((np.exp(s[0] * n / 1000) - np.exp(s[1] * n / 1000)) / (s[0] - s[1])) * 0.2
    position = np.rint(motion / QUANTUM) * QUANTUM
    # The law is linear in the two newest positions, as a scene's is; which one it is does not matter.
    asked = -3000.0 * position - 2000.0 * np.diff(position, prepend=position[:1])
    measured = measure_trace(trace_of(motion, asked), mass)
    assert measured.dominant
    assert measured.k == pytest.approx(mass * frequency**2, rel=1e-4)
    assert measured.b == pytest.approx(2 * ratio * mass * frequency, rel=1e-4)


def test_a_wall_away_from_zero_makes_no_difference() -> None:
    here = measure_trace(run(one_spring(2000.0, 5.0, friction=1.0), duration=1.0), 0.2)
    there = measure_trace(run(one_spring(2000.0, 5.0, friction=1.0, ground=0.0123), duration=1.0), 0.2)
    assert there.k == pytest.approx(here.k, rel=1e-6)
    assert there.b == pytest.approx(here.b, rel=1e-5)


@pytest.fixture(scope="module")
def touched() -> Trace:
    """A second of a hand on a spring."""
    return run(one_spring(2000.0, 5.0, friction=1.0), duration=1.0)


def test_late_and_lost_samples_are_stepped_over(touched: Trace) -> None:
    whole = measure_trace(touched, 0.2)
    flags = touched.flags.copy()
    flags[[120, 260]] |= LATE_FORCE
    flags[185] |= BRIDGED
    rows = {name: np.delete(getattr(touched, name), slice(180, 185), axis=0) for name in ROWS}
    broken = replace(touched, **rows | {"flags": np.delete(flags, slice(180, 185))})
    measured = measure_trace(broken, 0.2)
    assert abs(measured.k - whole.k) < 4 * (measured.k_uncertainty + whole.k_uncertainty)
    assert abs(measured.b - whole.b) < 4 * (measured.b_uncertainty + whole.b_uncertainty)


def test_a_late_force_that_is_not_flagged_would_have_shown(touched: Trace) -> None:
    """The record above is stepped over because it is flagged; the same disturbance unflagged leaves its mark."""
    counts = touched.position_counts.copy()
    counts[200:] += 5000
    assert measure_trace(replace(touched, position_counts=counts), 0.2).residual_m > 10 * QUANTUM


BLOWS = (120, 260)  # the samples from which on they show


def struck_again(trace: Trace) -> Trace:
    """The same hand, set off anew while it still rings, as at the beginning: a linear loop's motions add up."""
    summed = {}
    for name in ("position_counts", "force_counts", "asked_force"):
        once = getattr(trace, name)
        summed[name] = once.copy()
        for at in BLOWS:
            summed[name][at:] += once[1 : 1 + len(once) - at]
    return replace(trace, **summed)


@pytest.mark.parametrize(
    ("flag", "before"),
    [(LATE_FORCE, 0), (OFF_GRID, 0), (BRIDGED, 0), (UNSENT, 1)],  # an unsent force is missed in the sample after it
    ids=["late force", "off grid", "bridged", "unsent"],
)
def test_what_happens_around_a_flagged_sample_is_left_out(touched: Trace, flag: int, before: int) -> None:
    trace = struck_again(touched)
    flags = trace.flags.copy()
    flags[np.array(BLOWS) - before] |= flag
    felt = hapsim.predict(one_spring(2000.0, 5.0, friction=1.0)).felt[0]
    measured = measure_trace(replace(trace, flags=flags), 0.2)
    assert measured.residual_m < QUANTUM
    assert abs(measured.k - felt.k) < 4 * measured.k_uncertainty
    assert abs(measured.b - felt.b) < 4 * measured.b_uncertainty
    assert measure_trace(trace, 0.2).residual_m > 1000 * QUANTUM


def test_where_all_samples_are_off_the_grid_they_are_used_and_late_forces_still_left_out(touched: Trace) -> None:
    trace = struck_again(touched)
    flags = trace.flags | OFF_GRID
    flags[list(BLOWS)] |= LATE_FORCE
    measured = measure_trace(replace(trace, flags=flags), 0.2)
    assert measured.residual_m < QUANTUM
    assert measured.samples > 500


@pytest.mark.parametrize(
    ("scene", "within"),
    [
        (one_spring(2000.0, 0.5, friction=0.0, force_limit=5.0), (1e-4, 1e-3)),
        (one_spring(2000.0, 5.0, friction=1.0, velocity=0.0), (1e-5, 1e-5)),
    ],
    ids=["growing until the device stops it", "pushed from rest"],
)
def test_other_motions_than_a_ring_down_are_measured(scene: Scene, within: tuple[float, float]) -> None:
    prediction, measured = hapsim.predict(scene), hapsim.measure(scene)
    assert prediction.stable == (within[0] == 1e-5)
    assert measured.k == pytest.approx(prediction.felt[0].k, rel=within[0])
    assert measured.b == pytest.approx(prediction.felt[0].b, rel=within[1])


def test_a_hand_that_does_not_move_is_reported_to_have_shown_nothing() -> None:
    with pytest.raises(UsageError, match="too little motion"):
        measure_trace(run(one_spring(2000.0, 5.0, velocity=0.0), duration=0.5), 0.2)


def test_a_channel_without_a_hand_is_refused() -> None:
    with pytest.raises(UsageError, match="channel 3"):
        hapsim.measure(one_spring(2000.0, 5.0), channel=3)
