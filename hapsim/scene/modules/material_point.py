"""What every material point is: a mass at a place of its own, which forces move."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar, NamedTuple

from ..quantity import Quantity
from .module import Module


class Held(NamedTuple):
    """A spring and a damper from a point to where it rests: N/m, N·s/m, m."""

    stiffness: float
    damping: float
    rest: float


class MaterialPoint(Module):
    """A point with a mass, which the scene moves."""

    #: It pulls itself by a force of its own that is more than `held_by` says, or another: it has a part of the program
    #: under every scheme, and the linear theory asks for a line of its own.
    pulls_itself: ClassVar[bool] = False
    initial: ClassVar[tuple[str, ...]] = ("position", "velocity")

    mass: Annotated[float, Quantity("Mass", "kg", above=0)]

    @abstractmethod
    def start(self) -> tuple[float, float]:
        """Position and velocity at the start, m and m/s."""

    def held_by(self) -> Held | None:
        """The spring and the damper of its own; None where it has none."""
        return None
