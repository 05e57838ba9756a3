"""The mock's firmware, driven with the bytes of the protocol in virtual time: what its bodies do, and what survives.

What the protocol asks of every device, the mock among them, is held to account by tests/firmware/test_firmware_sessions
and by the model in test_mock_attacked.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.description import from_registers, to_registers
from hapsim.device.mock.assemble_mock import describe_mock

DEVICE, HOST, LOCKSTEP = schema.PACED_BY_DEVICE, schema.PACED_BY_HOST, schema.LOCKSTEP
T_NS = 1_000_000
FULL = 2**31 - 1

New = Callable[..., Any]


# Description.


@pytest.mark.parametrize("channels", [1, 3, 4, 16])
def test_describe_answers_every_register(new_host: New, new_scene: New, channels: int) -> None:
    description = describe_mock(new_scene(channels))
    host = new_host(channels)
    answered = np.array([host.register(number) for number in range(schema.REGISTERS)])
    assert answered.tolist() == to_registers(description).tolist()
    assert from_registers(answered) == description
    assert host.misread == 0


def test_the_description_states_the_values_of_the_scene(new_host: New) -> None:
    host = new_host(2, rate=2500.0, device={"force_limit": 7.5}, mock={"quantum": 2e-7})
    registers = np.array([host.register(number) for number in range(schema.REGISTERS)])
    said = from_registers(registers)
    assert (said.rate_hz, said.channels, said.version) == (2500.0, 2, schema.VERSION)
    assert (said.position_scale, said.force_limit) == ((2e-7, 2e-7), (7.5, 7.5))
    assert said.force_scale[0] * -(2**31) == -7.5
    assert said.velocity_scale == (2e-7 * 2500.0,) * 2
    assert said.sensed == ("velocity", "acceleration")
    assert all(said.paces(pacing) for pacing in (DEVICE, HOST, LOCKSTEP))
    assert struct.pack("<4I", *registers[schema.REG_NAME :][:4]).rstrip(b"\0") == b"hapsim mock"


def test_the_mock_s_steps_of_force_stay_fine_however_large_a_limit_a_scene_has(new_host: New) -> None:
    host = new_host(2, device={"force_limit": 1e12})
    said = from_registers(np.array([host.register(number) for number in range(schema.REGISTERS)]))
    assert said.force_limit == (1e6, 1e6)
    assert said.force_scale[0] * 2**31 == 1e6


# Exchanging.


def test_paced_by_the_host_the_mass_moves_for_as_long_as_the_force_was_in_coming(new_host: New) -> None:
    host = new_host(mock={"initial": {"velocity": 1.0}})
    host.arm(HOST, now=5 * T_NS)
    for n, now in enumerate([6.0, 6.5, 9.0, 9.0]):
        (position,) = host.force(n, now=int(now * T_NS))
        assert position.counts[0] * 1e-9 == pytest.approx((now - 5) * 1e-3, abs=3e-9)


# The limit.


def test_a_force_above_the_limit_is_cut_and_counted(new_host: New) -> None:
    host = new_host(3, device={"delay": 0, "force_limit": 10.0})
    host.mock.force_limit[:3] = [1.0, 10.0, 3.0]
    host.arm()
    host.force(0, [2**30, -(2**30), -(2**30)])  # 5, -5 and -5 N
    assert host.commanded[0].tolist() == [1.0, -5.0, -3.0]
    host.force(1, [2**26, 2**26, 2**26])
    assert host.commanded[1].tolist() == [0.3125] * 3
    host.disarm()
    assert host.register(schema.REG_LIMITED) == 2


@pytest.mark.parametrize("limit", [1e-3, 0.1, 10.0, 3.3333, 1e6])
def test_the_end_of_the_force_scale_is_the_limit(new_host: New, limit: float) -> None:
    host = new_host(device={"delay": 0, "force_limit": limit, "mass": 1e6})
    host.arm()
    host.force(0, [-(2**31)])
    host.force(1, [2**31 - 1])
    assert host.commanded[0, 0] == -limit
    assert host.commanded[1, 0] == pytest.approx(limit, rel=1e-9)
    assert host.commanded[1, 0] <= limit
    assert host.mock.registers[schema.REG_LIMITED] == 0


# The watchdog.


@pytest.mark.parametrize("rate", [1000.0, 333.0])
def test_paced_by_the_host_the_watchdog_is_a_time(new_host: New, rate: float) -> None:
    host = new_host(rate=rate)
    start = 10**12
    host.arm(HOST, watchdog=10, now=start)
    host.force(0, [FULL], now=start + T_NS)
    period = 1e9 / rate
    assert host.check_watchdog(now=start + T_NS + int(10.99 * period)) == []
    (status,) = host.check_watchdog(now=start + T_NS + int(11.01 * period))
    assert (status.state, status.fault) == (schema.LATCHED, schema.HOST_QUIET)
    assert not host.commanded.any()


@pytest.mark.parametrize("time_to_live", [0, 20, 255])
@pytest.mark.parametrize("rate", [1000.0, 333.0])
@pytest.mark.parametrize("silence", [0.5, 0.999, 1.001, 3.0])
def test_paced_by_the_host_a_force_acts_for_its_time_to_live_and_one_period_by_the_device_s_own_clock(
    new_host: New, time_to_live: int, rate: float, silence: float
) -> None:
    """A host that speaks again after `silence`, in times to live, finds the mass where the ended force left it."""
    host = new_host(rate=rate, device={"mass": 2.0, "force_limit": 1.0})
    host.arm(HOST, watchdog=2047, now=10**12)
    lives = (time_to_live + 1) / rate
    host.force(0, [2**30], time_to_live, now=10**12)  # half a newton
    (position,) = host.force(1, [0], 255, now=10**12 + int(silence * lives * 1e9))
    acted, coasted = min(silence, 1.0) * lives, max(silence - 1.0, 0.0) * lives
    moved = 0.25 * acted * (acted / 2 + coasted)
    assert position.counts[0] * 1e-9 == pytest.approx(moved, rel=1e-6, abs=0.6e-9)
    # The host hears that for a part of that sample there was no force; and the next force acts as ever.
    assert position.type == (schema.POSITION_HELD if silence > 1.0 else schema.POSITION)
    assert host.state == schema.ARMED
    assert host.force(2, [FULL], now=10**12 + int(silence * lives * 1e9) + T_NS)[0].type == schema.POSITION
    assert host.commanded.any()
    host.disarm()
    assert host.register(schema.REG_HELD) == (silence > 1.0)


def test_a_force_on_its_way_to_the_actuator_goes_with_the_time_to_live_of_the_newest(new_host: New) -> None:
    host = new_host(device={"mass": 1.0, "delay": 3.0})
    host.arm(HOST, watchdog=2047, now=0)
    for n in range(3):
        host.force(n, [FULL], 5, now=(n + 1) * T_NS)
    host.force(3, [0], 5, now=20 * T_NS)
    assert not host.commanded.any()
    for n in (4, 5):
        host.force(n, [0], 5, now=(n + 17) * T_NS)
    # The first of them acted from 3 ms on, for 6 ms; the others were to act from 20 ms on.
    assert host.bodies["velocity"][0] == pytest.approx(0.06, rel=1e-8)


def test_in_lockstep_only_a_host_that_is_gone_latches_whatever_the_watchdog(new_host: New) -> None:
    host = new_host()
    host.arm(LOCKSTEP, watchdog=1, now=10**12)
    host.force(0, [FULL], now=10**12 + 5 * 10**9)
    assert host.check_watchdog(now=10**12 + 15 * 10**9) == []
    (status,) = host.check_watchdog(now=10**12 + 15 * 10**9 + 1)
    assert (status.state, status.fault) == (schema.LATCHED, schema.HOST_QUIET)
    assert not host.commanded.any()
    assert host.register(schema.REG_VERSION) == schema.VERSION  # the next host is heard


def latched(new_host: New, channels: int = 1) -> Any:
    host = new_host(channels)
    host.arm(DEVICE, watchdog=1)
    host.force(0, [FULL] * channels, 255)
    host.sample_passes()
    host.sample_passes()
    assert host.check_watchdog()[0].state == schema.LATCHED
    return host


def test_a_run_of_a_thousand_years_goes_on_as_it_began(new_host: New) -> None:
    fields = {"device": {"delay": 2.5, "friction": 1.0}}
    young, old = new_host(**fields), new_host(**fields)
    years = 2**45 * 3 * schema.SAMPLE_MODULUS
    for host in (young, old):
        host.arm()
    old.mock.board.n = years
    for n in range(30):
        counts = [(n * 7919 % 101 - 50) * 2**24]
        assert old.force(years + n, counts) == young.force(n, counts)


# State that survives.


def trace(host: Any, pacing: int) -> list[Any]:
    random = np.random.default_rng(3)
    heard = host.arm(pacing)
    for n in range(60):
        if pacing != DEVICE or random.random() < 0.7:
            heard += host.force(n, random.integers(-(2**31), 2**31, host.channels), 2, now=(n + 1) * T_NS)
        if pacing == DEVICE:
            heard += host.sample_passes()
    return heard


@pytest.mark.parametrize("hold", ["zoh", "impulse"])
@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("pacing", [DEVICE, HOST, LOCKSTEP])
def test_a_second_arming_repeats_the_first_run_to_the_last_count(
    new_host: New, hold: str, sampling: str, pacing: int
) -> None:
    device = {"delay": 3.3, "friction": 0.5, "hold": hold, "sampling": sampling}
    mock = {"noise": 1e-5, "coulomb": 0.3, "initial": {"position": 0.01, "velocity": [0.1, -0.2]}}
    host = new_host(2, device=device, mock=mock)
    first = trace(host, pacing)
    host.disarm()
    counters = [host.register(number) for number in range(schema.REG_ACCEPTED, schema.REG_LIMITED + 1)]
    for other in (DEVICE, HOST, LOCKSTEP):  # and whatever lies in between
        trace(host, other)
        host.disarm()
    assert trace(host, pacing) == first
    host.disarm()
    assert [host.register(number) for number in range(schema.REG_ACCEPTED, schema.REG_LIMITED + 1)] == counters


def test_a_run_after_a_latch_is_like_the_first(new_host: New) -> None:
    fresh, host = new_host(), latched(new_host)
    assert trace(host, DEVICE) == trace(fresh, DEVICE)
