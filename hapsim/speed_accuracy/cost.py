"""What a simulated second of a scene costs in processor time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene
from hapsim.device.mock.assemble import describe_mock
from hapsim.loop.predictor import CorrectedTicks
from hapsim.prediction.correction import rendered
from hapsim.running.correction import LoopCorrection
from hapsim.scene import Scene
from hapsim.speed_accuracy.strings import hand_motion

ROUND_S = 0.15
_WARM = 0.2  # of a round


class Timed:
    """A simulation that is timed in rounds of about `round_s`, each of as many samples.

    `advance`: simulates so many samples. It is called until it has run warm.
    """

    def __init__(self, advance: Callable[[int], object], rate: float, round_s: float = ROUND_S) -> None:
        self._advance, self._rate = advance, rate
        self._samples = _samples_for(advance, round_s)

    def round(self) -> float:
        """Seconds of processor time for each second that is simulated at `rate` Hz, this time."""
        return _took(self._advance, self._samples) * self._rate / self._samples


def cost_of(advance: Callable[[int], object], rate: float, rounds: int, round_s: float = ROUND_S) -> list[float]:
    """Seconds of processor time for each second that is simulated at `rate` Hz, one for each round."""
    timed = Timed(advance, rate, round_s)
    return [timed.round() for _ in range(rounds)]


def _samples_for(advance: Callable[[int], object], round_s: float) -> int:
    samples = 1
    advance(samples)  # the first may compile
    while (took := _took(advance, samples)) < _WARM * round_s:
        samples *= 4 if took < 0.25 * _WARM * round_s else 2
    return max(1, round(samples * round_s / took))


def _took(advance: Callable[[int], object], samples: int) -> float:
    """Of the thread that asks, so that what shows progress beside it is not counted."""
    begin = time.thread_time()
    advance(samples)
    return time.thread_time() - begin


_BLOCK = 1024  # samples of the hand's motion that are ready: few enough to stay in the nearest cache
_ROUND_S = 0.02


class Running:
    """A scene whose first hand moves as `hand_motion` says, the first samples of it over and over."""

    def __init__(self, scene: Scene) -> None:
        rendering = rendered(scene)
        self._program = compile_scene(rendering.scene)
        self._measured, self._velocity, self._force = np.zeros((3, _BLOCK, scene.channels))
        self._measured[:, 0] = hand_motion(_BLOCK, scene.rate)
        start(self._program, self._measured[0])
        self._corrected: CorrectedTicks | None = None
        if rendering.predictors():
            self._corrected = CorrectedTicks(self._program, scene.channels)
            self._kept = LoopCorrection(self._corrected.record, rendering, describe_mock(scene))

    def advance(self, samples: int) -> None:
        """Simulates so many samples."""
        if self._corrected is not None:
            self._corrected.ticks(self._measured, samples)
            return
        ticks(self._program, self._measured, self._velocity, self._force, samples)


class Clocks:
    """Scenes that are timed, in a thread of their own, so that the caller's arithmetic stays as it is."""

    def __init__(self) -> None:
        self._apart = ThreadPoolExecutor(1)
        self._timed: list[Timed] = []

    def add(self, scene: Scene) -> None:
        """Compiles a scene and runs it warm."""

        def warm() -> Timed:
            return Timed(Running(scene).advance, scene.rate, _ROUND_S)

        self._timed.append(self._apart.submit(warm).result())

    def round(self) -> Iterator[float]:
        """Seconds of processor time for a simulated second of each scene, one after the other."""
        return (self._apart.submit(timed.round).result() for timed in self._timed)

    def close(self) -> None:
        """Ends the thread."""
        self._apart.shutdown()
