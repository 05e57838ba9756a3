"""The string: equal masses in a row, each linked to the next."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..issue import Issue
from ..part import Part
from ..quantity import count, quantity, words_of
from .module import ModuleContext, check_of
from .structure import Elements, Structure

MOST_MASSES = 100_000

#: fixed: a further link holds the end; clamped: it cannot turn there either, which only bending feels.
StringEnd = Literal["fixed", "clamped", "free"]

ENDS = words_of("How each end is held", ("fixed", "clamped", "free"), 2)
BENDING = quantity(
    "Stiffness against bending: each mass is pulled to the middle of its neighbours, and they the other way",
    "N/m",
    least=0,
)


class Pluck(Part):
    """A string that is pulled aside before the run begins, and released at rest. SI units."""

    at: Annotated[int, count("Number of the mass that is pulled aside", 0, MOST_MASSES - 1)]
    by: Annotated[float, quantity("How far it is pulled aside", "m")]


class String(Structure):
    """Equal masses in a row, each linked to the next; at rest where all are at `position`."""

    counts: ClassVar[tuple[str, ...]] = ("masses",)
    initial: ClassVar[tuple[str, ...]] = ("pluck",)

    type: Literal["string"] = Field(default="string", description="Equal masses in a row, each linked to the next")
    masses: Annotated[int, count("How many masses", 2, MOST_MASSES)]
    bending: Annotated[float, BENDING] = 0.0
    ends: Annotated[tuple[StringEnd, StringEnd], ENDS] = ("fixed", "fixed")
    pluck: Pluck | None = Field(
        default=None,
        title="Pluck",
        description="How it is pulled aside at the start: straight from that mass down to where a mass beyond each end "
        "would be; default: not at all",
    )

    def point_names(self) -> list[str]:
        return [str(i) for i in range(self.masses)]

    def place_words(self) -> str:
        return f"0 to {self.masses - 1}"

    def initial_positions(self) -> list[float]:
        """In m: where it rests, or in the triangle in which the pluck holds it."""
        if self.pluck is None:
            return super().initial_positions()
        at, by, masses = self.pluck.at, self.pluck.by, self.masses
        shares = (min((i + 1) / (at + 1), (masses - i) / (masses - at)) for i in range(masses))
        return [self.position + by * share for share in shares]

    @check_of("masses", "pluck")
    def _is_plucked_at_a_mass(self, name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.pluck is not None and self.pluck.at >= self.masses:
            expected = f"{name} has {self.masses} masses; expected 0 to {self.masses - 1}"
            yield Issue(("pluck", "at"), f"found {self.pluck.at}, but {expected}")

    def elements(self) -> Elements:
        """Bending about a point is half the square of x- - 2 x + x+, times its stiffness: with the stretches a and b
        of the two links that is (2 a² + 2 b² - (a + b)²)/2, a sum of links.

        It acts about every mass with two neighbours, of which one may be what holds an end. At a free end it does not:
        nothing turns the end. At a clamped end it also acts about what holds it, with a further point that stands
        still beyond; at a fixed one it does not: the string turns there as on a hinge."""
        last = self.masses - 1
        held = [end for end, how in zip((0, last), self.ends, strict=True) if how != "free"]
        links = [(i, i + 1, self.stiffness, self.damping) for i in range(last)]
        links += [(end, -1, self.stiffness, self.damping) for end in held]
        if self.friction:
            links += [(i, -1, 0.0, self.friction) for i in range(self.masses)]
        return Elements([self.mass] * self.masses, links + (self._bending_links(held) if self.bending else []))

    def _bending_links(self, held: list[int]) -> list[tuple[int, int, float, float]]:
        last = self.masses - 1
        points = [-1] * (0 in held) + list(range(self.masses)) + [-1] * (last in held)
        links = []
        for left, middle, right in zip(points, points[1:], points[2:], strict=False):
            links += [(middle, left, 2.0 * self.bending, 0.0), (middle, right, 2.0 * self.bending, 0.0)]
            links.append((max(left, right), min(left, right), -self.bending, 0.0))  # what stays is the second
        clamped = [end for end, how in zip((0, last), self.ends, strict=True) if how == "clamped"]
        links += [(end, -1, self.bending, 0.0) for end in clamped]  # the point beyond the end stands still too
        return [link for link in links if link[0] != link[1]]
