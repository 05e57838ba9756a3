"""The acceleration that the mock senses: that of its body under all forces, beside the position of the same instant."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from firmware_protocol import schema
from firmware_protocol.description import from_registers

T = 1e-3
SENSOR: dict[str, Any] = {"sensors": ["acceleration"]}
QUANTUM = 1000.0 / 2**31  # m/s² per count, of 1 N on 1 kg

New = Callable[..., Any]


def forces_of(count: int) -> list[int]:
    return np.random.default_rng(8).integers(-(2**31), 2**31, count).tolist()


def ran(host: Any, forces: list[int], parts: int = schema.MOTION_BITS) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations in m/s², and the bodies' positions and velocities, (N, 2), at the same instants: exact."""
    heard, states = host.arm(parts=parts), [(host.bodies["position"][0], host.bodies["velocity"][0])]
    for n, count in enumerate(forces):
        heard += host.force(n, [count])
        states.append((host.bodies["position"][0], host.bodies["velocity"][0]))
    scale = float(host.mock.converters["acceleration_quantum"][0])
    values = [frame.counts[-1] for frame in heard if frame.type == schema.POSITION]
    return np.array(values) * scale, np.array(states)


@pytest.mark.parametrize("age", [0, 1])
@pytest.mark.parametrize("delay", [0.37, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("parts", [schema.WITH_ACCELERATION, schema.MOTION_BITS])
def test_it_is_all_forces_over_the_mass_with_the_force_that_begins_or_the_one_before(
    new_host: New, delay: float, age: int, parts: int
) -> None:
    m, b, k, push, limit = 0.5, 3.0, 200.0, 0.7, 2.0
    host = new_host(
        device={
            "mass": m,
            "friction": b,
            "stiffness": k,
            "delay": delay,
            "force_limit": limit,
            "acceleration_age": age,
            **SENSOR,
        },
        mock={"initial": {"position": 0.01, "velocity": 0.3}, "hand": {"force": push}},
    )
    forces = forces_of(20)
    sensed, states = ran(host, forces, parts)
    commands = np.array(forces) * limit / 2**31
    newest = np.arange(21) - delay  # a command acts for one sample, `delay` samples after its own
    acting = np.floor(newest) if age == 0 else np.ceil(newest) - 1
    acting = np.array([commands[int(i)] if i >= 0 else 0.0 for i in acting])
    x, v = states.T
    np.testing.assert_allclose(sensed, (acting + push - k * x - b * v) / m, rtol=0, atol=0.51 * QUANTUM * limit / m)


def test_a_force_without_delay_is_not_decided_yet_and_the_one_before_is_sensed(new_host: New) -> None:
    sensed = [
        ran(
            new_host(device={"mass": 1.0, "delay": 0.0, "force_limit": 1.0, "acceleration_age": age, **SENSOR}),
            forces_of(9),
        )[0]
        for age in (0, 1)
    ]
    np.testing.assert_array_equal(*sensed)
    np.testing.assert_allclose(sensed[0][1:], np.array(forces_of(9)) / 2**31, atol=0.51 * QUANTUM)


def test_the_mock_s_age_may_differ_from_the_scene_s(new_host: New) -> None:
    older, said = (
        ran(new_host(device={"mass": 1.0, "force_limit": 1.0}, mock=mock), forces_of(9))[0]
        for mock in ({"acceleration_age": 1}, {})
    )
    np.testing.assert_array_equal(older[1:], said[:-1])


def test_of_a_ramp_it_is_the_force_of_this_instant(new_host: New) -> None:
    forces = forces_of(9)
    for age in (0, 1):
        device = {"mass": 1.0, "hold": "ramp", "force_limit": 1.0, "acceleration_age": age, **SENSOR}
        sensed, _ = ran(new_host(device=device), forces)
        # A ramp goes from each force to the next and has none of the newest at its beginning.
        np.testing.assert_allclose(sensed[2:], np.array(forces[:-1]) / 2**31, atol=0.51 * QUANTUM)


def test_an_impulse_is_not_in_it_but_what_it_leaves_behind_is(new_host: New) -> None:
    m, b, force = 0.5, 3.0, 1.0
    host = new_host(device={"mass": m, "friction": b, "hold": "impulse", "force_limit": force, "delay": 1.0})
    sensed, states = ran(host, [2**31 - 1, 0, 0, 0])
    after = states[:, 1] + [0.0, force * T / m, 0.0, 0.0, 0.0]  # of the body it is still to come
    np.testing.assert_allclose(sensed, -b * after / m, atol=0.51 * QUANTUM * force / m + 1e-9)


def test_dry_friction_brakes_a_moving_mass_and_holds_one_at_rest(new_host: New) -> None:
    device = {"mass": 1.0, "force_limit": 1.0}
    moving, _ = ran(new_host(device=device, mock={"coulomb": 0.25, "initial": {"velocity": -1.0}}), [2**30, 0])
    np.testing.assert_allclose(moving, [0.25, 0.75, 0.25], atol=QUANTUM)
    stuck, _ = ran(new_host(device=device, mock={"coulomb": 0.25}), [2**28, 2**30, 0])
    np.testing.assert_allclose(stuck, [0.0, 0.0, 0.25, -0.25], atol=QUANTUM)


@pytest.mark.parametrize("bandwidth", [20.0, 200.0])
@pytest.mark.parametrize("delay", [1.0, 1.37])
def test_a_bandwidth_passes_it_through_a_low_pass(new_host: New, delay: float, bandwidth: float) -> None:
    m, b, k = 1.0, 30.0, 4e3
    fields = {"mass": m, "friction": b, "stiffness": k, "delay": delay, "force_limit": 1.0}
    mock = {"acceleration_bandwidth": bandwidth, "initial": {"velocity": 0.1}}
    forces = forces_of(30)
    sensed, _ = ran(new_host(device=fields, mock=mock), forces)
    w, y, expected = 2 * math.pi * bandwidth, np.array([0.0, 0.1, -b * 0.1 / m]), []
    expected.append(y[2])
    edges = sorted({*np.arange(31) * T, *((np.arange(30) + delay) * T)})
    for start, stop in itertools.pairwise(edges):
        n = math.floor(start / T - delay + 1e-9)
        force = forces[n] / 2**31 if n >= 0 else 0.0

        def moved(_t: float, y: np.ndarray, force: float = force) -> list[float]:
            a = (force - k * y[0] - b * y[1]) / m
            return [y[1], a, w * (a - y[2])]

        y = solve_ivp(moved, (start, stop), y, rtol=1e-10, atol=1e-13).y[:, -1]
        if abs(stop / T - round(stop / T)) < 1e-9 and stop <= 30 * T + 1e-9:
            expected.append(y[2])
    np.testing.assert_allclose(sensed, expected, rtol=0, atol=1e-5)


def test_after_a_force_s_time_to_live_the_host_s_clock_finds_none(new_host: New) -> None:
    for mock in ({}, {"acceleration_bandwidth": 1e5}):
        host = new_host(device={"mass": 1.0, "force_limit": 1.0, "acceleration_age": 1, **SENSOR}, mock=mock)
        host.arm(schema.PACED_BY_HOST, now=0, parts=schema.WITH_ACCELERATION)
        host.force(0, [2**30], time_to_live=1, now=1_000_000)
        (alive,) = host.force(1, [2**30], time_to_live=1, now=2_000_000)
        (over,) = host.force(2, [2**30], time_to_live=1, now=9_000_000)
        assert alive.counts[1] * QUANTUM == pytest.approx(0.5, abs=1e-6)
        assert over.counts[1] == pytest.approx(0, abs=1)


def test_its_noise_is_its_own_and_as_large_as_stated(new_host: New) -> None:
    mock = {"noise": 1e-6, "acceleration_noise": 0.05}
    host = new_host(device={"mass": 1.0}, mock=mock)
    sensed, _ = ran(host, [0] * 3000)
    assert abs(sensed.mean()) < 4 * 0.05 / math.sqrt(3000)
    assert sensed.std() == pytest.approx(0.05, rel=4 / math.sqrt(2 * 3000))
    quiet, _ = ran(new_host(device={"mass": 1.0}, mock={"noise": 1e-6}), [0] * 9)
    assert not quiet.any()


@pytest.mark.parametrize("channels", [1, 2, 16])
def test_accelerations_stand_behind_the_positions_and_the_velocities_if_those_were_requested(
    new_host: New, channels: int
) -> None:
    push = [0.1 * (c + 1) for c in range(channels)]
    host = new_host(channels, device={"mass": 1.0, "force_limit": 1.0}, mock={"hand": {"force": push}})
    expected = [round(each / QUANTUM) for each in push]
    for parts in schema.COMBINATIONS[:4]:
        _, position = host.arm(parts=parts)
        assert len(position.counts) == channels * (1 + parts.bit_count())
        own = position.counts[-channels:] if parts & schema.WITH_ACCELERATION else ()
        assert list(own) == (expected if own else [])
        host.disarm()
    assert host.misread == 0


def test_one_beyond_its_scale_stops_at_the_end_of_it_and_is_no_fault(new_host: New) -> None:
    host = new_host(device={"mass": 1.0, "force_limit": 1.0}, mock={"hand": {"force": -2000.0}})
    _, position = host.arm(parts=schema.WITH_ACCELERATION)
    assert position.counts == (0, -2147483647)
    assert host.state == schema.ARMED


def test_the_mock_declares_it_with_a_scale_for_a_thousand_times_its_force(new_host: New) -> None:
    host = new_host(2, device={"mass": [0.2, 0.5], "force_limit": 4.0})
    said = from_registers(host.mock.registers)
    assert said.sensed == ("velocity", "acceleration")
    assert said.acceleration_scale == pytest.approx((4.0 / 0.2 * QUANTUM, 4.0 / 0.5 * QUANTUM), rel=1e-12)
    assert host.register(15) == 1
    assert host.register(160 + 16) | host.register(160 + 17) << 32 == np.float64(said.acceleration_scale[1]).view(int)


@pytest.mark.parametrize("parts", [schema.WITH_ACCELERATION, schema.MOTION_BITS])
def test_a_mock_without_the_sensor_refuses_to_send_it(new_host: New, parts: int) -> None:
    host = new_host()
    host.mock.offered &= ~schema.WITH_ACCELERATION
    (status,) = host.arm(parts=parts)
    assert (status.state, status.fault) == (schema.IDLE, schema.WRONG_SENSING)
    assert host.arm(parts=schema.WITH_VELOCITY)[0].state == schema.ARMED


def test_what_names_no_part_is_a_pacing_that_the_mock_does_not_have(new_host: New) -> None:
    (status,) = new_host().arm(3)
    assert (status.state, status.fault) == (schema.IDLE, schema.WRONG_PACING)
