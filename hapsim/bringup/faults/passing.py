"""How long a carrier takes to pass a piece on, of itself."""

from __future__ import annotations

import math
from collections import Counter


class PassingTimes:
    """Counted to the microsecond, so that hours of them take no more memory than seconds."""

    def __init__(self) -> None:
        self._times: Counter[int] = Counter()  # by whole µs

    def note(self, seconds: float) -> None:
        """One more piece was passed on."""
        self._times[max(round(1e6 * seconds), 0)] += 1

    @property
    def count(self) -> int:
        """Pieces."""
        return self._times.total()

    def quantile_s(self, share: float) -> float | None:
        """What this share of the pieces, 0 to 1, took at most, s; None where nothing was passed on."""
        left = math.ceil(share * self.count)
        for time_us in sorted(self._times):
            left -= self._times[time_us]
            if left <= 0:
                return 1e-6 * time_us
        return None
