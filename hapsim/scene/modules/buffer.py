"""The buffer: a contact from one side, CORDIS's BUT."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .link import Link


class Buffer(Link):
    """Keeps its first end above its second: a visco-elastic contact that pushes them apart, and never pulls."""

    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "distance")

    type: Literal["buffer"] = Field(
        default="buffer", description="A contact from one side: keeps its first end above its second, and never pulls"
    )
    stiffness: Annotated[float, Quantity("Stiffness of the contact", "N/m", least=0)]
    damping: Annotated[float, Quantity("Viscosity of the contact", "N·s/m", least=0)] = 0.0
    distance: Annotated[float, Quantity("First end minus second, below which they touch", "m")] = 0.0
