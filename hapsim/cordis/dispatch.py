"""The actions of a module type in a tick, each compiled by itself and called by its address.

A tick knows no module: it makes the calls of lists. A type of module that a scene lacks costs nothing. Any other is
compiled once, whatever other modules the scene has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import inlined
from hapsim.compiling.native import Behind, NativeFunction, array_at, function_at

Column = NDArray[np.floating[Any]]
"""Numbers in the scene's precision: one for each point, or for each module of a type."""


class TickState(NamedTuple):
    """N points at sample n. Positions in m, force in N, shape (N,); the arrays are the program's, not copies.

    A program has two of them: its two rows of positions take turns, so that no sample is ever copied. A third row would
    be half as much memory again for every step to go through.

    Attributes:
        position: x[n].
        previous: x[n-1]; after `integrate`, x[n+1].
        force: added up during a tick. Code that uses a force sets it to zero; none uses a ground's.
        velocity: (H,) m/s, sensed by the H device points, which come first; 0 where the device senses none.
    """

    position: Column
    previous: Column
    force: Column
    velocity: NDArray[np.float64]


def action(function: Callable[[Any, Any], None]) -> NativeFunction:
    """Decorates an action (numbers, state): the batch's own named tuple and a TickState, both behind addresses, so that
    it begins with `numbers, state = value_of(numbers), value_of(state)`."""
    return NativeFunction(function)


def fma_action(function: Callable[[Any, Any], None]) -> NativeFunction:
    """Decorates an action in which a product and its sum may be rounded once instead of twice."""
    return NativeFunction(function, fastmath={"contract"})


class Memory(NamedTuple):
    """The memory of modules, by name, beside the positions of their points: columns with one value per module, by the
    names that stored energy knows them by (`Potential` of hapsim.laws)."""

    modules: tuple[str, ...]
    columns: Mapping[str, Column]


class Batch(NamedTuple):
    """The modules of one type in a tick: their numbers, a named tuple, and their actions.

    Attributes:
        initialize: called before the first tick.
        retarget: called when live parameters have moved, and once more with the next sample.
        add_forces: called when all points have their positions of this sample.
        integrate: called when all forces are added up; writes the next positions of its points into `previous`.
        place: called before another program takes over; writes positions that a tick does not write.
        resume: called after `initialize` in a program that took over from another; reads the positions of its points.
        kept: objects that stay in memory with the batch, because its numbers hold addresses of them.
    """

    numbers: Any
    initialize: NativeFunction | None = None
    retarget: NativeFunction | None = None
    add_forces: NativeFunction | None = None
    integrate: NativeFunction | None = None
    place: NativeFunction | None = None
    resume: NativeFunction | None = None
    memory: Memory | None = None
    kept: Any = None


CALLS = np.dtype([("pairs", np.uint64), ("count", np.int64)], align=True)
"""A list of calls: the address of pairs of addresses (an action, its numbers), and their count."""


def calls_of(actions: Sequence[tuple[NativeFunction, Behind]], state: Behind) -> NDArray[np.uint64]:
    """Returns the addresses of these actions, compiled for states like `state`, and of their numbers, (calls, 2)."""
    pairs = [act.call_on(numbers, state)[:2] for act, numbers in actions]
    return np.array(pairs, np.uint64).reshape(-1, 2)


_words_at = array_at(np.uint64)
_call = function_at(types.void(types.uint64, types.uint64))

ADD_FRAME = types.void(types.uint64, types.uint64, types.uint64, types.float64)
call_add_frame = function_at(ADD_FRAME)
"""Calls `add_frame` of loop/sound.py, with its arguments: it adds a frame of a step's pick-up values."""


@inlined
def call_all(calls, state):
    """Makes all calls of a list, in order. `state`: the address of a TickState."""
    pairs = _words_at(calls.pairs, 2 * calls.count)
    for i in range(np.uint64(calls.count)):
        _call(pairs[i + i], (pairs[i + i + ONE], state))
