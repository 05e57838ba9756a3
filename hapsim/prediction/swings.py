"""How large a hand's swing gets where its rest is unstable: the loop of `theory`, on numbers, with the whole law of its
links. A kick grows until pieces beside bound it; a hand that presses steadily holds it at any place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapsim.number_format import number
from hapsim.prediction.characteristic import Characteristic
from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats

_PLACES = 256  # at most, of all unstable regions
_KICKS = (-10.0, -1.0, -0.1, 0.1, 1.0, 10.0)  # of a region's width
_WIDE = 1e-3  # m: of a region that has no end
_GROWN = 20.0  # e-folds, after which a kick has become what it can
_MOST_SAMPLES = 4000
_STEADY = 1.05  # a swing that is larger in the last quarter than in the one before by more still grows


class Swing(NamedTuple):
    """From one end to the other, where the hand swings most."""

    least: float
    """m, of the kicks tried."""
    most: float
    force: float
    """N, at the most from end to end."""

    @property
    def sentence(self) -> str:
        """How far and how hard, in words that follow "swings by"."""
        scale, unit = (1e3, "mm") if self.most >= 1e-3 else (1e6, "µm")
        ways = dict.fromkeys(number(scale * way, 3) for way in (self.least, self.most))
        return f"{' to '.join(ways)} {unit} and up to {number(self.force, 2)} N from end to end"


class Place(NamedTuple):
    """Where a steady push holds the hand, m; the width of its region, m; by how much a motion grows there in a
    sample."""

    at: float
    width: float
    growth: float


def swing_in(hand: Characteristic, loop: Configuration, places: Sequence[Place]) -> Swing | None:
    """The largest of the hand's at these places, none of which is stable.

    None where it still grew at the end or grows too slowly to tell, where the hand left its travel or came to rest
    though each place drives it off, and where all places are beyond the force limit.
    """
    # Beyond the force limit the force is constant there, and drives nothing.
    presses = np.abs(_force(hand, np.array([one.at for one in places]), np.zeros(len(places))))
    places = [one for one, press in zip(places, presses, strict=True) if press <= hand.force_limit]
    if not places:
        return None
    slowest = min(math.log(one.growth) for one in places)
    samples = int(min(_GROWN / slowest, _MOST_SAMPLES)) // 4 * 4 + 8
    if slowest * (samples // 4) < 2.0 * math.log(_STEADY):
        return None
    every = places[:: -(-len(places) // _PLACES)]
    at = np.repeat([one.at for one in every], len(_KICKS))
    kicks = np.outer([one.width if math.isfinite(one.width) else _WIDE for one in every], _KICKS).ravel()
    with np.errstate(all="ignore"):
        ways, forces, stays = _ends(hand, loop, at, kicks, samples)
    before, after = ways.reshape(2, -1, len(_KICKS))
    still = after > _STEADY * before
    # A larger swing that is steady bounds one that grows.
    if not np.isfinite(ways).all() or not stays or still[:, [0, -1]].any() or after.max() < np.abs(kicks).min():
        return None
    worst = np.unravel_index(after.argmax(), after.shape)[0]
    steady = after[worst][~still[worst]]
    return Swing(float(steady.min()), float(after.max()), float(forces.reshape(after.shape)[worst].max()))


def _ends(
    hand: Characteristic, configuration: Configuration, at: Floats, kicks: Floats, samples: int
) -> tuple[Floats, Floats, bool]:
    """(2, n): m, from end to end in the last two quarters; (n,): N, in the last; whether the hand stayed within its
    travel."""
    loop, limit = configuration.normalised_loop, hand.force_limit
    state = np.zeros((len(loop.change), at.size))
    state[loop.moving[0]] = kicks
    held = np.clip(_force(hand, at, 0.0 * at), -limit, limit)
    ends, stays = [], True
    for quarter in range(4):
        low, high, weak, strong = (sign * np.full(at.size, np.inf) for sign in (1.0, -1.0, 1.0, -1.0))
        for _ in range(samples // 4):
            away, rate = loop.reads @ state
            force = np.clip(_force(hand, at + away - loop.lag * rate, rate * configuration.rate), -limit, limit)
            state = state + loop.change @ state + np.outer(loop.push, (held - force) / configuration.stiffness_unit)
            if quarter >= 2:
                low, high = np.minimum(low, away), np.maximum(high, away)
                weak, strong = np.minimum(weak, force), np.maximum(strong, force)
            stays &= bool(((at + away >= hand.low) & (at + away <= hand.high)).all())
        ends.append((high - low, strong - weak))
    return np.array([ends[2][0], ends[3][0]]), ends[3][1], stays


def _force(hand: Characteristic, x: Floats, speed: Floats) -> Floats:
    """N, of the links."""
    force = 0.0 * x
    for link in hand.links.values():
        law, d = link.law, link.distance(x)
        force = force + link.sign * np.minimum(law.tension(d) + law.damping_along(d) * link.sign * speed, law.most)
    return np.asarray(force)
