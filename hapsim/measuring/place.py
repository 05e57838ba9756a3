"""The position at which a hand is measured in a scene with different regions, and the size of the pushes there.

Only the scene's geometry is used here: the positions at which a link begins to touch, releases or slides, the slopes
between these edges, and the static force. They guide the hand to its place and size the pushes. The identification uses
neither them nor the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hapsim.branch_law import BranchLaw
from hapsim.errors import UsageError
from hapsim.loop.ring import BRIDGED
from hapsim.measuring.branch import approach, on_branch, slides
from hapsim.measuring.converters import Floats
from hapsim.measuring.measure_trace import Attempt, Measurement
from hapsim.measuring.measurement_options import force_limit
from hapsim.measuring.scene_law import asks_by_one_law
from hapsim.number_format import percent, plural
from hapsim.prediction.characteristic import Characteristic, Piece, characteristic_of, piece_at, starts_at
from hapsim.recording.trace import Trace
from hapsim.running.session_options import Guide
from hapsim.scene import Scene
from hapsim.units import Units

_GUIDE_SLOW, _GUIDE_FAST = 60.0, 0.1  # eigenfrequency of the guide's spring: rad/s, and rad per sample without delay
_WAY_S, _SETTLING_S, _MEAN_S = 2.0, (1.0, 6.0), 0.25
_WITHIN = 0.45  # of the distance to the region's nearest edge
_COUNTS, _COUNTS_A_RADIAN = 4000.0, 400.0  # of a first swing: its size, and its motion in a sample
_AT_A_PORT = 0.1  # of the distance to the edge, for a device that reports the size of its counts later
_RESOLVED = 20.0  # counts: the least motion of a measurement
_EDGE = 1e-6  # of the region's width, or of 1 m: a position this near to an edge is on it
_MOST_GROWTH = 64.0  # of a swing, from one run to the next
_SLIDES = 4.0  # times the swing of a spring: a push that is surely too large
_STRAIGHT, _BENT = 1e-6, 0.01  # relative bend of a curve over a swing: a straight line has less, a curve more
_BENT_NOISES = 10.0  # times the noise: a larger deviation from a straight line shows in the motion
_PASSED = 1.25  # times the distance to where a plectrum grips: a margin for the hand's lag behind the guide
_LAST, _ARRIVED = 64, 0.5  # samples before the first push; of the room: the largest distance from the place


@dataclass(frozen=True)
class Place:
    """A position of a hand, and the region about it in which no link changes its state. SI units."""

    name: str
    channel: int
    at: float  # from the scene's position 0
    low: float
    high: float  # the region's edges, or infinite
    mass: float  # as declared
    stiffness: float
    damping: float  # of the scene's links and of the device, in the region
    hand: Characteristic | None
    """Static characteristic; None if the hand moves masses or another hand: its regions are then unknown."""
    piece: Piece | None
    units: Units
    less: float = 0.0
    """Part of the way beyond the place that the guide omits, m."""
    branch: str = ""
    """Branch along which the hand slides; "": none."""

    @property
    def room(self) -> float:
        """Distance to the nearest edge, or to where dry friction slides, m."""
        return min(self.at - self.low, self.high - self.at, math.inf if self.piece is None else self.piece.reach)

    @property
    def largest_swing(self) -> float:
        """Largest motion of the hand under a push, m."""
        return _WITHIN * self.room

    @property
    def expected_swing(self) -> float:
        """The same as a push is sized by it, m: a hand that slides does not come back as from a spring."""
        return self.largest_swing * (_SLIDES if self.branch else 1.0)

    @property
    def has_regions(self) -> bool:
        """True if the hand feels different springs and dampers in different regions."""
        return self.hand is not None and self.hand.is_regional

    def first_swing(self, scene: Scene) -> float:
        """Returns the motion of the first run, m: the smallest that is likely to exceed rounding, infinite for a scene
        without regions. Raises UsageError if the region has no room for it."""
        if not self.has_regions:
            return math.inf
        if scene.device.port is not None:
            return _AT_A_PORT * self.room
        if self.branch:
            return self.largest_swing
        quantum = scene.mock_device.quantum[self.channel]
        if self.largest_swing < _RESOLVED * quantum:
            raise UsageError(self.too_small(quantum))
        turn = math.sqrt(max(self.stiffness, 0.0) / self.mass) * scene.period
        swing = min(self.largest_swing, quantum * max(_COUNTS, _COUNTS_A_RADIAN / max(turn, 1e-3)))
        while swing > _RESOLVED * quantum * 20.0 and self.bend(swing) > _STRAIGHT:
            swing *= 0.8
        return swing

    def swing_in(self, trace: Trace) -> float:
        """Returns the largest distance of the hand from its place, m."""
        return float(np.max(np.abs(trace.position[:, self.channel] - self.at)))

    def bend(self, swing: float) -> float:
        """Returns the relative change of the apparent stiffness for a motion of `swing` m on a curve."""
        if self.hand is None or self.piece is None or not self.piece.is_curved:
            return 0.0
        below, here, above = self.hand.force(self.at, swing * np.array([-1.0, 0.0, 1.0])).tolist()
        even = (above - below) / (2.0 * swing) - self.stiffness
        uneven = (above + below - 2.0 * here) / swing
        return abs(even) / self.stiffness + (uneven / self.stiffness) ** 2

    def growth(self, swing: float, wanted: float, unsure: float) -> float:
        """Returns the factor by which to enlarge a motion of `swing` m, to reduce the relative uncertainty `unsure` of
        k by `wanted`. On a curve the effect of its bend must stay below the uncertainty."""
        factor = min(wanted, 2.0 if self.branch else _MOST_GROWTH)
        while factor > 1.0 and self.bend(swing * factor) > min(unsure / factor, _BENT):
            factor *= 0.8
        return factor

    def share_unknown(self, found: Measurement) -> float:
        """Returns the larger of the relative uncertainties of k and b.

        k counts as at least that of an oscillation at 2 Hz, b as at least a twentieth of the critical damping."""
        k = max(self.stiffness, self.mass * (4.0 * math.pi) ** 2)
        b = max(abs(found.b), 0.1 * math.sqrt(k * self.mass))
        return max(found.k_uncertainty / k, found.b_uncertainty / b)

    def require_arrival(self, way: Floats, count_m: float) -> None:
        """Raises UsageError if the guide did not bring the hand to its place. `way`: its positions until then, m."""
        x = float(np.median(way[-_LAST:]))
        if abs(x - self.at) > _ARRIVED * min(self.room, 1.0) + _RESOLVED * count_m:
            raise UsageError(
                f"the hand was led to {self.units(self.at, 'm')}, but ended at {self.units(x, 'm', 4)}. Dry friction "
                "or a hand may hold it, a snap on the way may be too steep, the force limit too low, or the declared "
                "mass wrong. Let it move freely, or choose another --at"
            )

    def guide(self, scene: Scene) -> Guide:
        """Returns the guide to the place: stiffer than the scene on the way, as far as the loop stays stable."""
        mass, fall = self.mass, 0.0
        if self.hand is not None:
            fall = max(0.0, *(-piece.stiffness for piece in self.hand.pieces()))
        wanted = max(mass * _GUIDE_SLOW**2, self.stiffness, 2.0 * fall)
        stiffness = min(wanted, mass * (_GUIDE_FAST * scene.rate / (1.0 + scene.device.delay)) ** 2)
        swing_s = math.sqrt(mass / stiffness)
        summing_s = 3.0 * swing_s * (1.0 + max(self.stiffness, 0.0) / stiffness)  # of the integrator
        settling_s = min(max(_SETTLING_S[0], 40.0 * swing_s, 6.0 * summing_s), max(_SETTLING_S[1], 40.0 * swing_s))
        reach = math.inf if self.piece is None else self.piece.reach
        beyond = reach if math.isfinite(reach) else 0.0  # then back, so that friction sticks without a bent bristle
        beyond = max(beyond, _PASSED * self.ahead(starts_at(scene, self.channel) or 0.0))
        return Guide(self.at, stiffness, beyond - self.less, (_WAY_S, settling_s, max(_MEAN_S, 5.0 * swing_s), _MEAN_S))

    def ahead(self, start: float) -> float:
        """Returns the distance in m beyond the place at which a hand from `start` makes every plectrum grip."""
        if self.hand is None or self.piece is None:
            return 0.0
        grips = [one.fixed_m for name, one in self.hand.links.items() if self.piece.states.get(name) == "gripping"]
        return max([math.copysign(1.0, self.at - start) * (one - self.at) for one in grips], default=0.0)

    def left_by(self, trace: Trace, noise_m: float, predicts: bool) -> str:
        """Returns how the hand left the region, or the straight part of a curve, in words; "" if it stayed within.

        The words name the links that changed. `noise_m`: noise of the position, m rms. `predicts`: the force depends on
        predicted positions, so that it obeys no law of the recorded ones."""
        x = trace.position[:, self.channel]
        if self.hand is None or self.piece is None or not self.has_regions:
            return ""
        least, most = float(x.min()), float(x.max())
        swing = self.swing_in(trace)
        if self.low <= least and most <= self.high and swing <= self.piece.reach:
            if (bend := self.bend(swing)) * swing > _BENT_NOISES * noise_m or bend > 2.0 * _BENT:
                return f"over {self.units(swing, 'm', 2)} its slope changes, and k by about {percent(bend)}"
            if self.branch or self.piece.is_curved or predicts or asks_by_one_law(trace, self.channel):
                return ""
        pieces = self.hand.pieces()
        ends = [self.hand.at(min(max(end, self.hand.low), self.hand.high), pieces) for end in (least, most)]
        changed = {
            f"{link} went from {state} to {end.states[link]}"
            for end in ends
            for link, state in self.piece.states.items()
            if end.states[link] != state
        }
        sticks = [f"{link} slid" for link, state in self.piece.states.items() if state.startswith("stuck")]
        return ", ".join(sorted(changed) or sticks) or "a link released, or a velocity left its segment of a table"

    def rows(self, scene: Scene, trace: Trace, guided: int) -> Trace:
        """Returns the samples of a run of `scene` after those of the guide; on a branch with a mark at those that are
        not on it, so that they are not identified."""
        rows = trace.since(guided)
        if not self.branch:
            return rows
        off = ~slides(scene, self.channel, self.branch, trace.position[:, self.channel])[guided:]
        return replace(rows, flags=np.where(off, rows.flags | BRIDGED, rows.flags).astype(rows.flags.dtype))

    def unbent(self, way: Floats) -> tuple[Place, float]:
        """Returns the place with a guide that stops more exactly where curves with two branches have z = 0, and the
        stiffness, N/m, that their z after `way` (positions until then, m) adds."""
        links = self.hand.links.values() if self.hand and self.piece and not self.piece.branch else ()
        off, more = 0.0, 0.0
        for one in links:
            if isinstance(one.law, BranchLaw):
                d, law = one.distance(way), one.law.variants
                z = float(one.law.along(d, float(d[0]))[-1])
                off = max(off, one.sign * z * one.law.reach, key=abs)
                more += 0.5 * abs(z * (law["pressed"].slope(d[-1]) - law["released"].slope(d[-1])))
        return replace(self, less=self.less - math.copysign(1.0, self.at - way[0]) * off), more

    def words(self) -> str:
        """Returns the place and its region in words."""
        if not math.isfinite(self.low) and not math.isfinite(self.high):
            return self.units(self.at, "m")
        low, high = self.units(self.low, "m"), self.units(self.high, "m")
        reach = f"from {self.units.number(self.low, 'm')} to {high}"
        if not math.isfinite(self.low):
            reach = f"below {high}"
        elif not math.isfinite(self.high):
            reach = f"above {low}"
        return f"{self.units(self.at, 'm')}, in the region {reach}"

    def too_small(
        self, count_m: float, attempts: Sequence[Attempt] = (), found: Measurement | None = None, limited: int = 0
    ) -> str:
        """Returns why no push within the region moves the hand enough, in sentences without the last full stop.
        `limited`: most samples of a run at the force limit."""
        noise, tried = "", ""
        if found is not None and found.residual_m > count_m:
            noise = f" and noise of {self.units(found.residual_m, 'm', 2)} rms"
        if attempts and attempts[-1].left:
            tried = f"; {attempts[-1].left} even with a push of {self.units(attempts[-1].push_n, 'N', 3)}"
        if limited:
            forces = plural(limited, "force")
            tried += f"; in one run, {forces} reached the force limit, so the loop may swing by itself"
        is_open = not (math.isfinite(self.low) and math.isfinite(self.high))
        where = "a position farther from the edge" if is_open else "the middle of a wider region"
        return (
            f"at {self.words()}, {self.name} can move only {self.units(self.room, 'm', 3)} to the nearest edge, with "
            f"counts of {self.units(count_m, 'm', 3)}{noise}{tried}: no push within this region moves it enough to "
            f"identify a spring. Choose {where} with --at, or a device with finer and quieter positions"
        )


def place_of(scene: Scene, channel: int, at: float | None) -> Place | None:
    """Returns the place on `channel` at `at` m, by default where the hand is held nearest to position 0; None if no
    place is given and the scene has no regions.

    Raises UsageError if no hand can be measured there: beyond the travel or the force limit, on an edge, on a snap.
    """
    name = next(name for name, point in scene.device_points.items() if point.channel == channel)
    hand = characteristic_of(scene, name, at or 0.0)
    if at is None and (hand is None or not hand.is_regional):
        return None
    device, units = scene.device, scene.units_of(channel)
    mass, stiffness, damping = (
        one(scene.channels)[channel] for one in (device.masses, device.stiffnesses, device.frictions)
    )
    if hand is None:
        low, high = device.travels(scene.channels)[channel]
        place = Place(name, channel, at or 0.0, low, high, mass, stiffness, damping, None, None, units)
        if not low <= place.at <= high:
            raise UsageError(
                f"at: found {units(place.at, 'm')}, beyond the travel of {name}; expected a position from "
                f"{units.number(low, 'm')} to {units(high, 'm')}"
            )
        return place
    piece = piece_at(hand, name, at)
    # On a curve the piece's slope is that of another position.
    stiffness = hand.stiffness_at(piece.place) if piece.is_curved else stiffness + piece.stiffness
    damping += piece.damping
    here = piece.place if at is None else at
    place = Place(name, channel, here, piece.low, piece.high, mass, stiffness, damping, hand, piece, units)
    _require_spring(place, abs(float(hand.force(place.at))), force_limit(scene))
    return place


def place_on_branch(scene: Scene, channel: int, at: float | None, branch: str) -> Place | None:
    """Returns the place of a hand that slides along a branch of `scene`: the guide brings it there on it. The spring by
    which pushes are sized has the force between the branches, too. Raises UsageError as `place_of`."""
    place = place_of(on_branch(scene, channel, branch), channel, at)
    hand = characteristic_of(scene, scene.hand_on(channel), at or 0.0)
    if place is None or hand is None:
        return place
    down, up = (float(hand.moving_force(np.array([place.at]), speed)[0]) for speed in (-1e-9, 1e-9))
    turn = 2.0 * max(one.law.reach for one in hand.links.values() if isinstance(one.law, BranchLaw))
    comes = math.copysign(1.0, place.at - (starts_at(scene, channel) or 0.0))
    stiffness = place.stiffness + 2.0 * abs(up - down) / max(place.largest_swing, turn)
    beyond = 0.0 if comes == approach(scene, channel, branch) else 2.0 * turn
    return replace(place, branch=branch, stiffness=stiffness, less=-beyond)


def _require_spring(place: Place, force: float, limit: float) -> None:
    """Raises UsageError if no spring holds the hand at this place. `force`: of the scene there, N; `limit`: of it."""
    if force > limit:
        raise UsageError(
            f"at: {place.words()}, the scene asks for {place.units(force, 'N', 4)}, more than the force limit of "
            f"{place.units(limit, 'N')}. The force is clipped there, so the hand feels no spring. Choose a position "
            "with less force"
        )
    if place.stiffness == 0.0:
        raise UsageError(
            f"at: {place.words()}, nothing holds the hand, so there is no spring to measure. Choose a position in a "
            "region with a spring; `hapsim check` lists them"
        )
    if place.stiffness < 0.0:
        raise UsageError(
            f"at: {place.words()}, the scene has a snap: it pushes the hand away with "
            f"{place.units(place.stiffness, 'N/m', 5)}, so no hand comes to rest there. Choose a position in a region "
            "of positive stiffness; `hapsim check` lists them"
        )
    if place.room < _EDGE * min(place.high - place.low, 1.0):
        raise UsageError(f"at: {place.words()}, the hand is on the edge; expected a position within a region")
