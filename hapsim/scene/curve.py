"""A curve of the scene file: a table of points, straight between them."""

import math
from dataclasses import dataclass
from typing import Any

from .quantity import Expectation, as_float, is_list, unexpected

#: Points, each where it stands and what the curve is there.
Curve = tuple[tuple[float, float], ...]

LEAST_POINTS, MOST_POINTS = 2, 1000


@dataclass(frozen=True)
class CurvePoints(Expectation):
    """A list of points [x, y], by ascending x; None is welcome in Python too.

    Attributes:
        description: what the curve is, for the schema.
        along, up: units of x and y as people read them.
        left_out: what it means to leave the curve out.
        fewest: how many points there are at least.
        above: what every y is greater than.
    """

    description: str
    along: str
    up: str
    left_out: str
    fewest: int = LEAST_POINTS
    above: float | None = None

    def expected(self) -> str:
        return f"a list of {self.fewest} to {MOST_POINTS} points [{self.along}, {self.up}]"

    def check(self, value: object) -> Curve | None:
        """The points as numbers; None stays. An error that names the point through `unexpected`."""
        if value is None:
            return None
        if not is_list(value) or not self.fewest <= len(value) <= MOST_POINTS:
            unexpected(self.expected())
        points: list[tuple[float, float]] = []
        for index, entry in enumerate(value):
            points.append(self._point(entry, index))
            if index and not points[index - 1][0] < points[index][0]:
                before = f"{points[index - 1][0]:.15g}"
                unexpected(f"a number > {before} ({self.along}): the points stand in ascending order", (index, 0))
        return tuple(points)

    def json_schema(self) -> dict[str, Any]:
        """A list of points, or ``null``."""
        number = {"type": "number"}
        point = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
        points = {"type": "array", "items": point, "minItems": self.fewest, "maxItems": MOST_POINTS}
        described = f"{self.description}, in points [{self.along}, {self.up}]; left out: {self.left_out}"
        return {"description": described, "anyOf": [points, {"type": "null"}]}

    def _point(self, entry: object, index: int) -> tuple[float, float]:
        if not is_list(entry) or len(entry) != 2:
            unexpected(f"a point [{self.along}, {self.up}], two numbers", (index,))
        x, y = self._number(entry[0], self.along, (index, 0)), self._number(entry[1], self.up, (index, 1))
        if self.above is not None and not y > self.above:
            unexpected(f"a number > {self.above:g} ({self.up})", (index, 1))
        return x, y

    @staticmethod
    def _number(value: object, unit: str, at: tuple[int, int]) -> float:
        number = as_float(value)
        if number is None or not math.isfinite(number):
            unexpected(f"a finite number ({unit})", at)
        return number
