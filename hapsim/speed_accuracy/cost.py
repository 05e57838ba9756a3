"""What a simulated second of a scene costs: compiled ticks in a compiled loop, in rounds in which all take turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hapsim.cordis.desk import desk_of, ticks_with_hand
from hapsim.cordis.program import compile_scene
from hapsim.cordis.tick import start
from hapsim.scene import Scene
from hapsim.speed_accuracy.strings import hand_motion
from hapsim.speed_accuracy.timing import Timed

_BLOCK = 16384  # samples of the hand's motion that are ready in memory
_ROUND_S = 0.02


class Running:
    """A scene whose first hand moves by a millimetre, twice a second."""

    def __init__(self, scene: Scene) -> None:
        self._program, self._desk = compile_scene(scene), desk_of(scene)
        self._motion, self._forces = hand_motion(_BLOCK, scene.rate), np.zeros(_BLOCK)
        start(self._program, self._desk["measured"])

    def advance(self, samples: int) -> None:
        """Simulates so many samples. Numbers too small to be normal are zero in the calling thread from then on."""
        ticks_with_hand(self._program, self._desk, self._motion, self._forces, samples)


def costs_of(
    scenes: Sequence[Scene],
    rounds: int,
    on_round: Callable[[int], None] = lambda _: None,
    on_scene: Callable[[int], None] = lambda _: None,
) -> list[tuple[float, ...]]:
    """For each scene, one number a round: seconds of processor time for a simulated second.

    `on_scene` hears which scene is made ready, `on_round` which round begins. It is all done in a thread of its own, so
    that the caller's arithmetic stays as it is.
    """
    with ThreadPoolExecutor(1) as apart:
        timed = []
        for i, scene in enumerate(scenes):
            on_scene(i)
            timed.append(apart.submit(_timed, scene).result())
        taken = []
        for i in range(rounds):
            on_round(i)
            taken.append([apart.submit(one.round).result() for one in timed])
    return list(zip(*taken, strict=True)) if taken else [() for _ in scenes]


def _timed(scene: Scene) -> Timed:
    return Timed(Running(scene).advance, scene.rate, _ROUND_S)
