"""The mass: a simulated material point."""

from typing import Annotated, Literal

from pydantic import Field

from ..quantity import Quantity
from .material_point import MaterialPoint


class Mass(MaterialPoint):
    """A simulated material point."""

    type: Literal["mass"] = Field(default="mass", description="A material point")
    position: Annotated[float, Quantity("Position at the start", "m")] = 0.0
    velocity: Annotated[float, Quantity("Velocity at the start", "m/s")] = 0.0

    def start(self) -> tuple[float, float]:
        return self.position, self.velocity
