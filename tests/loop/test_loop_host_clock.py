"""The loop when the host is the clock, tick by tick: over a transport that follows a script, no time asserted beyond
what the clock itself guarantees."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numba
import numpy as np
import pytest
from loop_rig import POSITION_SCALE, arrive, assembled, frame, scene_of

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from hapsim.compiling.native import array_at, record_at
from hapsim.loop.clocks import next_point
from hapsim.loop.compiled_loop import run_loop
from hapsim.loop.endings import DONE, RECEIVED, TIMED_OUT
from hapsim.loop.histogram import histogram_of
from hapsim.loop.portable import PortableLoop, _compose
from hapsim.loop.ring import OFF_GRID, UNSENT
from hapsim.loop.system import SCRATCH, now_ns, sleep_until
from hapsim.loop.transport import Transport, receiver, sender
from hapsim.running.assemble_loop import LoopMemory

RATE = 500.0
PERIOD_S = 1 / RATE

SCRIPT = np.dtype(
    [
        ("items", np.int64),
        ("next", np.int64),  # item
        ("after", np.int64, 8),  # so many frames of the host an item comes,
        ("late", np.int64, 8),  # 1: only once its reader has given up
        ("stop", np.int64, 8),  # where it ends
        ("bytes", np.uint8, 512),
        ("sent", np.int64),  # frames of the host
        ("given_up", np.int64),  # 1: since the last of them somebody has waited in vain
        ("heard", np.int64),  # bytes of them
        ("frames", np.uint8, 4096),
        ("held_up", np.int64),  # the host is held up so long (ns) behind its second frame, before it notes that it left
        SCRATCH,
    ],
    align=True,
)
_script_at, _bytes_at = record_at(SCRIPT), array_at(np.uint8)


@receiver
def follow_script(context, buffer, room, timeout_ns):
    script, buffer = _script_at(context), _bytes_at(buffer, room)
    item = script.next
    if item == script.items or script.sent < script.after[item] or script.late[item] > script.given_up:
        script.given_up |= timeout_ns <= 0
        return TIMED_OUT
    start = script.stop[item - 1] if item > 0 else 0
    for i in range(start, script.stop[item]):
        buffer[i - start] = script.bytes[i]
    script.next += 1
    return script.stop[item] - start


@sender
def note_frame(context, buffer, stop):
    script, buffer = _script_at(context), _bytes_at(buffer, stop)
    for i in range(stop):
        script.frames[script.heard + i] = buffer[i]
    script.heard += stop
    script.sent += 1
    script.given_up = 0
    if script.sent == 2 and script.held_up > 0:
        sleep_until(now_ns(script.scratch) + script.held_up, script.scratch)
    return 0


Play = Callable[..., tuple[LoopMemory, list[Frame]]]
Item = tuple[int, bool, bytes]
"""Bytes of the device: after how many frames of the host they come, and whether too late for the tick before."""


@pytest.fixture(params=["compiled", "portable"])
def play(request: pytest.FixtureRequest) -> Play:
    """Runs a loop by the host's clock until it has taken so many positions; it, and the frames that it sent."""

    def run(script: Sequence[Item], ticks: int, held_up_s: float = 0.0) -> tuple[LoopMemory, list[Frame]]:
        loop = assembled(scene_of(rate=RATE, device={"clock": "host"}))
        record = new_record(SCRIPT)
        record.items = len(script)
        record.after[: len(script)] = [after for after, _, _ in script]
        record.late[: len(script)] = [late for _, late, _ in script]
        record.stop[: len(script)] = np.cumsum([len(data) for _, _, data in script])
        whole = b"".join(data for _, _, data in script)
        record.bytes[: len(whole)] = np.frombuffer(whole, np.uint8)
        record.held_up = round(1e9 * held_up_s)
        transport = Transport(follow_script, note_frame, record)
        loop.inbox.transport = transport.record
        loop.control.samples = ticks
        loop.control.silence_ns = 60 * 10**9
        portable = request.param == "portable"
        ending = PortableLoop(loop.record, loop.inbox, transport).run() if portable else run_loop(loop.record)
        assert ending == DONE
        frames = frames_in(new_decoder(loop.wire, to_device=True), record.frames[: record.heard].tobytes())
        assert frames.pop().type == schema.DISARM
        return loop, frames

    return run


def test_a_position_that_came_after_its_tick_is_answered_and_leaves_no_lag(play: Play) -> None:
    loop, forces = play([(0, False, frame(0, 0)), (1, True, frame(1, 5)), (2, False, frame(2, 5))], 3)
    assert [force.number for force in forces] == [0, 1]
    assert loop.ring.drain()["sample"].tolist() == [0, 1, 2]


def test_a_position_that_does_not_come_is_asked_for_again(play: Play) -> None:
    loop, forces = play([(0, False, frame(0, 0)), (4, False, frame(1, 5)), (5, False, frame(2, 5))], 3)
    assert [force.number for force in forces] == [0, 0, 0, 0, 1]
    assert (loop.state.stale_positions, loop.state.lost_frames) == (0, 0)


def test_a_position_that_came_after_its_tick_is_measured_from_when_it_was_asked_for(play: Play) -> None:
    loop, forces = play([(0, False, frame(0, 0)), (10, False, frame(1, 5))], 2)
    assert [force.number for force in forces] == [0] * 10
    took = histogram_of(loop.record.histograms.exchange, 1e-9)
    assert took.total == 1
    assert took.maximum > 8 * PERIOD_S  # nine periods lie between; the first tick may be late by up to one


def test_a_position_that_a_newer_one_replaces_between_two_ticks_was_never_answered(play: Play) -> None:
    loop, forces = play([(0, False, frame(0, 0)), (0, False, frame(1, 1) + frame(2, 2))], 3)
    assert [force.number for force in forces] == [2]
    assert (loop.ring.drain()["flags"] & UNSENT).tolist() == [UNSENT, UNSENT, 0]
    assert loop.state.stale_positions == 2


def test_a_host_that_is_held_up_behind_a_request_takes_the_way_meanwhile_for_no_leap(play: Play) -> None:
    """The device answers a repeated request at once; the host reads that answer and asks again 0.1 s later."""
    way = round(0.1 / POSITION_SCALE)
    script = [(0, False, frame(0, 0)), (2, False, frame(1, 0) + frame(2, 0)), (3, False, frame(3, way))]
    loop, forces = play(script, 4, held_up_s=0.1)
    assert [force.number for force in forces] == [0, 0, 2]
    assert loop.state.ticks == 4


def test_a_sample_that_took_clearly_more_or_less_than_a_period_is_marked() -> None:
    loop = assembled(scene_of(rate=RATE, device={"clock": "host"}))
    period, now = int(loop.control.period_ns), 10**9
    most = period // 8
    took = [0, period, period + most, period + most + 1, period - most, period - most - 1, 0, 3600 * 10**9, period]
    for number, ns in enumerate(took):
        now += ns
        assert arrive(loop, frame(number, number), now) == RECEIVED
    _compose(loop.record, True)  # which shows the reader what there is
    marked = [0, 0, 0, OFF_GRID, 0, OFF_GRID, OFF_GRID, OFF_GRID, 0]
    assert (loop.ring.drain()["flags"] & OFF_GRID).tolist() == marked


DUE, PERIOD = 1_000_000, 500


@pytest.mark.parametrize("rule", [next_point, numba.njit(next_point)], ids=["python", "compiled"])
@pytest.mark.parametrize(
    ("late", "point", "missed"),
    [
        (-100, DUE + PERIOD, 0),
        (0, DUE + PERIOD, 0),
        (PERIOD - 1, DUE + PERIOD, 0),  # late, and the next point stays where it was
        (PERIOD, DUE + 2 * PERIOD, 1),
        (PERIOD + 1, DUE + 2 * PERIOD + 1, 1),  # the grid starts anew
        (10**9, DUE + 10**9 + PERIOD, 1),  # one miss, and no burst
    ],
)
def test_a_point_a_period_late_starts_the_grid_anew(rule: object, late: int, point: int, missed: int) -> None:
    assert callable(rule)
    assert rule(DUE, DUE + late, PERIOD) == (point, missed)
