"""What every structure is: many masses and links under one name, known to the compiler as such."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection
from typing import ClassVar, NamedTuple

from ..quantity import Count
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


class Numbers(NamedTuple):
    """The whole numbers, with a dot between them, that name a point of a structure.

    Attributes:
        below: each is less than this.
        known: whether that many there are; else as many as a structure can have, because its own is faulty.
    """

    below: tuple[int, ...]
    known: tuple[bool, ...]

    def are(self, place: str) -> bool:
        """Whether a point is called so, or may be where a count is not known."""
        numbers = place.split(".")
        return len(numbers) == len(self.below) and all(map(is_number, numbers, self.below))

    def words(self) -> list[str]:
        """Which each may be."""
        return [
            f"0 to {below - 1}" + ("" if known else " at the most")
            for below, known in zip(self.below, self.known, strict=True)
        ]

    @property
    def first(self) -> str:
        """What the first point is called."""
        return ".".join("0" for _ in self.below)


class Structure(Module):
    """Many masses under one name. A link holds one of them by the structure's name, a dot, and its place."""

    is_point: ClassVar[bool] = False
    can_move: ClassVar[bool] = False
    #: The fields that count its points: a place has a number for each, in this order.
    counts: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def point_names(self) -> list[str]:
        """What each of its points is called after the dot, in their order."""

    @abstractmethod
    def place_words(self, numbers: Numbers) -> str:
        """Which places there are, in words that follow 'expected'."""

    @abstractmethod
    def initial_positions(self) -> list[float]:
        """Where each of its points is when the run begins, at rest there, in m."""

    @abstractmethod
    def elements(self) -> Elements:
        """The modules that it stands for."""

    def numbers(self, known: Collection[str]) -> Numbers:
        """What names its points; `known`: which of the counts are sound."""
        below = [getattr(self, field) if field in known else _most(type(self), field) for field in self.counts]
        return Numbers(tuple(below), tuple(field in known for field in self.counts))


def _most(kind: type[Structure], field: str) -> int:
    """How many a structure of this kind can have."""
    (count,) = (expected for expected in kind.model_fields[field].metadata if isinstance(expected, Count))
    return count.most


def is_number(text: str, below: int) -> bool:
    """Whether this is how a whole number from 0 to one less than `below` is written."""
    return len(text) <= 9 and text.isdecimal() and str(int(text)) == text and int(text) < below
