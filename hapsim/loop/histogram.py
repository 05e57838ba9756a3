"""A histogram that the loop fills: logarithmic, 16 bins to the octave, from 1 to beyond 10^12, with a bin for zero.

A count costs a few nanoseconds and no allocation: the bin's number is the leading bits of the value's floating-point
form. Whole numbers below 32 have bins of their own; above, a bin is at most a sixteenth wide.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined

_PART_BITS = 4  # 16 bins to the octave
_OCTAVES = 42
_BINS = 1 + (_OCTAVES << _PART_BITS)
_SHIFT = 52 - _PART_BITS
_FIRST = (1023 << _PART_BITS) - 1  # so that 1.0 falls into bin 1

HISTOGRAM = np.dtype([("maximum", np.int64), ("counts", np.int64, (_BINS,))], align=True)


@inlined
def note(histogram, value):
    """Counts a whole number; a negative one counts as 0."""
    i: Any = 0
    if value > 0:
        i = (np.float64(value).view(np.int64) >> _SHIFT) - _FIRST
        i = i if i < _BINS else _BINS - 1
        histogram.maximum = value if value > histogram.maximum else histogram.maximum
    histogram.counts[np.uint64(i)] += 1


@dataclass(frozen=True)
class Spread:
    """Quantiles of a histogram (p999: 99.9 %); None if it is empty."""

    count: int
    p50: float | None
    p99: float | None
    p999: float | None
    max: float | None


@dataclass(frozen=True, eq=False, repr=False)
class Histogram:
    """A copy of a loop's histogram. `unit`: of the counted values, such as 1e-9 for nanoseconds in s."""

    counts: NDArray[np.int64]
    """Count of each bin, (bins,); bin i holds values >= edges[i] and < edges[i + 1]."""
    maximum: float
    """Largest value."""
    unit: float = 1.0

    def __repr__(self) -> str:
        spread = self.spread()
        quantiles = f", p50={spread.p50:.4g}, p99={spread.p99:.4g}, max={spread.max:.4g}" if self.total else ""
        return f"Histogram(count={spread.count}{quantiles})"

    @property
    def edges(self) -> NDArray[np.float64]:
        """Edges of the bins, (bins + 1,)."""
        return self.unit * _edges()

    @property
    def total(self) -> int:
        """Number of counted values."""
        return int(self.counts.sum())

    def quantile(self, share: float) -> float | None:
        """Returns the value that `share` of all (0 to 1) do not exceed; None if the histogram is empty. It is the upper
        end of the bin, so never too small, and exact below 32. Raises ValueError for another share."""
        if self.total == 0:
            return None
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"share {share}: a share of all is 0 to 1")
        at = int(np.searchsorted(np.cumsum(self.counts), np.ceil(share * self.total)))
        greatest = np.inf if at == _BINS - 1 else (np.ceil(_edges()[at + 1]) - 1) * self.unit
        return float(min(greatest, self.maximum))

    def share_above(self, value: float) -> float:
        """Returns the share (0 to 1) in bins that begin at `value` or above."""
        return float(self.counts[self.edges[:-1] >= value].sum() / max(self.total, 1))

    def spread(self) -> Spread:
        """Returns the quantiles."""
        largest = self.maximum if self.total else None
        return Spread(self.total, self.quantile(0.5), self.quantile(0.99), self.quantile(0.999), largest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Histogram) and np.array_equal(self.as_row(), other.as_row())

    __hash__ = None  # type: ignore[assignment]

    def as_row(self) -> NDArray[np.float64]:
        """Returns unit, maximum and counts in one array, for a file."""
        return np.concatenate([[self.unit, self.maximum], self.counts])

    @staticmethod
    def from_row(row: NDArray[np.float64]) -> Histogram:
        """Returns the histogram of a row that `as_row` made."""
        return Histogram(row[2:].astype(np.int64), float(row[1]), float(row[0]))


@cache
def _edges() -> NDArray[np.float64]:
    """Returns the lower edges of the bins, in counted units; the last bin has no upper edge."""
    octave, part = np.divmod(np.arange(_BINS), 1 << _PART_BITS)
    return np.concatenate([[0.0], np.ldexp(1.0 + part / (1 << _PART_BITS), octave)])


def histogram_of(record: Any, unit: float = 1.0) -> Histogram:
    """Returns a copy of a HISTOGRAM."""
    return Histogram(record.counts.copy(), float(record.maximum) * unit, unit)
