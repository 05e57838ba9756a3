"""No force answers a position that is older than a force may live."""

from __future__ import annotations

from typing import Any

import pytest
from loop_rig import arrive, assembled, frame, scene_of

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import armed_format
from hapsim.loop.endings import RECEIVED
from hapsim.loop.portable import _compose, _on_force_sent
from hapsim.loop.ring import LIMITED, OFF_GRID, SLEWED, WITHHELD
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.outcome import _late_at_end

MS = 1_000_000
START = 10**9
FAR = -5000  # um: 5 N, 5000 counts


def on(clock: str, **device: Any) -> LoopMemory:
    """A loop by this clock."""
    return assembled(scene_of(damping=0.0, device={"clock": clock, **device}))


def receive(loop: LoopMemory, number: int, at: int, kind: int = schema.POSITION) -> None:
    """The loop takes a position at FAR, at a time in ns."""
    assert arrive(loop, frame(number, FAR, kind=kind), at) == RECEIVED


def leaves(loop: LoopMemory, now: int) -> list[int]:
    """The force that leaves at a tick of the host at `now` (ns), by the bytes of its frame."""
    loop.record.wait.begun_ns = now
    stop = int(_compose(loop.record, False))
    decoder = new_decoder(armed_format(1), to_device=True)
    (force,) = frames_in(decoder, loop.record.io.outbox[:stop].tobytes())
    assert force.type == schema.FORCE
    loop.state.sent_ns, loop.state.unanswered = now, 0
    return list(force.counts)


def last_row(loop: LoopMemory) -> tuple[int, int]:
    """(flags, counts of the force) of the newest row."""
    loop.record.ring.head += loop.record.ring.unpublished
    loop.record.ring.unpublished = 0
    rows = loop.ring.drain()
    return int(rows["flags"][-1]), int(rows["force_counts"][-1, 0])


def last_flags(loop: LoopMemory) -> int:
    return last_row(loop)[0]


def test_a_host_that_was_held_up_sends_zero_in_place_of_an_old_force() -> None:
    """A time to live of 20 samples and one more allows an answer 21 ms after the position, but not 22 ms."""
    for late_ms, counts, withheld in ((1, 5000, 0), (21, 5000, 0), (22, 0, 1), (500, 0, 1)):
        loop = on("host")
        loop.state.tick_ns = START
        receive(loop, 0, at=START)
        assert leaves(loop, START + late_ms * MS) == [counts]
        assert loop.state.withheld_forces == withheld
        assert bool(last_flags(loop) & WITHHELD) == bool(withheld)


def test_a_host_that_gets_no_position_asks_with_zero_force_once_the_last_is_too_old() -> None:
    loop = on("host")
    loop.state.tick_ns = START
    receive(loop, 0, at=START)
    sent = [leaves(loop, START + n * MS)[0] for n in range(1, 40)]
    lives = int(loop.control.time_to_live)
    assert sent == [5000] * lives + [0] * (39 - lives)  # the first zero has an age that a device still takes
    assert loop.state.withheld_forces == 39 - lives


def test_after_that_the_force_rises_from_zero() -> None:
    loop = on("host", slew_limit=2000.0)
    sent = []
    for n in range(6):
        loop.state.tick_ns = START + n * MS
        receive(loop, n, at=START + n * MS)
        sent += leaves(loop, START + (n + 1) * MS)
    assert sent == [2000, 4000, 5000, 5000, 5000, 5000]
    loop.state.tick_ns = START + 5 * MS + 40 * MS
    receive(loop, 6, kind=schema.POSITION_HELD, at=START + 46 * MS)
    assert last_flags(loop) & SLEWED
    assert leaves(loop, START + 47 * MS) == [0]  # the device has none, or this makes it zero
    loop.state.tick_ns = START + 47 * MS
    receive(loop, 7, at=START + 47 * MS)
    assert leaves(loop, START + 48 * MS) == [2000]


def test_what_may_find_a_device_at_zero_is_zero() -> None:
    """The device's clock counts from the force before, not from the position that came late."""
    for late_us, counts in ((20_000, 5000), (21_000, 0)):
        loop = on("host")
        for n in range(2):
            loop.state.tick_ns = START + n * MS
            receive(loop, n, at=START + n * MS + 900_000 * n)
            sent = leaves(loop, START + MS + (late_us * 1000 if n else 0))
        assert sent == [counts]


def test_a_position_that_was_on_its_way_for_too_long_is_answered_with_zero() -> None:
    for on_its_way_ms, counts, flags in ((21, 5000, OFF_GRID), (22, 0, OFF_GRID | WITHHELD)):
        loop = on("host")
        loop.state.tick_ns = START
        receive(loop, 0, at=START)
        loop.state.tick_ns, loop.state.unanswered = START + MS, 0
        receive(loop, 1, at=START + (1 + on_its_way_ms) * MS)
        assert loop.record.io.force_counts[0] == counts
        assert last_flags(loop) == flags


@pytest.mark.parametrize("number", [1, 7])
def test_by_the_device_s_clock_one_that_arrives_too_late_is_answered_with_zero(number: int) -> None:
    """A position's number gives its time of measurement, even if earlier positions are lost."""
    for late_ms, counts in ((0, 5000), (21, 5000), (22, 0), (90, 0)):
        loop = on("device")
        receive(loop, 0, at=START)
        loop.state.unanswered = 0
        receive(loop, number, at=START + (number + late_ms) * MS)
        assert loop.record.io.force_counts[0] == counts
        assert bool(last_flags(loop) & WITHHELD) == (counts == 0)
        assert loop.state.withheld_forces == (counts == 0)


@pytest.mark.parametrize("clock", ["host", "device"])
@pytest.mark.parametrize(("late_ms", "row"), [(21, (LIMITED, 2000)), (22, (WITHHELD, 0))])
def test_a_force_that_is_withheld_is_recorded_as_zero_and_not_as_cut(
    clock: str, late_ms: int, row: tuple[int, int]
) -> None:
    loop = on(clock, force_limit=2.0)
    loop.state.tick_ns = START
    receive(loop, 0, at=START)
    if clock == "host":
        assert leaves(loop, START + late_ms * MS) == [row[1]]
    else:
        loop.state.unanswered = 0
        receive(loop, 1, at=START + (1 + late_ms) * MS)
    assert last_row(loop) == row
    assert loop.state.limited_ticks == (row[0] == LIMITED) + (clock == "device")


@pytest.mark.parametrize("held_up", ["on its way", "in the host"])
@pytest.mark.parametrize(("positions", "in_time", "is_told"), [(60, 0, True), (30, 0, False), (60, 3, False)])
def test_a_run_whose_last_second_had_no_force_fails(held_up: str, positions: int, in_time: int, is_told: bool) -> None:
    """Positions 25 ms apart, each too old when it arrives or when its force would leave; the last ones are not."""
    loop, at = on("host"), START
    for n in range(positions + in_time):
        late = 24 * MS if 0 < n < positions else 0
        loop.state.tick_ns = at - (late if held_up == "on its way" else 0)
        receive(loop, n, at=at)
        leaves(loop, at + (late if held_up == "in the host" else 0))
        loop.state.unanswered = 1
        _on_force_sent(loop.record, at + (late if held_up == "in the host" else 0))
        at += 25 * MS if n < positions - 1 else MS
    assert loop.state.withheld_forces >= positions - 1
    assert bool(_late_at_end(loop)) is is_told


def test_a_hand_at_rest_and_late_forces_withhold_nothing() -> None:
    """A sensor that says the same for long is no fault; forces that are late, each within its time to live, act."""
    loop = on("device")
    for n in range(500):
        receive(loop, n, kind=schema.POSITION_HELD if n else schema.POSITION, at=START + n * MS)
        loop.state.unanswered = 0
        assert loop.record.io.force_counts[0] == 5000
    assert loop.state.withheld_forces == 0


def test_in_virtual_time_no_time_passes() -> None:
    loop = on("lockstep")
    for n in range(5):
        receive(loop, n, at=START + n * 10**12)
        assert leaves(loop, START + n * 10**12 + 10**11) == [5000]
