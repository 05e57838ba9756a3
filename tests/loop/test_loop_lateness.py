"""How late a position is where the device is the clock, one exchange at a time: the times are the test's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hapsim.loop.endings import HEARD, TIMED_OUT
from hapsim.loop.histogram import histogram_of
from hapsim.running.assemble import LoopMemory

FrameOf = Callable[..., bytes]
BEGIN, PERIOD = 5_000_000_000, 1_000_000  # ns


class Timed:
    """A loop whose positions arrive when the test says."""

    def __init__(self, loop: LoopMemory, arrive: Callable[..., int], frame: FrameOf) -> None:
        self.loop, self._arrive, self._frame = loop, arrive, frame

    def hear(self, number: int, at: float, code: int = HEARD) -> None:
        """Position `number` arrives at `at` periods after the first one's."""
        assert self._arrive(self.loop, self._frame(number, 0), BEGIN + round(at * PERIOD)) == code

    @property
    def due(self) -> float:
        """When the next position is expected, in periods after the first one."""
        return (int(self.loop.state.due_ns) - BEGIN) / PERIOD

    @property
    def latest_ns(self) -> int:
        return int(self.loop.record.histograms.lateness.maximum)

    @property
    def counted(self) -> int:
        return histogram_of(self.loop.record.histograms.lateness).total


@pytest.fixture
def timed(
    assembled: Callable[..., LoopMemory], scene_of: Callable[..., Any], arrive: Callable[..., int], frame: FrameOf
) -> Callable[[str], Timed]:
    """A loop at 1 kHz by this clock, which nobody has told anything yet."""
    return lambda clock: Timed(assembled(scene_of(device={"clock": clock})), arrive, frame)


def test_positions_that_come_on_time_are_not_late_and_each_is_counted(timed: Callable[[str], Timed]) -> None:
    on = timed("device")
    for number in range(5):
        on.hear(number, number)
        assert on.due == number + 1
    assert (on.latest_ns, on.counted) == (0, 5)


def test_a_late_position_is_reported_and_moves_the_grid_by_a_sixteenth_of_that(timed: Callable[[str], Timed]) -> None:
    on = timed("device")
    on.hear(0, 0)
    on.hear(1, 1.32)
    assert on.latest_ns == 320_000
    assert on.due == 2.02


def test_an_early_position_moves_the_whole_grid_and_is_not_late(timed: Callable[[str], Timed]) -> None:
    on = timed("device")
    on.hear(0, 0)
    on.hear(1, 0.7)
    assert (on.latest_ns, on.due) == (0, 1.7)
    on.hear(2, 1.75)
    assert on.latest_ns == 50_000


@pytest.mark.parametrize("gap", [2, 3, 10, 1000])
def test_after_lost_positions_the_grid_goes_on_by_the_devices_own_count(
    timed: Callable[[str], Timed], gap: int
) -> None:
    on = timed("device")
    on.hear(0, 0)
    on.hear(gap, gap)
    assert (on.latest_ns, on.due) == (0, gap + 1)
    on.hear(gap + 1, gap + 1)
    assert on.due == gap + 2
    on.hear(gap + 2, gap + 2.5)
    assert on.latest_ns == 500_000
    assert (on.counted, on.loop.state.lost_frames) == (4, gap - 1)


def test_a_position_that_came_before_is_not_counted(timed: Callable[[str], Timed]) -> None:
    on = timed("device")
    on.hear(0, 0)
    on.hear(2, 2)
    due = on.due
    on.hear(1, 2.5, TIMED_OUT)
    on.hear(2, 2.5, TIMED_OUT)
    assert (on.due, on.counted, on.loop.state.stale_positions) == (due, 2, 3)


@pytest.mark.parametrize("clock", ["host", "lockstep"])
def test_by_no_other_clock_a_position_is_early_or_late(timed: Callable[[str], Timed], clock: str) -> None:
    on = timed(clock)
    on.hear(0, 0)
    on.hear(1, 7)
    assert on.counted == 0
