"""A string that is released in a shape, at rest, and watched along it: whatever coordinates its scheme keeps it in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst

from hapsim.cordis.offline import start, ticks_watched
from hapsim.cordis.program import Program, compile_scene, numbers_of
from hapsim.cordis.schemes.exact_modes import ExactModes
from hapsim.scene import Scene
from hapsim.speed_accuracy.strings import StringOfMasses


class _Kept(NamedTuple):
    """Where a program keeps a string: at the beginning of the row whose turn it is; `amounts`, there, of the shape."""

    rows: list[NDArray[np.floating]]
    amounts: NDArray[np.float64]


def record(scene: Scene, string: StringOfMasses, shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """The motion along `shape` (N,), sample by sample, once the scene's string was released in it; shape (samples,)."""
    program = compile_scene(scene)
    kept = _kept(program, scene, shape)
    for row in kept.rows:
        row[: string.masses] = kept.amounts
    start(program, np.zeros(scene.channels))
    watched = np.empty(samples)
    ticks_watched(program, kept.rows, kept.amounts / (kept.amounts @ kept.amounts), watched)
    return watched


def _kept(program: Program, scene: Scene, shape: NDArray[np.float64]) -> _Kept:
    """As positions of its masses; or, by the exact scheme, as how much there is of each of its modes: sines, all of one
    norm, the slowest first."""
    for part in program.parts:
        if isinstance(part.numbers, ExactModes):
            return _Kept(3 * [part.numbers.position], dst(shape, type=1) / (shape.size + 1))
    first = numbers_of(scene)["string.0"]
    return _Kept([row[first:] for row in program.rows], shape)
