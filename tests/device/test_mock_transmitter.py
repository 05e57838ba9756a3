"""The mock's transmitter: it never waits for room, and what it drops it drops as whole frames."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from hapsim.device.mock.wire import transmitter_transport
from hapsim.loop.endings import FAILED

FRAMES = [bytes([1 + n % 255]) * (7 + n % 13) + b"\0" for n in range(20000)]


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Where the host reads, where the mock writes: 64 kB of room."""
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
