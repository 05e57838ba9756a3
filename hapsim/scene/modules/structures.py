"""The structures: many masses and links under one name, known to the compiler as such. The string has equal masses in a
row, the membrane in rows and columns."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from ..issue import Issue
from ..quantity import count, quantity, words_of
from ..section import Module, ModuleContext, Section, check_of


class Elements(NamedTuple):
    """A structure taken apart into the modules that it stands for.

    Attributes:
        masses: kg, of its points, in their order.
        links: first point, second point (-1: what stays at the structure's position), N/m, N·s/m; the parts of a
            stiffness against bending may be negative.
    """

    masses: list[float]
    links: list[tuple[int, int, float, float]]


class Structure(Module):
    """Many masses under one name. A link holds one of them by the structure's name, a dot, and its place."""

    is_point: ClassVar[bool] = False
    can_move: ClassVar[bool] = False
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "friction")
    #: The fields that count its points: a place has a number for each, in this order.
    counts: ClassVar[tuple[str, ...]] = ()

    mass: Annotated[float, quantity("Mass of each", "kg", above=0)]
    stiffness: Annotated[float, quantity("Stiffness of each link", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of each link", "N·s/m", least=0)] = 0.0
    friction: Annotated[float, quantity("Viscous friction of each mass in what is around it", "N·s/m", least=0)] = 0.0
    position: Annotated[float, quantity("Position at rest and at the start", "m")] = 0.0

    @abstractmethod
    def point_names(self) -> list[str]:
        """Returns what each of its points is called after the dot, in their order."""

    @abstractmethod
    def place_words(self) -> str:
        """Returns which places there are, in words that follow 'expected'."""

    @abstractmethod
    def elements(self) -> Elements:
        """Returns the modules that it stands for."""

    def initial_positions(self) -> list[float]:
        """Returns where each of its points is when the run begins, at rest there, in m."""
        return [self.position] * len(self.point_names())

    def has_place(self, place: str) -> bool:
        """Returns whether one of its points is called so."""
        numbers, below = place.split("."), [getattr(self, field) for field in self.counts]
        if len(numbers) != len(below) or not all(len(one) <= 9 and one.isdecimal() for one in numbers):
            return False
        return all(str(int(one)) == one and int(one) < end for one, end in zip(numbers, below, strict=True))


MOST_MASSES = 100_000

#: fixed: a further link holds the end; clamped: it cannot turn there either, which only bending feels.
StringEnd = Literal["fixed", "clamped", "free"]

_ENDS = words_of("Support of each end", ("fixed", "clamped", "free"), 2)
_BENDING = quantity(
    "Stiffness against bending: each mass is pulled to the middle of its neighbours, and they the other way",
    "N/m",
    least=0,
)


class Pluck(Section):
    """A string that is pulled aside before the run begins, and released at rest. SI units."""

    at: Annotated[int, count("Number of the mass that is pulled aside", 0, MOST_MASSES - 1)]
    by: Annotated[float, quantity("Distance by which it is pulled aside", "m")]


class String(Structure):
    """Equal masses in a row, each linked to the next; at rest where all are at `position`."""

    counts: ClassVar[tuple[str, ...]] = ("masses",)
    initial: ClassVar[tuple[str, ...]] = ("pluck",)

    type: Literal["string"] = Field(default="string", description="Equal masses in a row, each linked to the next")
    masses: Annotated[int, count("Number of masses", 2, MOST_MASSES)]
    bending: Annotated[float, _BENDING] = 0.0
    ends: Annotated[tuple[StringEnd, StringEnd], _ENDS] = ("fixed", "fixed")
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
        """Returns the masses' initial positions in m: at rest, or on the triangle of the pluck."""
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


MOST_IN_A_ROW = 300

MembraneEdge = Literal["fixed", "free"]

_EDGES = words_of("Support of the top, bottom, left and right edge", ("fixed", "free"), 4)


class Membrane(Structure):
    """Equal masses in rows and columns, each linked to its neighbours; at rest where all are at `position`."""

    counts: ClassVar[tuple[str, ...]] = ("rows", "columns")

    type: Literal["membrane"] = Field(
        default="membrane", description="Equal masses in rows and columns, each linked to its neighbours"
    )
    rows: Annotated[int, count("Number of rows", 2, MOST_IN_A_ROW)]
    columns: Annotated[int, count("Number of columns: masses in each row", 2, MOST_IN_A_ROW)]
    edges: Annotated[tuple[MembraneEdge, ...], _EDGES] = ("fixed",) * 4

    def point_names(self) -> list[str]:
        return [f"{row}.{column}" for row in range(self.rows) for column in range(self.columns)]

    def place_words(self) -> str:
        return f"its row (0 to {self.rows - 1}), a dot and its column (0 to {self.columns - 1})"

    def elements(self) -> Elements:
        """Each mass on its neighbours and on what holds an edge, and its friction on what stays, row by row."""
        masses = [self.mass] * (self.rows * self.columns)
        links = [(*pair, self.stiffness, self.damping) for pair in self._neighbours()]
        if self.friction:
            links += [(i, -1, 0.0, self.friction) for i in range(len(masses))]
        return Elements(masses, links)

    def _neighbours(self) -> Iterator[tuple[int, int]]:
        """The ends of every link; -1 is what holds an edge."""
        points = range(self.rows * self.columns)
        last_row, right = points[-self.columns :], self.columns - 1
        for here in points:
            if here % self.columns != right:
                yield here, here + 1
            if here not in last_row:
                yield here, here + self.columns
        borders = (points[: self.columns], last_row, points[:: self.columns], points[right :: self.columns])
        for edge, border in zip(self.edges, borders, strict=True):
            if edge == "fixed":
                yield from ((here, -1) for here in border)
