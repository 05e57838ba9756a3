"""The points of a sweep (a grid, random samples of ranges, or the rows of a table), and the scene at each point."""

from __future__ import annotations

import csv
import itertools
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hapsim.errors import UsageError
from hapsim.scene.issue import quote
from hapsim.scene.varied import Value, Varied, as_written
from hapsim.scene.written_units import QUANTITY

Method = Literal["lhs", "random", "sobol"]
METHODS: tuple[Method, ...] = ("lhs", "random", "sobol")

POINT = "point"
"""The name of the dimension of samples and tables."""
_MOST = 10_000_000
_EXPECTED = (
    "expected values such as 0,0.5,1 or none,poles, a range such as lin:0:2:5 or log:100:10000:50, or, with --samples, "
    "one without a number, such as log:100:10000"
)


@dataclass(frozen=True)
class Range:
    """A range of values, linear or logarithmic."""

    least: float
    most: float
    is_logarithmic: bool
    unit: str = ""
    """Unit of both ends, such as N/mm; "" for SI units."""

    def at(self, shares: Any) -> list[Value]:
        """Returns the values at these fractions (0 to 1) of the range."""
        if self.is_logarithmic:
            values = self.least * (self.most / self.least) ** np.asarray(shares)
        else:
            values = self.least + (self.most - self.least) * np.asarray(shares)
        return [f"{one!r} {self.unit}" if self.unit else one for one in values.tolist()]


@dataclass(frozen=True)
class Points:
    """N points. In a grid the last dimension varies fastest."""

    sizes: dict[str, int]  # of each dimension by name: the varied paths of a grid, else POINT
    columns: dict[str, list[Value]]  # by path, the value at each point

    def __len__(self) -> int:
        return math.prod(self.sizes.values())

    def __getitem__(self, number: int) -> dict[str, Value]:
        return {path: column[number] for path, column in self.columns.items()}

    @property
    def is_grid(self) -> bool:
        """True if each path is a dimension."""
        return POINT not in self.sizes

    def axis(self, path: str) -> list[Value]:
        """Returns the values along one dimension of a grid."""
        after = math.prod(list(self.sizes.values())[list(self.sizes).index(path) + 1 :])
        return self.columns[path][:: after or 1][: self.sizes[path]]


def grid(axes: Mapping[str, Iterable[Value]]) -> Points:
    """Returns every combination of these values. Raises UsageError for an invalid value, or if there is none."""
    values = {path: [_value(path, one) for one in several] for path, several in axes.items()}
    sizes = {path: len(several) for path, several in values.items()}
    if not values:
        raise UsageError("found no parameter to sweep, expected some, such as touch.stiffness=log:100:10000:50")
    if not 1 <= (count := math.prod(sizes.values())) <= _MOST:
        raise UsageError(f"found {count} points, expected 1 to {_MOST}")
    for path, several in values.items():
        if len(set(several)) < len(several):
            raise UsageError(f"{path}: found a value twice, expected each once")
    columns = zip(*itertools.product(*values.values()), strict=True)
    return Points(sizes, {path: list(column) for path, column in zip(values, columns, strict=True)})


def listed(points: Sequence[Mapping[str, Value]]) -> Points:
    """Returns the points of a list. Raises UsageError unless all have the same paths."""
    paths = list(points[0]) if points else []
    if not paths or any(list(one) != paths for one in points):
        raise UsageError("points: expected one or more, each with a value for the same paths")
    return Points({POINT: len(points)}, {path: [_value(path, one[path]) for one in points] for path in paths})


def samples(ranges: Mapping[str, Range], count: int, method: Method = "lhs", seed: int = 0) -> Points:
    """Returns `count` points of these ranges, the same for the same seed: a Latin hypercube ("lhs"), independent points
    ("random") or Sobol's sequence ("sobol")."""
    if not 1 <= count <= _MOST or not ranges:
        raise UsageError(f"--samples: found {count} of {len(ranges)} ranges, expected 1 to {_MOST} of one or more")
    dimensions = len(ranges)
    if method == "random":
        shares = np.random.default_rng(seed).random((count, dimensions))
    else:
        from scipy.stats import qmc

        make = {"lhs": qmc.LatinHypercube, "sobol": qmc.Sobol}[method]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # scipy: a Sobol sequence is best at a power of two
            shares = make(dimensions, rng=np.random.default_rng(seed)).random(count)
    columns: dict[str, list[Value]] = {path: [*one.at(shares[:, i])] for i, (path, one) in enumerate(ranges.items())}
    return Points({POINT: count}, columns)


def table(path: Path) -> Points:
    """Returns the points of a .csv file. Its first row has the path of each column. Raises UsageError for another."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            heading, *rows = [row for row in csv.reader(stream) if row]
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    except ValueError:
        raise UsageError(f"{path}: found no rows, expected names such as touch.stiffness, and values") from None
    names = [name.strip() for name in heading]
    for number, row in enumerate(rows, 2):
        if len(row) != len(names):
            raise UsageError(f"{path}: row {number}: found {len(row)} values, expected {len(names)}")
    if not rows or len(set(names)) < len(names):
        raise UsageError(f"{path}: expected rows of values below a first row of different names")
    columns = {name: [_parsed(name, row[i].strip()) for row in rows] for i, name in enumerate(names)}
    return Points({POINT: len(rows)}, columns)


def read_axis(word: str) -> tuple[str, list[Value] | Range]:
    """Returns the path and the values or the range of a word such as "touch.stiffness=log:100:10000:50"."""
    path, equals, text = word.partition("=")
    kind, *numbers = text.split(":")
    if not equals or not path or not text:
        raise UsageError(f"found '{word}', expected PATH=VALUES, such as touch.stiffness=log:100:10000:50")
    if not numbers and ".." in text:
        raise UsageError(f"{path}: found '{text}', {_EXPECTED}")
    if not numbers:
        return path, [_parsed(path, one.strip()) for one in text.split(",")]
    try:
        (least, unit), (most, same), *counts = map(_end, numbers)
        count = [number for number, of_count in counts if not of_count]
        found = Range(least, most, {"lin": False, "log": True}[kind], unit)
    except (KeyError, ValueError):
        raise UsageError(f"{path}: found '{text}', {_EXPECTED}") from None
    if unit != same:
        raise UsageError(f"{path}: found '{text}', expected the same unit at both ends, such as lin:1 N/mm:5 N/mm:9")
    if not (math.isfinite(least) and math.isfinite(most)) or len(counts) > 1 or len(count) < len(counts):
        raise UsageError(f"{path}: found '{text}', {_EXPECTED}")
    if found.is_logarithmic and not min(least, most) > 0.0:
        raise UsageError(f"{path}: found '{text}', expected a logarithmic range above 0")
    if not count:
        return path, found
    if count[0] != int(count[0]) or not 1 <= count[0] <= _MOST:
        raise UsageError(f"{path}: found {count[0]:g} values, expected a whole number from 1 to {_MOST}")
    return path, [*found.at(np.linspace(0.0, 1.0, int(count[0])))]


def _end(text: str) -> tuple[float, str]:
    """Returns the number and the unit of an end of a range, or of its count."""
    quantity = QUANTITY.match(text)
    return (float(quantity[1]), (quantity[3] + quantity[4]).strip()) if quantity else (float(text), "")


def read_points(words: Sequence[str], count: int | None, method: str, seed: int) -> Points:
    """Returns the points given by the words of a command line: a grid, or `count` samples of ranges."""
    axes = dict(map(read_axis, words))
    if len(axes) < len(words):
        raise UsageError("found a parameter twice, expected each once")
    ranges = {path: one for path, one in axes.items() if isinstance(one, Range)}
    if count is None:
        if ranges:
            path = next(iter(ranges))
            raise UsageError(f"{path}: found a range without a number of values; add it, or --samples N")
        return grid({path: one for path, one in axes.items() if not isinstance(one, Range)})
    if others := [path for path in axes if path not in ranges]:
        raise UsageError(f"{others[0]}: found single values, expected with --samples a range such as lin:0:2")
    if method not in METHODS:
        raise UsageError(f"--method: found '{method}', expected {', '.join(METHODS)}")
    return samples(ranges, count, method, seed)


def _parsed(path: str, text: str) -> Value:
    try:
        return _value(path, float(text))
    except ValueError:
        return _value(path, text)


def _value(path: str, value: Any) -> Value:
    """Returns a value as a finite float or a word. Raises UsageError for any other."""
    if isinstance(value, str):
        if value:
            return value
    elif isinstance(value, (bool, int, float, np.number)) and math.isfinite(value):
        return float(value)
    raise UsageError(f"{path}: found {value!r}, expected a finite number or a word")


def in_si(points: Points, varied: Varied) -> Points:
    """Returns the points with quantities such as "2 N/mm" as numbers. Raises UsageError for a unit that is wrong."""
    if points.is_grid:
        return grid({path: [varied.in_si(path, one) for one in points.axis(path)] for path in points.columns})
    columns = {path: [varied.in_si(path, one) for one in column] for path, column in points.columns.items()}
    return Points(points.sizes, columns)


def require_values(points: Points, varied: Varied) -> None:
    """Raises UsageError for a word that its parameter does not take, and in a grid also for such a number."""
    for path, column in points.columns.items():
        values = points.axis(path) if points.is_grid else dict.fromkeys(one for one in column if isinstance(one, str))
        for value in values:
            if expected := varied.expected(path, as_written(value)):
                shown = quote(value) if isinstance(value, str) else f"{value:g}"
                raise UsageError(f"{path}: found {shown}, expected {expected}; correct this value, or leave it out")
