"""The linear links: CORDIS's RES (spring), FRO (damper) and both in parallel."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from hapsim.laws import Law, line

from ..choices import DAMPER, WITH_CUTOFF, WITH_SENSOR, DamperScheme
from ..issue import Issue, one_of, quote
from ..quantity import quantity
from .link import Link
from .module import ModuleContext, check_of
from .points import DevicePoint

CUTOFF = quantity(f"Cutoff of the {one_of(WITH_CUTOFF)} damper", "Hz", above=0)


class Spring(Link):
    """A spring between two points, at rest where the two coincide."""

    live: ClassVar[tuple[str, ...]] = ("stiffness",)

    type: Literal["spring"] = Field(default="spring", description="A spring")
    stiffness: Annotated[float, quantity("Stiffness", "N/m", least=0)]

    def law(self) -> Law:
        return line(self.stiffness, 0.0, in_a_matrix=True)


class Damper(Link):
    """A viscous damper between two points: it holds nothing where it is, and slows what moves."""

    live: ClassVar[tuple[str, ...]] = ("damping",)

    type: Literal["damper"] = Field(default="damper", description="A viscous damper")
    damping: Annotated[float, quantity("Viscosity", "N·s/m", least=0)]

    def law(self) -> Law:
        return line(0.0, self.damping, in_a_matrix=True)


class ViscoElastic(Link):
    """A spring and a damper in parallel between two points, at rest where the two coincide."""

    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping")

    type: Literal["viscoelastic"] = Field(default="viscoelastic", description="A spring and a damper in parallel")
    stiffness: Annotated[float, quantity("Stiffness of the spring", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of the damper", "N·s/m", least=0)] = 0.0
    damper: DamperScheme = Field(default="backward", description=DAMPER)
    cutoff: Annotated[float | None, replace(CUTOFF, left_out="no filter")] = None

    def law(self) -> Law:
        return line(self.stiffness, self.damping, in_a_matrix=self.damper == "backward")

    @check_of("damper", "cutoff")
    def _cutoff_fits(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.damper in WITH_CUTOFF and self.cutoff is None:
            sentence = f"found {self.damper} without a cutoff, expected cutoff: a number > 0 (Hz) too"
            yield Issue(("damper",), sentence)
        elif self.damper not in WITH_CUTOFF and self.cutoff is not None:
            having = one_of(WITH_CUTOFF)
            sentence = f"found a cutoff, which the {self.damper} damper does not have; expected damper: {having}"
            yield Issue(("cutoff",), sentence)

    @check_of("between", "damper")
    def _is_sensed(self, _name: str, around: ModuleContext) -> Iterator[Issue]:
        ends = [around.kinds.get(end) for end in self.between]
        if self.damper in WITH_SENSOR and None not in ends and DevicePoint not in ends:
            names = " and ".join(map(quote, self.between))
            expected = "expected a point of type device at one end"
            yield Issue(("damper",), f"found {self.damper} between {names}, which no device senses; {expected}")
