"""A program on a desk: its ticks in a compiled loop, without a device, for whoever asks what they cost or do.

Between two ticks of a loop with a device, other code runs: what stands in memory is written by then, and read anew. The
loops here keep to that (`other_code`), lest the compiler work on several ticks at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from hapsim.compiled import inlined, jit
from hapsim.cordis.tick import tick
from hapsim.scene import Scene


def desk_of(scene: Scene) -> Any:
    """One value per channel of each kind, of a number that the compiler knows, as in the loop."""
    return desks_of(scene, 1)[0]


def desks_of(scene: Scene, samples: int) -> Any:
    """A desk for each sample: where every hand is, and, once it is ticked, what every hand feels."""
    each = (scene.channels,)
    kinds = [(name, np.float64, each) for name in ("measured", "velocity", "force")]
    return np.zeros(samples, np.dtype(kinds))


@jit
def ticks(program, desk, samples):
    """So many samples; every hand stays where the desk says."""
    for _ in range(samples):
        tick(program, desk.measured, desk.velocity, desk.force)
        other_code()


@jit
def ticks_at(program, desks, samples):
    """So many samples, each at the next desk, over and over."""
    for begin in range(0, samples, desks.size):
        for n in range(min(desks.size, samples - begin)):
            desk = desks[n]
            tick(program, desk.measured, desk.velocity, desk.force)
            other_code()


@jit
def ticks_watched(program, desk, rows, turn, first, weights, watched):
    """As many samples as `watched` has room for; behind each, the sum of `weights` times the numbers from `first` on.

    `rows`, `turn`: where those numbers are, as in a program: in the row whose turn it is, or, where `turn` is None, in
    the first.
    """
    for n in range(watched.size):
        tick(program, desk.measured, desk.velocity, desk.force)
        row = rows[_at_hand(turn)]
        total = 0.0
        for i in range(weights.size):
            total += weights[i] * row[first + i]
        watched[n] = total


@intrinsic
def other_code(_typing: Any) -> Any:
    """To the compiler, code that may read and write all memory."""

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        nothing = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [])
        builder.asm(nothing, "", "~{memory}", [], side_effect=True)
        return context.get_dummy_value()

    return types.void(), generate


@inlined
def _at_hand(turn):
    return np.uint64(0) if turn is None else turn[0]
