"""The mailbox of a running loop: another thread posts words, which the loop writes at the beginning of a tick.

A change of a scene touches several parts of the loop: the values of its parameters, the correction, the guards, or the
scene itself. All of it acts from one tick on. The loop keeps the number of that tick, so that a record can be replayed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hapsim.compiling import fence, inlined
from hapsim.compiling.native import address_of, array_at

MOST = 64  # words of a change

POSTED = np.dtype(
    [
        ("number", np.int64),  # of changes posted,
        ("taken", np.int64),  # and taken
        ("tick", np.int64),  # in which the last one was taken; the first tick is 0
        ("count", np.int64),  # words of the posted one:
        ("at", np.uint64, (MOST,)),  # their addresses,
        ("word", np.int64, (MOST,)),  # and their values
    ],
    align=True,
)

_POLL_S = 5e-5
_words_at = array_at(np.int64)


@inlined
def take_posted(posted):
    """Writes the words of a new change. Returns the newest change's number, for `note_taken` later in the tick."""
    number = posted.number
    if number != posted.taken:
        fence()
        for i in range(posted.count):
            _words_at(posted.at[i], 1)[0] = posted.word[i]
    return number


@inlined
def note_taken(posted, number, tick):
    """Marks a change as taken in this tick: the memory that it was posted with is free again."""
    if number != posted.taken:
        posted.tick = tick
        fence()
        posted.taken = number


class Mailbox:
    """The writer's side of POSTED, for one thread at a time."""

    def __init__(self, record: Any, is_running: Callable[[], bool]) -> None:
        """`record`: POSTED. `is_running`: returns whether a loop ticks and takes changes."""
        self._record, self._is_running = record, is_running
        self._words: list[tuple[Any, str, int, int | float]] = []

    def add(self, record: Any, field: str, value: int | float, at: int = 0) -> None:
        """Adds a value of 8 bytes for a record's field to the next change. `at`: index in the field."""
        self._words.append((record, field, at, value))

    @property
    def next_number(self) -> int:
        """Number of the next change."""
        return int(self._record.number) + 1

    def send(self) -> None:
        """Posts the added values as one change. Without a running loop it writes them at once."""
        words, self._words = self._words, []
        if not self._is_running():
            for record, field, at, value in words:
                record[field] = value if np.ndim(record[field]) == 0 else _replaced(record[field], at, value)
            self._record.number = self._record.taken = self._record.number + 1
            return
        posted = self._record
        for i, (record, field, at, value) in enumerate(words):
            kind, offset = record.dtype.fields[field][:2]
            posted.at[i] = address_of(record) + offset + 8 * at
            posted.word[i] = np.array([value], kind.base).view(np.int64)[0]
        posted.count = len(words)
        posted.number += 1

    def wait(self) -> None:
        """Waits until the loop has taken the last change."""
        while self._record.taken != self._record.number and self._is_running():
            time.sleep(_POLL_S)

    def tick_of(self, number: int) -> int | None:
        """Returns the tick in which the loop took this change, the last one; None while it has not."""
        return int(self._record.tick) if self._record.taken >= number else None


def _replaced(values: Any, at: int, value: int | float) -> Any:
    values[at] = value
    return values
