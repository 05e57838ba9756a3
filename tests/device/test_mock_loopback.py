"""The mock in memory: the same bytes as on any line, handed over within `send`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hapsim.device.mock.record import INPUT_BYTES
from hapsim.device.mock.wire import loopback_transport
from hapsim.loop.endings import FAILED, TIMED_OUT

New = Callable[..., Any]


@pytest.mark.parametrize("room", [1, 2, 7, 11, 64])
def test_answers_can_be_fetched_in_pieces_of_any_size(new_host: New, room: int) -> None:
    host = new_host(4)
    transport = loopback_transport(host.mock)
    said = host.arm_frame() + b"".join(host.force_frame(n, [n] * 4) for n in range(20))
    assert transport.send(said) == 0
    whole = host.mock.outbox[: int(host.mock.board.out)].tobytes()
    buffer, data = np.full(room + 6, 0xEE, np.uint8), b""
    while (count := transport.receive(buffer[3 : 3 + room], 10**9)) > 0:
        data += buffer[3 : 3 + count].tobytes()
    assert count == TIMED_OUT
    assert data == whole
    assert (buffer[:3] == 0xEE).all()
    assert (buffer[-3:] == 0xEE).all()
    assert [frame.number for frame in host.read(np.frombuffer(data, np.uint8))] == [0, *range(21)]


def test_more_than_the_mock_takes_at_once_is_refused_whole(new_host: New) -> None:
    host = new_host()
    transport = loopback_transport(host.mock)
    flood = host.disarm_frame(armed=False) * 400
    assert transport.send(flood[: INPUT_BYTES + 1]) == FAILED
    assert host.mock.board.out == 0
    assert transport.send(flood[:INPUT_BYTES]) == 0
    assert host.mock.board.out > 0
