"""Motion of hands on a board that follows lines (`law: board`), simulated on numbers: the swings that go on.

Poles judge each piece of a law. A line carries one piece, and the hand may have crossed to the next before it acts: so
pushed hands are simulated, many motions at once, with the lines that the host finds for them
(`hapsim/cordis/board_line.py` has the rule). Masses behind the hands move as the theory's `Tick` moves them, the hands
exactly between local periods. Counts, noise and soft starts are not simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hapsim.laws import Law
from hapsim.prediction.linear import LinearScene, fastest_motion
from hapsim.prediction.memory import VERDICTS, content_of
from hapsim.prediction.reach import part_with_laws, pulls_itself, start_positions
from hapsim.prediction.swings import Swing
from hapsim.scene import Scene
from hapsim.theory import Network
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.device_step import device_step
from hapsim.theory.interface import damper_named, whole_and_fraction
from hapsim.theory.network import parts_of
from hapsim.theory.rows import stretches_of

_TRIES = 400  # pushed hands: a swing that one push in 133 starts is missed by 5 % of such sets
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532])  # R2 of M. Roberts: points that fill a square evenly
_BLOCK, _SETTLES, _JUDGED = 400, 3, 5  # samples; blocks in which a motion finds its swing, and that are judged
_LATER = 25  # blocks before what goes on is judged again: some motions take seconds to come to rest
_LEAST = 10.0  # quanta: a smaller swing is none
_MOST_MASSES = 50  # of a part
_KEPT, _NO_DECAY = 0.98, 0.999  # of a swing over two blocks: what keeps less dies away
_DRIFT = 0.25  # of a swing: largest movement of its middle in a block
_MOST_KNOTS = 256  # of a law within a hand's reach: as many as the loop takes
_CHORD = 0.1  # of the law's range on a chord: most that the law leaves it
_FLAT, _INSIDE = 1e-9, 1e-7


def _edges(law: Law, low: Floats, high: Floats) -> Floats:
    """Edges (k, n) of a law between, with the next on both sides; infinite where there are no more."""
    edges, period, count = np.array(law.edges), law.period, len(law.edges)
    turns = [np.floor((d - edges[0]) / period) if period else 0.0 for d in (low, high)]
    first, last = (
        (edges.searchsorted(d - turn * period, side="right") + turn * count).astype(int)
        for d, turn in zip((low, high), turns, strict=True)
    )
    most = min(int((last - first).max()) + 2, _MOST_KNOTS)
    number = np.minimum(first - 1 + np.arange(most)[:, None], last)
    if period:
        return np.asarray(edges[number % count] + period * (number // count))
    return np.asarray(np.array([np.inf, *law.edges, np.inf])[number + 1])


class _Hand:
    """The links at one hand: their law over its place, and its lines. `ends` (L, n): distance of each link, m, with the
    hand at 0; `ways`: the change of these in a sample."""

    def __init__(self, number: int, part: LinePart) -> None:
        network, board, sides = part.network, part.network.board, part.rows[:, number]
        assert board is not None
        self._links = [
            (i, float(sides[i]), part.curves.get(i), float(part.stiffness[i]), float(part.damping[i]))
            for i in np.flatnonzero(sides).tolist()
        ]
        self.others = part.rows.copy()
        self.others[:, number] = 0.0
        self._rate, self._limit = network.rate, part.force_limit
        self._lead, self._until = network.delay + board.delay / board.steps, network.delay + 2.0
        mass = network.channel_mass[number]
        self._least_reach = 0.5 * part.force_limit / mass * (self._until / network.rate) ** 2
        self._fastest = part.fastest / network.rate

    def _force(self, x: Floats, ends: Floats) -> Floats:
        """Force, N, at places (q, n) or (n,)."""
        force = np.zeros(x.shape)
        for i, side, curve, stiffness, _ in self._links:
            d = side * x + ends[i]
            force -= side * (stiffness * d if curve is None else curve.tension(d))
        return force

    def _law(self, x: Floats, ends: Floats) -> tuple[Floats, Floats]:
        """Force, N, at places (q, n) or (n,), and the slope with which it resists, N/m."""
        force, slope = np.zeros(x.shape), np.zeros(x.shape)
        for i, side, curve, stiffness, _ in self._links:
            d = side * x + ends[i]
            tension, k, _ = (stiffness * d, stiffness, 0.0) if curve is None else curve.local(d)
            force -= side * tension
            slope += k
        return force, slope

    def line(self, x: Floats, way: Floats, ends: Floats, ways: Floats) -> Floats:
        """Lines (6, n) of hands at x m that moved by `way` m in the last sample: F, k, b (N·s/m), low, high and x."""
        moved = np.abs(way)
        reach = np.minimum(moved, self._fastest) * self._until + self._least_reach
        knots = self._knots(x, reach, ends)
        between = np.minimum(np.maximum(knots, x - reach), x + reach)
        inside = _INSIDE * (between[1:] - between[:-1])
        forces = self._force(np.concatenate([between[:-1] + inside, between[1:] - inside]), ends)
        bounds = forces.min(axis=0), forces.max(axis=0)
        begin = x + way * self._lead
        tangent = self._tangent(knots, np.array([x, begin + 0.5 * way]), reach, ends, bounds)
        near, far = np.minimum(begin, begin + way), np.maximum(begin, begin + way)
        low, high = knots[:-1], knots[1:]
        narrow = ((high > low) & (high - low < moved) & (low < far) & (high > near)).any(axis=0)
        if narrow.any():
            chord = self._chord(knots, begin, way, ends, bounds)
            tangent = [np.where(narrow, *both) for both in zip(chord, tangent, strict=True)]
        return self._numbers(tangent, x, ends, ways)

    def _numbers(self, line: Sequence[Floats], x: Floats, ends: Floats, ways: Floats) -> Floats:
        """Lines (6, n) of places, forces, slopes and bounds there."""
        at, force, slope, low, high = line
        b, drift, free, free_drift = np.zeros((4, x.size))
        for i, side, curve, _, damping in self._links:
            own = damping if curve is None else curve.damping_along(side * at + ends[i])
            moved = (-side * self._rate) * ways[i] * own
            b += own
            drift += moved
            if curve is None or not curve.pushes:
                free += own
                free_drift += moved
        widest = free * (self._fastest * self._rate)
        low, high = (
            np.minimum(np.maximum(one, -self._limit), self._limit)
            for one in (low + free_drift - widest, high + free_drift + widest)
        )
        return np.array([force + slope * (at - x) + drift, slope, b, low, high, x])

    def _knots(self, x: Floats, reach: Floats, ends: Floats) -> Floats:
        """Places (k, n) of the law's knots around x, ascending from -infinity to infinity."""
        found = [np.full((1, x.size), -np.inf), np.full((1, x.size), np.inf)]
        for i, side, curve, *_ in self._links:
            if curve is not None:
                d = side * x + ends[i]
                edges = _edges(curve, d - reach, d + reach) - ends[i]
                found.append(np.where(edges < np.inf, side * edges, np.inf))
        return np.sort(np.concatenate(found), axis=0)

    def _tangent(self, knots: Floats, places: Floats, reach: Floats, ends: Floats, bounds: Any) -> Any:
        """Places of tangents, their forces, slopes and bounds: in the middle of the way, in a stiffer piece of the
        hand, or in a sloping one beside a flat one. `places`: of the hand and of the middle."""
        (x, middle), (own, there) = places, _pieces_around(knots, places)
        (force_here, force), (here, slope) = self._law(places, ends)
        stays = (own != there).any(axis=0) & (here > np.maximum(slope, 0.0))
        at, slope, piece = np.where(stays, x, middle), np.where(stays, here, slope), np.where(stays, own, there)
        force = np.where(stays, force_here, force)
        bounds = self._with_piece(bounds, piece, at, force, slope, reach, ends)
        apart = np.abs(piece - x)
        least = _FLAT * (bounds[1] - bounds[0])
        flat = (np.abs(slope) * reach <= least) & ((force <= bounds[0]) | (force >= bounds[1]))
        flat &= apart.min(axis=0) <= reach
        if not flat.any():
            return at, force, slope, *bounds
        below = apart[0] <= apart[1]
        edge = np.where(flat, np.where(below, *piece), 0.0)
        other = _pieces_around(knots, np.nextafter(edge, np.where(below, -np.inf, np.inf))[None])[0]
        ended = np.isfinite(other)
        inner = np.where(
            ended[0] & ended[1], 0.5 * other.sum(axis=0), np.where(ended[0], other[0] + reach, other[1] - reach)
        )
        inner = np.where(flat & ended.any(axis=0), inner, at)
        force_beside, beside = self._law(inner, ends)
        flat &= np.abs(beside) * reach > least
        line = at, force, slope, *bounds
        wider = self._with_piece(bounds, other, inner, force_beside, beside, reach, ends)
        return [np.where(flat, *both) for both in zip((inner, force_beside, beside, *wider), line, strict=True)]

    def _with_piece(
        self, bounds: Any, piece: Floats, at: Floats, force: Floats, slope: Floats, reach: Floats, ends: Floats
    ) -> Any:
        """Bounds with those of the law over a piece, in which it is `force` at `at`."""
        inside = _INSIDE * np.minimum(piece[1] - piece[0], reach)
        ended = np.isfinite(piece)
        both = self._force(np.where(ended, piece + [[1.0], [-1.0]] * inside, at), ends)
        (open_low, open_high), rising, falling = ~ended, slope > 0.0, slope < 0.0
        falls, rises = (open_low & falling) | (open_high & rising), (open_low & rising) | (open_high & falling)
        low = np.where(falls, -np.inf, np.minimum(np.minimum(*both), np.minimum(force, bounds[0])))
        high = np.where(rises, np.inf, np.maximum(np.maximum(*both), np.maximum(force, bounds[1])))
        return low, high

    def _chord(self, knots: Floats, begin: Floats, way: Floats, ends: Floats, bounds: Any) -> Any:
        """Places of lines across narrow pieces, their forces, slopes and bounds."""
        end = begin + way
        inside = (knots > np.minimum(begin, end)) & (knots < np.maximum(begin, end))
        places = np.concatenate([[begin, end], np.where(inside, knots, begin)])
        forces, slopes = self._law(places, ends)
        slope = (forces[0] - forces[1]) / np.where(way == 0.0, np.inf, way)
        off = np.abs(forces - forces[0] + slope * (places - begin)).max(axis=0)
        low, high = forces.min(axis=0), forces.max(axis=0)
        is_good = (slope > 0.0) & (off <= _CHORD * (high - low))
        slope = np.where(is_good, slope, np.maximum(slopes[0], 0.0))
        return begin, forces[0], slope, np.minimum(low, bounds[0]), np.maximum(high, bounds[1])


def _pieces_around(knots: Floats, places: Floats) -> Floats:
    """Ends (q, 2, n) of the pieces around these places (q, n), m; infinite without one."""
    number = (knots[None, 1:-1] <= places[:, None]).sum(axis=1)
    columns = np.arange(knots.shape[1])
    return np.stack([knots[number, columns], knots[number + 1, columns]], axis=1)


class LinePart:
    """Part of a scene, on a board, whose hands and masses no link joins to another.

    Attributes:
        network, points: of the part. curves: laws with pieces, by the number of the link.
        fixed: (L,) m, distance of each link's ends with all points at 0.
        force_limit: N. fastest: lasting motion of a hand, m/s. travel: of the hands, (C, 2), m.
        stiffness, damping: of the other links, (L,) N/m and N·s/m.
    """

    def __init__(
        self, network: Network, points: Sequence[str], laws: Mapping[int, Law], fixed: Floats, **more: Any
    ) -> None:
        """`more`: force_limit, fastest, travel."""
        self.network, self.points, self.fixed = network, points, fixed
        self.force_limit, self.fastest, self.travel = more["force_limit"], more["fastest"], more["travel"]
        self.curves = {**laws}
        straight = np.isin(np.arange(fixed.size), [*laws], invert=True)
        self.stiffness, self.damping = network.stiffness * straight, network.damping * straight
        self.rows = stretches_of(network, sparse=False)
        self.hands = [_Hand(c, self) for c in range(network.channel_mass.size)]

    @property
    def is_simulated(self) -> bool:
        """True if this module moves the part as a run does: few masses, by CORDIS's scheme."""
        network, backward = self.network, damper_named("backward", None, 1.0)
        whole = network.scheme == "cordis" and network.substeps == 1 and not network.implicit.any()
        whole &= network.point_mass.size <= _MOST_MASSES
        return bool(whole) and all(one == backward for one in network.damper)


class _Motions:
    """Motions of a part, n at a time: states of hands, board and masses."""

    def __init__(self, part: LinePart, masses: Floats, speeds: Floats, press: Floats) -> None:
        """`masses`: their places at rest, m. `speeds`, `press`: (n,), of the first hand, m/s and N."""
        network, board = part.network, part.network.board
        assert board is not None
        self.part, self._board, hands = part, board, network.channel_mass.size
        self._period = 1.0 / (network.rate * board.steps)
        each = zip(network.channel_mass, network.channel_friction, network.channel_stiffness, strict=True)
        steps = []
        for mass, friction, stiffness in each:
            unit = self._period / mass
            step = device_step(float(friction * unit), 0.0, "zoh", float(stiffness * unit * self._period))
            steps.append(np.column_stack([step.motion[:2] + np.eye(2), step.forces[:2, :1] * unit * self._period]))
        self._step = np.array(steps)  # (C, 2, 3): of place, speed and force
        self._whole, fraction = whole_and_fraction(network.delay)
        self._first = round(fraction * board.steps)
        self.x, self.v = np.zeros((2, hands, speeds.size))
        self.press = 0.0 * self.x
        self.v[0], self.press[0] = speeds * self._period, press
        self.y, self.moved = np.repeat(masses[:, None], speeds.size, axis=1), np.zeros((masses.size, speeds.size))
        self.before = self.x - board.steps * self.v
        self.past = [self.x - (i + 1) * self.v for i in range(board.window)]
        self.under_way = [0.0 * self.x] * board.delay
        rest = np.zeros((6, *self.x.shape))
        self.lines = [rest] * (self._whole + 2)

    def keep(self, which: Any) -> None:
        """Keeps these motions and drops the others."""
        for name in ("x", "v", "press", "y", "moved", "before"):
            setattr(self, name, getattr(self, name)[..., which])
        for name in ("past", "under_way", "lines"):
            setattr(self, name, [one[..., which] for one in getattr(self, name)])

    def ends(self, samples: int) -> Floats:
        """Least and largest values (2, C + C + M, n) over these samples: force of each line, N, and each place, m."""
        found = np.full((2, 2 * len(self.x) + len(self.y), self.x.shape[1]), np.nan)
        for _ in range(samples):
            self._answer()
            force = self._follow()
            now = np.concatenate([force, self.x, self.y])
            np.fmin(found[0], now, out=found[0])
            np.fmax(found[1], now, out=found[1])
        return found

    def _answer(self) -> None:
        """Moves the masses by a sample, and adds the lines that the host finds then."""
        part = self.part
        way = self.x - self.before
        if len(self.y):
            self._move_masses(way)
        places, ways, lines = np.concatenate([self.x, self.y]), np.concatenate([way, self.moved]), []
        for c, hand in enumerate(part.hands):
            ends = part.fixed[:, None] + hand.others @ places
            lines.append(hand.line(self.x[c], way[c], ends, hand.others @ ways))
        self.lines = [*self.lines[1:], np.array(lines).swapaxes(0, 1)]
        self.before = self.x

    def _move_masses(self, way: Floats) -> None:
        """Moves the masses by a sample, in which the hands moved by `way` m."""
        part, network, rows = self.part, self.part.network, self.part.rows
        stretch = part.fixed[:, None] + rows @ np.concatenate([self.x, self.y])
        rate = network.rate * (rows @ np.concatenate([way, self.moved]))
        pull = part.stiffness[:, None] * stretch + part.damping[:, None] * rate
        for i, curve in part.curves.items():
            pull[i] = curve.pull(stretch[i], rate[i])
        unit = 1.0 / (network.point_mass * network.rate**2)
        self.moved = self.moved - unit[:, None] * (rows[:, len(self.x) :].T @ pull)
        self.y = self.y + self.moved

    def _follow(self) -> Floats:
        """Moves the hands by a sample along the lines that act. Returns the forces at its end, N."""
        board, force, window = self._board, self.press, self._board.window * self._period
        state = np.stack([self.x, self.v, force], axis=1)  # (C, 3, n)
        line = self.lines[-2 - self._whole]
        for j in range(board.steps):
            if j == self._first:
                line = self.lines[-1 - self._whole]
            at_zero, k, b, low, high, place = line
            x = state[:, 0].copy()
            u = at_zero - k * (x - place)
            damped = np.minimum(np.maximum(u - b / window * (x - self.past[-1]), low), high)
            computed = np.where(u >= high, high, np.where(u <= low, low, damped))
            self.past = [x, *self.past[:-1]]
            self.under_way.append(computed)
            force = self.under_way.pop(0)
            state[:, 2] = force + self.press
            state[:, :2] = self._step @ state
        self.x, self.v = state[:, 0].copy(), state[:, 1].copy()
        return force


@np.errstate(all="ignore")
def lasting_swing(part: LinePart, masses: Floats, slowest: float, quantum: float) -> Swing | None:
    """Returns the largest swing that goes on after knocks of the first hand under steady presses; None if all die away.
    Its point is a number, not a name.

    `masses`: their places at the start, m. `slowest`: modulus of the slowest pole that decays: what dies away no faster
    is not told from what goes on. `quantum`: m, below which nothing swings.
    """
    knock, press = 2.0 * (_SPREAD[:, None] * np.arange(1.0, _TRIES + 1.0) % 1.0) - 1.0
    motions = _Motions(part, masses, part.fastest * knock, part.force_limit * press * np.sqrt(np.abs(press)))
    hands, least, sizes, forces = len(part.hands), _LEAST * quantum, np.zeros((0, 0)), np.zeros((0, 0))
    for settles in (_SETTLES, _LATER):
        blocks: list[Floats] = []
        for _ in range(settles + _JUDGED):
            block = motions.ends(_BLOCK)
            moves = (np.ptp(block, axis=0)[hands:] > least).any(axis=0)
            motions.keep(moves)
            blocks = [one[..., moves] for one in (*blocks, block)[-_JUDGED:]]
            if not moves.any():
                return None
        sizes, forces = _sizes_that_go_on(blocks, part, least, slowest)
        lasts = sizes.any(axis=0)
        if not lasts.any():
            return None
        motions.keep(lasts)
        sizes, forces = sizes[:, lasts], forces[:, lasts]
    point, worst = np.unravel_index(sizes.argmax(), sizes.shape)
    return Swing(
        point=str(point),
        least=float(sizes.max(axis=0).min()),
        most=float(sizes[point, worst]),
        force=float(forces.max()),
        push=float(motions.press[0, worst]),
        is_unnoticed=False,
    )


def _sizes_that_go_on(blocks: Sequence[Floats], part: LinePart, least: float, slowest: float) -> tuple[Floats, Floats]:
    """Sizes (C + M, n), m, of the swings that keep theirs over these blocks, 0 for the others, and spans of the forces
    (C, n), N."""
    hands, spans = len(part.hands), [np.ptp(one, axis=0) for one in blocks]
    kept = 0.5 + 0.5 * slowest ** (2 * _BLOCK)
    kept = max(kept, _KEPT) if kept < _NO_DECAY else 2.0 - _NO_DECAY
    early, after = np.minimum(*spans[:2]), np.maximum(*spans[-2:])
    drift = 0.5 * np.abs((blocks[-1] - blocks[-2]).sum(axis=0))
    goes_on = ((after > least) & (after > kept * early) & (drift < _DRIFT * after))[hands:]
    low, high = part.travel.T[..., None]
    places = blocks[-1][:, hands : 2 * hands]
    goes_on &= ((places[0] >= low) & (places[1] <= high)).all(axis=0)
    return np.where(goes_on, after[hands:], 0.0), after[:hands]


def lasting_swings(
    scene: Scene, linear: LinearScene, network: Network, points: Sequence[str], poles: Complexes
) -> dict[str, Swing]:
    """Returns `lasting_swing` of each simulated part of a scene, by the point that moves most. `linear`, `network`,
    `points`: its linear form; `poles`: of this."""
    found = {}
    for part, masses in line_parts(scene, linear, network, points):
        decaying = [
            math.exp(-0.5 * rate / network.rate) for rate in part.network.channel_friction / part.network.channel_mass
        ]
        decaying += [abs(pole) for pole in poles.tolist() if abs(pole) < 1.0 and pole.imag]
        channel = scene.device_points[part.points[0]].channel
        swing = _swing_of(part, masses, max(decaying), scene.mock_device.quantum[channel])
        if swing is not None:
            found[swing.point.partition(".")[0]] = swing
    return found


def _swing_of(part: LinePart, masses: Floats, slowest: float, quantum: float) -> Swing | None:
    """Returns `lasting_swing`, of parts that are alike but for their names computed once."""
    like = part.network, part.curves, part.fixed, part.force_limit, part.fastest, part.travel, masses, slowest, quantum
    found = VERDICTS.recall(
        content_of("lasting swing", *like), lambda: (lasting_swing(part, masses, slowest, quantum), ())
    )
    return found and found._replace(point=part.points[int(found.point)])


def line_parts(
    scene: Scene, linear: LinearScene, network: Network, points: Sequence[str]
) -> Iterator[tuple[LinePart, Floats]]:
    """Yields the parts of a scene on a board that are simulated, each with the places of its masses at the start, m."""
    number, begins, hands = parts_of(network), start_positions(scene), network.channel_mass.size
    travels = scene.device.travels(scene.channels)
    for its in dict.fromkeys(number[:hands].tolist()):
        inside = np.flatnonzero(number == its).tolist()
        names = [points[i] for i in inside]
        own, _, laws, fixed = part_with_laws(scene, linear, network, points, inside)
        if not laws or any(not law.memoryless or law.speeds or math.isfinite(law.reach) for law in laws.values()):
            continue
        travel = np.array([travels[scene.device_points[name].channel] for name in names if name in scene.device_points])
        limits = {"force_limit": scene.device.force_limit, "fastest": fastest_motion(scene), "travel": travel}
        part = LinePart(own, names, laws, fixed, **limits)
        if part.is_simulated and not pulls_itself(scene, names):
            yield part, np.array([begins[name] for name in names[len(travel) :]])
