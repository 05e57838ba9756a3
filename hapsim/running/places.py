"""The places that detents remember: where each is, and each change, for the session's views, events and records."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from hapsim.cordis.dispatch import Batch
from hapsim.cordis.modules.held_detents import MOST_CHANGES, HeldDetents
from hapsim.cordis.program import Program
from hapsim.running.assemble_loop import LoopMemory

_TRIES = 100  # to look between two ticks


class NewPlace(NamedTuple):
    """A change of the place that a detent's ends are in. `sample`: the device's, counted from arming."""

    sample: int
    name: str
    place: int


def _batches(program: Program) -> Iterator[tuple[Batch, tuple[str, ...]]]:
    """Yields the batches of detents that hold, with the names of these."""
    for part in program.parts:
        if isinstance(part.numbers, HeldDetents) and part.memory is not None:
            yield part, part.memory.modules


def places_in(program: Program) -> dict[str, int]:
    """Returns the number of the place in which each detent's ends are, by the names of those that remember it."""
    return {
        name: int(at) for part, names in _batches(program) for name, at in zip(names, part.numbers.place, strict=True)
    }


class PlaceChanges:
    """Reader of the changes of places in a loop."""

    def __init__(self) -> None:
        self._program: Program | None = None
        self._seen = 0

    def new(self, loop: LoopMemory) -> list[NewPlace]:
        """Returns the changes since the last call, the latest some thousands. While the loop is in a tick, a sample may
        be one too late."""
        if loop.program is not self._program:
            self._program, self._seen = loop.program, 0
        found = []
        for part, names in _batches(loop.program):
            numbers, state, tick = part.numbers, loop.state, loop.record.tick
            for _ in range(_TRIES):
                sample, steps, count = int(state.sample), int(numbers.counts[0]), int(numbers.counts[1])
                if int(state.ticks) == int(tick.number) + 1 and sample == int(state.sample):
                    break
            for i in range(max(self._seen, count - MOST_CHANGES), count):
                step, link, place = numbers.changes[i % MOST_CHANGES].tolist()
                ago = (steps - 1 - step) // loop.rendered_scene.substeps
                found.append(NewPlace(sample - ago, names[link], place))
            self._seen = count
        return found
