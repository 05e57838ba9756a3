"""The membrane: equal masses in rows and columns, each linked to its neighbours."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Count, Quantity, Words
from .structure import Elements, Numbers, Structure

MOST_IN_A_ROW = 300

MembraneEdge = Literal["fixed", "free"]

EDGES = Words("How each edge is held, the top, the bottom, the left and the right one", ("fixed", "free"), 4)


class Membrane(Structure):
    """Equal masses in rows and columns, each linked to its neighbours; at rest where all are at `position`."""

    counts: ClassVar[tuple[str, ...]] = ("rows", "columns")
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "friction")

    type: Literal["membrane"] = Field(
        default="membrane", description="Equal masses in rows and columns, each linked to its neighbours"
    )
    rows: Annotated[int, Count("How many rows", 2, MOST_IN_A_ROW)]
    columns: Annotated[int, Count("How many columns: masses in each row", 2, MOST_IN_A_ROW)]
    mass: Annotated[float, Quantity("Mass of each", "kg", above=0)]
    stiffness: Annotated[float, Quantity("Stiffness of each link", "N/m", least=0)]
    damping: Annotated[float, Quantity("Viscosity of each link", "N·s/m", least=0)] = 0.0
    friction: Annotated[float, Quantity("Viscous friction of each mass in what is around it", "N·s/m", least=0)] = 0.0
    edges: Annotated[tuple[MembraneEdge, MembraneEdge, MembraneEdge, MembraneEdge], EDGES] = (
        "fixed",
        "fixed",
        "fixed",
        "fixed",
    )
    position: Annotated[float, Quantity("Where it is at rest, and begins", "m")] = 0.0

    def point_names(self) -> list[str]:
        return [f"{row}.{column}" for row in range(self.rows) for column in range(self.columns)]

    def place_words(self, numbers: Numbers) -> str:
        row, column = numbers.words()
        return f"its row ({row}), a dot and its column ({column})"

    def initial_positions(self) -> list[float]:
        return [self.position] * (self.rows * self.columns)

    def elements(self) -> Elements:
        """Each mass on its neighbours and on what holds an edge, and its friction on what stays, row by row."""
        count = self.rows * self.columns
        links = [(*pair, self.stiffness, self.damping) for pair in self._neighbours()]
        if self.friction:
            links += [(i, -1, 0.0, self.friction) for i in range(count)]
        return Elements([self.mass] * count, links)

    def _neighbours(self) -> Iterator[tuple[int, int]]:
        """The ends of every link; -1 is what holds an edge."""
        rows, columns = range(self.rows), range(self.columns)
        for row in rows:
            for column in columns:
                here = row * self.columns + column
                if column < columns[-1]:
                    yield here, here + 1
                if row < rows[-1]:
                    yield here, here + self.columns
        last, right = (self.rows - 1) * self.columns, self.columns - 1
        top, bottom, left, right_edge = (edge == "fixed" for edge in self.edges)
        for held, first in ((top, 0), (bottom, last)):
            yield from ((first + column, -1) for column in columns if held)
        for held, first in ((left, 0), (right_edge, right)):
            yield from ((first + row * self.columns, -1) for row in rows if held)
