"""A program without a device: its ticks one by one, or in a compiled loop, to time and test them.

Between two ticks of a loop with a device, other code runs: what stands in memory is written by then, and read anew. The
loops here keep to that (`_other_code`), lest the compiler work on several ticks at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.cordis.dispatch import CALLS, Part, call_all
from hapsim.cordis.program import Program
from hapsim.cordis.stored_energy import number_at
from hapsim.cordis.tick import follow_parameters as _follow_inlined
from hapsim.cordis.tick import start as _start_inlined
from hapsim.cordis.tick import take_over as _take_over_inlined
from hapsim.cordis.tick import tick as _tick_inlined

Reals = NDArray[np.float64]

_PAIR_BYTES = 16


@intrinsic
def _other_code(_typing: Any) -> Any:
    """To the compiler, code that may read and write all memory."""

    def _generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        nothing = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [])
        builder.asm(nothing, "", "~{memory}", [], side_effect=True)
        return context.get_dummy_value()

    return types.void(), _generate


def start(program: Program, measured: Reals) -> None:
    """Puts the device points at `measured` (m, one per channel), at rest: before the first tick."""
    _start(program.record, measured)


def take_over(older: Program, program: Program, measured: Reals) -> None:
    """Instead of `start`, for a program that `take_over_from` prepared to follow `older`."""
    _take_over(older.record, program.record, measured)


def follow_parameters(program: Program) -> None:
    """Before a tick: live parameters that were posted move by a sample."""
    _follow_parameters(program.record)


def tick(program: Program, measured: Reals, velocity: Reals, force: Reals) -> None:
    """One sample; all arrays with one value per channel: m, m/s, and what it writes, N."""
    _tick(program.record, measured, velocity, force)


def ticks(program: Program, measured: Reals, velocity: Reals, force: Reals, samples: int) -> None:
    """Runs `samples` ticks, each with the next of the hands' positions and velocities, shape (rows, channels), over and
    over; forces in N, beside them."""
    _ticks(program.record, measured, velocity, force, samples)


def ticks_watched(program: Program, rows: list[NDArray[Any]], weights: Reals, watched: Reals) -> None:
    """As many samples as `watched` has room for, all hands at 0; behind each, the sum of `weights` times the numbers in
    the row whose turn it is: two rows, contiguous, of the program's own type of number."""
    addresses = np.array([row.ctypes.data for row in rows], np.uint64)
    if any(row.dtype != program.rows.dtype or row.size < weights.size for row in rows):
        raise ValueError("rows of another type of number, or too short")
    still = np.zeros(1 + int(program.record.channel.max()))
    _ticks_watched(program.record, still, np.zeros_like(still), addresses, weights, watched)


def act_alone(program: Program, action: str, part: Part, samples: int) -> None:
    """Calls one action of one of the program's parts `samples` times, at the program's own state."""
    having = [one for one in program.parts if getattr(one, action) is not None]
    (number,) = (i for i, one in enumerate(having) if one is part)
    alone = new_record(CALLS)
    alone.pairs, alone.count = program.record[action].pairs + np.uint64(_PAIR_BYTES * number), 1
    _call_many(program.record, alone, samples)


_start, _take_over = entry(_start_inlined), entry(_take_over_inlined)
_follow_parameters, _tick = entry(_follow_inlined), entry(_tick_inlined)


@entry
def _ticks(program, measured, velocity, force, samples):
    for begin in range(0, samples, measured.shape[0]):
        for n in range(np.uint64(min(measured.shape[0], samples - begin))):
            _tick_inlined(program, measured[n], velocity[n], force[n])
            _other_code()


@entry
def _ticks_watched(program, measured, force, rows, weights, watched):
    for n in range(watched.size):
        _tick_inlined(program, measured, measured, force)
        row, total = rows[np.uint64(program.turn)], 0.0
        for i in range(weights.size):
            total += weights[i] * number_at(row, i, program.single)
        watched[n] = total


@entry
def _call_many(program, calls, samples):
    for _ in range(samples):
        call_all(calls, program.states[np.uint64(program.turn)])
        _other_code()
