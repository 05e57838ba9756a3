"""Processor time of a simulation, long enough to be trusted."""

from __future__ import annotations

import time
from collections.abc import Callable

ROUND_S = 0.15
_WARM_S = 0.03


def cost_of(advance: Callable[[int], object], rate: float, rounds: int, round_s: float = ROUND_S) -> list[float]:
    """Seconds of processor time for each second that is simulated at `rate` Hz, one for each round.

    `advance`: simulates so many samples. It is called until it has run warm, then for about `round_s` in each round.
    """
    samples = _samples_for(advance, round_s)
    return [_took(advance, samples) * rate / samples for _ in range(rounds)]


def _samples_for(advance: Callable[[int], object], round_s: float) -> int:
    samples = 1
    while (took := _took(advance, samples)) < _WARM_S:
        samples *= 4 if took < 0.25 * _WARM_S else 2
    return max(1, round(samples * round_s / took))


def _took(advance: Callable[[int], object], samples: int) -> float:
    begin = time.process_time()
    advance(samples)
    return time.process_time() - begin
