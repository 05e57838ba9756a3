"""The clock of a record, and the time of each of its rows."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

import hapsim
from hapsim.recording import times
from hapsim.recording.times import Timeline, offset_of
from hapsim.recording.trace import Report, Trace
from hapsim.scene import parse_scene

SCENE = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 500, damping: 5}
"""


@pytest.fixture(scope="module")
def trace() -> Trace:
    return hapsim.run(parse_scene(SCENE), duration=0.1)


@pytest.mark.parametrize("ppm", [-5000.0, 0.0, 50.0])
def test_a_device_s_own_timer_is_found_behind_late_arrivals(trace: Trace, ppm: float) -> None:
    """Arrivals are late by 50 µs on average, now and then by 20 ms. With a crystal's error the samples are found to
    some microseconds, with that of a ceramic resonator to some ten: of a stretch in which the device drifts by d per
    sample, the earliest arrival is late by √(50 µs · d), deviation of a Rayleigh distribution."""
    random, period = np.random.default_rng(5), 1e-3 * (1.0 + 1e-6 * ppm)
    sample = np.delete(np.arange(7, 20_007), random.integers(0, 20_000, 500))
    truth = sample * period
    late = random.exponential(50e-6, sample.size) + 0.02 * (random.random(sample.size) < 0.01)
    time_ns = np.round(1e9 * (123.0 + truth + late)).astype(np.int64)
    line = Timeline(1000.0, _by_device(trace.report), [(sample, time_ns)])
    assert line.source == "device"
    found = line.of(sample, time_ns) + 1e-9 * line.start_ns - 123.0
    assert line.of(sample, time_ns)[0] == 0.0
    assert np.abs(found - truth).max() < 2e-6 + 4.0 * math.sqrt(50e-6 * abs(ppm) * 1e-9)
    assert np.abs(time_ns * 1e-9 - 123.0 - truth).max() > 0.02


def test_times_do_not_depend_on_how_a_record_is_read(trace: Trace) -> None:
    random = np.random.default_rng(6)
    sample = np.arange(5000)
    time_ns = sample * 1_000_100 + random.integers(0, 500_000, sample.size)
    report = _by_device(trace.report)
    whole = Timeline(1000.0, report, [(sample, time_ns)]).of(sample, time_ns)
    cuts = np.sort(random.integers(0, 5000, 40))
    pieces = Timeline(1000.0, report, zip(np.split(sample, cuts), np.split(time_ns, cuts), strict=True))
    assert np.array_equal(pieces.of(sample, time_ns), whole)
    assert pieces.last == 4999


def test_virtual_time_counts_samples_and_a_paced_mock_s_positions_are_sampled_as_they_arrive(trace: Trace) -> None:
    assert trace.timeline.source == "count"
    assert np.array_equal(trace.time_s, trace.sample / 1000.0)
    paced = replace(trace, report=replace(trace.report, virtual_time=False))
    assert paced.timeline.source == "arrivals"
    assert np.array_equal(paced.time_s, (trace.time_ns - trace.time_ns[0]) * 1e-9)
    for one in (trace, paced, replace(paced, report=_by_device(trace.report))):
        assert one.since(trace.sample.size).time_s.size == 0


def test_another_clock_is_compared_in_the_tightest_of_many_tries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each reading of a clock takes its time; only one try is not held up."""
    steps = itertools.chain([5000, 900, 300, 40, 60, 7000, 200], itertools.repeat(10_000))
    now = itertools.accumulate(steps, initial=10**12)
    monkeypatch.setattr(times.time, "monotonic_ns", lambda: next(now))
    offset, uncertainty = offset_of(lambda: next(now) + 77_000_000)
    assert abs(offset - 77_000_000) <= uncertainty == 50


def _by_device(report: Report) -> Report:
    return replace(report, virtual_time=False, timed_by_device=True)
