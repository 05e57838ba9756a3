"""The links of the plane: a shape, which keeps a point out or in, and a guide, which leads it along a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from hapsim.laws import Law, Potential
from hapsim.number_format import rounded_down

from ..chain import Chain, TooRoundError, capsule, crossing, disc, half_plane, polygon, smooth_path, straight_path
from ..issue import Issue
from ..quantity import place, places, quantity
from ..schemas import LEAST
from ..section import ModuleContext, Section, check_of
from .links import Link

if TYPE_CHECKING:
    from ..union import Outline

_CUSP = 0.1
"""Cosine of half the turn of a hollow corner that is a cusp: there a way out has no useful part along each normal."""

_RADIUS = quantity("Radius of a capsule: half its thickness", "m", above=0, left_out="it is no capsule")


class Form(Section):
    """A form, by one of its keys; a capsule has a radius too. SI units."""

    disc: Annotated[float | None, quantity("Radius of a disc", "m", above=0, left_out="none")] = None
    half_plane: Annotated[tuple[float, float] | None, place("Where a half plane is free", "m", "none")] = None
    capsule: Annotated[tuple[tuple[float, float], ...] | None, places("Ends of a capsule", "m", 2, "none")] = None
    radius: Annotated[float | None, _RADIUS] = None
    box: Annotated[tuple[float, float] | None, place("Width and height of a box", "m", "none")] = None
    polygon: Annotated[tuple[tuple[float, float], ...] | None, places("Corners of a polygon", "m", 3, "none")] = None

    def boundary(self, rounding: float) -> Chain:
        """Returns its boundary, free outside. Raises TooRoundError."""
        if self.disc is not None:
            return disc(self.disc)
        if self.half_plane is not None:
            return half_plane(self.half_plane)
        if self.capsule is not None:
            return capsule(self.capsule[0], self.capsule[1], self.radius or 0.0)
        if self.box is not None:
            x, y = 0.5 * self.box[0], 0.5 * self.box[1]
            return polygon([(-x, -y), (x, -y), (x, y), (-x, y)], rounding)
        return polygon(self.polygon or (), rounding)

    def fault(self) -> tuple[str, str] | None:
        """Returns the key at fault and a sentence; None if the form can be built."""
        named = [name for name in type(self).model_fields if name != "radius" and getattr(self, name) is not None]
        if len(named) != 1:
            return "", f"found {' and '.join(named) or 'none'}, expected one of disc, half_plane, capsule, box, polygon"
        if (self.capsule is None) != (self.radius is None):
            what = "a capsule without a radius" if self.radius is None else "a radius without a capsule"
            return named[0] if self.radius is None else "radius", f"found {what}; expected both or neither"
        if self.capsule is not None and len(self.capsule) > 2:
            return "capsule", f"found {len(self.capsule)} places, expected two: its ends"
        if self.half_plane == (0.0, 0.0):
            return "half_plane", "found [0, 0], which points nowhere; expected the direction in which it is free"
        if self.box is not None and min(self.box) < LEAST:
            return "box", f"found a side below {LEAST:g}; expected [width, height]"
        return (
            None if self.polygon is None else ("polygon", why) if (why := crossed(self.polygon, closed=True)) else None
        )


def crossed(points: tuple[tuple[float, float], ...], *, closed: bool) -> str:
    """Returns a sentence on points that are alike or on sides that cross; "" if there are none."""
    if closed and math.dist(points[0], points[-1]) < LEAST:
        return "found the first place again at the end; it closes by itself"
    if (both := crossing(points, closed=closed)) is not None:
        first, second = (number + 1 for number in both)
        return f"found side {first} crossing side {second}; expected sides that do not meet"
    turned = [*pairwise([*points, points[0]] if closed else points)]
    for i, ((a, b), (_, c)) in enumerate(zip(turned, turned[1:] + turned[:closed], strict=False)):
        ahead = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1])
        aside = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        if ahead < 0.0 and abs(aside) <= 1e-9 * abs(ahead):
            return f"found a turn straight back at place {i + 2}; expected sides that do not meet"
    return ""


_ROUND = quantity("Radius of its corners", "m", least=0)
_BRISTLE = quantity("Stiffness along the surface while friction sticks", "N/m", above=0, left_out="half of `stiffness`")
_BRISTLE_DAMPING = quantity(
    "Viscosity along the surface while it sticks", "N·s/m", least=0, left_out="that of `damping`"
)


class Shape(Link):
    """A surface about its second end, which its first end touches and cannot enter, with dry friction along it."""

    remembers_touch: ClassVar[tuple[str, bool] | None] = ("touches", True)
    spaces: ClassVar[tuple[int, ...]] = (2,)
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "friction_coefficient", "static_coefficient")
    with_default: ClassVar[Mapping[str, str]] = {"static_coefficient": "break_away"}
    damps_along = "corners"
    potential = (
        Potential(stretch="level", pushes=True),
        Potential(
            (("bristle_stiffness", 1.0), ("stiffness", 0.5)), stretch="bristle", side="sliding",
            slides_at="friction_coefficient", press="press",
        ),
    )  # fmt: skip

    type: Literal["shape"] = Field(
        default="shape", description="A surface about its second end, in the plane: keeps its first end out, or in"
    )
    form: Form = Field(description="Form of the surface: disc, half_plane, capsule, box or polygon")
    side: Literal["outside", "inside"] = Field(default="outside", description="Side on which the first end is free")
    round: Annotated[float, _ROUND] = 0.0
    stiffness: Annotated[float, quantity("Stiffness of the surface", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of the surface", "N·s/m", least=0)] = 0.0
    friction_coefficient: Annotated[float, quantity("Friction over pressure while it slides", "1", least=0)] = 0.0
    static_coefficient: Annotated[
        float | None,
        quantity("Friction over pressure at which it breaks away", "1", least=0, left_out="that of sliding"),
    ] = None
    bristle_stiffness: Annotated[float | None, _BRISTLE] = None
    bristle_damping: Annotated[float | None, _BRISTLE_DAMPING] = None

    @property
    def break_away(self) -> float:
        """Friction over pressure at which it breaks away."""
        return self.friction_coefficient if self.static_coefficient is None else self.static_coefficient

    @property
    def bristle(self) -> tuple[float, float]:
        stiffness, damping = self.bristle_stiffness, self.bristle_damping
        return 0.5 * self.stiffness if stiffness is None else stiffness, self.damping if damping is None else damping

    def chain(self) -> Chain:
        """Returns the surface, by the first end minus the second; the first is free on its right."""
        boundary = self.form.boundary(self.round)
        return boundary if self.side == "outside" else boundary.reversed()

    def law(self) -> Law:
        """Returns its force over the distance from the surface."""
        taken = "touches all the time; away from the surface, the hand does not feel it"
        return Law(
            ((0.0, 0.0),), (self.damping, 0.0), ("touched", "apart"), self.stiffness,
            pushes=True, taken_at=-math.inf, assumption=taken, memoryless=not self.friction_coefficient,
        )  # fmt: skip

    @check_of("form", "round")
    def _has_a_form(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if (fault := self.form.fault()) is not None:
            yield Issue(("form", *filter(None, fault[:1])), fault[1])
        else:
            yield from _too_round(lambda: self.form.boundary(self.round), self.round)

    @check_of("friction_coefficient", "static_coefficient")
    def _breaks_away_above(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.break_away < self.friction_coefficient:
            expected = f"expected a number >= {self.friction_coefficient:g}"
            yield Issue(
                ("static_coefficient",), f"found {self.static_coefficient:g}, less than while it slides; {expected}"
            )


@dataclass(frozen=True)
class Surface:
    """The surface of all shapes with the same two ends, `between`. `shapes`: by name, in the order of the file."""

    between: tuple[str, str]
    shapes: Mapping[str, Shape]

    @cached_property
    def outline(self) -> Outline:
        """Outline of their union, by the first end minus the second; the first is free on its right. Raises
        TooRoundError, and ValueError where there is none."""
        return _union_of(tuple(one.chain() for one in self.shapes.values()))

    @cached_property
    def sharers(self) -> tuple[int, ...]:
        """Number of the other shape that holds each piece of the outline: in a sharp hollow corner of two shapes that
        of the piece behind it; elsewhere its owner."""
        (pieces,), owners = self.outline
        return tuple(
            owners[one.after] if one.bend < 0 and not one.radius and math.cos(0.5 * one.extent) > _CUSP else owner
            for one, owner in zip(pieces, owners, strict=True)
        )


def surfaces_of(links: Mapping[str, Any]) -> list[Surface]:
    """Returns the surfaces of the shapes among these links, in the order of their first shapes."""
    together: dict[tuple[str, str], dict[str, Shape]] = {}
    for name, link in links.items():
        if isinstance(link, Shape):
            together.setdefault(link.between, {})[name] = link
    return [Surface(*one) for one in together.items()]


@lru_cache(maxsize=64)
def _union_of(chains: tuple[Chain, ...]) -> Outline:
    from ..union import union  # with numpy, which a scene without shapes does not need

    return union(chains)


def _too_round(build: Callable[[], Chain], radius: float) -> Iterator[Issue]:
    try:
        build()
    except TooRoundError as error:
        expected = f"expected at most ‹{rounded_down(error.most)} m›"
        yield Issue(("round",), f"found ‹{radius!r} m›, which does not fit between corners; {expected}")


class Guide(Link):
    """A path through places about its second end, along which it leads its first end."""

    spaces: ClassVar[tuple[int, ...]] = (2,)
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping")
    damps_along = "always"  # outside a bend and beyond an end
    potential = (Potential(stretch="level", width="width", reach="reach"),)

    type: Literal["guide"] = Field(default="guide", description="A path in the plane that holds its first end")
    through: Annotated[tuple[tuple[float, float], ...], places("Places that the path leads through", "m", 2)]
    path: Literal["smooth", "straight"] = Field(
        default="smooth", description="From place to place without a corner (smooth), or in straight lines (straight)"
    )
    closed: bool = Field(default=False, description="Whether the path returns to its first place")
    round: Annotated[float, _ROUND] = 0.0
    width: Annotated[float, quantity("Width within which it does not pull", "m", least=0)] = 0.0
    reach: Annotated[float | None, quantity("Distance beyond which it lets go", "m", above=0, left_out="never")] = None
    stiffness: Annotated[float, quantity("Stiffness across the path", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity across the path", "N·s/m", least=0)] = 0.0

    def chain(self) -> Chain:
        """Returns the middle of the path, by the first end minus the second."""
        if self.path == "smooth":
            return smooth_path(self.through, closed=self.closed)
        return straight_path(self.through, self.round, closed=self.closed)

    def law(self) -> Law:
        """Returns its force over the distance from the path, positive on the right."""
        half, K, B = 0.5 * self.width, self.stiffness, self.damping
        knots: tuple[tuple[float, float], ...] = ((-half, 0.0), (half, 0.0))
        dampings: tuple[float, ...] = (B, 0.0, B)
        states: tuple[str, ...] = ("on the left", "free", "on the right")
        if self.reach is None:
            return Law(knots, dampings, states, K, K, assumption="is taken at its edge", taken_at=half)
        far, most = self.reach, K * (self.reach - half)
        knots = ((-far, 0.0), (-far, -most), *knots, (far, most), (far, 0.0))
        dampings, states = (0.0, 0.0, *dampings, 0.0, 0.0), ("released", "", *states, "", "released")
        return Law(knots, dampings, states, assumption="is taken within its reach", taken_at=half)

    @property
    def is_contact(self) -> bool:
        """True if it has no force within its width, or beyond its reach."""
        return bool(self.law().without_force)

    @check_of("through", "path", "closed", "round", "width", "reach")
    def _is_a_path(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.closed and len(self.through) < 3:
            yield Issue(("closed",), "found a closed path through two places; expected three or more")
        elif self.path == "smooth" and self.round:
            yield Issue(("round",), "found a radius for a smooth path, which has no corners; expected path: straight")
        elif why := crossed(self.through, closed=self.closed):
            yield Issue(("through",), why)
        elif self.reach is not None and self.reach <= 0.5 * self.width:
            expected = f"expected more than ‹{0.5 * self.width!r} m›"
            yield Issue(("reach",), f"found ‹{self.reach!r} m›, within half of its width; {expected}")
        else:
            yield from _too_round(self.chain, self.round)
