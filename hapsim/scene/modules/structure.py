"""What every structure is: many masses and links under one name, known to the compiler as such."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar, NamedTuple

from ..quantity import quantity
from .module import Module


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
    position: Annotated[float, quantity("Where it is at rest, and begins", "m")] = 0.0

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
        return len(numbers) == len(below) and all(map(_is_number, numbers, below))


def _is_number(text: str, below: int) -> bool:
    """Whether this is how a whole number from 0 to one less than `below` is written."""
    return len(text) <= 9 and text.isdecimal() and str(int(text)) == text and int(text) < below
