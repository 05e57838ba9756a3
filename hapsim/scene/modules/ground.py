"""The ground: a point that no force moves."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .module import Module


class Ground(Module):
    """A fixed point."""

    can_move: ClassVar[bool] = False
    live: ClassVar[tuple[str, ...]] = ("position",)

    type: Literal["ground"] = Field(default="ground", description="A fixed point")
    position: Annotated[float, Quantity("Where it is", "m")] = 0.0
