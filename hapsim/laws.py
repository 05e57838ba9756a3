"""Force of each link over the distance of its ends: springs and dampers, piece by piece (`Law`).

Every link of a scene makes its own law (`law` in scene/modules). The account of stored energy, live changes and
predictions read that one, and the kernel reads its knots; straight links and friction have a recurrence there.

**Contact, plectrum, table, detent, click.** Each is a spring and a damper in every piece of its distance, and a hand
that stays within one piece feels that piece's. That all pieces are stable does not make the whole stable. Passivity
bounds it, with the steepest slope in place of the stiffness (Colgate and Schenkel; for curves, Miller, Colgate and
Freeman 2000). A swing across a corner meets a weighted mean of the slopes beside it (the describing function).

**Dry friction.** Stuck it is a spring, sliding a constant force. The larger the swing, the softer it is, and it always
brakes (Dahl; Hayward and Armstrong) - in continuous time. Sampled and delayed, the stuck bristle is a spring like any
other: where it is too stiff for the loop, the motion grows into a limit cycle about as wide as the bristle's reach.

**Detent that holds.** It remembers its place, so that there is no piece in which its force falls: it jumps from one
place to the next, and gives back at most what it took. Sampled, a jump comes up to (1/2 + delay) T late, and as the
flank before it does, it changes an energy by up to K p |v| T (1/2 + delay) for a way p. On a board that follows lines
the flank goes on until the next line, which costs at most K p |v| T.

**Plectrum.** The release loses the energy of the spring, K release²/2. It grips again where its ends have passed each
other by at most v T, which adds up to K (v T)²/2.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

if TYPE_CHECKING:  # a scene is read without NumPy
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

Points = Sequence[tuple[float, float]]
"""Points of a curve, by ascending abscissa: m or m/s, and N."""

_MOST_EDGES = 4000  # of a law that repeats, within a travel


class Linear(NamedTuple):
    """A spring and a damper that stand for a link.

    Attributes:
        stiffness: N/m.
        damping: N·s/m.
        assumption: under which this holds, in words that follow the link's name; "" where it always holds. Units stand
            in it as ‹N/m›.
        memoryless: the force depends on the positions and velocities of the ends and on nothing earlier, apart from
            what the link's damper remembers.
        in_a_matrix: the link is exactly this spring and a backward damper, so that a scheme can work it into a matrix.
    """

    stiffness: float
    damping: float
    assumption: str = ""
    memoryless: bool = False
    in_a_matrix: bool = False


class Piece(NamedTuple):
    """A straight piece of a law that begins at `edge` (m): its slope in N/m, damping in N·s/m, and state."""

    edge: float
    slope: float
    damping: float
    state: str


class Potential(NamedTuple):
    """A spring in which a link without a table stores energy. Texts name fields of the link, which may be live; those
    of `side` and `press` name numbers that its part of a program remembers.

    Attributes:
        stiffness: N/m, each with the share of it that counts: the first one that is set; of a sine its N, with
            its `pitch`, m.
        stretch: m: the distance of its ends beyond their rest; their way from an `anchor`; in the plane along a normal
            beyond a `level`, or along a surface as its `bristle` is bent.
        side: where this number and the stretch have one sign, it stores nothing. pushes: so it does above 0.
        slides_at: N, or over `press`, the force of a bristle while `side` is not 0.
        width, reach: m, of the middle in which it is not stretched; beyond which it releases.
        holds: it is that of the place that a detent remembers, and all else says nothing.
    """

    stiffness: tuple[tuple[str, float], ...] = (("stiffness", 1.0),)
    pitch: str = ""
    stretch: Literal["distance", "anchor", "level", "bristle"] = "distance"
    side: str = ""
    pushes: bool = False
    slides_at: str = ""
    press: str = ""
    width: str = ""
    reach: str = ""
    holds: bool = False


@dataclass(frozen=True)
class Law:
    """The tension of a link at rest over the distance d of its ends, in m: straight between knots.

    Attributes:
        knots: by ascending distance: m, and N there. A law of one piece is a straight line through its only knot.
        dampings, states: of each piece from the one below the first knot to the one above the last, N·s/m and a word or
            two. Of a law with a period: from each knot to the next, none below the first.
        below, beyond: N/m, the slopes below the first knot and above the last, of a law without a period.
        period: m, in which the law repeats; 0: it does not.
        pushes: its damper never makes it pull more than its knots do, however fast the ends part.
        taken_at: m, the distance at which the theory takes the link where nothing is known of the place of its ends.
        assumption: what that is, in words that follow the link's name.
        reach: m, how far the ends may move about where they are before the link lets them slide; infinite: any way.
        slides_at: N, the force while it slides.
        speeds: by ascending speed: m/s at which the ends part, and N, straight between and level beyond. What that is
            at rest, `knots` and `dampings` have too.
        memoryless, in_a_matrix: as of `Linear`.
        damper, cutoff: how it takes the velocity, of `DAMPERS`; Hz.
    """

    #: Whether the slope changes within a piece, which has the steepest then.
    is_curved: ClassVar[bool] = False
    #: Whether it holds between its edges once its ends have met there, and not before.
    grips: ClassVar[bool] = False

    knots: tuple[tuple[float, float], ...]
    dampings: tuple[float, ...]
    states: tuple[str, ...] = ("",)
    below: float = 0.0
    beyond: float = 0.0
    period: float = 0.0
    pushes: bool = False
    taken_at: float = 0.0
    assumption: str = ""
    reach: float = math.inf
    slides_at: float = 0.0
    speeds: tuple[tuple[float, float], ...] = ()
    memoryless: bool = True
    in_a_matrix: bool = False
    damper: str = "backward"
    cutoff: float | None = None

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces that are not empty, by ascending edge."""
        if len(self.states) == 1:
            return (Piece(-math.inf, self.below, self.dampings[0], self.states[0]),)
        edges, slopes = [edge for edge, _ in self._whole], self._slopes()
        if not self.period:
            edges, slopes = [-math.inf, *edges, math.inf], [self.below, *slopes, self.beyond]
        pieces = map(Piece, edges, slopes, self.dampings, self.states)
        return tuple(one for one, end in zip(pieces, edges[1:], strict=True) if one.edge < end)

    @cached_property
    def _columns(self) -> Floats:
        """m of each knot, and N there."""
        import numpy as np

        return np.array(self._whole).T

    @cached_property
    def _table(self) -> tuple[Floats, ...]:
        """Edge of each piece, m, force there, N, slope, N/m, damping, N·s/m (none where it may slide); inner edges."""
        import numpy as np

        tension, lowest = dict(self._whole), self.knots[0]
        begins = [(one.edge, tension[one.edge]) if math.isfinite(one.edge) else lowest for one in self.pieces]
        dampings = [0.0 if self.is_dry else one.damping for one in self.pieces]
        rows = (*zip(*begins, strict=True), [one.slope for one in self.pieces], dampings)
        return *map(np.array, rows), np.array([one.edge for one in self.pieces[1:]])

    @cached_property
    def edges(self) -> tuple[float, ...]:
        """m, where one piece ends and another begins; of one period."""
        return tuple(piece.edge for piece in self.pieces if math.isfinite(piece.edge))

    @property
    def is_dry(self) -> bool:
        """True if it is dry friction, which has no tension where it has rested."""
        return math.isfinite(self.reach)

    @property
    def variants(self) -> Mapping[str, Law]:
        """Further laws that small motions at one place may meet, apart from sliding friction, by state."""
        return {}

    @property
    def is_line(self) -> bool:
        """True if it is a spring and a damper everywhere, and nothing else."""
        return len(self.states) == 1 and self.memoryless and not self.speeds

    @property
    def rest(self) -> float:
        """m, where a straight line has no tension, and what pushes begins; of any other law 0."""
        return self.knots[-1][0] if self.pushes or len(self.knots) == 1 else 0.0

    @property
    def sector(self) -> tuple[float, float]:
        """N/m, the slopes between which the whole law lies: the least and the steepest."""
        slopes = [piece.slope for piece in self.pieces]
        return min(slopes), max(slopes)

    @cached_property
    def contact_edges(self) -> dict[str, int]:
        """Knots between which it has no force, if the ends are pushed back there from beyond them: "low", "high" or
        both; none of any other law."""
        import numpy as np

        forces = [force for _, force in self.knots]
        signs = np.sign([-self.below or forces[0], *forces, self.beyond or forces[-1]])
        low, high = (np.flatnonzero((signs[1:-1] == 0.0) & out) for out in (signs[:-2] < 0.0, signs[2:] > 0.0))
        edges = {end: int(found[0]) for end, found in (("low", low), ("high", high)) if found.size}
        first, last = edges.get("low", 0), edges.get("high", len(forces) - 1)
        is_one = (low.size, high.size) == (signs[0] < 0.0, signs[-1] > 0.0) and not any(forces[first : last + 1])
        is_spring = len(edges) == 2 and first >= last
        return edges if is_one and not is_spring and not self.period else {}

    @cached_property
    def without_force(self) -> list[tuple[float, float]]:
        """Ranges of distances, m, without a force; of a law with a period those of one."""
        if len(self.pieces) < 2:
            return []
        edges = [one.edge for one in self.pieces]
        ends = [*edges[1:], edges[0] + self.period if self.period else math.inf]
        ranges = [(one.edge, end) for one, end in zip(self.pieces, ends, strict=True) if one.slope == 0.0]
        return [(low, high) for low, high in ranges if not self.tension(low if math.isfinite(low) else high)]

    @property
    def most(self) -> float:
        """N, above which the tension never goes, however fast the ends part."""
        return max(tension for _, tension in self.knots) if self.pushes else math.inf

    def dampings_at(self, speed: float) -> tuple[float, ...]:
        """N·s/m, other dampings than those at rest that a motion up to this speed, m/s, may meet: the steepest, and the
        least of force over speed, with the mean force of both ways, as an oscillation moves both ways."""
        if not self.speeds:
            return ()
        at_rest, steepest = max(self.dampings), self._over_speed.sector[1]
        speeds = [*(abs(v) for v, _ in self.speeds if 0.0 < abs(v) < speed), speed]
        brakes = self._over_speed.tension
        least = min(float(brakes(v) - brakes(-v)) / (2.0 * v) for v in speeds)
        return (steepest,) * (steepest > max(at_rest, 0.0)) + (least,) * (least < at_rest - 1e-9 * abs(at_rest))

    def strongest(self, rate: float) -> float:
        """N, which the tension never exceeds at this rate of samples (Hz); infinite where nothing bounds it."""
        reach = self.edges[-1] if self.grips else self.reach
        if math.isfinite(reach):
            stuck = max(self.pieces, key=lambda piece: piece.slope)
            return max(self.slides_at, reach * (stuck.slope + 2.0 * stuck.damping * rate))
        if any(self.dampings) or self.below != 0.0 or self.beyond != 0.0:
            return math.inf
        return max(abs(tension) for _, tension in self.knots)

    def edges_between(self, low: float, high: float) -> list[float]:
        """The edges in [low, high], m; of a law with a period both have to be finite, and it raises ValueError where
        there are more than some thousand."""
        if not self.period:
            return [edge for edge in self.edges if low <= edge <= high]
        first, last = math.floor((low - self.edges[-1]) / self.period), math.ceil((high - self.edges[0]) / self.period)
        if (last - first) * len(self.edges) > _MOST_EDGES:
            raise ValueError(f"more than {_MOST_EDGES} edges")
        repeated = (edge + n * self.period for n in range(first, last + 1) for edge in self.edges)
        return [edge for edge in repeated if low <= edge <= high]

    def tension(self, d: Floats | float) -> Floats:
        """N, which pulls the ends together, at these distances in m; where it may slide, it has rested there: none."""
        import numpy as np

        return np.zeros(np.shape(d)) if self.is_dry else self.local(d)[0]

    def local(self, d: Floats | float) -> tuple[Floats, Floats, Floats]:
        """Tension, N, slope, N/m, and damping, N·s/m, at these distances, m; on an edge of the piece beyond."""
        inside, piece = self._placed(d)
        begin, tension, slope, damping = (row[piece] for row in self._table[:4])
        return tension + slope * (inside - begin), slope, damping

    def _placed(self, d: Floats | float) -> tuple[Floats, Any]:
        """These distances, m, of a law with a period within one; and the number of the piece there."""
        import numpy as np

        inside = np.asarray(d, float)
        if self.period:
            inside = inside - self.period * np.floor((inside - self.edges[0]) / self.period)
        return inside, self._table[4].searchsorted(inside, side="right")

    def about(self, d: Floats | float, way: Floats | float) -> Floats:
        """N at these ways, m, from d, where it has rested."""
        return self.tension(d + way)

    def pull(self, d: Floats, speed: Floats | float) -> Floats:
        """Pull, N, at these distances (m) and parting speeds (m/s) of the ends; undamped where it may slide."""
        import numpy as np

        if not self.speeds:
            return np.asarray(np.minimum(self.tension(d) + self.damping_along(d) * speed, self.most))
        return np.asarray(self.tension(d) + self._over_speed.tension(speed) - self._over_speed.tension(0.0))

    def slope(self, d: float) -> float:
        """N/m at d, in m; on an edge the mean of those beside it, which is what a small swing about it meets."""
        return sum(0.5 * piece.slope for piece in self._pieces_around(d))

    def damping(self, d: float) -> float:
        """N·s/m at d, as `slope`."""
        return sum(0.5 * piece.damping for piece in self._pieces_around(d))

    def damping_along(self, d: Floats | float) -> Floats:
        """N·s/m at these distances in m; on an edge that of the piece beyond it, and where it may slide none."""
        return self._table[3][self._placed(d)[1]]

    def state(self, d: float) -> str:
        """State of the link at d, in a word or two; "" if it is always the same."""
        return self._pieces_around(d)[1].state

    def linear(self, d: float | None = None) -> Linear:
        """The spring and damper that stand for the link about d, in m; None: about `taken_at`, as `assumption` says."""
        at, assumption = (self.taken_at, self.assumption) if d is None or self is RELEASED else (d, "")
        return Linear(self.slope(at), self.damping(at), assumption, self.memoryless, self.in_a_matrix)

    @cached_property
    def _whole(self) -> tuple[tuple[float, float], ...]:
        """The knots, with the first one of the next period."""
        (edge, tension), *_ = self.knots
        return (*self.knots, (edge + self.period, tension)) if self.period else self.knots

    @cached_property
    def _over_speed(self) -> Law:
        return curve_law(self.speeds)

    def _slopes(self) -> list[float]:
        """N/m, from each knot to the next."""
        pairs = pairwise(self._whole)
        return [(up - f) / (right - x) if right > x else 0.0 for (x, f), (right, up) in pairs]

    def _pieces_around(self, d: float) -> tuple[Piece, Piece]:
        """The pieces on both sides of d: the same one, unless d is on an edge."""
        first = 1 if self.period else 0  # there the first edge begins the first piece, below which is the last
        if self.period:
            d -= self.period * math.floor((d - self.edges[0]) / self.period)
        return self.pieces[bisect_left(self.edges, d) - first], self.pieces[bisect_right(self.edges, d) - first]


def line(stiffness: float, damping: float, rest: float = 0.0, **more: Any) -> Law:
    """A spring and a damper everywhere, N/m and N·s/m, without tension at `rest` m; `more`: of `Law`."""
    return replace(Law(((rest, 0.0),), (damping,), below=stiffness, beyond=stiffness), **more)


RELEASED = line(0.0, 0.0, states=("released",), assumption="never grips: its ends do not meet within the travel")
"""A plectrum that never grips."""


def curve_law(points: Points | None, damping: float = 0.0, more: float = 0.0, assumption: str = "") -> Law:
    """Straight between points and level beyond them, with `more` N everywhere; without points that and nothing else."""
    if not points:
        return line(0.0, damping, knots=((0.0, more),), assumption=assumption)
    states = ("level", *(f"piece {i + 1}" for i in range(len(points) - 1)), "level")
    knots = tuple((x, tension + more) for x, tension in points)
    return Law(knots, (damping,) * len(states), states, assumption=assumption)


@dataclass(frozen=True)
class SineLaw(Law):
    """depth sin(2 pi d / period): its pieces end at its knots, where the slope is 0."""

    is_curved: ClassVar[bool] = True

    def tension(self, d: Floats | float) -> Floats:
        import numpy as np

        return self.knots[-1][1] * np.sin(2.0 * np.pi * np.asarray(d, float) / self.period)

    def local(self, d: Floats | float) -> tuple[Floats, Floats, Floats]:
        import numpy as np

        angular = 2.0 * math.pi / self.period
        slope = self.knots[-1][1] * angular * np.cos(angular * np.asarray(d, float))
        return self.tension(d), slope, self.damping_along(d)

    def slope(self, d: float) -> float:
        angular = 2.0 * math.pi / self.period
        return self.knots[-1][1] * angular * math.cos(angular * math.remainder(d, self.period))

    def _slopes(self) -> list[float]:
        steepest = 2.0 * math.pi * self.knots[-1][1] / self.period
        return [steepest, -steepest]


@dataclass(frozen=True)
class GrippingLaw(Law):
    """A law without a force beyond its knots; `stiffness`, N/m, between them."""

    grips: ClassVar[bool] = True

    memoryless: bool = False
    stiffness: float = 0.0

    def tension(self, d: Floats | float) -> Floats:
        import numpy as np

        return np.where(np.abs(d) <= self.edges[-1], self.stiffness * np.asarray(d, float), 0.0)

    def _slopes(self) -> list[float]:
        return [self.stiffness]


@dataclass(frozen=True)
class HoldingLaw(Law):
    """A law that jumps from place to place and remembers its place: the knots are those of the nearest one.

    Attributes:
        ways: the same law while the ends part, and while they near each other: a place holds beyond the middle.
    """

    ways: tuple[Law, ...] = ()

    def pull(self, d: Floats, speed: Floats | float) -> Floats:
        import numpy as np

        parting, nearing = (law.tension(d) for law in self.ways)
        sign = np.sign(speed)
        tension = np.where(sign > 0.0, parting, np.where(sign < 0.0, nearing, self.tension(d)))
        return np.asarray(tension + self.damping_along(d) * speed)

    def strongest(self, rate: float) -> float:
        return max(law.strongest(rate) for law in self.ways)


def flank_stiffness(depth: float, hold: float, way: float, free: float) -> float:
    """Returns K of a place that holds for this share of the way to the next, N/m. `free`: m, within it has no force."""
    return depth / (hold * way - free) if way > 0.0 else 0.0


Holding = tuple[float, float, float]
"""A place that holds: m, and N/m below it and above it."""


def holding_law(places: Sequence[Holding], hold: float, free: float, damping: float, period: float) -> HoldingLaw:
    """Returns the law of a detent that holds. `period`: m, in which its only place repeats; 0: there are only these,
    with the flanks of the first and the last as stops."""
    parting, law, nearing = (_jumping(places, share, free, damping, period) for share in (hold, 0.5, 1.0 - hold))
    way = period or (places[1][0] - places[0][0] if len(places) > 1 else 4.0 * free + 1e-3)
    holds = f"; each holds for {hold:g} of the way to the next" if period or len(places) > 1 else ""
    taken = f"is taken beside its first place, in the place nearest to it{holds}"
    fields = {name: getattr(law, name) for name in ("knots", "dampings", "states", "below", "beyond", "period")}
    at = places[0][0] + 0.5 * (free + 0.5 * way)
    return HoldingLaw(**fields, memoryless=False, taken_at=at, assumption=taken, ways=(parting, nearing))


def _jumping(places: Sequence[Holding], share: float, free: float, damping: float, period: float) -> Law:
    """Returns the law in which each place takes over at this share of the way from the one before."""
    rests = [rest for rest, *_ in places]
    ends = [before + share * (rest - before) for before, rest in pairwise(rests)]
    ends = list(accumulate(ends, max)) if share >= 0.5 else list(accumulate(ends[::-1], min))[::-1]
    ends = [(share - 1.0) * period, share * period] if period else [-math.inf, *ends, math.inf]
    knots: list[tuple[float, float]] = []
    for (rest, below, above), begin, end in zip(places, ends[:-1], ends[1:], strict=True):
        inner = [x for x in sorted({rest - free, rest + free}) if begin < x < end]
        outer = [(x, below * min(x - rest + free, 0.0) + above * max(x - rest - free, 0.0)) for x in (begin, end)]
        if begin < end:
            knots += [
                *(outer[:1] * math.isfinite(begin)),
                *((x, 0.0) for x in inner),
                *(outer[1:] * math.isfinite(end)),
            ]
    states = ["held" if after > before else "free" for (_, before), (_, after) in pairwise(knots)]
    states = [*states, "free"] if period else ["at a stop", *states, "at a stop"]
    below, beyond = (0.0, 0.0) if period else (places[0][1], places[-1][2])
    return Law(tuple(knots), (damping,) * len(states), tuple(states), below, beyond, period)
