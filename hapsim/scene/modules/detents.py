"""The detent: places at which a knob or a fader rests, by a law of the distance alone, or holding with a memory."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from hapsim.laws import HoldingLaw, Law, Potential, SineLaw, flank_stiffness, holding_law

from ..choices import DETENT_SHAPE, WITH_SHARPNESS, DetentShape
from ..issue import Issue, one_of, with_article
from ..quantity import numbers, quantity
from ..section import ModuleContext, check_of
from .links import Link

_ROUNDED = 1e-6  # of a way
_HELD = ("hold_until", "places", "dead_zone", "stop", "only")


class Detent(Link):
    """Rests at every multiple of its pitch, or at its places: between two its ends are pulled to the nearer one, or to
    the one that still holds them."""

    live: ClassVar[tuple[str, ...]] = ("pitch", "depth", "damping", "sharpness", "dead_zone", "hold_until", "stop")
    with_default: ClassVar[Mapping[str, str]] = {
        "sharpness": "steepness",
        "pitch": "period",
        "dead_zone": "free",
        "hold_until": "hold",
        "stop": "wall",
    }
    crossfaded: ClassVar[tuple[str, ...]] = ("shape", "places", "only")
    potential = (Potential((("depth", 1.0),), pitch="pitch"),)

    type: Literal["detent"] = Field(default="detent", description="Detents: places to rest")
    pitch: Annotated[float | None, quantity("Distance from one rest to the next", "m", above=0, left_out="places")] = (
        None
    )
    depth: Annotated[float, quantity("Largest force of a detent", "N", least=0)]
    damping: Annotated[float, quantity("Viscosity", "N·s/m", least=0)] = 0.0
    shape: DetentShape = Field(default="sine", description=DETENT_SHAPE)
    sharpness: Annotated[
        float | None,
        quantity(
            f"With shape: {one_of(WITH_SHARPNESS)}. Of a snap, how much steeper it falls than it rises; of a notch, "
            "the pitch over its width",
            "1",
            least=1,
            left_out="2",
        ),
    ] = None
    hold_until: Annotated[
        float | None,
        quantity(
            "Share of the way to the next place up to which a place holds, from 0.5 to below 1.5; the link then "
            "remembers its place",
            "1",
            left_out="with places 0.5; else it remembers none",
        ),
    ] = None
    places: Annotated[tuple[float, ...] | None, numbers("Where it rests, in place of a pitch", "m", "a pitch")] = None
    dead_zone: Annotated[
        float | None,
        quantity("Distance from a rest within which it has no force, with hold_until", "m", least=0, left_out="0"),
    ] = None
    stop: Annotated[
        float | None,
        quantity(
            "Stiffness of the stops beyond the first and the last of its places",
            "N/m",
            least=0,
            left_out="that of the detent there",
        ),
    ] = None
    only: Annotated[tuple[int, ...] | None, numbers("Numbers of the places that hold, from 0", "", "all")] = None

    @property
    def steepness(self) -> float:
        """Sharpness, or its default."""
        return 2.0 if self.sharpness is None else self.sharpness

    @property
    def is_held(self) -> bool:
        """True if it remembers the place in which its ends are."""
        return self.hold_until is not None or self.places is not None

    @property
    def potentials(self) -> tuple[Potential, ...]:
        """Potential of the place that it remembers, if it does; else as of its class."""
        return (Potential(holds=True),) if self.is_held else self.potential

    @property
    def period(self) -> float:
        """Pitch, m; 0 of a detent with places of its own."""
        return self.pitch or 0.0

    @property
    def free(self) -> float:
        """Dead zone, m, or its default."""
        return self.dead_zone or 0.0

    @property
    def hold(self) -> float:
        """Share of the way up to which a place holds, or its default."""
        return 0.5 if self.hold_until is None else self.hold_until

    @property
    def wall(self) -> float:
        """Stiffness of the stops, N/m; below 0: that of the detent there."""
        return -1.0 if self.stop is None else self.stop

    @property
    def rests(self) -> tuple[float, ...]:
        """Places at which it rests, m; of a detent with a pitch that of number 0."""
        return self.places or (0.0,)

    @property
    def ways(self) -> tuple[float, ...]:
        """Distances from each place to the next, m."""
        return tuple(after - before for before, after in pairwise(self.rests)) or (self.period,)

    def passage(self, way: float) -> float:
        """Returns the energy that a passage along a way of this length, m, takes from a hand, J; below 0 it gives."""
        reach, back = self.hold * way - self.free, max(abs(1.0 - self.hold) * way - self.free, 0.0)
        return 0.5 * flank_stiffness(self.depth, self.hold, way, self.free) * (reach**2 - back**2)

    @property
    def holding(self) -> tuple[bool, ...]:
        """True for each place that holds."""
        return tuple(self.only is None or i in self.only for i in range(len(self.rests)))

    @property
    def width(self) -> float:
        """Width of a detent's force, m; infinite for a single place."""
        least = min(self.ways) or float("inf")
        return least / self.steepness if self.shape == "notch" else least

    @check_of("shape", "sharpness")
    def _sharpness_fits(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if self.shape not in WITH_SHARPNESS and self.sharpness is not None:
            expected = f"expected shape: {one_of(WITH_SHARPNESS)}, or no sharpness"
            yield Issue(("sharpness",), f"found a sharpness, which shape: {self.shape} does not have; {expected}")

    @check_of("pitch", "shape", *_HELD)
    def _keys_fit(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        if (self.pitch is None) == (self.places is None):
            found = "neither a pitch nor places" if self.pitch is None else "a pitch and places"
            yield Issue((), f"found {found}, expected one of them", at_key=True)
        if self.is_held and self.shape != "sine":
            expected = f"expected no {one_of([key for key in _HELD if getattr(self, key) is not None])}, or no shape"
            yield Issue(("shape",), f"found {self.shape} of a detent that remembers its place; {expected}")
        for key, needed in {"dead_zone": "hold_until", "stop": "places", "only": "places"}.items():
            is_there = self.is_held if key == "dead_zone" else self.places is not None
            if getattr(self, key) is not None and not is_there:
                sentence = f"found {with_article(key)} without {needed}; expected {needed} too, or none"
                yield Issue((key,), sentence, at_key=True)
        if self.only and self.only[-1] >= len(self.rests):
            expected = f"expected numbers from 0 to {len(self.rests) - 1}, those of its places"
            yield Issue(("only",), f"found {self.only[-1]}, {expected}")
        if len(self.rests) == 1 and self.places and self.stop is None:
            yield Issue(
                ("places",), "found a single place without a stop; expected a second one, or stop: its stiffness"
            )

    @check_of("pitch", "depth", *_HELD)
    def _gives_no_energy(self, _name: str, _around: ModuleContext) -> Iterator[Issue]:
        least, free, hold = min(self.ways), self.free, self.hold
        if not self.is_held or least <= 0.0 or (self.pitch and self.places):
            return
        if not free < 0.5 * least:
            yield Issue(("dead_zone",), f"found ‹{free!r} m›; expected less than half the least way, ‹{least!r} m›")
            return
        if not 0.5 <= hold < 1.5:
            gained = -self.passage(least) if hold * least > free else 0.0
            gives = f": every passage would give the hand ‹{gained!r} J›" if gained > 0.0 else ""
            yield Issue(("hold_until",), f"found {hold:g}{gives}; expected from 0.5 to below 1.5")
        way = max(self.ways[0], self.ways[-1])
        into = max((hold - 1.0 - _ROUNDED) * way - free, 0.0)
        gained = 0.5 * self.wall * into**2 - 0.5 * self.depth * (hold * way - free)
        if self.stop is not None and gained > 0.0:
            found = f"found ‹{self.stop!r} N/m›: the last place takes over within the stop, which gives the hand"
            expected = "expected hold_until: 1 or less, a softer stop or a dead zone"
            yield Issue(("stop",), f"{found} ‹{gained!r} J›; {expected}")

    def law(self) -> Law:
        depth, inside, outside = self.depth, "in a notch", "between notches"
        if self.is_held:
            return self._holding()
        if self.shape == "notch":
            q = 0.25 * self.period / self.steepness
            flank = "at the edge of a notch" if self.steepness > 1.0 else outside
            states: tuple[str, ...] = (flank, inside, flank, outside)
            knots: tuple[tuple[float, float], ...] = ((-2.0 * q, 0.0), (-q, -depth), (q, depth), (2.0 * q, 0.0))
        else:
            sharp = self.steepness if self.shape == "snap" else 1.0
            rise = 0.5 * self.period * sharp / (sharp + 1.0)
            knots, states = ((-rise, -depth), (rise, depth)), (inside, outside)
        kind = SineLaw if self.shape == "sine" else Law
        taken = "is taken in the middle of a notch"
        return kind(knots, (self.damping,) * len(states), states, period=self.period, assumption=taken)

    def _holding(self) -> HoldingLaw:
        ways = [self.period] * 2 if self.pitch else [0.0, *self.ways, 0.0] if len(self.rests) > 1 else [0.0, 0.0]
        flanks = [flank_stiffness(self.depth, self.hold, way, self.free) for way in ways]
        if not self.pitch:
            flanks[0], flanks[-1] = (self.wall, self.wall) if self.wall >= 0.0 else (flanks[1], flanks[-2])
        places = [
            (rest, flanks[i] * holds, flanks[i + 1] * holds)
            for i, (rest, holds) in enumerate(zip(self.rests, self.holding, strict=True))
        ]
        if not self.pitch:  # the stops hold, whether their places do or not
            places[0] = (places[0][0], flanks[0], places[0][2])
            places[-1] = (*places[-1][:2], flanks[-1])
        return holding_law(places, self.hold, self.free, self.damping, self.period)

    def table(self) -> Law | None:
        return None if self.shape == "sine" else self.law()
