"""How a device is pushed and moves: what it is given, what a record shows of it, and the model that `device_fit` fits.

**Pushes.** The device hangs on a soft simulated spring and damper at the place where it was found, and is pushed to one
side and to the other, level, each time for `half` samples, so that its parameters show and it stays where it may be.
Everything is slow beside the delay: with w the eigenfrequency, w half T <= 1 and half >= 16 (delay + 1), so that the
loop is stable for a mass and a delay several times the ones that it was designed for, or a fraction of them.

**Record.** Positions, the forces that were sent, and swings, in which the device moves to one side.

**Model.**

    m x'' + b0 x' + k0 x = F(t) + F0 - Fc sign(x') - k (x - y) - c (x' - y'),    M y'' = k (x - y) + c (x' - y')

The second mass M at y, on a spring and a damper, is a hand that does not hold the first one firmly. In sample periods
and forces per mass, with A = b0 T/m, W = k0 T²/m and the delay D + phi, force n acts from n + D + phi on, as the
device's hold says. Between two changes of the force the motion is the exponential of the equation's matrix; over
samples it is a recurrence, so that a whole record is one linear filter. Where the velocity keeps its sign dry friction
is a constant force, and the motion is linear in all but A, W and delay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from hapsim.holds import HOLDS
from hapsim.loop.ring import BRIDGED, LATE_FORCE, OFF_GRID
from hapsim.measuring.converters import Converters, Floats
from hapsim.measuring.trace_quality import ROUNDING, unbroken
from hapsim.recording.trace import Trace
from hapsim.running.session_options import Excitation
from hapsim.scene import Ground, Initial, Mock, Scene, ViscoElastic

_LEAST_HALF = 32
_SLOW = 16.0  # sample periods for each of the delay and one more
_LONGEST_HALF_S = 1.0
_DAMPING_RATIO = 0.5
_PUSHES = 0.8  # of the force that is allowed; the rest is the spring's
_WITH_SPRING = 2.0  # times a push: what leaves at most
_FADES = 0.3  # of the travel, at its ends
_LOOKED_AT = 24  # half periods of a motion that is simulated ahead
_GOLDEN = 0.6180339887498949  # as the loop varies its pushes


@dataclass(frozen=True)
class Bounds:
    """What the device may be given: force in N, travel in m to either side of where it was found."""

    force: float
    travel: float

    @property
    def push(self) -> float:
        """N that a push may have."""
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
        """From the first tick on, one push after the other."""
        return Excitation(channel, self.force, self.half, self.half, start=0, first=False)


def drive_for(plant: Plant, bounds: Bounds, rate_hz: float, *, pace: float, tightness: float) -> Drive:
    """Pushes with all the force that is allowed, and as long as it takes to cross the travel, were the plant free.

    `pace`: a factor on that time; `tightness`: eigenfrequency on the spring times half a period, in rad.
    """
    shortest = max(_LEAST_HALF, math.ceil(_SLOW * (plant.delay + 1.0)))
    longest = max(shortest, math.floor(_LONGEST_HALF_S * rate_hz))
    crossing = math.sqrt(4.0 * bounds.travel * plant.mass / bounds.push) * rate_hz
    half = min(max(shortest, math.ceil(pace * crossing)), longest)
    eigen = tightness * rate_hz / half  # rad/s
    return Drive(plant.mass * eigen**2, 2.0 * _DAMPING_RATIO * plant.mass * eigen, bounds.push, half)


def peak_per_newton(plant: Plant, drive: Drive, rate_hz: float, converters: Converters) -> float:
    """How far the plant gets under these pushes, m for each newton of them; with dry friction it would be less."""
    inertia = rate_hz * plant.mass * rate_hz
    motion = sampled_motion(plant.friction * rate_hz / inertia, plant.stiffness / inertia, plant.delay, converters)
    gains = np.array(motion.gains)
    ages = motion.whole_delay + np.arange(len(gains))
    pushes, gone = _LOOKED_AT * drive.half, int(ages[-1]) + 1
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
    """The scene's device on this spring and damper at `home` (m), or on nothing.

    Every other channel is free. The force is limited to what is allowed, and fades where the device comes near the end
    of its travel; nothing is corrected by what is declared, and a mock begins at rest.
    """
    device: dict[str, Any] = {"correction": "none", "force_limit": bounds.force, "travel": None}
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
        "precision": "double",
    }
    return scene.model_copy(update=changed)


_CERTAIN = 6.0  # standard deviations: a velocity of which the sign is known
_TURNING = 0.03  # of the largest velocity: what is slower may be about to turn
_LEAST_ROWS = 8
_REACHES = (1, 2, 4, 8, 16, 32, 64)  # rows to either side
_APART = 0.06  # of a swing: much longer than it takes from the least velocity to twice that
_CLEARLY = 4.0  # times the least velocity, in a swing that counts


@dataclass(frozen=True)
class Motion:
    """One channel of a record: `position` in counts from where the device was found, `force` in N, row by row."""

    position: Floats
    force: Floats
    known: tuple[tuple[int, int], ...]  # index ranges in which every force that acts was recorded


class Swing(NamedTuple):
    """Rows `first` to `last` of a motion: the velocity keeps its sign, `side` 1 or -1; or it may not, `side` 0."""

    motion: int
    first: int
    last: int
    side: float

    @property
    def rows(self) -> int:
        """How many."""
        return self.last - self.first


def motion_of(trace: Trace, channel: int, home_counts: float, most_delay: float) -> Motion:
    """`most_delay`: in sample periods; after a gap, forces that are unknown act in that many rows."""
    lead = math.ceil(most_delay) + 2
    runs = unbroken(trace, LATE_FORCE | BRIDGED | OFF_GRID)
    known = [(first + (lead if first > 0 else 0), last) for first, last in runs]  # before the first row no force acted
    position = trace.position_counts[:, channel].astype(np.float64) - home_counts
    force = trace.force_counts[:, channel].astype(np.float64) * float(trace.force_scale[channel])
    return Motion(position, force, tuple((begin, last) for begin, last in known if last - begin >= _LEAST_ROWS))


def swings_of(motions: list[Motion], noise_counts: float) -> list[Swing]:
    """Where the velocity is known to keep its sign, with a margin on either side. `noise_counts`: of a position, rms;
    the rounding is added. The velocity is one over as many rows as leave most of the record."""
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
    """All that is known of the motions, whatever the velocity, in pieces of at most `rows` rows."""
    return [
        Swing(i, begin, min(begin + rows, last), 0.0)
        for i, motion in enumerate(motions)
        for first, last in motion.known
        for begin in range(first, last - _LEAST_ROWS, rows)
    ]


def _velocity(position: Floats, reach: int) -> Floats:
    """Counts per sample from `reach` rows on either side; these are missing at either end."""
    return (position[2 * reach :] - position[: -2 * reach]) / (2.0 * reach)


def _swings(number: int, motion: Motion, reach: int, noise: float, fastest: float) -> Iterator[Swing]:
    least = max(_CERTAIN * noise / (math.sqrt(2.0) * reach), _TURNING * fastest)
    for first, last in motion.known:
        speed = _velocity(motion.position[first:last], reach)
        for side in (1.0, -1.0):
            moves = side * speed > least
            edges = np.flatnonzero(np.diff(moves.astype(np.int8), prepend=0, append=0))
            for begin, end in edges.reshape(-1, 2):
                # A velocity is a mean over its rows: only what lies so far inside keeps the sign for sure. And whose
                # noise had a say in where the swing begins must not be in it, or what is left would not be noise.
                apart = 1 + math.ceil(_APART * (end - begin))
                inner = Swing(number, first + begin + 2 * reach + apart, first + end - apart, side)
                if inner.rows >= _LEAST_ROWS and float(np.max(side * speed[begin:end])) > _CLEARLY * least:
                    yield inner


class SampledMotion(NamedTuple):
    """One sample of the motion, and what is measured at its end, in sample periods:

    state[n + 1] = step state[n] + sum over ages of gains[age] f[n - D - age], and
    y[n + 1] = row state[n] + sum over ages of gains[age][seen] f[n - D - age],

    the state being position and velocity of each mass, f force per mass. Behind the state each gain has the part of the
    position's mean; `steady` is the gain of a constant force, `polynomial` that of `step`.
    """

    whole_delay: int
    step: Floats
    row: Floats
    seen: int
    gains: tuple[Floats, ...]
    steady: Floats
    polynomial: Floats

    def answer_to(self, forces: Sequence[Floats]) -> Floats:
        """Positions along the last axis, the first one sample after rest at 0, under f[n - D - age] for each age."""
        each = zip(forces, self.gains, strict=True)
        return np.asarray(sum(self._filtered(force, gain, float(gain[self.seen])) for force, gain in each))

    def answer_at_once(self, force: Floats) -> Floats:
        """Positions along the last axis under forces that each act for one sample, the first one sample after rest."""
        return self._filtered(force, self.steady, float(self.steady[self.seen]))

    def free(self, samples: int) -> Floats:
        """(samples, states) positions without a force, from each unit state on, the first one sample after it."""
        start = np.eye(1, samples)[0]
        return np.column_stack([self._filtered(start, unit, 0.0, ahead=1) for unit in np.eye(self.row.size)])

    def _filtered(self, force: Floats, gain: Floats, seen: float, ahead: int = 0) -> Floats:
        """y[n + 1] = [row (zI - step)^-1 gain + seen] force[n], as one filter; `ahead`: samples sooner."""
        markov, state = [seen], gain[: self.row.size]
        for _ in range(self.row.size):
            markov.append(float(self.row @ state))
            state = self.step @ state
        numerator = np.convolve(self.polynomial, markov)[: self.polynomial.size]
        return np.asarray(lfilter(numerator[ahead:], self.polynomial, force))


def sampled_motion(
    friction: float, stiffness: float, delay: float, converters: Converters, hand: Sequence[float] = ()
) -> SampledMotion:
    """`friction` = b0 T/m, `stiffness` = k0 T²/m, `delay` in sample periods; any sign, for a fit tries any. `hand`:
    k T²/m, c T/m and m/M of a second mass, where there is one."""
    whole = math.floor(delay)
    part = delay - whole
    states = 4 if hand else 2
    state, force, area, slope = slice(states), states, states + 1, states + 2
    matrix = np.zeros((states + 3, states + 3))
    matrix[0, 1] = matrix[1, force] = matrix[area, 0] = matrix[force, slope] = 1.0
    matrix[1, :2] = -stiffness, -friction
    if hand:
        spring, damper, ratio = hand
        pull = np.array([spring, damper, -spring, -damper])
        matrix[1, state] -= pull
        matrix[2, 3], matrix[3, state] = 1.0, ratio * pull
    through = expm(matrix)
    pieces = [piece for piece in HOLDS[converters.hold].pieces(part) if piece.duration > 0.0]
    gains = np.zeros((states + 3, max(len(weights) for _, *each in pieces for weights in each)))
    for duration, impulse, level, grows in pieces:
        gains[1, : len(impulse)] += impulse
        gains[[force, slope]] = 0.0
        gains[force, : len(level)], gains[slope, : len(grows)] = level, grows
        gains = expm(matrix * duration) @ gains
    seen = area if converters.averages else 0
    step, row = through[state, state], through[seen, state]
    return SampledMotion(whole, step, row, seen, tuple(gains.T), through[:, force], np.asarray(np.poly(step)))
