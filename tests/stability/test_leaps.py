"""The guard of the position: never for what a hand, a blow, a sensor and lost positions can do; always for more."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import address_of
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.guards.leap import GUARD, LEAP, find_leap
from hapsim.loop.hooks import TICK, Setting, call_hook
from hapsim.scales import SCALES, Scale

SCALE = SCALES["linear"]


@entry
def first_leap(function, leap, tick, io, samples, arrived, positions, period_ns):
    """The guard as the loop has it: at which row it says that the position leapt; -1 if it never does."""
    for row in range(samples.size):
        tick.gap = samples[row] - samples[row - 1] if row > 0 else 1
        io.before[0] = io.measured[0]
        io.measured[0] = positions[row]
        tick.now_ns = arrived[row] * period_ns
        if call_hook(function, (leap, tick.address)) != 0:
            return row
        tick.before_ns = arrived[row] * period_ns
        tick.begun_ns = arrived[row] * period_ns + 1000
        tick.number += 1
    return -1


def judged(
    positions: Any,
    *,
    rate: float = 1000.0,
    mass: float = 0.2,
    friction: float = 0.0,
    stiffness: float = 0.0,
    force: float = 10.0,
    noise: float = 0.0,
    quantum: float = 1e-9,
    by_host: bool = False,
    samples: Any = None,
    arrived: Any = None,
    scale: Scale = SCALE,
) -> int | None:
    """The row at which the guard finds a leap in `positions` (m); None where it finds none. `arrived`: in periods, by
    the host's clock, where that is not when they were sampled."""
    leap, io, tick = new_record(LEAP), new_record(IO_BUFFER), new_record(TICK)
    tick.address, tick.io = address_of(tick), address_of(io)
    device = SimpleNamespace(
        clock="host" if by_host else "device",
        force_limit=force,
        mass_spans=lambda _: [(mass, mass)],
        frictions=lambda _: [friction],
        stiffnesses=lambda _: [stiffness],
        scales=lambda _: [scale],
    )
    mock = SimpleNamespace(mass=np.inf, friction=0.0, stiffness=0.0, coulomb=0.0, noise=noise)
    scene: Any = SimpleNamespace(channels=1, rate=rate, device=device, mock_device=mock)
    description: Any = SimpleNamespace(position_scale=[quantum])
    GUARD.set_up(SimpleNamespace(leap=leap), Setting(scene, description, None, False))  # type: ignore[arg-type]
    numbers = np.arange(len(positions)) if samples is None else np.asarray(samples)
    at = np.asarray(positions, float)
    times = numbers if arrived is None else arrived
    period_ns = np.int64(round(1e9 / rate))
    judge = np.uint64(find_leap.address()), np.uint64(address_of(leap))
    row = int(first_leap(*judge, tick, io, numbers.astype(np.int64), times.astype(np.int64), at, period_ns))
    return None if row < 0 else row


def moved_by(forces: np.ndarray, rate: float, mass: float, friction: float = 0.0, velocity: float = 0.0) -> np.ndarray:
    """Positions of a mass under a force (N) that is constant in each period, exactly but for the friction's steps."""
    parts, T = 8, 1.0 / rate
    x, v, positions = 0.0, velocity, []
    for force in forces:
        positions.append(x)
        for _ in range(parts):
            h = T / parts
            a = (force - friction * v) / mass
            x, v = x + v * h + 0.5 * a * h * h, v + a * h
    return np.array(positions)


RATES = [100.0, 500.0, 1000.0, 4000.0, 50_000.0]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("by_host", [False, True])
def test_a_hand_that_pushes_with_all_it_has_against_all_the_device_has_is_none(rate: float, by_host: bool) -> None:
    """And with a tenth of the declared mass, as where the hand lets go, at any speed to begin with."""
    rng = np.random.default_rng(1)
    for velocity in (0.0, 0.1, 30.0):
        forces = rng.choice([-1.0, 0.0, 1.0], 400) * (10.0 + SCALE.hand_force)
        for mass in (0.2, 0.0201):
            assert judged(moved_by(forces, rate, mass, velocity=velocity), rate=rate, by_host=by_host) is None


@pytest.mark.parametrize("rate", RATES)
def test_a_blow_against_a_stop_is_none_wherever_in_a_period_it_falls(rate: float) -> None:
    for speed in (0.1, 3.0, SCALE.hand_speed):
        for phase in np.linspace(0.0, 1.0, 23):
            time = (np.arange(60) - 30 - phase) / rate
            for bounce in (0.0, 0.5, 1.0):
                assert judged(np.where(time < 0.0, speed * time, -bounce * speed * time), rate=rate) is None


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("by_host", [False, True])
def test_lost_positions_are_none(rate: float, by_host: bool) -> None:
    rng = np.random.default_rng(2)
    forces = np.repeat(rng.choice([-1.0, 1.0], 40), 20) * (10.0 + SCALE.hand_force)
    positions = moved_by(forces, rate, 0.2, velocity=3.0)
    for share in (0.1, 0.5, 0.9):
        kept = np.flatnonzero(rng.uniform(size=positions.size) > share)
        assert judged(positions[kept], rate=rate, samples=kept, by_host=by_host) is None


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("noise", [1e-5, 1e-3, 0.1])
def test_noise_that_is_known_and_a_coarse_encoder_are_none(rate: float, noise: float) -> None:
    rng = np.random.default_rng(3)
    swing = 0.05 * np.sin(2.0 * np.pi * 3.0 * np.arange(100_000) / rate)
    assert judged(swing + rng.normal(0.0, noise, swing.size), rate=rate, noise=noise) is None
    assert judged(np.rint(swing / noise) * noise, rate=rate, quantum=noise) is None
    assert judged(swing + rng.normal(0.0, 4e-4, swing.size), rate=rate) is None  # noise that the scene does not declare


@pytest.mark.parametrize("rate", [1000.0, 10_000.0])
def test_friction_and_a_spring_of_the_device_are_none(rate: float) -> None:
    braked = moved_by(np.zeros(200), rate, 0.2, friction=50.0, velocity=1000.0)
    assert judged(braked, rate=rate, friction=50.0) is None
    sprung = 2.0 * np.sin(np.sqrt(1e5 / 0.2) * np.arange(2000) / rate)
    assert judged(sprung, rate=rate, stiffness=1e5) is None
    assert judged(sprung, rate=rate) is not None  # of which the scene says nothing


@pytest.mark.parametrize("rate", [500.0, 1000.0, 4000.0])
@pytest.mark.parametrize("by_host", [False, True])
def test_from_rest_the_bound_is_the_one_that_is_stated(rate: float, by_host: bool) -> None:
    stated = 10.0 * (10.0 + SCALE.hand_force) / 0.2 / rate**2 + SCALE.sensor + 4e-9
    for side in (-1.0, 1.0):
        rest = np.full(50, 0.3)
        for share, row in ((0.999, None), (1.001, 40)):
            leapt = rest.copy()
            leapt[40:] += side * share * stated
            assert judged(leapt, rate=rate, by_host=by_host) == row


@pytest.mark.parametrize("by_host", [False, True])
def test_what_leaps_from_the_beginning_is_found_at_the_third_position(by_host: bool) -> None:
    assert judged(0.1 * (-1.0) ** np.arange(9), by_host=by_host) == 2


def test_a_host_that_was_held_up_takes_no_hand_for_a_leap() -> None:
    """A sample by the host's clock lasts as long as the host was held up."""
    passed = np.cumsum([*[1] * 20, 60, *[1] * 20, 7, *[1] * 20])
    assert judged(2.5 * passed / 1000.0, arrived=passed, by_host=True) is None
    assert judged(2.5 * passed / 1000.0, arrived=passed, by_host=False) == 20


@pytest.mark.parametrize("speed", [60.0, SCALES["rotary"].hand_speed])
def test_a_knob_that_fingers_flick_against_a_stop_leaps_no_more_than_a_handle(speed: float) -> None:
    """A handle with the same counts would leap at 10 m/s."""
    time = (np.arange(60) - 30.4) / 1000.0
    bounced = np.where(time < 0.0, speed * time, -speed * time)
    told: dict[str, Any] = {"mass": 0.1, "force": 5.0}
    assert judged(bounced, **told, scale=SCALES["rotary"]) is None
    assert judged(bounced, **told) is not None
