"""The ring between the loop and its reader: in order, across its end, and where it is full the newest rows are lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.exchange import STATE
from hapsim.loop.ring import BRIDGED, RING, SENSED, UNSENT, Ring, mark_last, publish, push, row_type

CHANNELS, CAPACITY = 2, 4


@entry
def push_row(ring, state, flags, io):
    """Pushes a row like the loop."""
    push(ring, state, 1000 * state.sample, flags, io)


@entry
def publish_rows(ring):
    publish(ring)


@entry
def mark_row(ring, flag):
    mark_last(ring, flag)


@pytest.fixture
def ring() -> Ring:
    return Ring(new_record(RING), row_type(CHANNELS, SENSED, by_host=True), CAPACITY, waits=False)


@pytest.fixture
def write(ring: Ring) -> Callable[..., None]:
    """Pushes rows of these samples, each with numbers of its own; the reader sees them at once."""

    def rows(*samples: int) -> None:
        io = new_record(IO_BUFFER)
        for sample in samples:
            io.position_counts[:CHANNELS] = sample, -sample
            io.force_counts[:CHANNELS] = 10 * sample, -10 * sample
            io.asked[:CHANNELS] = 0.1 * sample, -0.1 * sample
            io.velocity_counts[:CHANNELS] = 7 * sample, -7 * sample
            io.acceleration_counts[:CHANNELS] = 11 * sample, -11 * sample
            push_row(ring.record, state_at(sample), BRIDGED if sample % 2 else 0, io)
        publish_rows(ring.record)

    return rows


def state_at(sample: int) -> Any:
    state = new_record(STATE)
    state.sample, state.sent_ns = sample, 1000 * sample - 5
    state.asked_ns, state.tick_ns = 1000 * sample - 6, -(1 << 40)
    return state


def require_rows(rows: Any, samples: list[int]) -> None:
    """Every number of each row is that of its sample."""
    s, sides = np.array(samples, np.int64), np.array([1, -1])
    assert rows["sample"].tolist() == samples
    assert rows["time_ns"].tolist() == (1000 * s).tolist()
    assert rows["flags"].tolist() == [BRIDGED if sample % 2 else 0 for sample in samples]
    np.testing.assert_array_equal(rows["position_counts"], s[:, None] * sides)
    np.testing.assert_array_equal(rows["force_counts"], 10 * s[:, None] * sides)
    np.testing.assert_array_equal(rows["asked_force"], 0.1 * s[:, None] * sides)
    np.testing.assert_array_equal(rows["velocity_counts"], 7 * s[:, None] * sides)
    np.testing.assert_array_equal(rows["acceleration_counts"], 11 * s[:, None] * sides)
    assert rows["sent_before_ns"].tolist() == [5] * len(samples)
    assert rows["asked_before_ns"].tolist() == [6] * len(samples)
    assert rows["tick_before_ns"].tolist() == [(1 << 31) - 1] * len(samples), "as long ago as the column can say"


def test_a_full_ring_drops_and_counts_rows_and_keeps_those_before(ring: Ring, write: Callable[..., None]) -> None:
    write(1, 2, 3, 4, 5, 6)
    assert ring.record.dropped == 2
    require_rows(ring.drain(), [1, 2, 3, 4])
    require_rows(ring.drain(), [])


def test_once_emptied_rows_flow_again_in_order_also_across_its_end(ring: Ring, write: Callable[..., None]) -> None:
    write(1, 2, 3, 4, 5, 6)
    ring.drain()
    for begin in range(7, 60, 3):  # 3 rows at a time into 4 places: they begin at each place in turn
        write(begin, begin + 1, begin + 2)
        require_rows(ring.drain(), [begin, begin + 1, begin + 2])
    assert ring.record.dropped == 2


def test_it_overflows_across_its_end_as_before_it(ring: Ring, write: Callable[..., None]) -> None:
    write(1, 2, 3)
    ring.drain()
    write(4, 5)
    write(6, 7, 8, 9)
    assert ring.record.dropped == 2
    require_rows(ring.drain(), [4, 5, 6, 7])
    write(10)
    require_rows(ring.drain(), [10])


def test_a_row_is_seen_once_it_is_published_and_carries_what_was_marked_until_then(ring: Ring) -> None:
    io = new_record(IO_BUFFER)
    for sample in (1, 2):
        push_row(ring.record, state_at(sample), 0, io)
        mark_row(ring.record, UNSENT)
        assert ring.drain().size == 0
    push_row(ring.record, state_at(3), 0, io)
    publish_rows(ring.record)
    mark_row(ring.record, UNSENT)  # too late: it is the reader's
    assert ring.drain()["flags"].tolist() == [UNSENT, UNSENT, 0]


def test_rows_that_are_not_published_yet_take_up_room(ring: Ring, write: Callable[..., None]) -> None:
    io = new_record(IO_BUFFER)
    for sample in range(5):
        push_row(ring.record, state_at(sample), 0, io)
    assert (ring.record.dropped, ring.drain().size) == (1, 0)
    publish_rows(ring.record)
    assert ring.drain()["sample"].tolist() == [0, 1, 2, 3]
    write(5)
    require_rows(ring.drain(), [5])
