"""The processor time of a simulated second of a scene: compiled ticks in a compiled loop, with what a correction
does around each, in rounds in which all scenes take turns."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene
from hapsim.device.mock.assemble import describe_mock
from hapsim.loop.exchange import LOOP
from hapsim.loop.predictor import corrected_ticks
from hapsim.prediction.correction import rendered
from hapsim.running.correction import LoopCorrection
from hapsim.scene import Scene
from hapsim.speed_accuracy.strings import hand_motion
from hapsim.speed_accuracy.timing import Timed

_ROUND_S = 0.02
_BLOCK = 1024  # samples of the hand's motion that are ready: few enough to stay in the nearest cache


class Running:
    """A scene whose first hand moves as `hand_motion` says, the first samples of it over and over."""

    def __init__(self, scene: Scene) -> None:
        rendering = rendered(scene)
        self._program = compile_scene(rendering.scene)
        self._measured, self._velocity, self._force = np.zeros((3, _BLOCK, scene.channels))
        self._measured[:, 0] = hand_motion(_BLOCK, scene.rate)
        start(self._program, self._measured[0])
        self._loop: Any = None
        if rendering.predictors():
            self._loop = new_record(LOOP)
            self._loop.io.address, self._loop.io.channels = address_of(self._loop.io), scene.channels
            self._kept = LoopCorrection(self._loop, rendering, describe_mock(scene))

    def advance(self, samples: int) -> None:
        """Simulates samples."""
        if self._loop is not None:
            corrected_ticks(self._loop, self._program.record, self._measured, samples)
        else:
            ticks(self._program, self._measured, self._velocity, self._force, samples)


class Clocks:
    """Scenes that are timed, in a thread of their own, so that the caller's arithmetic stays as it is."""

    def __init__(self) -> None:
        self._apart = ThreadPoolExecutor(1)
        self._timed: list[Timed] = []

    def add(self, scene: Scene) -> None:
        """Compiles a scene and runs it warm."""
        warm = self._apart.submit(lambda: Timed(Running(scene).advance, scene.rate, _ROUND_S))
        self._timed.append(warm.result())

    def round(self) -> Iterator[float]:
        """Seconds of processor time for a simulated second of each scene, one after the other."""
        return (self._apart.submit(timed.round).result() for timed in self._timed)

    def close(self) -> None:
        """Ends the thread."""
        self._apart.shutdown()
