"""A histogram on the terminal: a row a bin, with a bar whose length is logarithmic in the count.

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
    from rich.console import Console

    from hapsim.loop.histogram import Histogram

_MOST_ROWS = 24
#: Where an octave's sixteen bins are parted, by how many rows it gets: each row as near to alike as sixteenths allow.
_PARTS = {3: (0, 4, 9), 2: (0, 7), 1: (0,)}
_BINS_AN_OCTAVE = 16
_EIGHTHS = " ▏▎▍▌▋▊▉█"
_LEAST_BAR, _MOST_BAR = 8, 56
_QUANTILES = (("p50", 0.5), ("p99", 0.99), ("99.9 %", 0.999), ("max", 1.0))


@dataclass(frozen=True)
class Row:
    """What fell into one range of values."""

    begins: float
    ends: float
    count: int
    marks: tuple[str, ...]
    """Names of what is in it: p50, p99, max, …"""


def show_histogram(out: Console, histogram: Histogram, marks: Mapping[str, float] | None = None) -> None:
    """Prints a histogram of durations (s) as wide as the terminal. `marks`: further values to mark, by name."""
    for line in histogram_lines(histogram, out.width, ascii_only=out.options.ascii_only, marks=marks):
        # Bars and numbers are to be left as they are: no colours, no markup, no wrapping.
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def histogram_lines(
    histogram: Histogram, width: int, *, ascii_only: bool = False, marks: Mapping[str, float] | None = None
) -> list[str]:
    """The same as lines of at most `width` characters, as far as numbers and marks have room."""
    rows = histogram_rows(histogram, marks)
    if not rows:
        return ["nothing was counted"]
    total = sum(row.count for row in rows)
    left = [_range(row) for row in rows]
    right = [f"{row.count} {share_in_percent(row.count / total):>8} {' '.join(row.marks)}".rstrip() for row in rows]
    counts = max(len(str(row.count)) for row in rows)
    right = [" " * (counts - len(str(row.count))) + text for row, text in zip(rows, right, strict=True)]
    wide = max(map(len, left))
    bar = min(max(width - wide - max(map(len, right)) - 4, _LEAST_BAR), _MOST_BAR)
    most = max(row.count for row in rows)
    lines = [
        f" {label:>{wide}} {_bar(row.count, most, bar, ascii_only):<{bar}} {text}".rstrip()
        for row, label, text in zip(rows, left, right, strict=True)
    ]
    lines.append(f" {total} in all; bars are logarithmic in the count: one is {_bar(1, most, bar, ascii_only)}")
    return [in_ascii(line) for line in lines] if ascii_only else lines


def histogram_rows(histogram: Histogram, marks: Mapping[str, float] | None = None) -> list[Row]:
    """The bins merged to three rows an octave, fewer where there would be too many; from the first that holds anything
    to the last, the empty ones between them too. [] where nothing was counted."""
    if histogram.total == 0:
        return []
    for parts in _PARTS.values():
        starts = _starts(histogram, parts)
        if starts.size - 1 <= _MOST_ROWS:
            break
    counts = np.add.reduceat(histogram.counts, starts[:-1])  # the last one to the end, beyond which there is nothing
    edges = histogram.edges[starts]
    values = {name: _quantile(histogram, share) for name, share in _QUANTILES} | dict(marks or {})
    return [
        Row(float(low), float(high), int(count), tuple(n for n, v in values.items() if low <= v < high))
        for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True)
    ]


def _starts(histogram: Histogram, parts: tuple[int, ...]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """The first bin of every row, and the bin after the last row. Bin 0 is zero's alone, and a row of its own."""
    bins = histogram.counts.size
    octaves = np.arange(1, bins, _BINS_AN_OCTAVE)
    every = np.concatenate([[0], (octaves[:, None] + np.array(parts)).ravel(), [bins]])
    filled = np.flatnonzero(histogram.counts)
    first = int(np.searchsorted(every, filled[0], side="right")) - 1
    last = int(np.searchsorted(every, filled[-1], side="right"))
    kept: np.ndarray[tuple[int], np.dtype[np.int64]] = every[first : last + 1]
    return kept


def _quantile(histogram: Histogram, share: float) -> float:
    """The value of a quantile; NaN, which is in no row, of nothing."""
    value = histogram.quantile(share)
    return math.nan if value is None else value


def _range(row: Row) -> str:
    """65.5 –  81.9 µs: both ends in the unit of the upper one's row."""
    if row.begins == 0.0:
        return "0"
    size, unit = time_unit(row.begins)
    return f"{_three(row.begins / size):>4} – {_three(row.ends / size):>4} {unit}"


def _three(value: float) -> str:
    return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


def _bar(count: int, most: int, width: int, ascii_only: bool) -> str:
    """One has the share 1 / (1 + lg most) of the width, and each ten times as many as much more."""
    if count == 0:
        return ""
    eighths = max(round(8.0 * width * (1.0 + math.log10(count)) / (1.0 + math.log10(most))), 1)
    if ascii_only:
        return "#" * max(eighths // 8, 1)
    return ("█" * (eighths // 8) + _EIGHTHS[eighths % 8]).rstrip()
