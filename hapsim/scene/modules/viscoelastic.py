"""The visco-elastic link: a spring and a damper in parallel."""

from typing import Annotated, Literal

from pydantic import Field

from ..quantity import Quantity
from .link import Link


class ViscoElastic(Link):
    """A spring and a damper in parallel between two points, at rest where the two coincide."""

    type: Literal["viscoelastic"] = Field(default="viscoelastic", description="A spring and a damper in parallel")
    stiffness: Annotated[float, Quantity("Stiffness of the spring", "N/m", least=0)]
    damping: Annotated[float, Quantity("Viscosity of the damper", "N·s/m", least=0)] = 0.0
