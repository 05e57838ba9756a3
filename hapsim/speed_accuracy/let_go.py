"""A string that is let go in a shape, at rest, and watched along it: whatever coordinates its scheme keeps it in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.desk import desk_of, ticks_watched
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.cordis.tick import start
from hapsim.scene import Scene
from hapsim.speed_accuracy.strings import StringOfMasses


def record(scene: Scene, string: StringOfMasses, shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """The motion along `shape` (N,), sample by sample, once the scene's string was let go in it; shape (samples,)."""
    program, desk = compile_scene(scene), desk_of(scene)
    first = numbers_of(scene)["string.0"]
    program.rows[:, first : first + string.masses] = shape
    start(program, desk["measured"])
    watched = np.empty(samples)
    weights = shape / (shape @ shape)
    ticks_watched(program, desk, program.rows, program.turn, first, weights, watched)
    return watched
