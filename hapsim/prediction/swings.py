"""How large a swing gets where a rest is unstable: the loop of `theory`, on numbers, with the whole law of its links.
A kick grows until pieces beside bound it; a hand that presses steadily holds the rest at any place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.laws import Law
from hapsim.number_format import number
from hapsim.theory import Network
from hapsim.theory.arrays import Floats
from hapsim.theory.network import loop, state_size
from hapsim.theory.rows import stretches_of

_PLACES = 256  # at most, of all unstable rests
_KICKS = (-10.0, -1.0, -0.1, 0.1, 1.0, 10.0)  # of a region's width
_WIDE = 1e-3  # m: of a region that has no end
_ASIDE = -0.7  # of a point's kick, that of the next
_GROWN = 20.0  # e-folds, after which a kick has become what it can
_MOST_SAMPLES = 4000
_MOST_STATES = 100  # numbers in the state, of 4000 samples of which nobody waits for long
_STEADY = 1.05  # a swing that is larger in the last quarter than in the one before by more still grows
_NOTICED = 0.02  # of the force limit


class Swing(NamedTuple):
    """From one end to the other, where it is widest."""

    point: str
    """That moves most."""
    least: float
    """m, of the kicks tried."""
    most: float
    force: float
    """N, at the most from end to end, on a hand."""
    is_unnoticed: bool
    """Whether nothing moves by a count, and next to no force."""

    @property
    def sentence(self) -> str:
        """How far and how hard, in words that follow "swings by"."""
        scale, unit = (1e3, "mm") if self.most >= 1e-3 else (1e6, "µm")
        ways = dict.fromkeys(number(scale * way, 3) for way in (self.least, self.most))
        force = f" and up to {number(self.force, 2)} N" if self.force else ""
        return f"{' to '.join(ways)} {unit}{force} from end to end"


def has_pieces(law: Law) -> bool:
    """Whether a link of this law is more than one spring and one damper."""
    return len(law.pieces) > 1 or bool(law.speeds) or math.isfinite(law.reach)


class Rest(NamedTuple):
    """Where a steady push holds a hand and what it moves, or where what no hand moves rests by itself."""

    at: float
    """m, of the hand."""
    distances: Sequence[float]
    """m, of the links that have laws."""
    press: float
    """N, of the scene on the hand."""
    width: float
    """m, of the narrowest piece that a link is in; infinite where none has two ends."""
    growth: float
    """By how much a motion grows there in a sample."""


class Swinging(NamedTuple):
    """A part of the scene that no link joins to another: one hand or none, masses, and links some of which have laws
    that say more than the network does."""

    network: Network
    points: Sequence[str]
    laws: Mapping[int, Law]
    """By the number of the link."""
    force_limit: float
    travel: tuple[float, float]
    """m, of the hand."""
    quantum: float
    """m, of a position as the mock sends it."""

    @property
    def is_simulated(self) -> bool:
        """Whether `_ends` moves it as a run does."""
        network, laws = self.network, self.laws.values()
        has_memory = any(math.isfinite(law.reach) or law.grips for law in laws)
        at_the_sample = network.scheme == "cordis" or all(network.outside[link] for link in self.laws)
        is_small = network.channel_mass.size < 2 and state_size(network) <= _MOST_STATES
        return is_small and network.substeps == 1 and at_the_sample and not has_memory

    def swing_at(self, rests: Sequence[Rest]) -> Swing | None:
        """The largest at these rests, none of which is stable.

        None where it still grew at the end or grows too slowly to tell, where the hand left its travel or nothing moved
        though each rest drives it off, where all rests are beyond the force limit, and where a link remembers more than
        its damper does.
        """
        # Beyond the force limit the force is constant there, and drives nothing.
        rests = [one for one in rests if abs(one.press) <= self.force_limit]
        if not rests or not self.is_simulated or not all(math.isfinite(one.growth) for one in rests):
            return None
        slowest = min(math.log(one.growth) for one in rests)
        samples = int(min(_GROWN / slowest, _MOST_SAMPLES)) // 4 * 4 + 8
        if slowest * (samples // 4) < 2.0 * math.log(_STEADY):
            return None
        every = rests[:: -(-len(rests) // _PLACES)]
        kicks = np.outer([one.width if math.isfinite(one.width) else _WIDE for one in every], _KICKS)
        with np.errstate(all="ignore"):
            (before, after), stays = self._spans(every, kicks.ravel(), samples)
        hands = self.network.channel_mass.size
        widest = after[hands:].max(axis=0).reshape(kicks.shape)
        still = widest > _STEADY * before[hands:].max(axis=0).reshape(kicks.shape)
        # A larger swing that is steady bounds one that grows.
        if not np.isfinite([before, after]).all() or not stays or still[:, [0, -1]].any():
            return None
        if widest.max() < np.abs(kicks).min():
            return None
        worst, kick = np.unravel_index(widest.argmax(), widest.shape)
        spans = after.reshape(-1, *kicks.shape)[:, worst]
        force, most = float(spans[:hands].max(initial=0.0)), float(widest.max())
        is_unnoticed = most < self.quantum and force < _NOTICED * self.force_limit
        point = self.points[int(spans[hands:, kick].argmax())]
        return Swing(point, float(widest[worst][~still[worst]].min()), most, force, is_unnoticed)

    def _spans(self, rests: Sequence[Rest], kicks: Floats, samples: int) -> tuple[Floats, bool]:
        """(2, C + C + M, n): from end to end in the last two quarters, N on the hand and m of every point; whether the
        hand stayed within its travel."""
        links, hands, limit = [*self.laws], self.network.channel_mass.size, self.force_limit
        springs = self.network.stiffness.copy(), self.network.damping.copy()
        for linear in springs:
            linear[links] = 0.0
        change, points, push, computed, (stretch, rate) = loop(
            replace(self.network, stiffness=springs[0], damping=springs[1]), inputs=True
        )
        stretch, rate = stretch[links], self.network.rate * rate[links]
        pulled = -stretches_of(self.network, sparse=False)[links].T
        each = np.repeat(np.arange(len(rests)), len(_KICKS))
        rest = np.array([one.distances for one in rests]).reshape(len(rests), -1).T[:, each]
        at, press = (np.array([getattr(one, what) for one in rests])[each] for what in ("at", "press"))
        held = self._pulls(rest, 0.0 * rest)
        state, stays, spans = np.zeros((len(change), kicks.size)), True, []
        # Neighbours are kicked to either side, so that what is between them is too.
        state[: len(points)] = np.outer(_ASIDE ** np.arange(len(points)), kicks)
        for quarter in range(4):
            ends = np.full((2, 2 * hands + self.network.point_mass.size, kicks.size), np.nan)
            for _ in range(samples // 4):
                pushed = pulled @ (self._pulls(rest + stretch @ state, rate @ state) - held)
                linear = computed @ state
                force = np.clip(press + linear + pushed[:hands], -limit, limit)
                pushed[:hands] = force - press - linear
                places = points @ state
                if quarter >= 2:
                    now = np.vstack([force, places])
                    ends = np.array([np.fmin(ends[0], now), np.fmax(ends[1], now)])
                x = at + places[:hands]
                stays &= bool(((x >= self.travel[0]) & (x <= self.travel[1])).all())
                state = state + change @ state + push @ pushed
            spans.append(ends[1] - ends[0])
        return np.array(spans[2:]), stays

    def _pulls(self, d: Floats, speed: Floats) -> Floats:
        """(laws, n): N."""
        pulls = [law.pull(*one) for law, *one in zip(self.laws.values(), d, speed, strict=True)]
        return np.array(pulls).reshape(d.shape)
