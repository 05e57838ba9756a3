"""The damper, CORDIS's FRO."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .link import Link


class Damper(Link):
    """A viscous damper between two points: it holds nothing where it is, and slows what moves."""

    live: ClassVar[tuple[str, ...]] = ("damping",)

    type: Literal["damper"] = Field(default="damper", description="A viscous damper")
    damping: Annotated[float, Quantity("Viscosity", "N·s/m", least=0)]
