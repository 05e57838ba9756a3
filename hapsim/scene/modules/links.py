"""The links, elements between two points: CORDIS's REF (visco-elastic link), RES (spring), FRO (damper), BUT (buffer)
and LNL (nonlinear), dry friction, plectrum and click."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hapsim.branch_law import branch_law
from hapsim.laws import GrippingLaw, Law, Potential, curve_law, line

from ..chain import Chain
from ..choices import DAMPER, WITH_CUTOFF, WITH_SENSOR, DamperScheme
from ..issue import Issue, did_you_mean, one_of, quote
from ..quantity import NAME_PATTERN, curve, names, quantity, text
from ..section import Module, ModuleContext, Section, check_of
from ..values import Branches, Curve
from .point_modules import DevicePoint
from .structures import Structure

ENDS = names(
    "The two modules that it joins, by name",
    "the names of two modules, such as [hand, wall]",
    entry="the name of a module",
    count=2,
)


INPUT = text("Input while which is on it acts", "the name of an input", NAME_PATTERN, "always")


class Link(Module):
    """An element between two points, which are named and may stand anywhere in the file."""

    is_point: ClassVar[bool] = False
    can_move: ClassVar[bool] = False
    #: Its law, whatever its values are, is its `table`.
    has_table: ClassVar[bool] = False
    #: The number by which it remembers whether it touches, and whether that is 0 while it does not.
    remembers_touch: ClassVar[tuple[str, bool] | None] = None
    #: Whether in the plane it holds across the direction of its ends as along it: near where they meet, or everywhere.
    holds_across: ClassVar[Literal["never", "near", "always"]] = "never"
    #: Where along its `chain` it damps by the same share as it is stiff there: in hollow corners, or everywhere.
    damps_along: ClassVar[Literal["never", "corners", "always"]] = "never"
    #: Where it stores energy if it has no table.
    potential: ClassVar[tuple[Potential, ...]]
    #: Live values that a gate leaves alone, though they are forces.
    ungated: ClassVar[tuple[str, ...]] = ()
    between: Annotated[tuple[str, str], ENDS]
    when: Annotated[str | None, INPUT] = None

    def law(self) -> Law:
        """Returns what it does over the distance of its ends, as the theory takes it."""
        raise NotImplementedError

    def table(self) -> Law | None:
        """Returns the law by whose knots the kernel works out its force; None where it has a recurrence of its own."""
        return self.law() if self.has_table else None

    @property
    def is_contact(self) -> bool:
        """True if it closes and opens: at some distances of its ends it has a force, and at others none."""
        law = self.table()
        return self.remembers_touch is not None or bool(law and law.without_force)

    def slider(self) -> Law | None:
        """Returns the force, N, over the distance of its ends, of what slides along its table; None: nothing does."""
        return None

    @property
    def second_scale(self) -> tuple[float, float]:
        """Weights of its second end in its stretch, and in its pull on it."""
        return 1.0, 1.0

    @property
    def share(self) -> float:
        """Share of its force that its second end feels."""
        return self.second_scale[1] / self.second_scale[0]

    @property
    def potentials(self) -> tuple[Potential, ...]:
        """Potentials in which it stores energy, as its values are."""
        return self.potential

    @property
    def bristle(self) -> tuple[float, float] | None:
        """Stiffness, N/m, and viscosity, N·s/m, along a surface while dry friction sticks; None: it has no surface."""
        return None

    def chain(self) -> Chain | None:
        """Returns the line in the plane from which its distance counts; None: the other end."""
        return None

    @check_of("between")
    def _ends_fit(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        wrong_ends = {index: wrong_end(name, end, around) for index, end in enumerate(self.between)}
        yield from (Issue(("between", index), sentence) for index, sentence in wrong_ends.items() if sentence)
        if any(wrong_ends.values()):
            return
        first, second = self.between
        kinds = [around.kinds.get(end) for end in self.between]
        if first == second:
            yield Issue(("between",), f"found {quote(first)} at both ends, expected two different points")
        elif all(kind is not None and not kind.can_move for kind in kinds):
            ends = f"{quote(first)} and {quote(second)}"
            yield Issue(("between",), f"found {ends}, which cannot move; expected at least one end that can")


def wrong_end(name: str, end: str, around: ModuleContext) -> str | None:
    """Returns the error of this end of `name`, a link or a pick-up; None if it is right."""
    if end == name:
        return f"found {quote(end)}, the link itself; expected a point to hold"
    holder = around.holder(end)
    if holder not in around.kinds:
        points = [other for other, kind in around.kinds.items() if kind is None or kind.is_point]
        hint = did_you_mean(end, points)
        return f"found {quote(end)}, expected the name of a module of this scene{hint}"
    kind = around.kinds[holder]
    if kind is None:
        return None
    if issubclass(kind, Structure):
        return _wrong_place(end, holder, around) if around.knows(holder, *kind.counts) else None
    if holder != end:
        what = kind.model_fields["type"].default
        return f"found {quote(end)}, but {quote(holder)} is a single {what}; remove the dot and the rest"
    if not kind.is_point:
        return f"found {quote(end)}, which is a link; expected a point"
    return None


def _wrong_place(end: str, holder: str, around: ModuleContext) -> str | None:
    structure = around.modules[holder]
    assert isinstance(structure, Structure)
    if holder != end and structure.has_place(end[len(holder) + 1 :]):
        return None
    expected = f"expected one of its masses, {structure.place_words()}, such as {holder}{'.0' * len(structure.counts)}"
    return f"found {quote(end)}, but {quote(holder)} is a {structure.type}; {expected}"


CUTOFF = quantity(f"Cutoff of the {one_of(WITH_CUTOFF)} damper", "Hz", above=0, left_out="no filter")


LENGTH = quantity("Distance of its ends at rest, in a scene with space: 2", "m", least=0, left_out="0: they coincide")


class Gain(Section):
    """Scale of a link's force between two hands."""

    force: Annotated[float, quantity("Share of the force that the second end feels", "1", above=0)]


RATIO = quantity(
    "First end's way for one of the second, between a linear and a rotary hand; it keeps the power",
    "m/rad",
    above=0,
    left_out="1",
)


class ViscoElastic(Link):
    """A spring and a damper in parallel between two points, at rest where the two coincide or are `length` apart."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    holds_across = "near"
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping")
    potential = (Potential(),)

    type: Literal["viscoelastic"] = Field(default="viscoelastic", description="A spring and a damper in parallel")
    stiffness: Annotated[float, quantity("Stiffness of the spring", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of the damper", "N·s/m", least=0)] = 0.0
    damper: DamperScheme = Field(default="backward", description=DAMPER)
    cutoff: Annotated[float | None, CUTOFF] = None
    length: Annotated[float | None, LENGTH] = None
    gain: Gain | None = Field(default=None, description="Scale of its force at its second end; it gives or takes power")
    ratio: Annotated[float | None, RATIO] = None

    @property
    def second_scale(self) -> tuple[float, float]:
        ratio = self.ratio or 1.0
        return ratio, ratio if self.gain is None else ratio * self.gain.force

    def lever(self, end: str) -> float:
        """Returns the factor between its stiffness and that which this end feels."""
        way, pull = self.second_scale
        return 1.0 if end == self.between[0] else way * pull

    def at_end(self, end: str) -> "ViscoElastic":
        """Returns the link without a scale that this end feels while the other stands still at 0."""
        lever = self.lever(end)
        own = {"stiffness": lever * self.stiffness, "damping": lever * self.damping}
        return self.model_copy(update=own | {"gain": None, "ratio": None})

    @property
    def scale(self) -> str:
        """The key of its first scale; "" if it has none."""
        return "gain" if self.gain is not None else "ratio" if self.ratio is not None else ""

    def law(self) -> Law:
        kind = {"damper": self.damper, "cutoff": self.cutoff, "in_a_matrix": self.damper == "backward"}
        return line(self.stiffness, self.damping, self.length or 0.0, **kind)

    @check_of("damper", "cutoff")
    def _cutoff_fits(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.damper in WITH_CUTOFF and self.cutoff is None:
            sentence = f"found {self.damper} without a cutoff, expected cutoff: a number > 0 (Hz) too"
            yield Issue(("damper",), sentence)
        elif self.damper not in WITH_CUTOFF and self.cutoff is not None:
            having = one_of(WITH_CUTOFF)
            sentence = f"found a cutoff, which the {self.damper} damper does not have; expected damper: {having}"
            yield Issue(("cutoff",), sentence)

    @check_of("between", "damper", "gain", "ratio")
    def _scale_fits(self, _name: str, around: ModuleContext) -> Iterator[Issue]:
        if not self.scale:
            return
        others = [end for end in self.between if around.kinds.get(end) not in (None, DevicePoint)]
        if others:
            found = f"found a {self.scale} at {' and '.join(map(quote, others))}"
            yield Issue((self.scale,), f"{found}, expected a point of type device at both ends", at_key=True)
        if self.damper != "backward":
            yield Issue(("damper",), f"found {self.damper} with a {self.scale}, expected damper: backward")

    @check_of("between", "damper")
    def _is_sensed(self, _name: str, around: ModuleContext) -> Iterator[Issue]:
        ends = [around.kinds.get(end) for end in self.between]
        if self.damper in WITH_SENSOR and None not in ends and DevicePoint not in ends:
            names = " and ".join(map(quote, self.between))
            expected = "expected a point of type device at one end"
            yield Issue(("damper",), f"found {self.damper} between {names}, which no device senses; {expected}")


class Spring(Link):
    """A spring between two points, at rest where the two coincide or are `length` apart."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    holds_across = "near"
    live: ClassVar[tuple[str, ...]] = ("stiffness",)
    potential = (Potential(),)

    type: Literal["spring"] = Field(default="spring", description="A spring")
    stiffness: Annotated[float, quantity("Stiffness", "N/m", least=0)]
    length: Annotated[float | None, LENGTH] = None

    def law(self) -> Law:
        return line(self.stiffness, 0.0, self.length or 0.0, in_a_matrix=True)


class Damper(Link):
    """A viscous damper between two points: it holds nothing where it is, and slows what moves."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    live: ClassVar[tuple[str, ...]] = ("damping",)
    potential = ()

    type: Literal["damper"] = Field(default="damper", description="A viscous damper")
    damping: Annotated[float, quantity("Viscosity", "N·s/m", least=0)]

    def law(self) -> Law:
        return line(0.0, self.damping, in_a_matrix=True)


OVER_DISTANCE = curve(
    "Tension with which it pulls its ends together, over the first end minus the second; with two branches it is that "
    "of `press` while the distance grows, that of `release` while it shrinks, and crosses over `turn`",
    "m",
    "N",
    "none",
    branches=True,
)
OVER_VELOCITY = curve(
    "Tension with which it pulls its ends together, over how fast the first end minus the second grows",
    "m/s",
    "N",
    "none",
)


class Buffer(Link):
    """Keeps its first end above its second: a visco-elastic contact that pushes them apart, and never pulls."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    has_table: ClassVar[bool] = True
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "distance")

    type: Literal["buffer"] = Field(
        default="buffer", description="A contact from one side: keeps its first end above its second, and never pulls"
    )
    stiffness: Annotated[float, quantity("Stiffness of the contact", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of the contact", "N·s/m", least=0)] = 0.0
    distance: Annotated[float, quantity("First end minus second, below which they touch", "m")] = 0.0

    def law(self) -> Law:
        taken = "touches all the time; while its ends are apart, the hand does not feel it"
        knots, dampings, states = ((self.distance, 0.0),), (self.damping, 0.0), ("touched", "apart")
        return Law(knots, dampings, states, self.stiffness, pushes=True, taken_at=-math.inf, assumption=taken)


class Nonlinear(Link):
    """A spring and a damper of any characteristic: curves, straight between their points and level beyond the ends."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    crossfaded: ClassVar[tuple[str, ...]] = ("force_over_distance", "force_over_velocity")
    potential = ()

    type: Literal["nonlinear"] = Field(
        default="nonlinear", description="A spring and a damper of any characteristic, given as curves"
    )
    force_over_distance: Annotated[Curve | Branches | None, OVER_DISTANCE] = None
    force_over_velocity: Annotated[Curve | None, OVER_VELOCITY] = None

    @check_of("force_over_distance", "force_over_velocity")
    def _has_a_curve(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.force_over_distance is None and self.force_over_velocity is None:
            sentence = "found neither force_over_distance nor force_over_velocity, expected at least one of them"
            yield Issue((), sentence, at_key=True)

    @property
    def branches(self) -> Branches | None:
        """The curve over distance, if it has two."""
        return self.force_over_distance if isinstance(self.force_over_distance, Branches) else None

    def turning_over(self, least: float) -> "Nonlinear":
        """Returns the link with the `turn` that its branches omit: 2 % of their range, or `least` (m) if that is
        larger and finite."""
        if self.branches is None or self.branches.turn is not None:
            return self
        turn = max(self.branches.width, least if math.isfinite(least) else 0.0)
        return self.model_copy(update={"force_over_distance": self.branches.model_copy(update={"turn": turn})})

    def law(self) -> Law:
        """The curve over distance, with what the one over velocity does where the ends stand: at a corner the mean of
        the slopes beside it."""
        standing, curve = curve_law(self.force_over_velocity), self.force_over_distance
        damping, more = standing.slope(0.0), float(standing.tension(0.0))
        if isinstance(curve, Branches):
            taken = "is taken stuck between its branches; while it slides along one, it has the slope of that"
            law: Law = branch_law(curve.mean, curve.half, curve.width, damping, more, taken)
        else:
            sectors = (*curve_law(curve).sector, "N/m"), (*standing.sector, "N·s/m")
            words = " and ".join(f"between ‹{low:g} and {high:g} {unit}›" for low, high, unit in sectors if low or high)
            taken = f"is taken with its slopes where its ends meet and stand{words and f'; elsewhere they lie {words}'}"
            law = curve_law(curve, damping, more, taken)
        return replace(law, speeds=tuple(self.force_over_velocity or ()))

    def table(self) -> Law | None:
        curve = self.force_over_distance
        curve = curve.mean if isinstance(curve, Branches) else curve
        return None if curve is None else curve_law(curve)

    def slider(self) -> Law | None:
        return None if self.branches is None else curve_law(self.branches.half)


class Friction(Link):
    """Dry friction between two points: a bristle that holds like a spring, and slides where it is pulled too hard."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    holds_across = "always"
    live: ClassVar[tuple[str, ...]] = ("force", "static", "stiffness", "damping")
    with_default: ClassVar[Mapping[str, str]] = {"static": "break_away"}
    ungated = ("stiffness", "damping")  # of the bristle, which slides where the gate leaves no force
    potential = (Potential(stretch="anchor", side="sliding", slides_at="force"),)

    type: Literal["friction"] = Field(default="friction", description="Dry friction: sticks, and slides")
    force: Annotated[float, quantity("Friction while it slides", "N", least=0)]
    static: Annotated[
        float | None, quantity("Force at which it breaks away", "N", least=0, left_out="that of sliding")
    ] = None
    stiffness: Annotated[float, quantity("Stiffness of the bristle that sticks", "N/m", above=0)]
    damping: Annotated[float, quantity("Viscosity of the bristle while it sticks", "N·s/m", least=0)] = 0.0

    @property
    def break_away(self) -> float:
        """Force at which it breaks away, N."""
        return self.force if self.static is None else self.static

    @check_of("force", "static")
    def _breaks_away_above(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.break_away < self.force:
            expected = f"expected at least ‹{self.force!r} N›"
            yield Issue(("static",), f"found ‹{self.static!r} N›, less than the force while it slides; {expected}")

    def law(self) -> Law:
        taken = "sticks, as a spring; while it slides, its force is constant and adds no stiffness"
        reach, force = self.break_away / self.stiffness, self.force
        more: dict[str, Any] = {
            "states": ("stuck",),
            "reach": reach,
            "slides_at": force,
            "memoryless": False,
            "assumption": taken,
        }
        return line(self.stiffness, self.damping, **more)


class Plectrum(Link):
    """A visco-elastic link that releases where its ends are too far apart, and grips again where they meet."""

    remembers_touch: ClassVar[tuple[str, bool] | None] = ("side", False)
    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    holds_across = "near"
    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "release")
    potential = (Potential(side="side"),)

    type: Literal["plectrum"] = Field(
        default="plectrum", description="Plucks: grips, releases beyond a distance, and grips again where its ends meet"
    )
    stiffness: Annotated[float, quantity("Stiffness while it grips", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity while it grips", "N·s/m", least=0)] = 0.0
    release: Annotated[float, quantity("Distance of its ends beyond which it releases", "m", above=0)]

    def law(self) -> Law:
        taken = "grips all the time; once released, the hand does not feel it"
        knots = tuple((d, self.stiffness * d) for d in (-self.release, self.release))
        dampings, states = (0.0, self.damping, 0.0), ("released", "gripping", "released")
        return GrippingLaw(knots, dampings, states, assumption=taken, stiffness=self.stiffness)


class Click(Link):
    """A button: its first end is pressed down on its second, gives way, and meets the bottom."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    has_table: ClassVar[bool] = True
    live: ClassVar[tuple[str, ...]] = ("travel", "peak", "drop", "bottom", "damping", "peak_at")

    type: Literal["click"] = Field(
        default="click", description="A button that clicks: its first end is pressed down on its second"
    )
    travel: Annotated[float, quantity("Depth of the press at which it meets the bottom", "m", above=0)]
    peak: Annotated[float, quantity("Force at which it gives way", "N", above=0)]
    drop: Annotated[float, quantity("Drop of its force then; if larger than the peak, it stays down", "N", least=0)]
    bottom: Annotated[float, quantity("Stiffness of the bottom", "N/m", above=0)]
    damping: Annotated[float, quantity("Viscosity while it is pressed", "N·s/m", least=0)] = 0.0
    peak_at: Annotated[float, quantity("Share of the travel at which it gives way", "1", least=0.01, most=0.99)] = 0.5
    length: Annotated[float | None, LENGTH] = None

    def law(self) -> Law:
        travel, peak, low, rest = self.travel, self.peak, self.peak - self.drop, self.length or 0.0
        forces = (-low - 0.5 * peak, -low, -peak, 0.0)
        shares = 1.0, 0.5 + 0.5 * self.peak_at, self.peak_at, 0.0
        knots = tuple((rest - share * travel, force) for share, force in zip(shares, forces, strict=True))
        states = ("at the bottom", "after the click", "in the click", "before the click", "apart")
        dampings, at = (self.damping,) * 4 + (0.0,), rest - 0.5 * self.peak_at * travel
        taken = "is taken as pressed before its click"
        return Law(knots, dampings, states, self.bottom, pushes=True, taken_at=at, assumption=taken)
