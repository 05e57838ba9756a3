"""The mock's wire: forces late by whole samples in virtual time, bytes that take their time in real time, and a
transmitter that never waits for room."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.wire import UART, arrived, next_due_ns, put_on_wire, take_off_wire, transmitter_transport
from hapsim.errors import UsageError
from hapsim.loop.endings import FAILED
from hapsim.running import run

FULL = 2**31 - 1
SLOW = {"baud": 115200, "turnaround": 0.0}  # 23 bytes: 1.997 ms

New = Callable[..., Any]


# In virtual time.


@pytest.mark.parametrize(("rate", "late"), [(500.0, 0), (900.0, 1)])
@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5])
def test_in_lockstep_a_force_acts_as_many_samples_later_as_the_wire_takes(
    new_host: New, exchange: New, rate: float, late: int, delay: float
) -> None:
    """A slow wire acts like a delay of that many samples on a mock without a wire."""
    counts = [int(n) for n in np.random.default_rng(3).integers(-(2**31), 2**31, 30)]
    slow = new_host(rate=rate, device={"delay": delay}, mock=SLOW)
    quick = new_host(rate=rate, device={"delay": delay})
    heard = exchange(slow, [[count] for count in counts])
    expected = exchange(quick, [[count] for count in [*[0] * late, *counts]][:30])
    assert [frame.counts for frame in heard] == [frame.counts for frame in expected]
    assert {frame.type for frame in heard[2:]} == {schema.POSITION_HELD if late else schema.POSITION}
    slow.disarm()
    assert slow.register(schema.REG_HELD) == 30 * late
    assert slow.register(schema.REG_ACCEPTED) == 30 - late


def test_a_force_that_is_older_than_its_time_to_live_when_it_arrives_is_not_acted_on(new_host: New) -> None:
    host = new_host(rate=900.0, mock=SLOW | {"turnaround": 0.003})  # 4.997 ms: four samples late
    host.arm()
    for n in range(20):
        (position,) = host.force(n, [FULL], time_to_live=3 if n < 10 else 4)
        assert position.number == n + 1  # and time goes on
    host.disarm()
    assert host.register(schema.REG_EXPIRED) == 10
    assert host.register(schema.REG_ACCEPTED) == 6


def test_arming_again_forgets_what_was_on_the_wire(new_host: New) -> None:
    host = new_host(rate=900.0, mock=SLOW)
    for _ in range(2):
        host.arm()
        assert not host.commanded.any()
        host.force(0, [FULL])
        assert not host.commanded.any()  # one sample late
        host.force(1, [FULL])
        assert host.commanded.any()
        host.disarm()
        assert not host.commanded.any()


@pytest.mark.parametrize("pacing", [schema.PACED_BY_DEVICE, schema.PACED_BY_HOST])
def test_the_other_clocks_have_real_time_and_no_force_is_late_by_count(new_host: New, pacing: int) -> None:
    host = new_host(rate=900.0, mock=SLOW)
    host.arm(pacing)
    host.force(0, [FULL], now=10**6)
    assert host.commanded.any()


def test_a_wire_that_lets_no_force_through_is_refused_in_virtual_time_alone(new_scene: New) -> None:
    for mock, sentence in (
        ({"baud": 110_000}, r"mock.baud: found 110000, .* 12 bytes takes longer than .* expected more than 120000"),
        ({"turnaround": 0.022}, r"every force is late by 22 samples and older than its time to live of 20"),
    ):
        with pytest.raises(UsageError, match=sentence):
            assemble_mock(new_scene(mock=mock))
        assemble_mock(new_scene(mock=mock, device={"clock": "device"}))


# In real time; the clock is the test's.


def put(way: Any, data: bytes, now: float, byte_ns: float = 10.0, whole: bool = False) -> int:
    return put_on_wire(way, np.frombuffer(data, np.uint8), len(data), now, byte_ns, whole)


def test_bytes_arrive_one_after_the_other_and_count_with_the_delimiter() -> None:
    way = new_record(UART).incoming
    assert put(way, b"\1\2\0", 100.0) == 3
    assert put(way, b"\3\0\4", 105.0) == 3  # the wire is free at 130
    assert way.due_ns[:6].tolist() == [110, 120, 130, 140, 150, 160]
    assert (arrived(way, 129.0), arrived(way, 130.0), arrived(way, 149.0), arrived(way, 1e9)) == (0, 3, 3, 5)
    assert (next_due_ns(way, 1e9), next_due_ns(way, 50.0)) == (130.0, 50.0)
    take_off_wire(way, 3)
    assert bytes(way.bytes[:3]) == b"\3\0\4"
    assert way.due_ns[:3].tolist() == [140, 150, 160]
    take_off_wire(way, 2)
    assert (int(way.waiting), next_due_ns(way, 777.0)) == (1, 777.0)
    assert put(way, b"\0", 1000.0) == 1
    assert way.due_ns[1] == 1010.0  # after a pause the wire is free at once


def test_a_frame_of_the_mock_is_there_as_a_whole_with_its_last_byte() -> None:
    way = new_record(UART).outgoing
    put(way, b"\1\2\0\3\0", 100.0, whole=True)
    assert way.due_ns[:5].tolist() == [130, 130, 130, 150, 150]


def test_a_wire_that_is_full_takes_no_more_and_hands_on_what_never_ends() -> None:
    way = new_record(UART).incoming
    room = way.bytes.size
    assert put(way, b"\1" * (room + 5), 0.0) == room
    assert put(way, b"\1", 0.0) == 0
    assert arrived(way, 1e9) == room  # no delimiter among them: the decoder counts them as garbage


# On a pseudo-terminal: nothing here measures time.


@pytest.mark.parametrize("clock", ["device", "host", "lockstep"])
def test_a_run_over_a_pseudo_terminal_with_a_uart_ends_as_asked(new_scene: New, clock: str) -> None:
    scene = new_scene(rate=200.0, device={"clock": clock}, mock={"baud": 1_000_000, "turnaround": 1e-4})
    report = run(scene, duration=0.2, transport="terminal").report
    assert report.ending == "done"
    # A duration is time: where this machine was held up, fewer samples passed in it.
    assert report.ticks == 40 if clock == "lockstep" else 0 < report.ticks <= 40


def test_paced_by_the_device_over_a_pseudo_terminal_a_turnaround_of_more_than_a_sample_makes_every_force_late(
    new_scene: New,
) -> None:
    """Two samples and a half of 20 ms: however late this machine wakes up, no force is in time."""
    scene = new_scene(rate=50.0, device={"clock": "device"}, mock={"turnaround": 0.05})
    report = run(scene, duration=0.5, transport="terminal").report
    assert report.deadline_misses >= report.ticks - 1 - report.lost_frames


FRAMES = [bytes([1 + n % 255]) * (7 + n % 13) + b"\0" for n in range(20000)]


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Descriptors of the host's reading end and the mock's writing end: 64 kB of room."""
    far, near = os.pipe()
    os.set_blocking(near, False)
    os.set_blocking(far, False)
    try:
        yield far, near
    finally:
        os.close(far)
        os.close(near)


def read_all(far: int) -> bytes:
    data = b""
    try:
        while piece := os.read(far, 1 << 20):
            data += piece
    except BlockingIOError:
        return data
    return data


def test_what_finds_no_room_is_dropped_as_whole_frames(pipe: tuple[int, int]) -> None:
    """14 kB at a time, of which a pipe takes what fits: the room ends in the middle of a frame."""
    far, near = pipe
    transport = transmitter_transport(near)
    data, dropped = b"", 0
    for first in range(0, len(FRAMES), 1000):
        dropped += transport.send(b"".join(FRAMES[first : first + 1000])) == FAILED
        if first % 9000 == 0:
            data += os.read(far, 5000)  # not at a frame's end
    for _ in range(2):  # what was begun is ended once there is room, though nothing new is sent
        data += read_all(far)
        transport.send(b"")
    came = data.split(b"\0")[:-1]
    assert data.endswith(b"\0")
    assert dropped > 0
    assert len(came) < len(FRAMES)
    sent = iter(frame[:-1] for frame in FRAMES)
    assert all(frame in sent for frame in came)  # whole, and in order
