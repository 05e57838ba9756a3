"""The mock's converters: holds, delays, positions and counts, against a simulation that goes from event to event."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol import schema
from hapsim.device.mock import sampler
from hapsim.device.mock.motion import move_of
from hapsim.device.mock.sampler import SAMPLINGS
from hapsim.holds import HOLDS

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
from bodies import body_of
from converters import (
    CASES,
    DELAYS,
    WINDOWS,
    T,
    advance_body,
    converter_of,
    event_by_event,
    first_sample,
    sample,
    sample_velocity,
    to_counts,
)
from unshipped_holds import UNSHIPPED


def measured_by_the_mock(hold: str, sampling: str, delay: float, body: Any, commands: Sequence[float]) -> list[float]:
    return read_by_the_mock(hold, sampling, delay, body, commands)[0]


def read_by_the_mock(
    hold: str, sampling: str, delay: float, body: Any, commands: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Positions and velocities."""
    converter = converter_of()
    rows, how = sampler.set_timing(converter, hold, sampling, delay), np.uint64(move_of(np.array([body])))
    ring = np.zeros((rows, 1))
    positions, velocities = [], []
    for n, command in enumerate(commands):
        ring[n % len(ring), 0] = command
        advance_body(how, body, converter, ring, n, T)
        velocities.append(sample_velocity(body, converter, T))
        positions.append(sample(body, converter, T))
    return positions, velocities


@pytest.mark.parametrize(("hold", "sampling", "delay", "b"), CASES)
def test_the_measured_positions_are_those_of_an_event_by_event_simulation(
    hold: str, sampling: str, delay: float, b: float
) -> None:
    m, x, v = 0.05, 0.02, -0.4
    commands = np.random.default_rng(7).uniform(-30.0, 30.0, 60)
    measured = measured_by_the_mock(hold, sampling, delay, body_of(m, b, position=x, velocity=v), commands)
    expected, _ = event_by_event(hold, sampling, delay, m, b, x, v, commands)
    np.testing.assert_allclose(measured, expected, atol=3e-16)


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("sampling", WINDOWS)
@pytest.mark.parametrize("hold", HOLDS | UNSHIPPED)
def test_holds_and_samplings_are_what_their_entries_say(
    hold: str, sampling: str, delay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(HOLDS, hold, (HOLDS | UNSHIPPED)[hold])
    monkeypatch.setitem(SAMPLINGS, sampling, WINDOWS[sampling])
    commands = np.random.default_rng(7).uniform(-30.0, 30.0, 60)
    positions, velocities = read_by_the_mock(
        hold, sampling, delay, body_of(0.05, 60.0, position=0.02, velocity=-0.4), commands
    )
    expected, speeds = event_by_event(hold, sampling, delay, 0.05, 60.0, 0.02, -0.4, commands)
    np.testing.assert_allclose(positions, expected, atol=3e-16)
    np.testing.assert_allclose(velocities, speeds, atol=1e-12)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.sampled_from(list(HOLDS)), st.sampled_from(["ideal", "average"]), st.floats(0.0, 7.0))
@example("zoh", "ideal", math.nextafter(1.0, 0.0))
@example("impulse", "average", math.nextafter(1.0, 2.0))
@example("zoh", "average", 5e-324)
def test_any_delay_is_as_an_event_by_event_simulation_has_it(hold: str, sampling: str, delay: float) -> None:
    commands = [5.0, -3.0, 0.0, 0.0, 8.0, *[0.0] * 6]
    measured = measured_by_the_mock(hold, sampling, delay, body_of(0.1, 0.5), commands)
    expected, _ = event_by_event(hold, sampling, delay, 0.1, 0.5, 0.0, 0.0, commands)
    np.testing.assert_allclose(measured, expected, atol=1e-17)


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize(("delay", "first"), [(0.0, 0), (0.37, 0), (0.999, 0), (1.0, 1), (1.5, 1), (2.0, 2), (3.01, 3)])
def test_a_command_is_first_seen_in_the_sample_in_which_its_delay_ends(hold: str, delay: float, first: int) -> None:
    measured = np.array(measured_by_the_mock(hold, "ideal", delay, body_of(1.0), [1.0, *[0.0] * 6]))
    assert (measured[:first] == 0).all()
    assert (measured[first:] > 0).all()


def test_nothing_acts_before_the_first_command_whatever_the_delay() -> None:
    for hold, delay in itertools.product(HOLDS, (0.0, 0.5, 3.0, 9.25)):
        assert measured_by_the_mock(hold, "ideal", delay, body_of(1.0, position=0.125), [0.0] * 12) == [0.125] * 12


def test_all_holds_give_the_same_momentum() -> None:
    speeds = []
    for hold in HOLDS:
        body = body_of(0.2)
        measured_by_the_mock(hold, "ideal", 1.5, body, [1.0, 2.0, -0.5, 0.0, 0.0, 0.0])
        speeds.append(body["velocity"])
    assert speeds == pytest.approx([2.5 * T / 0.2] * len(HOLDS), rel=1e-14)


@pytest.mark.parametrize("delay", [1.0, 1.25, 1.5])
@pytest.mark.parametrize("lengths", [[T] * 5, [0.4e-3, 2.5e-3, 1e-6, 1.1e-3, 7e-3], [3e-3, 0.25e-3, 0.8e-3, T, 0.1e-3]])
def test_an_impulse_gives_what_its_force_gives_in_a_period_however_long_the_sample_lasts(
    new_host: Callable[..., Any], delay: float, lengths: list[float]
) -> None:
    """Paced by the host, a sample lasts for as long as the host takes; the mass is free from the instant on."""
    m, force, quantum = 0.5, 5.0, 1e-9
    host = new_host(
        device={"mass": m, "delay": delay, "hold": "impulse", "force_limit": 2 * force}, mock={"quantum": quantum}
    )
    host.arm(schema.PACED_BY_HOST, now=0, velocity=True)
    speed = force * T / m
    acts = lengths[0] + (delay - 1.0) * lengths[1]
    for n, end in enumerate(np.cumsum(lengths)):
        (heard,) = host.force(n, [2**30 if n == 0 else 0], now=round(end * 1e9))
        gone, moving = (end - acts) * speed, n > 0
        assert heard.counts[0] == pytest.approx(moving * gone / quantum, abs=0.5 + 1e-6)
        assert heard.counts[1] == moving * round(speed / (quantum / T))
    assert host.bodies["velocity"][0] == pytest.approx(speed, rel=1e-15)


@pytest.mark.parametrize(("hold", "sampling", "delay", "b"), CASES)
def test_through_the_wire_positions_and_velocities_are_those_of_an_event_by_event_simulation_rounded(
    new_host: Callable[..., Any], exchange: Callable, hold: str, sampling: str, delay: float, b: float
) -> None:
    m, x, v, quantum, limit = 0.05, 0.02, -0.4, 1e-8, 40.0
    host = new_host(
        device={"mass": m, "friction": b, "delay": delay, "hold": hold, "sampling": sampling, "force_limit": limit},
        mock={"initial": {"position": x, "velocity": v}, "quantum": quantum},
    )
    counts = np.random.default_rng(8).integers(-(2**31), 2**31, 60).tolist()
    forces = [[count] for count in counts]
    commands = [count * limit / 2**31 for count in counts]
    positions, velocities = event_by_event(hold, sampling, delay, m, b, x, v, commands)
    first = x - v * T / 2 if sampling == "average" else x
    plain = [frame.counts for frame in exchange(host, forces) if frame.type == schema.POSITION]
    np.testing.assert_allclose(plain, np.array([[first, *positions]]).T / quantum, rtol=0, atol=0.5 + 1e-6)
    host.disarm()
    heard = [frame.counts for frame in exchange(host, forces, velocity=True) if frame.type == schema.POSITION]
    assert [counts[:1] for counts in heard] == plain
    sensed = [velocity for _, velocity in heard]
    np.testing.assert_allclose(sensed, np.array([v, *velocities]) / (quantum / T), rtol=0, atol=0.5 + 1e-6)


def test_averaged_sampling_takes_the_mean_over_the_time_that_a_sample_really_lasted(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(
        device={"sampling": "average"}, mock={"initial": {"position": 1.0, "velocity": 0.5}, "quantum": 1e-9}
    )
    host.arm(schema.PACED_BY_HOST, now=0)
    edges = [0, 1_000_000, 1_300_000, 5_300_000]
    for n, (start, stop) in enumerate(itertools.pairwise(edges)):
        (position,) = host.force(n, now=stop)
        assert position.counts[0] * 1e-9 == pytest.approx(1.0 + 0.5 * (start + stop) / 2 * 1e-9, abs=1e-9)


def test_the_first_averaged_sample_is_the_mean_over_the_period_before_the_start() -> None:
    body = body_of(1.0, position=0.3, velocity=2.0)
    assert first_sample(body, converter_of(window=1.0)) == 0.3 - 2.0 * T / 2
    assert first_sample(body, converter_of(window=0.0)) == 0.3


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.floats(-2.1, 2.1), st.sampled_from([1e-9, 3e-9, 1e-6, 0.25]))
def test_a_position_is_rounded_to_the_nearest_count(position: float, quantum: float) -> None:
    counts, fits = to_counts(position, quantum)
    assert fits
    assert abs(counts * quantum - position) <= quantum / 2 * (1 + 1e-9)
    assert to_counts(-position, quantum) == (-counts, True)


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        (2147483647.0, (2147483647, True)),
        (2147483647.49, (2147483647, True)),
        (2147483647.5, (2147483647, False)),
        (-2147483647.49, (-2147483647, True)),
        (-2147483648.0, (-2147483647, False)),
        (1e300, (2147483647, False)),
        (-1e300, (-2147483647, False)),
        (math.inf, (2147483647, False)),
        (-math.inf, (-2147483647, False)),
    ],
)
def test_a_position_beyond_the_scale_stops_at_its_end_and_says_so(position: float, expected: tuple[int, bool]) -> None:
    assert to_counts(position, 1.0) == expected


def test_a_position_that_is_no_number_does_not_fit() -> None:
    counts, fits = to_counts(math.nan, 1e-9)
    assert not fits
    assert abs(counts) == 2147483647
