"""Lateness of a position whose device is the clock, one exchange at a time. The tests set the times themselves."""

from __future__ import annotations

import pytest
from loop_rig import arrive, assembled, frame, scene_of

from hapsim.loop.endings import RECEIVED, TIMED_OUT
from hapsim.loop.histogram import histogram_of
from hapsim.running.assemble_loop import LoopMemory

BEGIN, PERIOD = 5_000_000_000, 1_000_000  # ns


def receive(loop: LoopMemory, number: int, at: float, code: int = RECEIVED) -> None:
    """Position `number` arrives at `at` periods after the first one's."""
    assert arrive(loop, frame(number, 0), BEGIN + round(at * PERIOD)) == code


def loop_after(*positions: tuple[int, float], clock: str = "device") -> LoopMemory:
    """A loop at 1 kHz by this clock, after these positions."""
    loop = assembled(scene_of(device={"clock": clock}))
    for number, at in positions:
        receive(loop, number, at)
    return loop


def due(loop: LoopMemory) -> float:
    """Returns the time of the next expected position, in periods after the first one."""
    return (int(loop.state.due_ns) - BEGIN) / PERIOD


def lateness(loop: LoopMemory) -> tuple[int, int]:
    """(ns, how many were counted)"""
    counted = loop.record.histograms.lateness
    return int(counted.maximum), histogram_of(counted).total


@pytest.mark.parametrize(
    ("positions", "expected", "latest_ns"),
    [
        ([(number, number) for number in range(5)], 5, 0),
        ([(0, 0), (1, 1.32)], 2.02, 320_000),  # the grid moves by a sixteenth of that
        ([(0, 0), (1, 0.7)], 1.7, 0),  # an early one moves the whole grid
        ([(0, 0), (1, 0.7), (2, 1.75)], 2.7 + 0.05 / 16, 50_000),
        *(([(0, 0), (gap, gap)], gap + 1, 0) for gap in (2, 3, 10, 1000)),  # after losses by the device's own count
        *(([(0, 0), (gap, gap), (gap + 1, gap + 1.5)], gap + 2 + 0.5 / 16, 500_000) for gap in (2, 1000)),
    ],
)
def test_the_grid_of_arrivals(positions: list[tuple[int, float]], expected: float, latest_ns: int) -> None:
    loop = loop_after(*positions)
    assert due(loop) == pytest.approx(expected, abs=1e-6)
    assert lateness(loop) == (latest_ns, len(positions))
    assert loop.state.lost_frames == positions[-1][0] + 1 - len(positions)


def test_a_position_that_came_before_is_not_counted() -> None:
    loop = loop_after((0, 0), (2, 2))
    before = due(loop)
    for number in (1, 2):
        receive(loop, number, 2.5, TIMED_OUT)
    assert (due(loop), lateness(loop)[1], loop.state.stale_positions) == (before, 2, 3)


@pytest.mark.parametrize("clock", ["host", "lockstep"])
def test_by_no_other_clock_a_position_is_early_or_late(clock: str) -> None:
    assert lateness(loop_after((0, 0), (1, 7), clock=clock))[1] == 0
