"""Growing motions of a network, and the size of the oscillation at an unstable rest.

The oscillation is simulated: the loop of `theory`, on numbers, with the whole law of its links. A kick grows until the
neighbouring pieces limit it. A hand that presses steadily holds the rest at any place.
"""

from __future__ import annotations

import cmath
import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from hapsim.laws import Law
from hapsim.one_thread import one_thread
from hapsim.prediction.linear import stand_in_for
from hapsim.prediction.memory import VERDICTS, content_of
from hapsim.theory import Network, NotWorkedOutError, Solution, solve
from hapsim.theory.arrays import Floats
from hapsim.theory.network import LARGE, SURELY, loop, part_of, parts_of, proves_stability, state_size
from hapsim.theory.network.modes import AT_THE_LIMIT
from hapsim.theory.network.phases import at_worst_phase
from hapsim.theory.network.rest_poles import motions_at_rest
from hapsim.theory.rows import geometry_of, stretches_of
from hapsim.units import Units

UNNOTICED = 100.0
"""Time, s, from which on nobody notices that a motion without an oscillation grows e-fold."""
_PLACES = 256  # limit for all unstable rests; with more no oscillation counts as unnoticed
_KICKS = (-10.0, -1.0, -0.1, 0.1, 1.0, 10.0)  # of a region's width
_WIDE = 1e-2  # m: largest width for a kick
_COUNTS = (3.0, 30.0, 300.0)  # movements of a hand in counts, to test whether an oscillation stays unnoticed
_ASIDE = -0.7  # ratio of a point's kick to that of the one before
_GROWN = 20.0  # e-folds after which a kick is fully grown
_MOST_SAMPLES = 4000
_MOST_STATES = 100  # numbers in the state: limits the time of 4000 samples
_STEADY = 1.05  # ratio of the last quarter to the one before, above which an oscillation still grows
_DRIFT = 0.25  # of an oscillation: largest movement of its middle in a quarter
_NOTICED = 0.02  # of the force limit


class Swing(NamedTuple):
    """Oscillation at its widest, from end to end."""

    point: str
    """Point that moves most."""
    least: float
    """Smallest of the kicks tried, m."""
    most: float
    force: float
    """Force on a hand, N, the largest from end to end."""
    push: float
    """Steady push of the hand at the rest around which it swings widest, N; another push may swing it further."""
    is_unnoticed: bool
    """True if every point moves by less than a count, with almost no force."""

    def sentence(self, units: Units) -> str:
        """Returns the amplitude and force, to follow "swings by"."""
        unit = "mm" if self.most >= 1e-3 else "µm"
        ways = " to ".join(dict.fromkeys(units.number(way, unit, 3) for way in (self.least, self.most)))
        force = f" and up to {units(self.force, 'N', 2)}" if self.force else ""
        pushed = f" while a push of {units(abs(self.push), 'N', 2)} holds it" if self.push else ""
        return f"{units(ways, unit)}{force} from end to end{pushed}"


def has_pieces(law: Law) -> bool:
    """Returns whether a link of this law is more than one spring and one damper."""
    return len(law.pieces) > 1 or bool(law.speeds) or math.isfinite(law.reach)


class Rest(NamedTuple):
    """Rest under a steady push of a hand and the masses that it moves, or the natural rest of masses without a hand."""

    at: float
    """Position of the hand, m."""
    distances: Sequence[float]
    """Distances of the links that have laws, m."""
    press: float
    """Force of the scene on the hand, N."""
    width: float
    """Width of the narrowest piece that a link is in, m; infinite if none has two ends."""
    growth: float
    """Growth of a motion there in a sample."""


class Swinging(NamedTuple):
    """Part of the scene that no link joins to another: at most one hand, masses and links, some with piecewise laws."""

    network: Network
    points: Sequence[str]
    laws: Mapping[int, Law]
    """Laws by the number of the link."""
    force_limit: float
    travel: tuple[float, float]
    """Travel of the hand, m."""
    quantum: float
    """Resolution of a position as the mock sends it, m."""

    @property
    def is_simulated(self) -> bool:
        """True if `_ends` moves this part exactly as a run does."""
        network, laws = self.network, self.laws.values()
        has_memory = any(not law.memoryless for law in laws)
        at_the_sample = network.scheme == "cordis" or all(network.outside[link] for link in self.laws)
        is_small = network.channel_mass.size < 2 and state_size(network) <= _MOST_STATES
        at_once = network.substeps > 1 or network.implicit.any()  # a force acts on others in the same sample
        on_board = network.board is not None  # its bounds and tangents are no pull at the sample
        return is_small and not at_once and not on_board and at_the_sample and not has_memory

    def swing_at(self, rests: Sequence[Rest], is_all: bool = True) -> Swing | None:
        """Returns the largest oscillation at these rests, all unstable. `is_all`: there are no other unstable ones.
        None if it still grew at the end or grows too slowly to decide, if it drifts or decays, if the hand left its
        travel, or if a link has more memory than its damper."""
        if not rests or not self.is_simulated or not all(math.isfinite(one.growth) for one in rests):
            return None
        slowest = min(math.log(one.growth) for one in rests)
        every, hands = rests[:: -(-len(rests) // _PLACES)], self.network.channel_mass.size
        kicks = np.outer([min(one.width, _WIDE) for one in every], _KICKS)
        # A wide swing, of which an unstable piece is a small part, is slow: beside it a quarter may be short.
        for samples in (int(min(_GROWN / slowest, _MOST_SAMPLES)) // 4 * 4 + 8, _MOST_SAMPLES):
            if slowest * (samples // 4) < 2.0 * math.log(_STEADY):
                return None
            ends, stays = self._ends(every, kicks, samples, _ASIDE)
            before, after = (ends[:, 1, hands:] - ends[:, 0, hands:]).max(axis=1)
            drift = np.abs(np.diff(ends[:, :, hands:].mean(axis=1), axis=0)[0]).max(axis=0)
            # A larger steady oscillation bounds one that grows.
            is_bound = stays and bool(np.isfinite(ends).all()) and not (after > _STEADY * before)[:, [0, -1]].any()
            moves = after >= np.abs(kicks).min(axis=1, keepdims=True)
            steady = moves & (after < _STEADY * before) & (before < _STEADY * after) & (drift < _DRIFT * after)
            if is_bound and steady.any():
                break
        else:
            return None
        worst, kick = np.unravel_index(np.where(steady, after, 0.0).argmax(), after.shape)
        spans = ends[1, 1] - ends[1, 0]
        force = float(spans[:hands, worst, steady[worst]].max(initial=0.0))
        swing = Swing(
            point=self.points[int(spans[hands:, worst, kick].argmax())],
            least=float(after[worst][steady[worst]].min()),
            most=float(after[worst, kick]),
            force=force,
            push=every[int(worst)].press if hands else 0.0,
            is_unnoticed=False,
        )
        is_small = is_all and len(every) == len(rests) and bool(moves.any(axis=1).all()) and self._is_small(ends[1])
        if is_small:  # again after a movement of the hand
            low, high = self.travel
            ways = [side * counts * self.quantum for side in (-1.0, 1.0) for counts in _COUNTS]
            kicks = np.array([[min(max(way, low - one.at), high - one.at) for way in ways] for one in every])
            ends, stays = self._ends(every, kicks, _MOST_SAMPLES, 0.0)
            is_small = stays and bool(np.isfinite(ends).all()) and self._is_small(ends[1])
        return swing._replace(is_unnoticed=is_small)

    def _is_small(self, ends: Floats) -> bool:
        """Returns whether every point moves by less than a count, with almost no force."""
        spans, hands = ends[1] - ends[0], self.network.channel_mass.size
        force, way = spans[:hands].max(initial=0.0), spans[hands:].max()
        return bool(way < self.quantum and force < _NOTICED * self.force_limit)

    @np.errstate(all="ignore")
    def _ends(self, rests: Sequence[Rest], kicks: Floats, samples: int, aside: float) -> tuple[Floats, bool]:
        """Least and largest values (2, 2, C + C + M, rests, kicks) in the last two quarters: N on the hand and m of
        every point; and whether the hand stayed within its travel. `aside`: ratio of a point's kick to that of the one
        before."""
        links, hands, limit = [*self.laws], self.network.channel_mass.size, self.force_limit
        springs = self.network.stiffness.copy(), self.network.damping.copy()
        for linear in springs:
            linear[links] = 0.0
        change, points, push, computed, (stretch, rate), _ = loop(
            replace(self.network, stiffness=springs[0], damping=springs[1]), inputs=True
        )
        stretch, rate = stretch[links], self.network.rate * rate[links]
        pulled = -geometry_of(self.network, sparse=False)[1][links].T
        each = np.repeat(np.arange(len(rests)), kicks.shape[1])
        rest = np.array([one.distances for one in rests]).reshape(len(rests), -1).T[:, each]
        at, press = (np.array([getattr(one, what) for one in rests])[each] for what in ("at", "press"))
        held = self._pulls(rest, 0.0 * rest)
        state, stays, found = np.zeros((len(change), kicks.size)), True, []
        # Neighbours are kicked to opposite sides, to excite the links between them.
        state[: len(points)] = np.outer(aside ** np.arange(len(points)), kicks.ravel())
        for quarter in range(4):
            ends = np.full((2, hands + len(points), kicks.size), np.nan)
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
            found.append(ends.reshape(2, -1, *kicks.shape))
        return np.array(found[2:]), stays

    def _pulls(self, d: Floats, speed: Floats) -> Floats:
        """Pulls (laws, n), N."""
        pulls = [law.pull(*one) for law, *one in zip(self.laws.values(), d, speed, strict=True)]
        return np.array(pulls).reshape(d.shape)


_MANY_STATES = 40  # fewer eigenvalues take one thread anyway
_SQUARED = 24  # most squarings: a motion that takes more than 2^24 samples to decay is close to the limit
_REAL = 1e-6  # of a pole's modulus: a smaller imaginary part is rounding
_GONE = 0.5  # norm of a power, below which all moduli are below 1
_MOST_NORM = 1e5  # of the norms before: above, rounding of the squares, 1e-16 of their own, would matter


class Shaking(NamedTuple):
    """Motion that surely grows."""

    growth: float
    """Factor in a sample, above 1."""
    module: str
    """Module that moves most in it; "" if its motion was not found."""
    state: str = ""
    """State of the contacts in its part of the scene, such as "finger is apart"; "" in the assumed state."""
    swing: Swing | None = None
    """Oscillation that it grows to, if found."""
    snaps: int = 0
    """Number of snaps beside it."""

    @property
    def rank(self) -> tuple[bool, float]:
        """Order by growth, behind those that a snap cuts short."""
        return not self.snaps, self.growth

    def sentence(self, units: Units) -> str:
        """Returns the sentence with what would help, without a full stop."""
        return f"{self.motion(units)}; reduce the stiffness there, change its damping, add mass or raise the rate"

    def motion(self, units: Units) -> str:
        """Returns the sentence, without a full stop."""
        by = "beyond the range of numbers" if self.growth > 1e300 else f"{self.growth:.3g}-fold"
        if self.growth < 2.0:
            by = f"by {100.0 * (self.growth - 1.0):.2g} %"
        whose = f"the motion of {self.module}" if self.module else "a motion"
        when = f" while {self.state}" if self.state else ""
        if self.swing is not None:
            when += f", to an oscillation of {self.swing.sentence(units)}"
        return f"{whose} grows {by} per sample{when}"


def _is_positive(pole: complex) -> bool:
    """Returns whether a pole is real and positive: its motion does not oscillate."""
    return abs(pole.imag) <= _REAL * abs(pole) and pole.real > 0.0


def drop_real_poles(poles: Iterable[complex], count: int) -> list[complex]:
    """Returns the poles without the ``count`` largest real positive ones: these are the snaps, which drive a point
    on."""
    rest = list(poles)
    for _ in range(count):
        real = [pole for pole in rest if _is_positive(pole)]
        if real:
            rest.remove(max(real, key=abs))
    return rest


class Solved(NamedTuple):
    """Network with its poles and modes, and a sentence if it stands in for another (`stand_in_for`); else ""."""

    network: Network
    solution: Solution
    instead: str


@dataclass(eq=False)
class NetworkVerdict:
    """Poles of a network, and its growing motions, computed on demand.

    Attributes:
        network: as the theory sees it; of several clocks at their worst phase. points: the names of its points.
    """

    network: Network
    points: tuple[str, ...]

    def __post_init__(self) -> None:
        self.network = at_worst_phase(self.network)

    def _one_thread(self) -> AbstractContextManager[Any]:
        return one_thread(_MANY_STATES < state_size(self.network) <= LARGE)

    @cached_property
    def solved(self) -> Solved:
        """Network with its poles and modes, or its stand-in if they cannot be computed."""
        with self._one_thread():
            try:
                return Solved(self.network, solve(self.network), "")
            except NotWorkedOutError as reason:
                instead, sentence = stand_in_for(self.network, reason)
                return Solved(instead, solve(instead), sentence)

    @cached_property
    def _change(self) -> Floats | None:
        """Change of the state from one sample to the next; None of a large scene, or if it cannot be computed."""
        if state_size(self.network) > LARGE:
            return None
        with contextlib.suppress(NotWorkedOutError):
            return loop(self.network).change
        return None

    @cached_property
    @np.errstate(all="ignore")
    def decays(self) -> bool:
        """True if squares of the transition show that every motion decays, in a fifth of the time that eigenvalues
        take. False proves nothing."""
        with self._one_thread():
            if self._change is None:
                return False
            power = self._change + np.eye(len(self._change))
            for _ in range(_SQUARED):
                norm = np.abs(power).sum(axis=0).max(initial=0.0)
                if not _GONE <= norm < _MOST_NORM:
                    return bool(norm < _GONE)
                power = power @ power
        return False

    @property
    def rests(self) -> int:
        """Number of motions that nothing drives and no spring holds: a pole at 1 each, if something brakes it."""
        return motions_at_rest(self.solved.network)[0]

    @cached_property
    def settles(self) -> bool:
        """True if every motion decays, or rests at any place. What grows more slowly than a hand notices rests."""
        solution, most = self.solved.solution, 1.0 + 1.0 / (UNNOTICED * self.network.rate)
        poles = solution.poles
        at_rest = (poles.imag == 0.0) & (poles.real >= 1.0 - AT_THE_LIMIT) & (poles.real < most)
        decays = float(np.abs(poles[~at_rest]).max(initial=solution.growth)) < 1.0 - AT_THE_LIMIT
        return decays and int(at_rest.sum()) <= self.rests

    @property
    def _stays(self) -> bool:
        """True if no pole's modulus says that a motion surely grows. False proves nothing."""
        with self._one_thread():
            change = self._change
            if change is None or not np.isfinite(change).all():
                return False
            return bool(np.abs(1.0 + np.linalg.eigvals(change)).max(initial=0.0) <= SURELY)

    @cached_property
    def snaps(self) -> int:
        """Number of unstable directions at rest: as many real poles belong to a snap, which moves the points on."""
        network = self.network
        if not (network.stiffness[: network.margin_links] < 0.0).any():  # those of a bending bar push nothing away
            return 0
        stretches = stretches_of(network, sparse=False)
        held = np.append(network.channel_stiffness, np.zeros(network.point_mass.size))
        stiffness = np.linalg.eigvalsh(stretches.T @ (network.stiffness[:, None] * stretches) + np.diag(held))
        return int((stiffness < -1e-9 * np.abs(stiffness).max(initial=0.0)).sum())

    @property
    def swing_growth(self) -> float:
        """Factor by which the slowest oscillation to decay grows in a sample; 0 if there is none."""
        poles = self.solved.solution.poles.tolist()
        return max((abs(pole) for pole in poles if not _is_positive(pole)), default=0.0)

    def may_grow(self, most_angle: float = math.inf) -> bool:
        """Returns False if no motion surely grows, as `shaken_by_network`, in a fifth of its time."""
        if self.snaps or math.isfinite(most_angle):
            return self.shaken_by_network(most_angle) is not None
        return not self._stays

    def shaken_by_network(self, most_angle: float = math.inf) -> Shaking | None:
        """Returns the motion that surely grows, apart from snaps; None also if the poles cannot be computed for the
        scheme. `most_angle`: turn of a motion in a sample, rad, above which it does not count."""
        key = content_of(type(self).__name__, self.network, self.points, most_angle)
        return cast(Shaking | None, VERDICTS.recall(key, lambda: (self._shaken(most_angle), ())))

    @property
    def _is_quiet(self) -> bool:
        """True if it is quickly found that no motion surely grows: in each part that no link joins to another, if there
        are several in a network that is not small. False proves nothing."""
        if state_size(self.network) > _MANY_STATES:
            part = parts_of(self.network, (self.network.stiffness != 0.0) | (self.network.damping != 0.0))
            parts = [np.flatnonzero(part == its) for its in np.unique(part)]
            each = ((part_of(self.network, its), tuple(self.points[i] for i in its.tolist())) for its in parts)
            if len(parts) > 1 and all(
                proves_stability(one) or NetworkVerdict(one, names).shaken_by_network() is None for one, names in each
            ):
                return True
        return self.decays or self._stays

    def _shaken(self, most_angle: float) -> Shaking | None:
        if not self.snaps and self._is_quiet:
            return None
        solution = self.solved.solution
        if self.solved.instead:
            return None
        if math.isnan(solution.spectral_radius):
            return Shaking(math.inf, "")
        poles = drop_real_poles(solution.poles.tolist(), self.snaps)
        radius = max([solution.growth, *(abs(pole) for pole in poles if abs(cmath.phase(pole)) <= most_angle)])
        if not radius > SURELY:
            return None
        near = min(solution.modes, key=lambda mode: abs(abs(mode.pole) - radius), default=None)
        if near is None or abs(near.pole) < radius * (1.0 - 1e-9):
            return Shaking(radius, "", snaps=self.snaps)
        return Shaking(radius, self.points[int(np.argmax(near.participation))].partition(".")[0], snaps=self.snaps)
