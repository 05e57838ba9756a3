"""What each link does over the distance of its ends: springs and dampers, piece by piece (`Law`).

**Contact, plectrum, table, detent, click.** Each is a spring and a damper in every piece of its distance, and a hand
that stays within one piece feels that piece's. That all pieces are stable does not make the whole stable. Passivity
bounds it, with the steepest slope in place of the stiffness (Colgate and Schenkel; for curves, Miller, Colgate and
Freeman 2000). A swing across a corner meets a weighted mean of the slopes beside it (the describing function).

**Dry friction.** Stuck it is a spring, sliding a constant force. The larger the swing, the softer it is, and it always
brakes (Dahl; Hayward and Armstrong) - in continuous time. Sampled and delayed, the stuck bristle is a spring like any
other: where it is too stiff for the loop, the motion grows into a limit cycle about as wide as the bristle's reach.

**Plectrum.** The release loses the energy of the spring, K release²/2. It grips again where its ends have passed each
other by at most v T, which adds up to K (v T)²/2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats

Points = Sequence[tuple[float, float]]
"""Of a curve, by ascending abscissa: m or m/s, and N."""

_MOST_EDGES = 4000  # of a law that repeats, within a travel


class Linear(NamedTuple):
    """A spring and a damper that stand for a link.

    Attributes:
        stiffness: N/m.
        damping: N·s/m.
        assumption: under which this holds, in words that follow the link's name; "" where it always holds.
        memoryless: the force depends on the positions and velocities of the ends and on nothing earlier, apart from
            what the link's damper remembers.
        in_a_matrix: the link is exactly this spring and damper, so that a scheme can work it into a matrix.

    The last two are as the kernel's `PartType` says.
    """

    stiffness: float
    damping: float
    assumption: str = ""
    memoryless: bool = False
    in_a_matrix: bool = False


@dataclass(frozen=True)
class Law:
    """The tension of a link at rest over the distance d of its ends, in m: straight between `edges`.

    Attributes:
        slopes, dampings, states: of each piece from the one below the first edge to the one above the last, N/m,
            N·s/m and a word or two. Of a law with a period: from each edge to the next, none below the first.
        tension_at: N, at the first edge; without an edge at d = 0.
        taken_at: m, the distance at which the theory takes the link where nothing is known of the place of its ends.
        assumption: what that is, in words that follow the link's name.
        period: m, in which the law repeats; 0: it does not.
        reach: m, how far the ends may move about where they are before the link lets them slide; infinite: any way.
        slides_at: N, the force while it slides.
        most: N, above which the tension never goes, however fast the ends part: 0 of what only pushes.
    """

    edges: tuple[float, ...]
    slopes: tuple[float, ...]
    dampings: tuple[float, ...]
    states: tuple[str, ...]
    tension_at: float = 0.0
    taken_at: float = 0.0
    assumption: str = ""
    period: float = 0.0
    reach: float = math.inf
    slides_at: float = 0.0
    most: float = math.inf
    memoryless: bool = True
    in_a_matrix: bool = False

    @property
    def is_curved(self) -> bool:
        """Whether the slope changes within a piece; `slopes` has the steepest then."""
        return False

    def strongest(self, rate: float) -> float:
        """N, which the tension never exceeds at this rate of samples (Hz); infinite where nothing bounds it."""
        reach = self.edges[-1] if self.grips else self.reach
        if math.isfinite(reach):
            stuck = self.slopes.index(max(self.slopes))
            return max(self.slides_at, reach * (self.slopes[stuck] + 2.0 * self.dampings[stuck] * rate))
        is_level = bool(self.period) or self.slopes[0] == self.slopes[-1] == 0.0
        if any(self.dampings) or not is_level:
            return math.inf
        return float(np.abs(self.tension(np.array(self.edges or 0.0))).max())

    @property
    def grips(self) -> bool:
        """Whether it holds between its edges once its ends have met there, and not before."""
        return False

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

    def tension(self, d: Floats) -> Floats:
        """N, which pulls the ends together, at these distances in m."""
        d = np.asarray(d, float)
        if not self.edges:
            return self.tension_at + self.slopes[0] * d
        edges, slopes = np.array(self._whole), self.slopes if self.period else self.slopes[1:-1]
        rises = [slope * (right - left) for slope, (left, right) in zip(slopes, pairwise(edges), strict=True)]
        tensions = np.array(list(accumulate(rises, initial=self.tension_at)))
        inside = self._folded(d)
        between = np.interp(inside, edges, tensions)
        if self.period:
            return between
        below, above = np.minimum(d - edges[0], 0.0), np.maximum(d - edges[-1], 0.0)
        return between + self.slopes[0] * below + self.slopes[-1] * above

    def slope(self, d: float) -> float:
        """N/m at d, in m; on an edge the mean of those beside it, which is what a small swing about it meets."""
        return self._mean(self.slopes, d)

    def damping(self, d: float) -> float:
        """N·s/m at d, as `slope`."""
        return self._mean(self.dampings, d)

    def state(self, d: float) -> str:
        """How the link is at d, in a word or two; "" where it is always the same."""
        return self.states[self._pieces(d)[1]]

    def linear(self, d: float | None = None) -> Linear:
        """The spring and damper that stand for the link about d, in m; None: about `taken_at`, as `assumption` says."""
        at, assumption = (self.taken_at, self.assumption) if d is None or self is RELEASED else (d, "")
        return Linear(self.slope(at), self.damping(at), assumption, self.memoryless, self.in_a_matrix)

    @property
    def _whole(self) -> tuple[float, ...]:
        """The edges, with the first one of the next period."""
        return (*self.edges, self.edges[0] + self.period) if self.period else self.edges

    def _folded(self, d: Floats) -> Floats:
        """d within the first period."""
        if not self.period:
            return d
        first = self.edges[0]
        return d - self.period * np.floor((d - first) / self.period)

    def _pieces(self, d: float) -> tuple[int, int]:
        """The pieces on both sides of d: the same one, unless d is on an edge."""
        inside = float(self._folded(np.asarray(d, float)))
        below, above = (int(np.searchsorted(self.edges, inside, side)) for side in ("left", "right"))
        return (below - 1, above - 1) if self.period else (below, above)  # -1 is the last

    def _mean(self, values: tuple[float, ...], d: float) -> float:
        below, above = self._pieces(d)
        return values[below] if below == above else 0.5 * (values[below] + values[above])


@dataclass(frozen=True)
class SineLaw(Law):
    """depth sin(2 pi d / period): its pieces end where the slope is 0."""

    depth: float = 0.0

    @property
    def is_curved(self) -> bool:
        return True

    def tension(self, d: Floats) -> Floats:
        return self.depth * np.sin(2.0 * np.pi * np.asarray(d, float) / self.period)

    def slope(self, d: float) -> float:
        angular = 2.0 * math.pi / self.period
        return self.depth * angular * math.cos(angular * math.remainder(d, self.period))


def viscoelastic(stiffness: float, damping: float) -> Law:
    """A spring and a damper, N/m and N·s/m."""
    return Law((), (stiffness,), (damping,), ("",), in_a_matrix=True)


def buffer(stiffness: float, damping: float, distance: float = 0.0) -> Law:
    """The contact, N/m and N·s/m, which is touched below `distance` m; taken as touched."""
    assumption = "is taken as touched all the time; while its ends are apart, the hand does not feel it"
    slopes, dampings = (stiffness, 0.0), (damping, 0.0)
    states = ("touched", "apart")
    return Law((distance,), slopes, dampings, states, taken_at=-math.inf, assumption=assumption, most=0.0)


def plectrum(stiffness: float, damping: float, release: float = math.inf) -> Law:
    """The plectrum, N/m and N·s/m, which grips up to `release` m; taken as gripping."""
    assumption = "is taken as gripping all the time; once released, the hand does not feel it"
    if not math.isfinite(release):
        return Law((), (stiffness,), (damping,), ("gripping",), assumption=assumption, memoryless=False)
    slopes, dampings = (0.0, stiffness, 0.0), (0.0, damping, 0.0)
    states = ("released", "gripping", "released")
    return _Plectrum(
        (-release, release), slopes, dampings, states, -stiffness * release, 0.0, assumption, memoryless=False
    )


RELEASED = Law((), (0.0,), (0.0,), ("released",), assumption="never grips: its ends do not meet within the travel")
"""A plectrum that never grips."""


@dataclass(frozen=True)
class _Plectrum(Law):
    """Without a force beyond its edges."""

    @property
    def grips(self) -> bool:
        return True

    def tension(self, d: Floats) -> Floats:
        return np.where(np.abs(d) <= self.edges[-1], self.slopes[1] * np.asarray(d, float), 0.0)


def friction(stiffness: float, damping: float, force: float = 0.0, static: float = math.inf) -> Law:
    """Dry friction, taken as stuck: its bristle, N/m and N·s/m. It slides with `force` N, from `static` N on."""
    assumption = "is taken as stuck, a spring; while it slides, its force is constant and adds no stiffness"
    reach = static / stiffness if stiffness > 0.0 else math.inf
    return _Bristle(
        (),
        (stiffness,),
        (damping,),
        ("stuck",),
        assumption=assumption,
        reach=reach,
        slides_at=force,
        memoryless=False,
    )


@dataclass(frozen=True)
class _Bristle(Law):
    """A stuck friction link: its anchor is where the ends rest, so that it has no force there."""

    def tension(self, d: Floats) -> Floats:
        return np.zeros(np.shape(d))


def detent(depth: float, pitch: float, shape: str, sharpness: float, damping: float) -> Law:
    """Notches of `depth` N every `pitch` m: a `sine`, or straight flanks. `sharpness` makes the falling flanks of
    `snap` steeper, the notches of `notch` narrower. Taken in a notch."""
    assumption = "is taken in the middle of a notch"
    notch = ("in a notch", "between notches")
    if shape == "sine":
        steepest, edge = 2.0 * math.pi * depth / pitch, 0.25 * pitch
        slopes, dampings = (steepest, -steepest), (damping,) * 2
        return SineLaw((-edge, edge), slopes, dampings, notch, assumption=assumption, period=pitch, depth=depth)
    if shape == "snap" or sharpness == 1.0:
        rise = 0.5 * pitch * sharpness / (sharpness + 1.0)
        slopes = (depth / rise, -depth / (0.5 * pitch - rise))
        return Law((-rise, rise), slopes, (damping,) * 2, notch, -depth, assumption=assumption, period=pitch)
    quarter = 0.25 * pitch / sharpness
    slope, flank = depth / quarter, "at the edge of a notch"
    return Law(
        (-2.0 * quarter, -quarter, quarter, 2.0 * quarter),
        (-slope, slope, -slope, 0.0),
        (damping,) * 4,
        (flank, notch[0], flank, notch[1]),
        assumption=assumption,
        period=pitch,
    )


def click(travel: float, peak: float, drop: float, bottom: float, damping: float) -> Law:
    """A button whose first end is pressed below its second: `peak` N at half the travel (m), `drop` less at three
    quarters, `bottom` N/m beyond the travel. Taken as pressed before its click."""
    rise, fall = 2.0 * peak / travel, -4.0 * drop / travel
    edges = (-travel, -0.75 * travel, -0.5 * travel, 0.0)
    slopes, dampings = (bottom, rise, fall, rise, 0.0), (damping,) * 4 + (0.0,)
    states = ("at the bottom", "after the click", "in the click", "before the click", "apart")
    lowest = -(peak - drop + 0.25 * rise * travel)
    assumption, most = "is taken as pressed before its click", max(0.0, drop - peak)
    return Law(edges, slopes, dampings, states, lowest, taken_at=-0.25 * travel, assumption=assumption, most=most)


class Sector(NamedTuple):
    """The slopes between which a whole curve lies, N/m or N·s/m."""

    least: float
    steepest: float


def sector(points: Points | None) -> Sector:
    """The least and the steepest slope of a curve, the level ends included; both are 0 where there is no curve."""
    slopes = [0.0, *_slopes(points or ())]
    return Sector(min(slopes), max(slopes))


def nonlinear(over_distance: Points | None, over_velocity: Points | None) -> Law:
    """The link with curves; its damping is the slope over velocity where its ends stand, at a corner the mean of both.
    Taken where its ends meet."""
    words = [
        f"between {least:g} and {steepest:g} {unit}"
        for (least, steepest), unit in ((sector(over_distance), "N/m"), (sector(over_velocity), "N·s/m"))
        if (least, steepest) != (0.0, 0.0)
    ]
    reach = f"; elsewhere they lie {' and '.join(words)}" if words else ""
    assumption = f"is taken with its slopes where its ends meet and stand{reach}"
    at_velocity, at_rest = _table(over_velocity, 0.0), 0.0
    damping = at_velocity.slope(0.0)
    if over_velocity:
        at_rest = float(at_velocity.tension(np.array(0.0)))
    return _table(over_distance, damping, at_rest, assumption)


def _table(points: Points | None, damping: float, more: float = 0.0, assumption: str = "") -> Law:
    if not points:
        return Law((), (0.0,), (damping,), ("",), more, assumption=assumption)
    slopes = (0.0, *_slopes(points), 0.0)
    names = ("level", *(f"piece {i + 1}" for i in range(len(points) - 1)), "level")
    edges = tuple(x for x, _ in points)
    return Law(edges, slopes, (damping,) * len(slopes), names, points[0][1] + more, assumption=assumption)


def _slopes(points: Points) -> list[float]:
    return [(up - f) / (right - x) for (x, f), (right, up) in pairwise(points)]
