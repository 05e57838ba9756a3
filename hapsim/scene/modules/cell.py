"""The cell: a mass that is held where it rests, CORDIS's CEL."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .material_point import Held, MaterialPoint


class Cell(MaterialPoint):
    """A material point on a spring and a damper of its own, which hold it to a fixed point."""

    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "rest")

    type: Literal["cell"] = Field(default="cell", description="A material point that is held where it rests")
    stiffness: Annotated[float, Quantity("Stiffness of the spring that holds it", "N/m", least=0)]
    damping: Annotated[float, Quantity("Viscosity of the damper that holds it", "N·s/m", least=0)] = 0.0
    rest: Annotated[float, Quantity("Where it rests", "m")] = 0.0
    position: Annotated[float | None, Quantity("Position at the start", "m", left_out="where it rests")] = None
    velocity: Annotated[float, Quantity("Velocity at the start", "m/s")] = 0.0

    def start(self) -> tuple[float, float]:
        return self.rest if self.position is None else self.position, self.velocity

    def held_by(self) -> Held:
        return Held(self.stiffness, self.damping, self.rest)
