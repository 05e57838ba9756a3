"""Pushes, records and the model of a device's motion; `device_fit` fits that model.

**Pushes.** A soft simulated spring and damper hold the device at its home position. Constant pushes of `half` samples
to alternate sides move it, so that its parameters show and it stays within its travel. All is slow compared with the
delay: with w the eigenfrequency, w half T <= 1 and half >= 16 (delay + 1). So the loop is stable for several times the
assumed mass and delay, or a fraction of them.

**Record.** Positions, sent forces, and swings: the rows in which the device moves to one side.

**Model.**

    m x'' + b0 x' + k0 x = F(t) + F0 - Fc sign(x') - k (x - y) - c (x' - y'),    M y'' = k (x - y) + c (x' - y')

The second mass M at y, on a spring and a damper, is a hand that does not hold the first one firmly. Units are sample
periods and force per mass: A = b0 T/m, W = k0 T²/m, the delay is D + phi, and force n acts from n + D + phi on, shaped
by the device's hold. Between two changes of the force the motion is the exponential of the equation's matrix. Over
samples it is a recurrence, so a whole record is one linear filter. While the velocity keeps its sign, dry friction is a
constant force, and the motion is linear in all parameters but A, W and delay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, schur
from scipy.signal import lfilter

from hapsim.holds import HOLDS
from hapsim.loop.ring import BRIDGED, LATE_FORCE, OFF_GRID
from hapsim.measuring.converters import Complexes, Converters, Floats
from hapsim.measuring.trace_quality import ROUNDING, unbroken
from hapsim.recording.trace import Trace
from hapsim.running.session_options import Excitation
from hapsim.scene import Ground, Initial, Mock, Scene, ViscoElastic

_LEAST_HALF = 32
_SLOW = 16.0  # sample periods for each of the delay and one more
_LONGEST_HALF_S = 1.0
_DAMPING_RATIO = 0.5
_PUSHES = 0.8  # of the allowed force; the rest is left for the spring
_WITH_SPRING = 2.0  # times a push: the largest sent force
_FADES = 0.3  # of the travel, at its ends
_SIMULATED = 24  # half periods of a simulated motion
_GOLDEN = 0.6180339887498949  # the loop varies its pushes by it


@dataclass(frozen=True)
class Bounds:
    """Limits for the device: force in N, and travel in m to either side of the home position."""

    force: float
    travel: float

    @property
    def push(self) -> float:
        """Largest force of a push, N."""
        return _PUSHES * self.force


class Plant(NamedTuple):
    """A model of the device, SI units, delay in sample periods."""

    mass: float
    friction: float
    stiffness: float
    delay: float


@dataclass(frozen=True)
class Drive:
    """A simulated spring and damper in SI units, and pushes of `force` N, `half` samples each."""

    stiffness: float
    damping: float
    force: float
    half: int

    def excitation(self, channel: int) -> Excitation:
        """Returns the pushes as an excitation, one after the other from the first tick."""
        return Excitation(channel, self.force, self.half, self.half, start=0, first=False)


def drive_for(plant: Plant, bounds: Bounds, rate_hz: float, *, pace: float, tightness: float) -> Drive:
    """Returns pushes with the largest allowed force. A free plant crosses the travel during one push.

    `pace`: a factor on that time; `tightness`: eigenfrequency on the spring times half a period, in rad.
    """
    shortest = max(_LEAST_HALF, math.ceil(_SLOW * (plant.delay + 1.0)))
    longest = max(shortest, math.floor(_LONGEST_HALF_S * rate_hz))
    crossing = math.sqrt(4.0 * bounds.travel * plant.mass / bounds.push) * rate_hz
    half = min(max(shortest, math.ceil(pace * crossing)), longest)
    eigen = tightness * rate_hz / half  # rad/s
    return Drive(plant.mass * eigen**2, 2.0 * _DAMPING_RATIO * plant.mass * eigen, bounds.push, half)


def peak_per_newton(plant: Plant, drive: Drive, rate_hz: float, converters: Converters) -> float:
    """Returns the peak position of the plant under these pushes, m per newton; dry friction would reduce it."""
    inertia = rate_hz * plant.mass * rate_hz
    motion = sampled_motion(plant.friction * rate_hz / inertia, plant.stiffness / inertia, plant.delay, converters)
    gains = np.array(motion.gains)
    ages = motion.whole_delay + np.arange(len(gains))
    pushes, gone = _SIMULATED * drive.half, int(ages[-1]) + 1
    forces, seen, state = np.zeros(pushes + gone), np.zeros(pushes + 1), np.zeros(2)
    for n in range(pushes):
        number = n // drive.half
        push = (-1.0) ** number * (1.0 - 0.5 * ((number * _GOLDEN) % 1.0))
        spring = drive.stiffness * seen[n] + drive.damping * rate_hz * (seen[n] - seen[max(n - 1, 0)])
        forces[n + gone] = (push - spring) / inertia
        acting = forces[n + gone - ages] @ gains
        seen[n + 1] = motion.row @ state + acting[motion.seen]
        state = motion.step @ state + acting[:2]
    return float(np.max(np.abs(seen)))


def scene_of(scene: Scene, bounds: Bounds, channel: int, drive: Drive | None, home: float) -> Scene:
    """Returns a scene with the device on this spring and damper at `home` (m), or free.

    Every other channel is free. The force is limited to the bounds, and fades near the ends of the travel. No
    correction is applied, and a mock begins at rest.
    """
    device: dict[str, Any] = {"law": "host", "correction": "none", "force_limit": bounds.force, "travel": None}
    modules: dict[str, Any] = {f"device-{point.channel}": point for point in scene.device_points.values()}
    if drive is not None:
        ends, K, B = (f"device-{channel}", "home"), drive.stiffness, drive.damping
        modules["home"] = Ground(type="ground", position=home)
        modules["spring"] = ViscoElastic(type="viscoelastic", between=ends, stiffness=K, damping=B)
        limits, fades = list(scene.device.travels(scene.channels)), _FADES * bounds.travel
        least, most = limits[channel]
        limits[channel] = max(least, home - bounds.travel + fades), min(most, home + bounds.travel - fades)
        force = min(bounds.force, _WITH_SPRING * drive.force)
        device |= {"travel": tuple(limits), "travel_margin": fades, "force_limit": force}
    mock = scene.mock or Mock()
    changed = {
        "device": scene.device.model_copy(update=device),
        "mock": mock.model_copy(update={"initial": Initial(position=mock.initial.position)}),
        "modules": modules,
        "scheme": "cordis",
        "space": 1,
        "precision": "double",
    }
    made = scene.model_copy(update=changed)
    made._is_auxiliary = True
    return made


_CERTAIN = 6.0  # standard deviations: the sign of a larger velocity is certain
_TURNING = 0.03  # of the largest velocity: a slower motion may be about to turn
_LEAST_ROWS = 8
_REACHES = (1, 2, 4, 8, 16, 32, 64)  # rows to either side
_APART = 0.06  # of a swing: much longer than it takes from the least velocity to twice that
_CLEARLY = 4.0  # times the least velocity, in a swing that counts


@dataclass(frozen=True)
class Motion:
    """One channel of a record, row by row: `position` in counts from home, `force` in N."""

    position: Floats
    force: Floats
    known: tuple[tuple[int, int], ...]  # index ranges in which all acting forces were recorded
    acceleration: Floats  # m/s², as the device senses it; NaN if it does not


class Swing(NamedTuple):
    """Rows `first` to `last` of a motion. `side`: 1 or -1, the sign of the velocity; 0 if the sign may change."""

    motion: int
    first: int
    last: int
    side: float

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.last - self.first


def motion_of(trace: Trace, channel: int, home_counts: float, most_delay: float) -> Motion:
    """Returns one channel of a trace as a motion. Unknown forces act for `most_delay` rows after a gap."""
    lead = math.ceil(most_delay) + 2
    runs = unbroken(trace, LATE_FORCE | BRIDGED | OFF_GRID)
    known = [(first + (lead if first > 0 else 0), last) for first, last in runs]  # before the first row no force acted
    position = trace.position_counts[:, channel].astype(np.float64) - home_counts
    force = trace.force_counts[:, channel].astype(np.float64) * float(trace.force_scale[channel])
    known = [(begin, last) for begin, last in known if last - begin >= _LEAST_ROWS]
    sensed = trace.sensed.get("acceleration", np.full(trace.position_counts.shape, np.nan))
    return Motion(position, force, tuple(known), sensed[:, channel])


def swings_of(motions: list[Motion], noise_counts: float) -> list[Swing]:
    """Returns the swings: rows in which the velocity certainly keeps its sign, with a margin on either side.

    `noise_counts`: noise of a position, rms; rounding is added. The velocity is a difference over several rows; their
    number is chosen to keep most of the record."""
    noise = math.hypot(noise_counts, ROUNDING)
    speeds = [np.abs(_velocity(motion.position[first:last], 2)) for motion in motions for first, last in motion.known]
    fastest = max((float(np.quantile(speed, 0.99)) for speed in speeds if speed.size), default=0.0)
    if fastest == 0.0:
        return []
    found = (
        [swing for i, motion in enumerate(motions) for swing in _swings(i, motion, reach, noise, fastest)]
        for reach in _REACHES
    )
    return max(found, key=lambda swings: sum(swing.rows for swing in swings))


def pieces_of(motions: list[Motion], rows: int) -> list[Swing]:
    """Returns the known rows of the motions at any velocity, in pieces of at most `rows` rows."""
    return [
        Swing(i, begin, min(begin + rows, last), 0.0)
        for i, motion in enumerate(motions)
        for first, last in motion.known
        for begin in range(first, last - _LEAST_ROWS, rows)
    ]


def _velocity(position: Floats, reach: int) -> Floats:
    """Returns the velocity in counts per sample, over `reach` rows on either side; both ends lack `reach` rows."""
    return (position[2 * reach :] - position[: -2 * reach]) / (2.0 * reach)


def _swings(number: int, motion: Motion, reach: int, noise: float, fastest: float) -> Iterator[Swing]:
    least = max(_CERTAIN * noise / (math.sqrt(2.0) * reach), _TURNING * fastest)
    for first, last in motion.known:
        speed = _velocity(motion.position[first:last], reach)
        for side in (1.0, -1.0):
            moves = side * speed > least
            edges = np.flatnonzero(np.diff(moves.astype(np.int8), prepend=0, append=0))
            for begin, end in edges.reshape(-1, 2):
                # A velocity is a mean over its rows, so the sign is certain only this far inside. Rows whose noise
                # decided where the swing begins must not be in it, or the residual would not be white.
                apart = 1 + math.ceil(_APART * (end - begin))
                inner = Swing(number, first + begin + 2 * reach + apart, first + end - apart, side)
                if inner.rows >= _LEAST_ROWS and float(np.max(side * speed[begin:end])) > _CLEARLY * least:
                    yield inner


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """The motion over one sample, and the measured position y at its end, in sample periods:

    state[n + 1] = step state[n] + sum over ages of gains[age] f[n - D - age], and
    y[n + 1] = row state[n] + sum over ages of gains[age][seen] f[n - D - age].

    The state is position and velocity of each mass; f is force per mass. A gain has the rows of the state, then that of
    the mean position. `steady` is the gain of a constant force. `turn` is the row of the acceleration: that of the
    state without forces at this instant.
    """

    whole_delay: int
    step: Floats
    row: Floats
    seen: int
    gains: tuple[Floats, ...]
    steady: Floats
    turn: Floats

    @cached_property
    def polynomial(self) -> Floats:
        """Characteristic polynomial of `step`."""
        return np.asarray(np.poly(self.step))

    def turning(self) -> SampledMotion:
        """Returns this motion with the acceleration in place of the position. That of a force that begins to act at
        this very instant is left out; a constant one has been acting."""
        row, states = self.turn @ self.step, self.row.size
        gains = tuple(np.append(gain[:states], self.turn @ gain[:states]) for gain in self.gains)
        steady = np.append(self.steady[:states], self.turn @ self.steady[:states] + 1.0)
        return replace(self, row=row, seen=states, gains=gains, steady=steady)

    def answer_to(self, forces: Sequence[Floats]) -> Floats:
        """Returns positions along the last axis under the forces f[n - D - age] of each age, starting at rest."""
        each = zip(forces, self.gains, strict=True)
        return np.asarray(sum(self._filtered(force, gain) for force, gain in each))

    def answer_at_once(self, force: Floats) -> Floats:
        """Returns positions along the last axis under forces that each act for one sample, starting at rest."""
        return self._filtered(force, self.steady)

    def response(self, turned: Complexes) -> Complexes:
        """Returns y over f (n,) at `turned` (n,): exp(2 pi j times the frequency, in periods per sample)."""
        states = self.row.size
        ages = self.whole_delay + np.arange(len(self.gains))
        gains = turned[:, None] ** -ages @ np.array(self.gains)
        triangle, basis = schur(self.step, "complex")
        state = (gains[:, :states] @ basis.conj()).T
        for i in reversed(range(states)):  # (z I - triangle) state = gains, from the last state on
            state[i] = (state[i] + triangle[i, i + 1 :] @ state[i + 1 :]) / (turned - triangle[i, i])
        return np.asarray(((self.row @ basis) @ state + gains[:, self.seen]) / turned)

    def free(self, samples: int) -> Floats:
        """Returns the positions (samples, states) of the free motions from each unit state."""
        rows, steps = self.row[None], self.step
        while len(rows) < samples:
            rows, steps = np.concatenate([rows, rows @ steps]), steps @ steps
        return rows[:samples]

    def _filtered(self, force: Floats, gain: Floats) -> Floats:
        """Returns y[n + 1] = [row (zI - step)^-1 gain + gain[seen]] force[n], as one filter."""
        markov = np.append(gain[self.seen], self.free(self.row.size) @ gain[: self.row.size])
        numerator = np.convolve(self.polynomial, markov)[: self.polynomial.size]
        return np.asarray(lfilter(numerator, self.polynomial, force))


def sampled_motion(
    friction: float, stiffness: float, delay: float, converters: Converters, hand: Sequence[float] = ()
) -> SampledMotion:
    """Returns the sampled motion of `friction` = b0 T/m, `stiffness` = k0 T²/m and `delay` in sample periods. All may
    be negative, because a fit tries any value. `hand`: k T²/m, c T/m and m/M of a second mass, if any."""
    matrix = np.zeros((4, 4) if hand else (2, 2))
    matrix[0, 1], matrix[1, :2] = 1.0, (-stiffness, -friction)
    if hand:
        spring, damper, ratio = hand
        pull = np.array([spring, damper, -spring, -damper])
        matrix[1] -= pull
        matrix[2, 3], matrix[3] = 1.0, ratio * pull
    return sampled(matrix, np.eye(len(matrix))[1], delay, converters)


def sampled(system: Floats, push: Floats, delay: float, converters: Converters) -> SampledMotion:
    """Returns the sampled motion of state' = `system` state + `push` f, whose first state is the measured position.
    Times are in sample periods."""
    whole = math.floor(delay)
    part = delay - whole
    states = push.size
    state, force, area, slope = slice(states), states, states + 1, states + 2
    matrix = np.zeros((states + 3, states + 3))
    matrix[state, state], matrix[state, force] = system, push
    matrix[area, 0] = matrix[force, slope] = 1.0
    through = expm(matrix)
    pieces = [piece for piece in HOLDS[converters.hold].pieces(part) if piece.duration > 0.0]
    gains = np.zeros((states + 3, max(len(weights) for _, *each in pieces for weights in each)))
    for duration, impulse, level, grows in pieces:
        gains[state, : len(impulse)] += np.multiply.outer(push, impulse)
        gains[[force, slope]] = 0.0
        gains[force, : len(level)], gains[slope, : len(grows)] = level, grows
        gains = (through if duration == 1.0 else expm(matrix * duration)) @ gains
    seen = area if converters.averages else 0
    step, row = through[state, state], through[seen, state]
    return SampledMotion(whole, step, row, seen, tuple(gains.T), through[:, force], system[1])
