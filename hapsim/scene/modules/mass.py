"""The mass: a simulated material point."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .module import Module


class Mass(Module):
    """A simulated material point."""

    initial: ClassVar[tuple[str, ...]] = ("position", "velocity")

    type: Literal["mass"] = Field(default="mass", description="A material point")
    mass: Annotated[float, Quantity("Mass", "kg", above=0)]
    position: Annotated[float, Quantity("Position at the start", "m")] = 0.0
    velocity: Annotated[float, Quantity("Velocity at the start", "m/s")] = 0.0
