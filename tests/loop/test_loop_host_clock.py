"""The loop when the host is the clock, one exchange at a time: a port in the test's hands, no time asserted."""

from __future__ import annotations

import contextlib
import os
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from firmware_protocol.decoder import frames_in, new_decoder
from hapsim.compiled import jit
from hapsim.loop.codes import HEARD
from hapsim.loop.histogram import histogram_of
from hapsim.loop.paced_by_host import exchange_before
from hapsim.loop.portable import show_last_rows
from hapsim.loop.ring import OFF_GRID, UNSENT, drain
from hapsim.loop.waiting import take_newest_position

FrameOf = Callable[..., bytes]
LONG_NS = 10_000_000_000


@jit
def take(loop, now, timeout_ns):
    """A part of the compiled loop, callable from Python."""
    return take_newest_position(loop, now, timeout_ns)


@jit
def exchange(loop, now, due):
    """Another."""
    return exchange_before(loop, now, due)


@pytest.fixture
def held_port(scene_of: Callable[..., Any], assembled: Callable[..., Any]) -> Iterator[tuple[Any, int]]:
    """(a loop over one end of a pseudo-terminal, armed; the descriptor of the other end)."""
    near, far = os.openpty()
    for end in (near, far):
        tty.setraw(end)
        os.set_blocking(end, False)
    yield assembled(scene_of(device={"clock": "host"}), far), near
    for end in (near, far):
        with contextlib.suppress(OSError):
            os.close(end)


def test_a_position_that_came_after_its_tick_is_answered_and_leaves_no_lag(
    held_port: tuple[Any, int], frame: FrameOf
) -> None:
    loop, near = held_port
    os.write(near, frame(0, 0))
    assert take(loop, time.monotonic_ns(), LONG_NS) == HEARD
    # The tick that asked for position 1 is over before it comes, so at the next tick it waits in the line.
    os.write(near, frame(1, 5))
    exchange(loop, time.monotonic_ns(), 0)
    forces = frames_in(new_decoder(loop.wire, to_device=True), os.read(near, 4096))
    assert [force.number for force in forces] == [1]


def test_a_sample_that_took_far_more_or_less_than_a_period_is_marked(
    held_port: tuple[Any, int], frame: FrameOf
) -> None:
    loop, near = held_port
    for number in range(3):
        os.write(near, frame(number, number))
        assert take(loop, time.monotonic_ns(), LONG_NS) == HEARD
        # As if this position had come an hour ago: the next one is far off the grid, whatever the machine does.
        loop.state["newest_ns"] -= 3_600_000_000_000
    show_last_rows(loop)
    assert drain(loop.ring).flags.tolist() == [UNSENT, OFF_GRID | UNSENT, OFF_GRID | UNSENT]


def test_a_position_that_came_after_its_tick_is_measured_from_when_it_was_asked_for(
    held_port: tuple[Any, int], frame: FrameOf
) -> None:
    loop, near = held_port
    os.write(near, frame(0, 0))
    assert take(loop, time.monotonic_ns(), LONG_NS) == HEARD
    exchange(loop, time.monotonic_ns(), 0)  # asks for position 1, which does not come
    loop.state["tick_ns"] -= 3_600_000_000_000  # as if that had been an hour ago
    exchange(loop, time.monotonic_ns(), 0)  # asks again
    os.write(near, frame(1, 5))
    exchange(loop, time.monotonic_ns(), 0)
    took = histogram_of(loop.statistics.exchange, 1e-9)
    assert took.total == 1
    assert took.maximum > 3600.0


def test_a_position_that_a_newer_one_overtakes_between_two_ticks_was_never_answered(
    held_port: tuple[Any, int], frame: FrameOf
) -> None:
    loop, near = held_port
    for number in (0, 1, 2):
        os.write(near, frame(number, number))
        assert take(loop, time.monotonic_ns(), LONG_NS) == HEARD
    exchange(loop, time.monotonic_ns(), 0)
    assert drain(loop.ring).flags.tolist() == [UNSENT, OFF_GRID | UNSENT, OFF_GRID]
    assert loop.state["stale_positions"] == 2
