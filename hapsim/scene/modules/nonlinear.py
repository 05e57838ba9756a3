"""The link with curves for a spring and a damper, CORDIS's LNL."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from ..curve import Curve, CurvePoints
from ..issue import Issue
from .link import Link
from .module import Check, ModuleContext

OVER_DISTANCE = CurvePoints(
    "Tension with which it pulls its ends together, over the first end minus the second", "m", "N", "none"
)
OVER_VELOCITY = CurvePoints(
    "Tension with which it pulls its ends together, over how fast the first end minus the second grows",
    "m/s",
    "N",
    "none",
)


class Nonlinear(Link):
    """A spring and a damper of any characteristic: curves, straight between their points and level beyond the ends."""

    type: Literal["nonlinear"] = Field(
        default="nonlinear", description="A spring and a damper of any characteristic, given as curves"
    )
    force_over_distance: Annotated[Curve | None, OVER_DISTANCE] = None
    force_over_velocity: Annotated[Curve | None, OVER_VELOCITY] = None

    def checks(self) -> list[Check]:
        curves = ("force_over_distance", "force_over_velocity")
        return [*super().checks(), Check(curves, self._has_a_curve)]

    def _has_a_curve(self, name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.force_over_distance is None and self.force_over_velocity is None:
            sentence = "found neither force_over_distance nor force_over_velocity, expected at least one of them"
            yield Issue(("modules", name), sentence, at_key=True)
