"""The membrane: equal masses in rows and columns, each linked to its neighbours."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import count, words_of
from .structure import Elements, Structure

MOST_IN_A_ROW = 300

MembraneEdge = Literal["fixed", "free"]

EDGES = words_of("How each edge is held, the top, the bottom, the left and the right one", ("fixed", "free"), 4)


class Membrane(Structure):
    """Equal masses in rows and columns, each linked to its neighbours; at rest where all are at `position`."""

    counts: ClassVar[tuple[str, ...]] = ("rows", "columns")

    type: Literal["membrane"] = Field(
        default="membrane", description="Equal masses in rows and columns, each linked to its neighbours"
    )
    rows: Annotated[int, count("How many rows", 2, MOST_IN_A_ROW)]
    columns: Annotated[int, count("How many columns: masses in each row", 2, MOST_IN_A_ROW)]
    edges: Annotated[tuple[MembraneEdge, ...], EDGES] = ("fixed",) * 4

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
