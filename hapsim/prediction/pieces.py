"""The pieces of its law that a link can be in: each a spring and a damper."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

from hapsim.laws import Law, Linear


class Option(NamedTuple):
    """A piece of a link's law, in which it is this spring and damper: its distance is between these two, m."""

    state: str
    linear: Linear
    low: float = -math.inf
    high: float = math.inf
    through: bool = False
    """Whether its ends have to meet before."""
    moved: float = 0.0
    """By how much its ends have to move before, m."""
    period: float = 0.0
    """m, in which the piece repeats; 0: it does not."""

    def at_pace(self, pace: str, damping: float | None) -> Option:
        """The same while its ends move so; `damping`: N·s/m, if it is another then."""
        linear = self.linear if damping is None else self.linear._replace(damping=damping)
        return self._replace(state=f"{self.state} and {pace}" if self.state else pace, linear=linear)

    def near(self, d: float) -> tuple[float, float]:
        """From where to where the piece goes that is nearest to this distance, m."""
        middle = 0.5 * (self.low + self.high)
        away = self.period * round((d - middle) / self.period) if self.period else 0.0
        return self.low + away, self.high + away

    @property
    def acts(self) -> bool:
        """Whether it is a spring or a damper at all."""
        return self.linear.stiffness != 0.0 or self.linear.damping != 0.0


def options_of(law: Law, fastest: float = 1.0) -> tuple[Option, ...]:
    """The pieces that a link of this law can be in, alike neighbours as one; one for a link that is always the same.
    `fastest`: how fast its ends part, m/s."""
    here = law.linear()
    pieces = [(piece, here._replace(stiffness=piece.slope, damping=piece.damping)) for piece in law.pieces]
    if math.isfinite(law.reach):
        return Option("stuck", here), Option("sliding", here._replace(stiffness=0.0, damping=0.0), moved=law.reach)
    if law.grips:
        (_, gripping, _), edge = pieces, law.edges[-1]
        free = here._replace(stiffness=0.0, damping=0.0)
        return Option("gripping", gripping[1], -edge, edge, through=True), Option("released", free)
    ends = [(piece.edge, after.edge) for (piece, _), (after, _) in pairwise(pieces)]
    ends.append((pieces[-1][0].edge, pieces[0][0].edge + law.period if law.period else math.inf))
    found: list[Option] = []
    for (piece, linear), (low, high) in zip(pieces, ends, strict=True):
        if found and (found[-1].linear, found[-1].state) == (linear, piece.state):
            found[-1] = found[-1]._replace(high=high)
        elif not law.period or linear not in [one.linear for one in found]:
            found.append(Option(piece.state, linear, low, high, period=law.period))
    dampings = law.dampings_at(fastest)
    if dampings:
        paces = [("slow", None), *(("fast" if damping else "faster than its table", damping) for damping in dampings)]
        found = [one.at_pace(pace, damping) for pace, damping in paces for one in found]
    return tuple(found)


State = dict[str, Option]
"""How each link of a part of the scene is, by name."""
