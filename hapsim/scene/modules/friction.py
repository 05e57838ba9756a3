"""Dry friction."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..issue import Issue
from ..quantity import Quantity
from .link import Link
from .module import Check, ModuleContext


class Friction(Link):
    """Dry friction between two points: a bristle that holds like a spring, and slides where it is pulled too hard."""

    live: ClassVar[tuple[str, ...]] = ("force", "static", "stiffness", "damping")

    type: Literal["friction"] = Field(default="friction", description="Dry friction: sticks, and slides")
    force: Annotated[float, Quantity("Friction while it slides", "N", least=0)]
    static: Annotated[
        float | None, Quantity("Force at which it breaks away", "N", least=0, left_out="that of sliding")
    ] = None
    stiffness: Annotated[float, Quantity("Stiffness of the bristle that sticks", "N/m", above=0)]
    damping: Annotated[float, Quantity("Viscosity of the bristle while it sticks", "N·s/m", least=0)] = 0.0

    @property
    def break_away(self) -> float:
        """Force at which it breaks away, N."""
        return self.force if self.static is None else self.static

    def checks(self) -> list[Check]:
        return [*super().checks(), Check(("force", "static"), self._breaks_away_above)]

    def _breaks_away_above(self, name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.break_away < self.force:
            yield Issue(
                ("modules", name, "static"),
                f"found {self.static:g}, less than the force while it slides; expected a number >= {self.force:g} (N)",
            )
