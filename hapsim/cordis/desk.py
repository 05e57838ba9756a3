"""A program on a desk: its ticks in a compiled loop, without a device, for whoever asks what they cost or do."""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiled import inlined, jit
from hapsim.cordis.tick import tick
from hapsim.scene import Scene


def desk_of(scene: Scene) -> Any:
    """One value per channel of each kind, of a number that the compiler knows, as in the loop."""
    each = (scene.channels,)
    kinds = [(name, np.float64, each) for name in ("measured", "velocity", "force")]
    return np.zeros(1, np.dtype(kinds))[0]


@jit
def ticks(program, desk, samples):
    """So many samples; every hand stays where the desk says."""
    for _ in range(samples):
        tick(program, desk.measured, desk.velocity, desk.force)


@jit
def ticks_with_hand(program, desk, motion, forces, samples):
    """So many samples in which the first hand moves as `motion` says, in m, over and over; `forces` in N, beside it."""
    done = 0
    while done < samples:
        block = min(samples - done, motion.size)
        for n in range(block):
            desk.measured[0] = motion[n]
            tick(program, desk.measured, desk.velocity, desk.force)
            forces[n] = desk.force[0]
        done += block


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


@inlined
def _at_hand(turn):
    return np.uint64(0) if turn is None else turn[0]
