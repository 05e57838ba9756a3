"""The mock's firmware, driven with the bytes of the protocol in virtual time: describing, arming, exchanging."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.description import from_registers, to_registers
from hapsim.device.mock.assemble import describe_mock

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


def test_the_description_says_what_the_scene_says(new_host: New) -> None:
    host = new_host(2, rate=2500.0, device={"force_limit": 7.5}, mock={"quantum": 2e-7})
    registers = np.array([host.register(number) for number in range(schema.REGISTERS)])
    said = from_registers(registers)
    assert (said.rate_hz, said.channels, said.version) == (2500.0, 2, schema.VERSION)
    assert (said.position_scale, said.force_limit) == ((2e-7, 2e-7), (7.5, 7.5))
    assert said.force_scale[0] * -(2**31) == -7.5
    assert said.velocity_scale == (2e-7 * 2500.0,) * 2
    assert said.senses_velocity
    assert all(said.paces(pacing) for pacing in (DEVICE, HOST, LOCKSTEP))
    assert struct.pack("<4I", *registers[schema.REG_NAME :][:4]).rstrip(b"\0") == b"hapsim mock"


def test_the_mock_s_steps_of_force_stay_fine_however_large_a_limit_a_scene_has(new_host: New) -> None:
    host = new_host(2, device={"force_limit": 1e12})
    said = from_registers(np.array([host.register(number) for number in range(schema.REGISTERS)]))
    assert said.force_limit == (1e6, 1e6)
    assert said.force_scale[0] * 2**31 == 1e6


@pytest.mark.parametrize("number", [schema.REGISTERS, schema.REGISTERS + 1, 1000, 4095])
def test_a_register_that_does_not_exist_reads_0(new_host: New, number: int) -> None:
    assert new_host(16).register(number) == 0


def test_describe_is_not_answered_while_armed(new_host: New) -> None:
    for channels in (1, 4):
        host = new_host(channels)
        host.arm()
        for armed in (False, True):
            assert host.send(host.frame(schema.DESCRIBE, schema.REG_VERSION, 0, [0], armed=armed)) == []
        assert host.state == schema.ARMED


# Arming.


@pytest.mark.parametrize("channels", [1, 3, 4, 16])
@pytest.mark.parametrize("pacing", [DEVICE, HOST, LOCKSTEP])
def test_arming_is_answered_by_a_status_and_then_position_0(new_host: New, channels: int, pacing: int) -> None:
    where = [0.001 * (c + 1) for c in range(channels)]
    host = new_host(channels, mock={"initial": {"position": where}, "quantum": 1e-6})
    status, position = host.arm(pacing)
    assert (status.type, status.number, status.state, status.fault) == (schema.STATUS, 0, schema.ARMED, 0)
    assert (position.type, position.number) == (schema.POSITION, 0)
    assert position.counts == tuple(1000 * (c + 1) for c in range(channels))
    assert host.misread == 0


@pytest.mark.parametrize(
    ("pacing", "watchdog", "word", "fault"),
    [
        (LOCKSTEP, 100, schema.SCHEMA_HASH ^ 1, schema.WRONG_SCHEMA),
        (LOCKSTEP, 100, schema.SCHEMA_HASH ^ 0x80000000, schema.WRONG_SCHEMA),
        (LOCKSTEP, 100, 0, schema.WRONG_SCHEMA),
        (3, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (64, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (127, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (255, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (3 | schema.WITH_VELOCITY, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (LOCKSTEP | schema.WITH_VELOCITY, 100, schema.SCHEMA_HASH ^ 1, schema.WRONG_SCHEMA),
        (LOCKSTEP | schema.WITH_VELOCITY, 0, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
        (DEVICE, 0, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
        (DEVICE, schema.MAX_WATCHDOG_SAMPLES + 1, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
        (DEVICE, 4095, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
    ],
)
def test_arming_wrongly_is_refused_with_the_fault_that_says_why(
    new_host: New, pacing: int, watchdog: int, word: int, fault: int
) -> None:
    host = new_host()
    (status,) = host.send(host.arm_frame(pacing, watchdog, word))
    assert (status.type, status.state, status.fault) == (schema.STATUS, schema.IDLE, fault)
    assert host.register(schema.REG_FAULT) == fault
    status, _ = host.arm()
    assert (status.state, status.fault) == (schema.ARMED, schema.NO_FAULT)


def test_a_pacing_that_the_device_does_not_offer_is_refused(new_host: New) -> None:
    host = new_host()
    host.mock.registers[schema.REG_PACINGS] = 1 << LOCKSTEP
    for pacing in (DEVICE, HOST):
        (status,) = host.arm(pacing)
        assert status.fault == schema.WRONG_PACING
    assert host.arm(LOCKSTEP)[0].state == schema.ARMED


def test_a_device_that_senses_no_velocity_refuses_to_arm_with_velocities_and_arms_without(new_host: New) -> None:
    host = new_host(2)
    host.mock.converters["velocity_quantum"] = 0.0
    (status,) = host.arm(velocity=True)
    assert (status.state, status.fault) == (schema.IDLE, schema.WRONG_SENSING)
    assert host.register(schema.REG_FAULT) == schema.WRONG_SENSING
    status, position = host.arm()
    assert (status.state, len(position.counts)) == (schema.ARMED, 2)


@pytest.mark.parametrize("watchdog", [1, schema.MAX_WATCHDOG_SAMPLES])
def test_the_watchdog_may_be_anything_from_1_to_what_the_device_allows(new_host: New, watchdog: int) -> None:
    assert new_host().arm(DEVICE, watchdog)[0].state == schema.ARMED


def test_arming_an_armed_device_changes_nothing(new_host: New) -> None:
    host = new_host()
    host.arm()
    host.force(0, [FULL])
    before = host.bodies.copy(), host.commanded.copy(), int(host.mock.board.n)
    assert host.send(host.arm_frame()) == []
    assert host.send(host.frame(schema.ARM, 100, LOCKSTEP, [0], armed=True)) == []
    assert (host.bodies == before[0]).all()
    assert (host.commanded == before[1]).all()
    assert host.mock.board.n == before[2] == 1


def test_a_force_before_arming_is_ignored(new_host: New) -> None:
    host = new_host()
    for armed in (False, True):
        assert host.send(host.frame(schema.FORCE, 0, 20, [FULL], armed=armed)) == []
    assert not host.commanded.any()
    assert host.register(schema.REG_ACCEPTED) == 0
    _, position = host.arm()
    assert position.number == 0
    assert not host.commanded.any()


# Exchanging.


@pytest.mark.parametrize("channels", [1, 3, 4, 16])
@pytest.mark.parametrize("pacing", [HOST, LOCKSTEP])
def test_each_force_gives_exactly_one_next_position(new_host: New, channels: int, pacing: int) -> None:
    host = new_host(channels)
    host.arm(pacing)
    for n in range(20):
        (position,) = host.force(n, [n * 1000] * channels, now=(n + 1) * T_NS)
        assert (position.type, position.number) == (schema.POSITION, n + 1)
    assert host.misread == 0
    host.disarm()
    assert host.register(schema.REG_ACCEPTED) == 20
    assert host.register(schema.REG_HELD) == 0


@pytest.mark.parametrize("channels", [1, 3, 4, 16])
def test_every_channel_moves_by_its_own_force(new_host: New, channels: int) -> None:
    host = new_host(channels, device={"delay": 0, "mass": 1.0}, mock={"quantum": 1e-12})
    host.arm()
    (position,) = host.force(0, [(c + 1) * 2**26 for c in range(channels)])
    step = 10.0 * 2.0**26 / 2**31 * 1e-6 / 2 / 1e-12
    assert position.counts == pytest.approx([step * (c + 1) for c in range(channels)], abs=1)


def test_paced_by_the_device_a_force_gives_no_position_until_the_sample_is_over(new_host: New) -> None:
    host = new_host()
    host.arm(DEVICE)
    for n in range(5):
        assert host.force(n) == []
        (position,) = host.sample_passes()
        assert (position.type, position.number) == (schema.POSITION, n + 1)


def test_paced_by_the_host_the_mass_moves_for_as_long_as_the_force_was_in_coming(new_host: New) -> None:
    host = new_host(mock={"initial": {"velocity": 1.0}})
    host.arm(HOST, now=5 * T_NS)
    for n, now in enumerate([6.0, 6.5, 9.0, 9.0]):
        (position,) = host.force(n, now=int(now * T_NS))
        assert position.counts[0] * 1e-9 == pytest.approx((now - 5) * 1e-3, abs=3e-9)


def test_a_sample_without_an_answer_holds_the_force_and_says_so(new_host: New) -> None:
    host = new_host(device={"delay": 0, "mass": 1.0}, mock={"quantum": 1e-12})
    host.arm(DEVICE)
    host.force(0, [2**30])
    types, speeds = [], []
    for _ in range(4):
        (position,) = host.sample_passes()
        types.append(position.type)
        speeds.append(float(host.bodies["velocity"][0]))
    assert types == [schema.POSITION, *[schema.POSITION_HELD] * 3]
    assert speeds == pytest.approx([0.005, 0.01, 0.015, 0.02])
    host.disarm()
    assert host.register(schema.REG_HELD) == 3


def test_an_impulse_is_not_held(new_host: New) -> None:
    host = new_host(device={"delay": 0, "mass": 1.0, "hold": "impulse"})
    host.arm(DEVICE)
    host.force(0, [2**30])
    for _ in range(4):
        host.sample_passes()
        assert host.bodies["velocity"][0] == pytest.approx(0.005)


def test_of_two_forces_in_one_sample_the_later_one_acts(new_host: New) -> None:
    host = new_host(device={"delay": 0, "mass": 1.0})
    host.arm(DEVICE)
    host.force(0, [2**30])
    host.force(0, [-(2**30)])
    (position,) = host.sample_passes()
    assert position.type == schema.POSITION
    assert host.bodies["velocity"][0] == pytest.approx(-0.005)


@pytest.mark.parametrize("age", [1, 2, 5])
def test_a_late_force_acts_and_the_position_says_that_its_sample_was_not_answered(new_host: New, age: int) -> None:
    host = new_host(device={"delay": 0, "mass": 1.0})
    host.arm(DEVICE)
    for _ in range(age):
        host.sample_passes()
    host.force(0, [2**30], time_to_live=age)
    (position,) = host.sample_passes()
    assert position.type == schema.POSITION_HELD
    assert host.bodies["velocity"][0] == pytest.approx(0.005)


# Time to live.


@pytest.mark.parametrize("ttl", [0, 1, 3, 255])
def test_a_force_acts_in_its_sample_and_for_its_time_to_live_after_that(new_host: New, ttl: int) -> None:
    host = new_host(device={"delay": 0})
    host.arm(DEVICE, watchdog=schema.MAX_WATCHDOG_SAMPLES)
    host.force(0, [FULL], ttl)
    acted = 0
    for n in range(ttl + 5):
        host.sample_passes()
        acted += bool(host.commanded[n % len(host.commanded)].any())
        assert host.commanded[n % len(host.commanded)].any() == (n <= ttl)
    assert acted == ttl + 1


@pytest.mark.parametrize("ttl", [0, 1, 3, 255])
def test_a_force_older_than_its_time_to_live_is_refused_and_counted(new_host: New, ttl: int) -> None:
    host = new_host()
    host.arm(DEVICE, watchdog=schema.MAX_WATCHDOG_SAMPLES)
    for _ in range(ttl + 1):
        host.sample_passes()
    host.force(0, [FULL], ttl)
    host.sample_passes()
    assert not host.commanded.any()
    host.force(2, [FULL], ttl)  # of age ttl, sample ttl + 2 lasts now
    assert host.commanded.any()
    host.disarm()
    assert [host.register(number) for number in (schema.REG_ACCEPTED, schema.REG_EXPIRED)] == [1, 1]


@pytest.mark.parametrize("ahead", [1, 2, 100, 2047, 2048, 3840])
def test_a_force_from_the_future_is_refused(new_host: New, ahead: int) -> None:
    for pacing in (DEVICE, HOST, LOCKSTEP):
        host = new_host()
        host.arm(pacing)
        assert host.force(ahead, [FULL], 255) == []
        assert not host.commanded.any()
        assert host.mock.registers[schema.REG_EXPIRED] == 1
        assert host.mock.registers[schema.REG_ACCEPTED] == 0
        assert host.mock.board.n == 0


def test_a_refused_force_does_not_feed_the_watchdog(new_host: New) -> None:
    host = new_host()
    host.arm(DEVICE, watchdog=3)
    for n in range(3):
        host.force(n + 1, [FULL], 255)
        host.sample_passes()
    (status,) = host.look_at_watchdog()
    assert (status.state, status.fault) == (schema.LATCHED, schema.HOST_QUIET)


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


@pytest.mark.parametrize("time_to_live", [0, 4])
@pytest.mark.parametrize("silence_ms", [3, 200])
def test_paced_by_the_host_a_force_ends_by_the_devices_own_clock(
    new_host: New, time_to_live: int, silence_ms: int
) -> None:
    """No tick comes while the host is silent: the force acts for t + 1 nominal periods, and then it is zero."""
    host = new_host(device={"mass": 0.5, "friction": 0.0, "force_limit": 10.0})
    host.arm(schema.PACED_BY_HOST, watchdog=2000, now=0)
    host.force(0, [2**30], time_to_live=time_to_live, now=1_000_000)  # 5 N
    host.force(1, [0], time_to_live=time_to_live, now=1_000_000 + silence_ms * 1_000_000)
    acted = min(silence_ms, time_to_live + 1) * 1e-3
    assert host.bodies["velocity"][0] == pytest.approx(5.0 / 0.5 * acted, rel=1e-9)
    assert host.state == schema.ARMED
