"""The spring, CORDIS's RES."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .link import Link


class Spring(Link):
    """A spring between two points, at rest where the two coincide."""

    live: ClassVar[tuple[str, ...]] = ("stiffness",)

    type: Literal["spring"] = Field(default="spring", description="A spring")
    stiffness: Annotated[float, Quantity("Stiffness", "N/m", least=0)]
