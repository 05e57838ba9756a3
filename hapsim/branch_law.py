"""Law of a curve with two branches, of which one holds while its distance d grows and the other while it shrinks.

    F = M(d) + h(d) z        z: 1 on the press branch, -1 on the release branch; z' = 2 d'/turn between them

M is the mean of the branches, and h half of what they differ by. Between them it is stuck: a bristle with the slope
M' + h' z + 2 h/turn. On a branch it slides, with the slope of that branch. Where its motion turns round, z crosses over
`turn`. Beside the work of M it stores

    2/turn times the integral of h over the way back to z = 0, weighted with what is left of that way.

Sliding, it takes h less the mean of h over the last half of `turn` from the hand per way, and whatever h it never gives
back more than it took. Sampled and late, the stuck bristle is a spring like any other.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

from hapsim.laws import Law, Points, curve_law

if TYPE_CHECKING:  # a scene is read without NumPy
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class StuckLaw(Law):
    """M, level beyond its knots, with slopes of its own, N/m, between these."""

    is_curved: ClassVar[bool] = True

    slopes: tuple[float, ...] = ()

    def tension(self, d: Floats | float) -> Floats:
        import numpy as np

        return np.asarray(np.interp(d, *self._columns))

    def _slopes(self) -> list[float]:
        return [*self.slopes]


@dataclass(frozen=True)
class BranchLaw(StuckLaw):
    """A curve with two branches, as it is about z = 0; its pieces have the steepest slopes of any z.

    Attributes:
        half: N, h at each of the knots, which are those of M.
        reach: m, half of `turn`.
    """

    half: tuple[float, ...] = ()

    @cached_property
    def variants(self) -> Mapping[str, Law]:
        """The law in small motions in other states: stuck where its slope is the steepest of each piece, or the least;
        pressed; released."""
        found: dict[str, Law] = {}
        slopes = extremes(self.knots, self.half, self.reach)
        for state, (low, *inner, high) in zip(("steepest", "softest"), slopes, strict=True):
            found[state] = self._as(state, StuckLaw, self.knots, below=low, beyond=high, slopes=tuple(inner))
        for state, z in (("pressed", 1.0), ("released", -1.0)):
            branch = ((x, mean + z * h) for (x, mean), h in zip(self.knots, self.half, strict=True))
            found[state] = self._as(state, Law, tuple(branch))
        return found

    @property
    def is_dry(self) -> bool:
        """False: it pulls with M where it has rested."""
        return False

    @property
    def sector(self) -> tuple[float, float]:
        """N/m, the slopes between which it lies in any state: the least and the steepest."""
        least, most = zip(*(one.sector for one in self.variants.values()), strict=True)
        return min(least), max(most)

    def slope(self, d: float) -> float:
        """N/m about z = 0 at d, in m."""
        return curve_law(self.knots).slope(d) + float(self._h(d)) / self.reach

    def along(self, way: Iterable[float], d: float) -> Floats:
        """Returns z after each step of a way, m, from d and from between the branches."""
        import numpy as np

        z, found = 0.0, []
        for now in way:
            z, d = min(max(z + (now - d) / self.reach, -1.0), 1.0), now
            found.append(z)
        return np.array(found)

    def about(self, d: Floats | float, way: Floats | float) -> Floats:
        """N at these ways, m, from d, where z is 0."""
        import numpy as np

        return np.asarray(self.tension(d + way) + self._h(d + way) * np.clip(way / self.reach, -1.0, 1.0))

    def pull(self, d: Floats, speed: Floats | float) -> Floats:
        """Pull, N, at these distances (m) and parting speeds (m/s) of the ends, sliding that way."""
        import numpy as np

        return np.asarray(super().pull(d, speed) + self._h(d) * np.sign(speed))

    def strongest(self, rate: float) -> float:
        """N, which the tension never exceeds at this rate of samples (Hz); infinite where nothing bounds it."""
        return max(self.variants[branch].strongest(rate) for branch in ("pressed", "released"))

    def cycle_energy(self, low: float, high: float) -> float:
        """Returns the energy, J, that moving from `low` to `high` (m) and back takes each time: the area between the
        branches, less what both turns give back. The ends must be `turn` or more apart."""
        import numpy as np

        turn = 2.0 * self.reach
        inner = (x for x in (low + turn, high - turn, *(x for x, _ in self.knots)) if low < x < high)
        begin, end = np.array([*pairwise(sorted({low, high, *inner}))]).T
        taken = 0.0
        for weight, x in ((1.0, begin), (4.0, 0.5 * (begin + end)), (1.0, end)):  # Simpson's rule: exact for squares
            turned = np.maximum(0.0, 1.0 - (x - low) / turn) + np.maximum(0.0, 1.0 - (high - x) / turn)
            taken += weight / 3.0 * float((end - begin) @ (self._h(x) * (1.0 - turned)))
        return taken

    def _h(self, d: Floats | float) -> Floats:
        import numpy as np

        return np.asarray(np.interp(d, self._columns[0], self.half))

    def _as(self, how: str, kind: type[Law], knots: Points, **more: Any) -> Law:
        states = tuple(state.replace("stuck", how) for state in self.states)
        return kind(tuple(knots), self.dampings, states, speeds=self.speeds, memoryless=False, **more)


def extremes(mean: Points, half: tuple[float, ...], reach: float) -> tuple[list[float], list[float]]:
    """Returns the steepest and the least slopes of M' + h' z + h/reach, N/m, below the first of the distances, from
    each to the next, and above the last."""
    steepest, least = [half[0] / reach], [half[0] / reach]
    for ((x, m), (right, up)), (h, after) in zip(pairwise(mean), pairwise(half), strict=True):
        slope, beside = (up - m) / (right - x), abs(after - h) / (right - x)
        steepest.append(slope + beside + max(h, after) / reach)
        least.append(slope - beside + min(h, after) / reach)
    return [*steepest, half[-1] / reach], [*least, half[-1] / reach]


def branch_law(mean: Points, half: Points, turn: float, damping: float, more: float, assumption: str) -> BranchLaw:
    """The law of branches with this mean and half difference (m, N), and this `turn`, m; with `more` N everywhere."""
    flat, halves = curve_law(mean, damping, more), tuple(h for _, h in half)
    low, *slopes, high = extremes(flat.knots, halves, 0.5 * turn)[0]
    states = tuple(f"stuck, {state}" for state in flat.states)
    kind: dict[str, Any] = {"memoryless": False, "reach": 0.5 * turn, "half": halves, "slopes": tuple(slopes)}
    return BranchLaw(flat.knots, flat.dampings, states, low, high, assumption=assumption, **kind)
