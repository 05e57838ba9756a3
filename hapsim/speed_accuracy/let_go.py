"""A string that is let go in a shape, at rest, and watched along it: whatever coordinates its scheme keeps it in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst

from hapsim.cordis.desk import desk_of, ticks_watched
from hapsim.cordis.program import Program, compile_scene, numbers_of
from hapsim.cordis.schemes.exact_modes import ExactModes
from hapsim.cordis.tick import start
from hapsim.scene import Scene
from hapsim.speed_accuracy.strings import StringOfMasses


class _Kept(NamedTuple):
    """Where a program keeps a string: from number `first` on, in the row whose `turn` it is; `amounts`, there, of the
    shape."""

    rows: NDArray[np.floating]
    turn: NDArray[np.uint64] | None
    first: int
    amounts: NDArray[np.float64]


def record(scene: Scene, string: StringOfMasses, shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """The motion along `shape` (N,), sample by sample, once the scene's string was let go in it; shape (samples,)."""
    program, desk = compile_scene(scene), desk_of(scene)
    kept = _kept(program, scene, shape)
    kept.rows[:, kept.first : kept.first + string.masses] = kept.amounts
    start(program, desk["measured"])
    watched = np.empty(samples)
    weights = kept.amounts / (kept.amounts @ kept.amounts)
    ticks_watched(program, desk, kept.rows, kept.turn, kept.first, weights, watched)
    return watched


def _kept(program: Program, scene: Scene, shape: NDArray[np.float64]) -> _Kept:
    """As positions of its masses; or, by the exact scheme, as how much there is of each of its modes: sines, all of one
    norm, the slowest first."""
    for part in program.parts:
        if isinstance(part, ExactModes):
            return _Kept(part.position.reshape(1, -1), None, 0, dst(shape, type=1) / (shape.size + 1))
    return _Kept(program.rows, program.turn, numbers_of(scene)["string.0"], shape)
