"""Types of the values of a scene that are no plain numbers or words."""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, model_serializer

T = TypeVar("T")


class WrittenAsMapping(BaseModel):
    """Number that the file gives as a mapping."""

    model_config = ConfigDict(frozen=True)

    def __str__(self) -> str:
        """Returns the mapping in braces, as a scene's file spells it."""
        return "{" + ", ".join(f"{key}: {value!r}" for key, value in self.model_dump().items()) + "}"


class Span(WrittenAsMapping):
    """An unknown number: `from` its least `to` its largest possible value."""

    least: float
    most: float

    @model_serializer
    def _as_written(self) -> dict[str, float]:
        return {"from": self.least, "to": self.most}


class Known(WrittenAsMapping):
    """A number that was measured, with its standard uncertainty."""

    value: float
    uncertainty: float


class Area(WrittenAsMapping):
    """A disc or a polygon in the plane, about the scene's position 0. SI units."""

    disc: float | None = None
    center: tuple[float, float] = (0.0, 0.0)
    polygon: tuple[tuple[float, float], ...] = ()

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Corners of the polygon, m; of a disc its centre."""
        return self.polygon or (self.center,)

    @property
    def radius(self) -> float:
        """Distance from the corners to the edge, m: of a disc."""
        return self.disc or 0.0

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Least and most x, and least and most y, m."""
        return tuple((min(each) - self.radius, max(each) + self.radius) for each in zip(*self.corners, strict=True))

    @model_serializer
    def _as_written(self) -> dict[str, Any]:
        return {"polygon": self.polygon} if self.polygon else {"disc": self.disc, "center": self.center}


#: A curve: points by ascending x, straight between them.
Curve = tuple[tuple[float, float], ...]


class Branches(WrittenAsMapping):
    """A curve with two branches over the same distances: the force of a spring and a slider in one.

    With M the mean of the branches and h half their difference, F = M(x) + h(x) z; z = clip(z + 2 dx/turn, -1, 1).
    """

    press: Curve
    """m and N, while the distance grows."""
    release: Curve
    """m and N, while it shrinks; nowhere above `press`."""
    turn: float | None = None
    """m, over which the force crosses from one branch to the other; None: the scene's default."""

    @property
    def mean(self) -> Curve:
        """M: m and N."""
        return self._of_both(lambda press, release: 0.5 * (press + release))

    @property
    def half(self) -> Curve:
        """h: m and N."""
        return self._of_both(lambda press, release: 0.5 * (press - release))

    @property
    def width(self) -> float:
        """`turn`, m, by default 2 % of the range."""
        return 0.02 * (self.press[-1][0] - self.press[0][0]) if self.turn is None else self.turn

    @property
    def steepest(self) -> float:
        """Steepest slope of the force, N/m, in any place and any z: the largest M' + |h'| + 2 h/turn."""
        return max(slope + 2.0 * half / self.width for slope, half in self._pieces())

    def least_turn(self, rate: float, delay: float, friction: float) -> float:
        """Returns the `turn`, m, from which on any hand is safe: friction >= (1/2 + delay) T `steepest`.

        Args:
            rate, delay, friction: of the device: Hz, samples, N·s/m.

        Returns:
            0 for branches that are one; infinity where one of them is too steep itself.
        """
        most = friction * rate / (0.5 + delay)
        each = [(2.0 * half, most - slope) for slope, half in self._pieces() if half > 0.0 or slope > most]
        return max((rise / left if left > 0.0 else math.inf for rise, left in each), default=0.0)

    def _of_both(self, form: Callable[[float, float], float]) -> Curve:
        both = zip(self.press, self.release, strict=True)
        return tuple((x, form(press, release)) for (x, press), (_, release) in both)

    def _pieces(self) -> list[tuple[float, float]]:
        """Slope of the steeper branch, N/m, and the largest h, N, of each piece; level beyond the ends."""
        steeper = [
            max((up[1] - low[1]) / (up[0] - low[0]) for low, up in both)
            for both in zip(pairwise(self.press), pairwise(self.release), strict=True)
        ]
        halves = [half for _, half in self.half]
        inner = zip(steeper, map(max, pairwise(halves)), strict=True)
        return [(0.0, halves[0]), *inner, (0.0, halves[-1])]

    @model_serializer
    def _as_written(self) -> dict[str, Any]:
        return {key: value for key, value in self if value is not None}


def force_at(curve: Curve, x: float) -> float:
    """Returns the force of a curve at x, N: straight between its points, and level beyond them."""
    k = bisect_right(curve, x, key=lambda point: point[0])
    (low, first), (up, last) = curve[max(k - 1, 0)], curve[min(k, len(curve) - 1)]
    return first + (last - first) * ((x - low) / (up - low)) if low < x < up else first if x >= low else last


#: A number of the scene file, or one for each channel of the device; a `Span` or `Known` in its place; or a word.
PerChannel = float | tuple[float, ...]
SpanPerChannel = float | Span | Known | tuple[float | Span | Known, ...]
WordPerChannel = float | str | tuple[float | str, ...]

#: A symmetric positive definite matrix, one row per channel: the mass of a device whose channels move each other.
Matrix = tuple[tuple[float, ...], ...]

#: A lower and an upper limit, or such a pair for each channel.
Limits = tuple[float, float]
LimitsPerChannel = Limits | tuple[Limits, ...]


def per_channel(value: T | tuple[T, ...], channels: int) -> tuple[T, ...]:
    """Returns one value for each of ``channels`` channels: one alone is repeated, a tuple is taken as it is."""
    return value if isinstance(value, tuple) else (value,) * channels


def spans_of(numbers: Iterable[float | Span | Known]) -> tuple[tuple[float, float], ...]:
    """Returns the least and the largest value that each number may have."""
    known = (one.value if isinstance(one, Known) else one for one in numbers)
    return tuple((one.least, one.most) if isinstance(one, Span) else (one, one) for one in known)


def entries_of(value: object) -> Sequence[Any]:
    """Returns the entries of a list, or the only value."""
    return value if isinstance(value, list | tuple) else (value,)
