"""The mock's firmware: everything that ends a run, and what of it survives into the next one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema

DEVICE, HOST, LOCKSTEP = schema.PACED_BY_DEVICE, schema.PACED_BY_HOST, schema.LOCKSTEP
T_NS = 1_000_000
FULL = 2**31 - 1

New = Callable[..., Any]


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


@pytest.mark.parametrize("time_to_live", [0, 20, 255])
@pytest.mark.parametrize("rate", [1000.0, 333.0])
@pytest.mark.parametrize("silence", [0.5, 0.999, 1.001, 3.0])
def test_paced_by_the_host_a_force_acts_for_its_time_to_live_and_one_period_by_the_device_s_own_clock(
    new_host: New, time_to_live: int, rate: float, silence: float
) -> None:
    """Whoever speaks again after `silence`, in times to live, finds the mass where a force that ended left it."""
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
    board.n = board.heard = start
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
        assert host.commanded[(int(board.n) - 1) % len(host.commanded)].any() == expected


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
