"""The mailbox of a running loop: another thread posts words, which the loop writes at the beginning of a tick.

A change of a scene touches several parts of the loop: the values of its parameters, the correction, the guards, or the
scene itself. All of it acts from one tick on. The loop keeps the number of that tick, so that a record can be replayed.

A record that begins during a run needs the state of all that, so the loop copies memory between two ticks, too. A tick
itself reads about as much of it.
"""

from __future__ import annotations

import ctypes
import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from hapsim.compiling import fence, inlined
from hapsim.compiling.native import address_of, array_at, function_at, native

MOST = 64  # words of a change

POSTED = np.dtype(
    [
        ("number", np.int64),  # of changes posted,
        ("taken", np.int64),  # and taken
        ("tick", np.int64),  # in which the last one was taken; the first tick is 0
        ("sample", np.int64),  # and the number of its position
        ("count", np.int64),  # words of the posted one:
        ("at", np.uint64, (MOST,)),  # their addresses,
        ("word", np.int64, (MOST,)),  # and their values
        ("copy", np.uint64),  # address of `copy_blocks`; 0: nothing is to be copied
        ("blocks", np.uint64),  # its argument
    ],
    align=True,
)

_POLL_S = 5e-5
_words_at, _bytes_at = array_at(np.int64), array_at(np.uint8)
_COPY = types.void(types.uint64)
call_copy = function_at(_COPY)
"""Calls `copy_blocks`, with its argument."""


@native(_COPY.return_type, *_COPY.args, bulk=True)
def copy_blocks(blocks):
    """Copies blocks of memory. `blocks`: the address of their count, and of three words for each: from, to, bytes."""
    count = _words_at(blocks, 1)[0]
    words = _words_at(blocks, 1 + 3 * count)
    for i in range(1, 1 + 3 * count, 3):
        size = words[i + 2]
        source, target = _bytes_at(np.uint64(words[i]), size), _bytes_at(np.uint64(words[i + 1]), size)
        for j in range(np.uint64(size)):
            target[j] = source[j]


@inlined
def take_posted(posted):
    """Writes the words of a new change, or copies. Returns the newest one's number, for `note_taken` later in the
    tick."""
    number = posted.number
    if number != posted.taken:
        fence()
        for i in range(posted.count):
            _words_at(posted.at[i], 1)[0] = posted.word[i]
        if posted.copy != 0:
            call_copy(posted.copy, (posted.blocks,))
            posted.copy = np.uint64(0)
    return number


@inlined
def note_taken(posted, number, state):
    """Marks a change as taken in this tick: the memory that it was posted with is free again."""
    if number != posted.taken:
        posted.tick, posted.sample = state.ticks, state.sample
        fence()
        posted.taken = number


class Mailbox:
    """The writer's side of POSTED, for one thread at a time."""

    def __init__(self, record: Any, is_running: Callable[[], bool]) -> None:
        """`record`: POSTED. `is_running`: returns whether a loop ticks and takes changes."""
        self._record, self._is_running = record, is_running
        self._words: list[tuple[int, int]] = []

    def add(self, record: Any, field: str, value: int | float, at: int = 0) -> None:
        """Adds a value of 8 bytes for a record's field to the next change. `at`: index in the field."""
        kind, offset = record.dtype.fields[field][:2]
        word = np.array([value], kind.base).view(np.int64)[0]
        self._words.append((address_of(record) + offset + 8 * at, int(word)))

    @property
    def next_number(self) -> int:
        """Number of the next change."""
        return int(self._record.number) + 1

    def send(self) -> None:
        """Posts the added values as one change. Without a running loop it writes them at once."""
        words, self._words, posted = self._words, [], self._record
        if self._is_running():
            for i, (address, word) in enumerate(words):
                posted.at[i], posted.word[i] = address, word
            posted.count = len(words)
        else:
            for address, word in words:
                ctypes.c_int64.from_address(address).value = word
            posted.taken = posted.number + 1
        posted.number += 1

    def copies(self, blocks: Sequence[NDArray[Any]]) -> list[NDArray[Any]] | None:
        """Returns copies of contiguous arrays, all of one time between two ticks; None if the loop has ended."""
        copies = [np.array(block) for block in blocks]  # written here first, so that the loop causes no page fault
        rows = [(address_of(a), address_of(b), a.nbytes) for a, b in zip(blocks, copies, strict=True)]
        words, posted = np.array([len(rows), *itertools.chain(*rows)], np.int64), self._record
        posted.blocks, posted.copy, posted.count = address_of(words), copy_blocks.address(), 0
        posted.number += 1
        self.wait()
        return copies if posted.taken == posted.number else None

    def wait(self) -> None:
        """Waits until the loop has taken the last change."""
        while self._record.taken != self._record.number and self._is_running():
            time.sleep(_POLL_S)

    def taken_in(self, number: int) -> tuple[int, int] | None:
        """Returns the tick and the sample in which the loop took this change, the last one; None while it has not."""
        return (int(self._record.tick), int(self._record.sample)) if self._record.taken >= number else None
