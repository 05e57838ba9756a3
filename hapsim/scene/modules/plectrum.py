"""The plectrum: what plucks."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..quantity import Quantity
from .link import Link


class Plectrum(Link):
    """A visco-elastic link that releases where its ends are too far apart, and grips again where they meet."""

    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "release")

    type: Literal["plectrum"] = Field(
        default="plectrum", description="Plucks: grips, releases beyond a distance, and grips again where its ends meet"
    )
    stiffness: Annotated[float, Quantity("Stiffness while it grips", "N/m", least=0)]
    damping: Annotated[float, Quantity("Viscosity while it grips", "N·s/m", least=0)] = 0.0
    release: Annotated[float, Quantity("Distance of its ends beyond which it releases", "m", above=0)]
