"""The string: equal masses in a row, each linked to the next."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Count, Quantity, Words
from .structure import Elements, Structure

MOST_MASSES = 100_000

#: fixed: a further link holds the end; clamped: it cannot turn there either, which only bending feels.
StringEnd = Literal["fixed", "clamped", "free"]

BENDING = Quantity(
    "Stiffness against bending: each mass is pulled to the middle of its neighbours, and they the other way",
    "N/m",
    least=0,
)


class String(Structure):
    """Equal masses in a row, each linked to the next; at rest where all are at `position`."""

    shared: ClassVar[tuple[str, ...]] = ("masses",)
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "friction", "bending")

    type: Literal["string"] = Field(default="string", description="Equal masses in a row, each linked to the next")
    masses: Annotated[int, Count("How many masses", 2, MOST_MASSES)]
    mass: Annotated[float, Quantity("Mass of each", "kg", above=0)]
    stiffness: Annotated[float, Quantity("Stiffness of each link", "N/m", least=0)]
    damping: Annotated[float, Quantity("Viscosity of each link", "N·s/m", least=0)] = 0.0
    friction: Annotated[float, Quantity("Viscous friction of each mass in what is around it", "N·s/m", least=0)] = 0.0
    bending: Annotated[float, BENDING] = 0.0
    ends: Annotated[tuple[StringEnd, StringEnd], Words("How each end is held", ("fixed", "clamped", "free"), 2)] = (
        "fixed",
        "fixed",
    )
    position: Annotated[float, Quantity("Where it is at rest, and begins", "m")] = 0.0

    def places(self) -> list[str]:
        return [str(i) for i in range(self.masses)]

    def place_words(self) -> str:
        return f"0 to {self.masses - 1}"

    def has_place(self, place: str) -> bool:
        return place.isdecimal() and str(int(place)) == place and int(place) < self.masses

    def elements(self) -> Elements:
        """Bending about a point is half the square of x- - 2 x + x+, times its stiffness: with the stretches a and b
        of the two links that is (2 a² + 2 b² - (a + b)²)/2, a sum of links."""
        last = self.masses - 1
        links = [(i, i + 1, self.stiffness, self.damping) for i in range(last)]
        held = [end for end, how in zip((0, last), self.ends, strict=True) if how != "free"]
        links += [(end, -1, self.stiffness, self.damping) for end in held]
        if self.friction:
            links += [(i, -1, 0.0, self.friction) for i in range(self.masses)]
        if self.bending:
            links += self._bending_links()
        return Elements([self.mass] * self.masses, links)

    def _bending_links(self) -> list[tuple[int, int, float, float]]:
        held = [how != "free" for how in self.ends]
        points = [-1] * held[0] + list(range(self.masses)) + [-1] * held[1]
        links = []
        for left, middle, right in zip(points, points[1:], points[2:], strict=False):
            links += [(middle, left, 2.0 * self.bending, 0.0), (middle, right, 2.0 * self.bending, 0.0)]
            links.append((left, right, -self.bending, 0.0))
        for end, how in zip((0, self.masses - 1), self.ends, strict=True):
            if how == "clamped":  # the point beyond the end stands still too: the bending at the end itself
                links.append((end, -1, self.bending, 0.0))
        return [link for link in links if link[0] != link[1]]
