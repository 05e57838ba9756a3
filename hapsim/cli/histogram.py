"""A histogram on the terminal: rows with a bar whose length is logarithmic in the count.

Logarithmic, because what matters in a histogram of lateness are the few in a hundred thousand: no other bar shows them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hapsim.number_format import in_ascii, share_in_percent, time_unit

if TYPE_CHECKING:
    from hapsim.loop.histogram import Histogram

_BINS_AN_OCTAVE = 16
_EIGHTHS = " ▏▎▍▌▋▊▉█"
_LEAST_BAR, _MOST_BAR = 8, 56
_QUANTILES = (("p50", 0.5), ("p99", 0.99), ("99.9 %", 0.999), ("max", 1.0))


@dataclass(frozen=True)
class Row:
    """What fell into one range of values, in s."""

    begins: float
    ends: float
    count: int
    marks: tuple[str, ...]
    """Names of the values in it: p50, p99, max, …"""


def histogram_lines(
    histogram: Histogram, width: int, *, ascii_only: bool = False, marks: Mapping[str, float] | None = None
) -> list[str]:
    """Returns a histogram of durations as lines of at most `width` characters, as far as numbers and marks have room.

    `marks`: further values to mark, s, by name.
    """
    rows = histogram_rows(histogram, marks)
    if not rows:
        return ["nothing was counted"]
    total, most = sum(row.count for row in rows), max(row.count for row in rows)
    ranges = [_range(row) for row in rows]
    shares = [f"{row.count:>{len(str(most))}} {share_in_percent(row.count / total):>8}" for row in rows]
    texts = [f"{share} {' '.join(row.marks)}".rstrip() for share, row in zip(shares, rows, strict=True)]
    wide = max(map(len, ranges))
    length = min(max(width - wide - max(map(len, texts)) - 4, _LEAST_BAR), _MOST_BAR)
    lines = [
        f" {between:>{wide}} {_bar(row.count, most, length, ascii_only):<{length}} {text}".rstrip()
        for row, between, text in zip(rows, ranges, texts, strict=True)
    ]
    lines.append(f" {total} in all; bars are logarithmic in the count: one is {_bar(1, most, length, ascii_only)}")
    return [in_ascii(line) for line in lines] if ascii_only else lines


def histogram_rows(histogram: Histogram, marks: Mapping[str, float] | None = None) -> list[Row]:
    """Returns the bins merged to a row an octave, from the first that holds anything to the last; bin 0 is zero's
    alone, and a row of its own. [] where nothing was counted."""
    if histogram.total == 0:
        return []
    starts = np.concatenate([[0], np.arange(1, histogram.counts.size, _BINS_AN_OCTAVE)])
    counts = np.add.reduceat(histogram.counts, starts).tolist()
    edges = histogram.edges[[*starts, -1]].tolist()
    values = {name: histogram.quantile(share) or 0.0 for name, share in _QUANTILES} | dict(marks or {})
    filled = np.flatnonzero(counts)
    return [
        Row(low, high, count, tuple(name for name, value in values.items() if low <= value < high))
        for low, high, count in list(zip(edges, edges[1:], counts, strict=False))[filled[0] : filled[-1] + 1]
    ]


def _range(row: Row) -> str:
    """Returns both ends of a row in the unit of the lower one: 65.5 –  81.9 µs."""
    if row.begins == 0.0:
        return "0"
    size, unit = time_unit(row.begins)
    low, high = (f"{value:.{3 if value < 1e3 else 4}g}" for value in (row.begins / size, row.ends / size))
    return f"{low:>4} – {high:>4} {unit}"


def _bar(count: int, most: int, width: int, ascii_only: bool) -> str:
    """Returns the bar of a count. One has the share 1 / (1 + lg most) of the width, and each ten times as many as much
    more."""
    if count == 0:
        return ""
    eighths = max(round(8.0 * width * (1.0 + math.log10(count)) / (1.0 + math.log10(most))), 1)
    if ascii_only:
        return "#" * max(eighths // 8, 1)
    return ("█" * (eighths // 8) + _EIGHTHS[eighths % 8]).rstrip()
