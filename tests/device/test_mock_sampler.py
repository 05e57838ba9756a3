"""The mock's converters: holds, delays, positions and velocities against a simulation that goes from event to event.

The reference knows no ring of commands and no split of a sample: it sorts the instants at which something happens
(a sample is taken, a force changes) and lets the mass coast from one to the next, in thirty digits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from firmware_protocol import schema
from firmware_protocol.records import new_record
from hapsim.compiling import entry
from hapsim.device.mock import sampler
from hapsim.device.mock.motion import BODY, move_of
from hapsim.device.mock.sampler import CONVERTER, HOLDS, MockHold, Piece

T = 1e-3
DELAYS = [0.0, 0.37, 1.0, 1.5, 2.0]
CASES = list(itertools.product(("zoh", "impulse"), ("ideal", "average"), DELAYS, (0.0, 60.0)))


@entry
def advance_body(how, body, converter, commands, n, h):
    sampler.advance_body(how, body, converter, commands, len(commands), 0, n, h)


@entry
def sample(body, converter, h):
    return sampler.sample(body, converter, h)


@entry
def first_sample(body, converter):
    return sampler.first_sample(body, converter)


@entry
def to_counts(value, quantum):
    return sampler.to_counts(value, quantum)


@dataclass
class Coasting:
    """One mass between two events."""

    m: float
    b: float
    x: mp.mpf
    v: mp.mpf
    force: mp.mpf
    travel: mp.mpf

    def coast(self, t: mp.mpf) -> None:
        if self.b == 0:
            a = self.force / self.m
            self.travel += self.x * t + self.v * t**2 / 2 + a * t**3 / 6
            self.x += self.v * t + a * t**2 / 2
            self.v += a * t
            return
        rate, final = mp.mpf(self.b) / self.m, self.force / self.b
        gone = (1 - mp.exp(-rate * t)) / rate
        self.travel += self.x * t + final * t**2 / 2 + (self.v - final) * (t - gone) / rate
        self.x += final * t + (self.v - final) * gone
        self.v = final + (self.v - final) * mp.exp(-rate * t)


def _act(mass: Coasting, force: Any) -> None:
    mass.force = mp.mpf(force)


def _blow(mass: Coasting, force: Any) -> None:
    mass.v += force * mp.mpf(T) / mass.m


Event = Callable[[Coasting, Sequence[float], int], None]

#: What a command n does, and how many samples after its delay.
EVENTS: dict[str, list[tuple[float, Event]]] = {
    "zoh": [(0.0, lambda mass, c, n: _act(mass, c[n]))],
    "impulse": [(0.0, lambda mass, c, n: _blow(mass, c[n]))],
    "mean of two": [(0.0, lambda mass, c, n: _act(mass, (mp.mpf(c[n]) + (c[n - 1] if n else 0)) / 2))],
    "half as long": [(0.0, lambda mass, c, n: _act(mass, 2 * c[n])), (0.5, lambda mass, _c, _n: _act(mass, 0))],
    "two blows": [
        (0.0, lambda mass, c, n: _blow(mass, c[n] / 4)),
        (0.5, lambda mass, c, n: _blow(mass, mp.mpf(3) * c[n] / 4)),
    ],
}

#: Holds that hapsim does not ship, of what an entry can say.
OTHERS = {
    "mean of two": MockHold(lambda phi: [Piece(phi, (0.0, 0.5, 0.5)), Piece(1.0 - phi, (0.5, 0.5))], goes_on=True),
    "half as long": MockHold(
        lambda phi: (
            [Piece(phi), Piece(0.5, (2.0,)), Piece(0.5 - phi)]
            if phi < 0.5
            else [Piece(phi - 0.5, (0.0, 2.0)), Piece(0.5), Piece(1.0 - phi, (2.0,))]
        ),
        goes_on=False,
    ),
    "two blows": MockHold(
        lambda phi: (
            [Piece(phi), Piece(0.5, blow=(0.25,)), Piece(0.5 - phi, blow=(0.75,))]
            if phi < 0.5
            else [Piece(phi - 0.5), Piece(0.5, blow=(0.0, 0.75)), Piece(1.0 - phi, blow=(0.25,))]
        ),
        goes_on=False,
    ),
}


def event_by_event(
    hold: str, sampling: str, delay: float, m: float, b: float, x: float, v: float, commands: Sequence[float]
) -> tuple[list[float], list[float]]:
    """What is measured at the end of samples 0, 1, …, positions (m) and velocities (m/s): command n changes the force
    `delay` samples after n began."""
    with mp.workdps(30):
        T_, samples, acts = mp.mpf(T), len(commands), EVENTS[hold]
        events = [(mp.mpf(n + 1), 0, n) for n in range(samples)]
        events += [(n + mp.mpf(delay) + late, 1 + i, n) for n in range(samples) for i, (late, _) in enumerate(acts)]
        mass = Coasting(m, b, mp.mpf(x), mp.mpf(v), mp.mpf(0), mp.mpf(0))
        clock, positions, velocities, before = mp.mpf(0), [], [], mass.x
        for at, kind, n in sorted(events):
            mass.coast((at - clock) * T_)
            clock = at
            if kind == 0:
                positions.append(float(mass.x if sampling == "ideal" else mass.travel / T_))
                velocities.append(float(mass.v if sampling == "ideal" else (mass.x - before) / T_))
                mass.travel, before = mp.mpf(0), mass.x
            else:
                acts[kind - 1][1](mass, commands, n)
        return positions, velocities


def converter_of(**fields: float) -> Any:
    converter = new_record(CONVERTER)
    converter.period, converter.quantum = T, 1e-9
    for name, value in fields.items():
        converter[name] = value
    return converter


def body_of(m: float, b: float = 0.0, x: float = 0.0, v: float = 0.0) -> Any:
    body = new_record(BODY)
    for name, value in {"mass": m, "friction": b, "position": x, "velocity": v}.items():
        body[name] = value
    return body


def measured_by_the_mock(hold: str, sampling: str, delay: float, body: Any, commands: Sequence[float]) -> list[float]:
    converter = converter_of(average=sampling == "average")
    rows, how = sampler.set_hold(converter, hold, delay), np.uint64(move_of(np.array([body])))
    ring = np.zeros((rows, 1))
    measured = []
    for n, command in enumerate(commands):
        ring[n % len(ring), 0] = command
        advance_body(how, body, converter, ring, n, T)
        measured.append(sample(body, converter, T))
    return measured


@pytest.mark.parametrize(("hold", "sampling", "delay", "b"), CASES)
def test_the_measured_positions_are_those_of_an_event_by_event_simulation(
    hold: str, sampling: str, delay: float, b: float
) -> None:
    m, x, v = 0.05, 0.02, -0.4
    commands = np.random.default_rng(7).uniform(-30.0, 30.0, 60)
    measured = measured_by_the_mock(hold, sampling, delay, body_of(m, b, x, v), commands)
    expected, _ = event_by_event(hold, sampling, delay, m, b, x, v, commands)
    np.testing.assert_allclose(measured, expected, atol=3e-16)


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("hold", OTHERS)
def test_a_hold_is_the_pieces_that_its_entry_says(hold: str, delay: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(HOLDS, hold, OTHERS[hold])
    commands = np.random.default_rng(7).uniform(-30.0, 30.0, 60)
    measured = measured_by_the_mock(hold, "average", delay, body_of(0.05, 60.0, 0.02, -0.4), commands)
    expected, _ = event_by_event(hold, "average", delay, 0.05, 60.0, 0.02, -0.4, commands)
    np.testing.assert_allclose(measured, expected, atol=3e-16)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.sampled_from(["zoh", "impulse"]), st.sampled_from(["ideal", "average"]), st.floats(0.0, 7.0))
@example("zoh", "ideal", math.nextafter(1.0, 0.0))
@example("impulse", "average", math.nextafter(1.0, 2.0))
@example("zoh", "average", 5e-324)
def test_any_delay_is_as_an_event_by_event_simulation_has_it(hold: str, sampling: str, delay: float) -> None:
    commands = [5.0, -3.0, 0.0, 0.0, 8.0, *[0.0] * 6]
    measured = measured_by_the_mock(hold, sampling, delay, body_of(0.1, 0.5), commands)
    expected, _ = event_by_event(hold, sampling, delay, 0.1, 0.5, 0.0, 0.0, commands)
    np.testing.assert_allclose(measured, expected, atol=1e-17)


@pytest.mark.parametrize("hold", ["zoh", "impulse"])
@pytest.mark.parametrize(("delay", "first"), [(0.0, 0), (0.37, 0), (0.999, 0), (1.0, 1), (1.5, 1), (2.0, 2), (3.01, 3)])
def test_a_command_is_first_seen_in_the_sample_in_which_its_delay_ends(hold: str, delay: float, first: int) -> None:
    measured = np.array(measured_by_the_mock(hold, "ideal", delay, body_of(1.0), [1.0, *[0.0] * 6]))
    assert (measured[:first] == 0).all()
    assert (measured[first:] > 0).all()


def test_nothing_acts_before_the_first_command_whatever_the_delay() -> None:
    for hold, delay in itertools.product(("zoh", "impulse"), (0.0, 0.5, 3.0, 9.25)):
        assert measured_by_the_mock(hold, "ideal", delay, body_of(1.0, x=0.125), [0.0] * 12) == [0.125] * 12


def test_both_holds_give_the_same_momentum() -> None:
    speeds = []
    for hold in ("zoh", "impulse"):
        body = body_of(0.2)
        measured_by_the_mock(hold, "ideal", 1.5, body, [1.0, 2.0, -0.5, 0.0, 0.0, 0.0])
        speeds.append(body["velocity"])
    assert speeds == pytest.approx([2.5 * T / 0.2] * 2, rel=1e-14)


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


# Velocities.


@pytest.mark.parametrize(("delay", "seen"), [(0.0, 1), (0.5, 1), (1.0, 2), (1.5, 2), (2.0, 3)])
def test_an_impulse_at_the_instant_of_a_sample_is_not_in_that_sample_s_velocity_but_in_the_next(
    new_host: Callable[..., Any], exchange: Callable, delay: float, seen: int
) -> None:
    host = new_host(device={"mass": 1.0, "delay": delay, "hold": "impulse", "force_limit": 10.0})
    heard = exchange(host, [[2**30], *[[0]] * 5], velocity=True)
    sensed = [frame.counts[1] for frame in heard if frame.type == schema.POSITION]
    assert sensed == [0] * seen + [5000] * (7 - seen)  # 5 N for a millisecond: 5 mm/s in steps of 1 um/s


def test_the_mean_velocity_is_the_way_that_was_gone_over_the_time_that_the_sample_really_lasted(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(
        device={"sampling": "average", "mass": 0.01, "friction": 20.0, "delay": 0},
        mock={"initial": {"velocity": 0.5}, "quantum": 1e-9},
    )
    host.arm(schema.PACED_BY_HOST, now=0, velocity=True)
    edges = [0, 1_000_000, 1_300_000, 5_300_000]
    for n, (start, stop) in enumerate(itertools.pairwise(edges)):
        (position,) = host.force(n, now=stop)
        gone = -0.5 * 5e-4 * math.exp(-start / 5e5) * math.expm1((start - stop) / 5e5)
        assert position.counts[1] * 1e-6 == pytest.approx(gone / (stop - start) * 1e9, abs=0.51e-6)


@pytest.mark.parametrize("sampling", ["ideal", "average"])
def test_the_first_velocity_is_the_body_s_and_arming_again_measures_from_the_start(
    new_host: Callable[..., Any], exchange: Callable, sampling: str
) -> None:
    host = new_host(device={"sampling": sampling}, mock={"initial": {"position": 0.1, "velocity": -0.25}})
    for _ in range(2):
        heard = exchange(host, [[0]] * 3, velocity=True)
        assert [frame.counts[1] for frame in heard if frame.type == schema.POSITION] == [-250_000] * 4
        host.disarm()


@pytest.mark.parametrize("channels", [1, 2, 3, 16])
def test_velocities_of_all_channels_stand_behind_the_positions_of_all_channels(
    new_host: Callable[..., Any], channels: int
) -> None:
    initial = {
        "position": [0.001 * (c + 1) for c in range(channels)],
        "velocity": [0.25 * (c + 1) for c in range(channels)],
    }
    host = new_host(channels, mock={"initial": initial, "quantum": 1e-6})
    _, position = host.arm(velocity=True)
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
    _, position = host.arm(velocity=True)
    assert position.counts == (0, direction * 2147483647)
    assert host.state == schema.ARMED


def test_a_device_that_latches_while_it_sends_velocities_says_so_in_their_format(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(3)
    host.arm(schema.PACED_BY_DEVICE, watchdog=1, velocity=True)
    for _ in range(3):
        host.sample_passes()
    (status,) = host.look_at_watchdog()
    assert status.counts == (schema.LATCHED | schema.HOST_QUIET << 8, 0, 0, 0, 0, 0)
    assert host.register(schema.REG_FAULT) == schema.HOST_QUIET
    assert host.misread == 0


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
    body = body_of(1.0, x=0.3, v=2.0)
    assert first_sample(body, converter_of(average=1)) == 0.3 - 2.0 * T / 2
    assert first_sample(body, converter_of(average=0)) == 0.3


# Counts.


@settings(max_examples=300, deadline=None, derandomize=True)
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


# Noise.


def noise_of(count: int, seed: int, rms: float = 1.0) -> np.ndarray:
    converter = converter_of(noise=rms, seed=seed)
    body = body_of(1.0)
    first = first_sample(body, converter)
    return np.array([first, *[sample(body, converter, T) for _ in range(count - 1)]])


def test_the_noise_has_the_mean_and_the_deviation_that_are_stated_and_is_normal_and_white() -> None:
    n = 40_000
    noise = noise_of(n, seed=20240611, rms=2.5e-6) / 2.5e-6
    assert abs(noise.mean()) < 4 / math.sqrt(n)
    assert abs(noise.std() - 1) < 4 / math.sqrt(2 * n)
    assert kstest(noise, "norm").pvalue > 1e-3
    for lag in (1, 2, 3, 7):
        assert abs((noise[lag:] * noise[:-lag]).mean()) < 4 / math.sqrt(n)


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
    n = 4000
    host = new_host(channels=2, rate=2000.0, mock={"noise": 1e-6, "quantum": 1e-9})
    heard = exchange(host, [[0, 0]] * n, velocity=True)
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
    assert first_sample(body_of(1.0, x=0.5), converter) == 0.5
