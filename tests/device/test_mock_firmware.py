"""The mock's firmware, driven with the bytes of the protocol in virtual time: what it answers, what force it leaves."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.description import from_registers, to_registers
from hapsim.device.mock.assemble import describe_mock
from hapsim.device.mock.firmware import INPUT_BYTES, OUTBOX_BYTES, take_bytes

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
    assert all(said.paces(pacing) for pacing in (DEVICE, HOST, LOCKSTEP))
    assert struct.pack("<4I", *registers[schema.REG_NAME :][:4]).rstrip(b"\0") == b"hapsim mock"


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
        (255, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
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


@pytest.mark.parametrize("watchdog", [1, schema.MAX_WATCHDOG_SAMPLES])
def test_the_watchdog_may_be_anything_from_1_to_what_the_device_allows(new_host: New, watchdog: int) -> None:
    assert new_host().arm(DEVICE, watchdog)[0].state == schema.ARMED


def test_arming_an_armed_device_changes_nothing(new_host: New) -> None:
    host = new_host()
    host.arm()
    host.force(0, [FULL])
    before = host.mock.bodies.copy(), host.commanded.copy(), int(host.mock.board["n"])
    assert host.send(host.arm_frame()) == []
    assert host.send(host.frame(schema.ARM, 100, LOCKSTEP, [0], armed=True)) == []
    assert (host.mock.bodies == before[0]).all()
    assert (host.commanded == before[1]).all()
    assert host.mock.board["n"] == before[2] == 1


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
        speeds.append(float(host.mock.bodies["velocity"][0]))
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
        assert host.mock.bodies["velocity"][0] == pytest.approx(0.005)


def test_of_two_forces_in_one_sample_the_later_one_acts(new_host: New) -> None:
    host = new_host(device={"delay": 0, "mass": 1.0})
    host.arm(DEVICE)
    host.force(0, [2**30])
    host.force(0, [-(2**30)])
    (position,) = host.sample_passes()
    assert position.type == schema.POSITION
    assert host.mock.bodies["velocity"][0] == pytest.approx(-0.005)


@pytest.mark.parametrize("age", [1, 2, 5])
def test_a_late_force_acts_and_the_position_says_that_its_sample_was_not_answered(new_host: New, age: int) -> None:
    host = new_host(device={"delay": 0, "mass": 1.0})
    host.arm(DEVICE)
    for _ in range(age):
        host.sample_passes()
    host.force(0, [2**30], time_to_live=age)
    (position,) = host.sample_passes()
    assert position.type == schema.POSITION_HELD
    assert host.mock.bodies["velocity"][0] == pytest.approx(0.005)


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
        assert host.mock.board["n"] == 0


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
    host.mock.force_limit[:] = [1.0, 10.0, 3.0]
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


@pytest.mark.parametrize("watchdog", [1, 2, 10, 2047])
def test_paced_by_the_device_the_watchdog_latches_after_its_number_of_samples_without_a_force(
    new_host: New, watchdog: int
) -> None:
    host = new_host(device={"mass": 1e3})
    host.arm(DEVICE, watchdog)
    host.force(0, [FULL], 255)
    assert host.sample_passes()[0].type == schema.POSITION
    for _ in range(watchdog):
        assert host.look_at_watchdog() == []
        host.sample_passes()
    (status,) = host.look_at_watchdog()
    assert (status.type, status.state, status.fault) == (schema.STATUS, schema.LATCHED, schema.HOST_QUIET)
    assert not host.commanded.any()
    assert host.misread == 0


@pytest.mark.parametrize("watchdog", [1, 10, 2047])
def test_a_host_that_never_answers_is_given_as_long(new_host: New, watchdog: int) -> None:
    host = new_host()
    host.arm(DEVICE, watchdog)
    passed = 0
    while not host.look_at_watchdog():
        host.sample_passes()
        passed += 1
    assert passed == watchdog


@pytest.mark.parametrize("rate", [1000.0, 333.0])
def test_paced_by_the_host_the_watchdog_is_a_time(new_host: New, rate: float) -> None:
    host = new_host(rate=rate)
    start = 10**12
    host.arm(HOST, watchdog=10, now=start)
    host.force(0, [FULL], now=start + T_NS)
    period = 1e9 / rate
    assert host.look_at_watchdog(now=start + T_NS + int(10.99 * period)) == []
    (status,) = host.look_at_watchdog(now=start + T_NS + int(11.01 * period))
    assert (status.state, status.fault) == (schema.LATCHED, schema.HOST_QUIET)
    assert not host.commanded.any()


def test_in_lockstep_only_a_host_that_is_gone_latches_whatever_the_watchdog(new_host: New) -> None:
    host = new_host()
    host.arm(LOCKSTEP, watchdog=1, now=10**12)
    host.force(0, [FULL], now=10**12 + 5 * 10**9)
    assert host.look_at_watchdog(now=10**12 + 15 * 10**9) == []
    (status,) = host.look_at_watchdog(now=10**12 + 15 * 10**9 + 1)
    assert (status.state, status.fault) == (schema.LATCHED, schema.HOST_QUIET)
    assert not host.commanded.any()
    assert host.register(schema.REG_VERSION) == schema.VERSION  # the next host is heard


def test_the_watchdog_sleeps_while_the_device_is_not_armed(new_host: New) -> None:
    host = new_host()
    assert host.look_at_watchdog(now=10**18) == []
    host.arm(HOST, watchdog=1, now=0)
    host.disarm()
    assert host.look_at_watchdog(now=10**18) == []


def latched(new_host: New, channels: int = 1) -> Any:
    host = new_host(channels)
    host.arm(DEVICE, watchdog=1)
    host.force(0, [FULL] * channels, 255)
    host.sample_passes()
    host.sample_passes()
    assert host.look_at_watchdog()[0].state == schema.LATCHED
    return host


@pytest.mark.parametrize("channels", [1, 4])
def test_only_arming_brings_a_latched_device_back_to_force(new_host: New, channels: int) -> None:
    host = latched(new_host, channels)
    for armed in (False, True):
        assert host.send(host.frame(schema.FORCE, 2, 255, [FULL] * channels, armed=armed)) == []
    assert host.register(schema.REG_FAULT) == schema.HOST_QUIET
    assert host.look_at_watchdog() == []
    assert not host.commanded.any()
    (refused,) = host.arm(DEVICE, watchdog=0)
    assert (refused.state, refused.fault) == (schema.LATCHED, schema.WRONG_WATCHDOG)
    status, _ = host.arm(DEVICE)
    assert (status.state, status.fault) == (schema.ARMED, schema.NO_FAULT)
    assert not host.commanded.any()
    host.force(0, [FULL] * channels)
    assert host.commanded.any()


def test_disarming_a_latched_device_is_confirmed_and_the_fault_can_still_be_read(new_host: New) -> None:
    host = latched(new_host)
    (status,) = host.disarm()
    assert (status.state, status.fault) == (schema.IDLE, schema.HOST_QUIET)
    assert host.register(schema.REG_FAULT) == schema.HOST_QUIET
    assert host.send(host.frame(schema.FORCE, 2, 255, [FULL])) == []
    assert not host.commanded.any()


# Out of scale.


def test_a_position_out_of_scale_latches(new_host: New) -> None:
    host = new_host(3, device={"delay": 0}, mock={"quantum": 1e-12, "initial": {"velocity": [0.0, 1.0, 0.0]}})
    host.arm()  # the second channel leaves 2.147 mm in the third sample
    assert [host.force(n, [FULL] * 3)[0].type for n in range(2)] == [schema.POSITION] * 2
    (status,) = host.force(2, [FULL] * 3)
    assert (status.type, status.number, status.state) == (schema.STATUS, 3, schema.LATCHED)
    assert status.fault == schema.POSITION_OUT_OF_RANGE
    assert not host.commanded.any()
    assert host.force(3, [FULL] * 3) == []
    assert host.register(schema.REG_FAULT) == schema.POSITION_OUT_OF_RANGE


def test_a_start_out_of_scale_latches_at_once_and_again_at_every_arming(new_host: New) -> None:
    host = new_host(4, mock={"quantum": 1e-9, "initial": {"position": 3.0}})
    for _ in range(3):
        armed, stopped = host.arm()
        assert (armed.state, stopped.state) == (schema.ARMED, schema.LATCHED)
        assert stopped.fault == schema.POSITION_OUT_OF_RANGE
        assert host.misread == 0


def test_a_position_that_went_out_of_scale_does_not_latch_the_next_run(new_host: New) -> None:
    host = new_host(device={"delay": 0, "mass": 1e-3}, mock={"quantum": 1e-9})
    host.arm()
    n = 0
    while host.force(n, [FULL])[0].type == schema.POSITION:
        n += 1
    assert n > 1
    status, position = host.arm()
    assert (status.state, position.counts) == (schema.ARMED, (0,))
    assert host.force(0)[0].type == schema.POSITION


# Disarming.


@pytest.mark.parametrize("channels", [1, 3, 4, 16])
@pytest.mark.parametrize("pacing", [DEVICE, HOST, LOCKSTEP])
def test_disarming_zeroes_every_force_at_once_those_on_their_way_too(new_host: New, channels: int, pacing: int) -> None:
    host = new_host(channels, device={"delay": 7.5})
    host.arm(pacing)
    for n in range(4):
        host.force(n, [FULL] * channels)
        if pacing == DEVICE:
            host.sample_passes()
    assert host.commanded.any()
    (status,) = host.disarm()
    assert (status.type, status.number, status.state) == (schema.STATUS, 4, schema.IDLE)
    assert not host.commanded.any()
    assert host.misread == 0


@pytest.mark.parametrize("channels", [1, 4])
def test_disarming_is_understood_in_the_format_of_the_state_that_the_device_is_in(new_host: New, channels: int) -> None:
    host = new_host(channels)
    (status,) = host.send(host.disarm_frame(armed=False))
    assert status.state == schema.IDLE
    host.arm()
    (status,) = host.send(host.disarm_frame(armed=True))
    assert status.state == schema.IDLE
    host.arm()
    # A host that does not know which it is sends both, as the conversation does.
    (status,) = host.send(host.disarm_frame(armed=False) + host.disarm_frame(armed=True))
    assert status.state == schema.IDLE


def test_a_disarm_right_behind_a_force_leaves_none_of_it(new_host: New) -> None:
    host = new_host()
    host.arm()
    position, status = host.send(host.force_frame(0, [FULL]) + host.disarm_frame())
    assert (position.type, status.state) == (schema.POSITION, schema.IDLE)
    assert not host.commanded.any()


# Sample numbers.


def test_sample_numbers_wrap_and_the_exchange_goes_on(new_host: New) -> None:
    host = new_host(mock={"initial": {"velocity": 1e-3}})
    (_, position) = host.arm()
    for n in range(2 * schema.SAMPLE_MODULUS + 5):
        (position,) = host.force(n, [1], time_to_live=0)
        assert (position.type, position.number) == (schema.POSITION, (n + 1) % schema.SAMPLE_MODULUS)
    host.disarm()
    assert host.register(schema.REG_ACCEPTED) == 2 * schema.SAMPLE_MODULUS + 5


@pytest.mark.parametrize("start", [schema.SAMPLE_MODULUS - 1, 7 * schema.SAMPLE_MODULUS - 1, 2**52 - 1])
def test_ages_are_counted_across_the_wrap(new_host: New, start: int) -> None:
    """`start` is the last sample before a wrap; the board is set there, as after a long run."""
    host = new_host(device={"delay": 0})
    host.arm(DEVICE, watchdog=100)
    board = host.mock.board
    board["n"] = board["heard"] = start
    host.sample_passes()
    host.sample_passes()  # sample start + 2 lasts now
    host.force(start, [FULL], time_to_live=1)
    assert host.mock.registers[schema.REG_EXPIRED] == 1
    host.force(start + 3, [FULL], time_to_live=255)
    assert host.mock.registers[schema.REG_EXPIRED] == 2
    host.force(start, [FULL], time_to_live=3)
    assert host.mock.registers[schema.REG_ACCEPTED] == 1
    for expected in (True, True, False):
        host.sample_passes()
        assert host.commanded[(int(board["n"]) - 1) % len(host.commanded)].any() == expected


def test_a_run_of_a_thousand_years_goes_on_as_it_began(new_host: New) -> None:
    fields = {"device": {"delay": 2.5, "friction": 1.0}}
    young, old = new_host(**fields), new_host(**fields)
    years = 2**45 * 3 * schema.SAMPLE_MODULUS
    for host in (young, old):
        host.arm()
    old.mock.board["n"] = years
    for n in range(30):
        counts = [(n * 7919 % 101 - 50) * 2**24]
        assert old.force(years + n, counts) == young.force(n, counts)


# State that survives.


def test_the_counters_count_since_the_last_arming(new_host: New) -> None:
    host = new_host()
    numbers = range(schema.REG_ACCEPTED, schema.REG_LIMITED + 1)
    host.send(b"what a board says as it starts\0" + b"\x01" * 12 + b"\0")
    assert host.register(schema.REG_REJECTED) == 2
    host.arm()
    host.disarm()
    assert [host.register(number) for number in numbers] == [0] * 5
    host.mock.force_limit[:] = 1.0
    host.arm()
    host.force(0, [FULL])  # accepted, limited
    host.send(b"short\0")  # rejected
    host.force(0, time_to_live=0)  # expired
    host.force(0)  # accepted, a sample late
    host.disarm()
    assert [host.register(number) for number in numbers] == [2, 1, 1, 1, 1]
    host.arm()
    host.disarm()
    assert [host.register(number) for number in numbers] == [0] * 5


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


def test_what_is_left_of_a_frame_when_the_format_changes_is_forgotten(new_host: New) -> None:
    host = new_host()
    half = host.force_frame(0, [FULL])[:5]
    host.send(half)
    host.send(host.frame(schema.DESCRIBE, 0, 0, [0]))
    host.arm()
    host.send(half)
    host.send(host.disarm_frame())
    status, position = host.arm()
    assert (status.state, position.number) == (schema.ARMED, 0)


# The outbox.


def worst_inputs(host: Any) -> dict[str, bytes]:
    """Frames that, sent over and over, are answered at length."""
    return {
        "describe": host.frame(schema.DESCRIBE, 0, 0, [0], armed=False),
        "disarm": host.disarm_frame(armed=False),
        "arm": host.arm_frame(),
        "arm and disarm": host.arm_frame() + host.disarm_frame(),
        "refused": host.arm_frame(watchdog=0),
    }


@pytest.mark.parametrize("start", [0.0, 5.0])  # 5 m is out of scale: each arming is answered twice, once at length
@pytest.mark.parametrize("channels", [1, 3, 4, 16])
def test_the_answers_to_the_worst_input_fit_the_outbox(new_host: New, channels: int, start: float) -> None:
    longest = schema.frame_bytes(schema.MAX_CHANNELS, to_device=False)
    for name, frame in worst_inputs(new_host(channels)).items():
        stream = np.frombuffer((frame * (2 * INPUT_BYTES // len(frame) + 2)), np.uint8).copy()
        for begun in range(0, len(frame), 3):  # bytes of a frame that came before
            host = new_host(channels, mock={"initial": {"position": start}})
            take_bytes(host.mock, stream, begun, 0)
            host.listen()
            take_bytes(host.mock, stream[begun:].copy(), INPUT_BYTES, 0)
            assert host.mock.board["out"] <= OUTBOX_BYTES - longest, name
            assert len(host.listen()) >= 1
            assert host.misread == 0


def test_a_whole_input_of_forces_is_answered_force_by_force(new_host: New) -> None:
    for channels in (1, 16):
        host = new_host(channels)
        host.arm()
        count = INPUT_BYTES // schema.frame_bytes(channels, to_device=True)
        heard = host.send(b"".join(host.force_frame(n) for n in range(count)))
        assert [frame.number for frame in heard] == list(range(1, count + 1))


@pytest.mark.parametrize("channels", [1, 16])
def test_answers_that_nobody_fetches_are_lost_whole_and_never_beyond_the_outbox(new_host: New, channels: int) -> None:
    host = new_host(channels, mock={"initial": {"position": 5.0}})
    stream = np.frombuffer(host.arm_frame() * (INPUT_BYTES // 12), np.uint8).copy()
    for _ in range(8):
        take_bytes(host.mock, stream, stream.size, 0)
        assert host.mock.board["out"] <= OUTBOX_BYTES
    assert len(host.listen()) > 100
    assert host.misread == 0
    host.send(host.disarm_frame(armed=False))
    assert host.register(schema.REG_VERSION) == schema.VERSION


def test_two_mocks_share_nothing(new_host: New) -> None:
    one, other = new_host(), new_host()
    one.arm()
    one.force(0, [FULL])
    assert (other.state, other.commanded.any(), other.mock.board["n"]) == (schema.IDLE, False, 0)
    assert other.arm()[1].counts == (0,)
