"""What every structure is: many masses and links under one name, known to the compiler as such."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, NamedTuple

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

    @abstractmethod
    def point_names(self) -> list[str]:
        """What each of its points is called after the dot, in their order."""

    @abstractmethod
    def place_words(self) -> str:
        """Which places there are, in words that follow 'expected'."""

    @abstractmethod
    def initial_positions(self) -> list[float]:
        """Where each of its points is when the run begins, at rest there, in m."""

    @abstractmethod
    def elements(self) -> Elements:
        """The modules that it stands for."""

    def has_place(self, place: str) -> bool:
        """Whether one of its points is called so."""
        return place in self.point_names()


def is_number(text: str, below: int) -> bool:
    """Whether this is how a whole number from 0 to one less than `below` is written."""
    return len(text) <= 9 and text.isdecimal() and str(int(text)) == text and int(text) < below
