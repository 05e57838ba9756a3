"""The mock's converters: holds, delays, positions, velocities and counts, against a simulation that goes from event to
event; and the noise of its sensor."""

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
from scipy.stats import kstest

from firmware_protocol import schema
from hapsim.device.mock import sampler
from hapsim.device.mock.motion import move_of
from hapsim.device.mock.sampler import SAMPLINGS
from hapsim.holds import HOLDS

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
from bodies import body_of
from converters import (
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


@pytest.mark.thorough(keep=15)
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("sampling", WINDOWS)
@pytest.mark.parametrize("hold", HOLDS | UNSHIPPED)
def test_holds_and_samplings_are_what_their_entries_state(
    hold: str, sampling: str, delay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(HOLDS, hold, (HOLDS | UNSHIPPED)[hold])
    monkeypatch.setitem(SAMPLINGS, sampling, WINDOWS[sampling])
    commands = np.random.default_rng(7).uniform(-30.0, 30.0, 25)
    for b in (0.0, 60.0):
        body = body_of(0.05, b, position=0.02, velocity=-0.4)
        positions, velocities = read_by_the_mock(hold, sampling, delay, body, commands)
        expected, speeds = event_by_event(hold, sampling, delay, 0.05, b, 0.02, -0.4, commands)
        np.testing.assert_allclose(positions, expected, atol=3e-16)
        np.testing.assert_allclose(velocities, speeds, atol=1e-12)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.sampled_from(list(HOLDS)), st.sampled_from(["ideal", "average"]), st.floats(0.0, 7.0))
@example("zoh", "ideal", math.nextafter(1.0, 0.0))
@example("impulse", "average", math.nextafter(1.0, 2.0))
@example("zoh", "average", 5e-324)
def test_any_delay_is_as_an_event_by_event_simulation_has_it(hold: str, sampling: str, delay: float) -> None:
    commands = [5.0, -3.0, 0.0, 0.0, 8.0, *[0.0] * 6]
    measured, _ = read_by_the_mock(hold, sampling, delay, body_of(0.1, 0.5), commands)
    expected, _ = event_by_event(hold, sampling, delay, 0.1, 0.5, 0.0, 0.0, commands)
    np.testing.assert_allclose(measured, expected, atol=1e-17)


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
    host.arm(schema.PACED_BY_HOST, now=0, parts=schema.WITH_VELOCITY)
    speed = force * T / m
    acts = lengths[0] + (delay - 1.0) * lengths[1]
    for n, end in enumerate(np.cumsum(lengths)):
        (heard,) = host.force(n, [2**30 if n == 0 else 0], now=round(end * 1e9))
        gone, moving = (end - acts) * speed, n > 0
        assert heard.counts[0] == pytest.approx(moving * gone / quantum, abs=0.5 + 1e-6)
        assert heard.counts[1] == moving * round(speed / (quantum / T))
    assert host.bodies["velocity"][0] == pytest.approx(speed, rel=1e-15)


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
def test_a_position_beyond_the_scale_stops_at_its_end_and_is_reported(
    position: float, expected: tuple[int, bool]
) -> None:
    assert to_counts(position, 1.0) == expected


def test_a_position_that_is_no_number_does_not_fit() -> None:
    counts, fits = to_counts(math.nan, 1e-9)
    assert not fits
    assert abs(counts) == 2147483647


def test_the_mean_velocity_is_the_way_that_was_gone_over_the_time_that_the_sample_really_lasted(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(
        device={"sampling": "average", "mass": 0.01, "friction": 20.0, "delay": 0},
        mock={"initial": {"velocity": 0.5}, "quantum": 1e-9},
    )
    host.arm(schema.PACED_BY_HOST, now=0, parts=schema.WITH_VELOCITY)
    edges = [0, 1_000_000, 1_300_000, 5_300_000]
    for n, (start, stop) in enumerate(itertools.pairwise(edges)):
        (position,) = host.force(n, now=stop)
        gone = -0.5 * 5e-4 * math.exp(-start / 5e5) * math.expm1((start - stop) / 5e5)
        assert position.counts[1] * 1e-6 == pytest.approx(gone / (stop - start) * 1e9, abs=0.51e-6)


@pytest.mark.parametrize("channels", [1, 2, 3, 16])
def test_velocities_of_all_channels_stand_behind_the_positions_of_all_channels(
    new_host: Callable[..., Any], channels: int
) -> None:
    initial = {
        "position": [0.001 * (c + 1) for c in range(channels)],
        "velocity": [0.25 * (c + 1) for c in range(channels)],
    }
    host = new_host(channels, mock={"initial": initial, "quantum": 1e-6})
    _, position = host.arm(parts=schema.WITH_VELOCITY)
    assert position.counts[:channels] == tuple(1000 * (c + 1) for c in range(channels))
    assert position.counts[channels:] == tuple(250 * (c + 1) for c in range(channels))
    host.disarm()
    assert len(host.arm()[1].counts) == channels
    assert host.misread == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_a_velocity_beyond_its_scale_stops_at_the_end_of_it_and_is_no_fault(
    new_host: Callable[..., Any], direction: int
) -> None:
    host = new_host(rate=500.0, mock={"quantum": 1e-12, "initial": {"velocity": 1.5 * direction}})  # scale: 1.07 m/s
    _, position = host.arm(parts=schema.WITH_VELOCITY)
    assert position.counts == (0, direction * 2147483647)
    assert host.state == schema.ARMED


def test_a_device_that_latches_while_it_sends_velocities_reports_it_in_their_format(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(3)
    host.arm(schema.PACED_BY_DEVICE, watchdog=1, parts=schema.WITH_VELOCITY)
    for _ in range(3):
        host.sample_passes()
    (status,) = host.check_watchdog()
    assert status.counts == (schema.LATCHED | schema.HOST_QUIET << 8, 0, 0, 0, 0, 0)
    assert host.register(schema.REG_FAULT) == schema.HOST_QUIET
    assert host.misread == 0


def noise_of(count: int, seed: int, rms: float = 1.0) -> np.ndarray:
    converter = converter_of(noise=rms, seed=seed)
    body = body_of(1.0)
    first = first_sample(body, converter)
    return np.array([first, *[sample(body, converter, T) for _ in range(count - 1)]])


def test_the_noise_is_that_of_xorshift64_star_and_box_muller_on_every_machine() -> None:
    state, expected, mask = 0x1234567, [], 2**64 - 1

    def uniform() -> float:
        nonlocal state
        state ^= state >> 12
        state ^= (state << 25) & mask
        state ^= state >> 27
        return (((state * 2685821657736338717) & mask) >> 11) / 2**53 + 2**-53

    for _ in range(50):
        radius = math.sqrt(-2 * math.log(uniform()))
        expected.append(radius * math.cos(2 * math.pi * uniform()))
    np.testing.assert_allclose(noise_of(50, seed=0x1234567), expected, rtol=1e-12, atol=1e-12)


def noisy_run(new_host: Callable[..., Any], exchange: Callable, seed: int, samples: int = 60) -> np.ndarray:
    host = new_host(channels=3, mock={"noise": 1e-6, "seed": seed, "quantum": 1e-9})
    heard = exchange(host, [[0]] * samples)
    return np.array([frame.counts for frame in heard if frame.type == schema.POSITION])


def test_the_same_seed_gives_the_same_noise_and_another_seed_another(
    new_host: Callable[..., Any], exchange: Callable
) -> None:
    one, again, other = (noisy_run(new_host, exchange, seed) for seed in (5, 5, 6))
    assert (one == again).all()
    assert (one != other).mean() > 0.9


def test_every_channel_has_noise_of_its_own_from_the_first_sample_on(
    new_host: Callable[..., Any], exchange: Callable
) -> None:
    noise = noisy_run(new_host, exchange, seed=0, samples=2000)
    assert (noise[0] != 0).all()
    correlation = np.corrcoef(noise.T) - np.eye(3)
    assert np.abs(correlation).max() < 4 / math.sqrt(2000)
    assert noise.std(axis=0) == pytest.approx([1000.0] * 3, rel=0.1)


def test_velocities_have_normal_noise_of_their_own_as_many_periods_of_the_position_s_as_there_are_in_a_second(
    new_host: Callable[..., Any], exchange: Callable
) -> None:
    n = 2000
    host = new_host(channels=2, rate=2000.0, mock={"noise": 1e-6, "quantum": 1e-9})
    heard = exchange(host, [[0, 0]] * n, parts=schema.WITH_VELOCITY)
    noise = np.array([frame.counts for frame in heard if frame.type == schema.POSITION])
    rms = noise.std(axis=0) * [1e-9, 1e-9, 2e-6, 2e-6]
    assert rms == pytest.approx([1e-6, 1e-6, 2e-3, 2e-3], rel=0.06)
    assert (noise[0] != 0).all()
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 4 / math.sqrt(n)
    velocity = noise[:, 2] / noise[:, 2].std()
    assert kstest(velocity, "norm").pvalue > 1e-3
    assert abs((velocity[1:] * velocity[:-1]).mean()) < 4 / math.sqrt(n)


def test_a_run_without_velocities_has_the_noise_that_it_always_had(new_host: Callable[..., Any]) -> None:
    host = new_host(mock={"noise": 1e-6, "seed": 7, "quantum": 1e-9})
    expected = noise_of(5, seed=int(host.mock.converters["seed"][0]), rms=1e-6)
    heard = host.arm()
    for n in range(4):
        heard += host.force(n)
    counts = [frame.counts[0] for frame in heard if frame.type == schema.POSITION]
    assert counts == np.rint(expected / 1e-9).tolist()


def test_noise_is_in_the_sensor_and_not_in_the_motion(new_host: Callable[..., Any], exchange: Callable) -> None:
    moving = {"initial": {"velocity": 0.3}}
    quiet, noisy = new_host(mock=moving), new_host(mock=moving | {"noise": 1e-4})
    for host in (quiet, noisy):
        exchange(host, [[2**30]] * 50)
    assert quiet.bodies.tolist() == noisy.bodies.tolist()


def test_without_noise_the_generator_stands_still() -> None:
    converter = converter_of(seed=99)
    sample(body_of(1.0), converter, T)
    assert converter.state == 0
    assert first_sample(body_of(1.0, position=0.5), converter) == 0.5
