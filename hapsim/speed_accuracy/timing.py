"""Processor time of a simulation, long enough to be trusted. It imports nothing, for peers without hapsim's own."""

from __future__ import annotations

import time
from collections.abc import Callable

ROUND_S = 0.15
_WARM = 0.2  # of a round


class Timed:
    """A simulation that is timed in rounds of about `round_s`, each of as many samples.

    `advance`: simulates that many samples. It is called until it has run warm.
    """

    def __init__(self, advance: Callable[[int], object], rate: float, round_s: float = ROUND_S) -> None:
        self._advance, self._rate = advance, rate
        samples = 1
        advance(samples)  # the first may compile
        while (took := self._took(samples)) < _WARM * round_s:
            samples *= 4 if took < 0.25 * _WARM * round_s else 2
        self._samples = max(1, round(samples * round_s / took))

    def round(self) -> float:
        """Seconds of processor time for each second that is simulated at `rate` Hz, this time."""
        return self._took(self._samples) * self._rate / self._samples

    def _took(self, samples: int) -> float:
        """Of the thread that asks, so that what shows progress beside it is not counted."""
        begin = time.thread_time()
        self._advance(samples)
        return time.thread_time() - begin


def cost_of(advance: Callable[[int], object], rate: float, rounds: int, round_s: float = ROUND_S) -> list[float]:
    """Seconds of processor time for each second that is simulated at `rate` Hz, one for each round."""
    timed = Timed(advance, rate, round_s)
    return [timed.round() for _ in range(rounds)]
