"""The mock's answers to the longest input: they fit its outbox, and each mock has its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.frames import frame_to_device
from hapsim.device.mock.firmware import take_bytes
from hapsim.device.mock.record import INPUT_BYTES, OUTBOX_BYTES

New = Callable[..., Any]


def worst_inputs(host: Any) -> dict[str, bytes]:
    """Frames that, sent over and over, are answered at length."""
    return {
        "describe": host.frame(schema.DESCRIBE, 0, 0, [0], armed=False),
        "disarm": host.disarm_frame(armed=False),
        "arm": host.arm_frame(),
        "arm and disarm": host.arm_frame() + host.disarm_frame(),
        "refused": host.arm_frame(watchdog=0),
        "arm with parts": host.arm_frame(schema.LOCKSTEP | schema.MOTION_BITS),
        "arm with parts and disarm": host.arm_frame(schema.LOCKSTEP | schema.MOTION_BITS)
        + frame_to_device(host.armed_formats[schema.MOTION_BITS], schema.DISARM, 0, 0, [0] * host.channels),
    }


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("start", [0.0, 5.0])  # 5 m is out of scale: each arming is answered twice, once at length
@pytest.mark.parametrize("channels", [1, 16])
def test_the_answers_to_the_worst_input_fit_the_outbox(new_host: New, channels: int, start: float) -> None:
    longest = schema.frame_bytes(schema.MAX_CHANNELS, to_device=False, parts=schema.MOTION_BITS)
    for name, frame in worst_inputs(new_host(channels)).items():
        stream = np.frombuffer((frame * (2 * INPUT_BYTES // len(frame) + 2)), np.uint8).copy()
        for begun in range(0, len(frame), 7):  # bytes of a frame that came before
            host = new_host(channels, mock={"initial": {"position": start}})
            take_bytes(host.mock, stream, begun, 0)
            host.listen()
            take_bytes(host.mock, stream[begun:].copy(), INPUT_BYTES, 0)
            assert host.mock.board.out <= OUTBOX_BYTES - longest, name
            assert len(host.listen()) >= 1
            assert host.misread == 0


@pytest.mark.parametrize("parts", schema.COMBINATIONS[:4])
def test_a_whole_input_of_forces_is_answered_force_by_force(new_host: New, parts: int) -> None:
    for channels in (1, 2, 16):
        host = new_host(channels)
        host.arm(parts=parts)
        count = INPUT_BYTES // schema.frame_bytes(channels, to_device=True, parts=parts)
        heard = host.send(b"".join(host.force_frame(n) for n in range(count)))
        assert [frame.number for frame in heard] == list(range(1, count + 1))


@pytest.mark.parametrize("channels", [1, 16])
def test_unread_answers_are_lost_whole_and_never_beyond_the_outbox(new_host: New, channels: int) -> None:
    host = new_host(channels, mock={"initial": {"position": 5.0}})
    stream = np.frombuffer(host.arm_frame() * (INPUT_BYTES // 12), np.uint8).copy()
    for _ in range(8):
        take_bytes(host.mock, stream, stream.size, 0)
        assert host.mock.board.out <= OUTBOX_BYTES
    assert len(host.listen()) > 100
    assert host.misread == 0
    host.send(host.disarm_frame(armed=False))
    assert host.register(schema.REG_VERSION) == schema.VERSION


def test_two_mocks_share_nothing(new_host: New) -> None:
    one, other = new_host(), new_host()
    one.arm()
    one.force(0, [2**31 - 1])
    assert (other.state, other.commanded.any(), other.mock.board.n) == (schema.IDLE, False, 0)
    assert other.arm()[1].counts == (0,)
