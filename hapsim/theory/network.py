"""The closed loop of any linear scene as arrays: device channels, CORDIS masses and visco-elastic links."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory import checks
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.device_step import device_step
from hapsim.theory.interface import HOLDS, SAMPLINGS
from hapsim.theory.poles import sort_by_modulus

_quietly = np.errstate(all="ignore")  # what is out of range becomes NaN

NO_MOTION = 1e-12  # a pole of smaller modulus is a memory that empties, not a motion


class Mode(NamedTuple):
    """One motion of the scene by itself: a conjugate pair of poles, or a real pole.

    Attributes:
        pole: in the z-plane; of a pair, the one above the real axis.
        frequency_hz: |s|/(2 pi) with s = ln(pole)/T, the undamped eigenfrequency.
        damping_ratio: -Re s/|s|; 1 for a real pole that decays, NaN for one that rests (s = 0).
        participation: (C + M,) each point's share of the kinetic energy, sum 1, device channels first.
    """

    pole: complex
    frequency_hz: float
    damping_ratio: float
    participation: Floats


@dataclass(frozen=True, eq=False)
class Network:
    """Device channels, masses and links that run together at one rate.

    Points are numbered: 0 to C - 1 the device channels, C to C + M - 1 the simulated masses, -1 a ground. A
    simulated mass moves by the centred scheme, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n]. A link's force on its
    first end is -K (xa - xb)[n] - (B/T) ((xa - xb)[n] - (xa - xb)[n-1]), the opposite on its second. A
    channel's x[n] is its measured sample; the sum of its links' forces acts on its real mass from (n + delay)
    T on, by the hold. The mass itself moves in continuous time, exactly (Florens et al., §6 and Figure 5).

    Attributes:
        rate: sample rate, Hz, > 0.
        channel_mass: (C,) real masses, kg, > 0.
        channel_friction: (C,) real viscous frictions, N·s/m, >= 0.
        delay: sample periods from the sampling of a position to the change of the force that answers it, >=
            0.
        hold: "zoh" or "impulse". sampling: "ideal" or "average". As for ``Configuration``.
        point_mass: (M,) simulated masses, kg, > 0.
        ends: (L, 2) the two points that each link joins.
        stiffness: (L,) K in N/m.
        damping: (L,) B in N·s/m.

    Raises:
        ValueError: an argument is out of its range or its shape does not fit; the sentence says which.
    """

    rate: float
    channel_mass: Floats
    channel_friction: Floats
    delay: float
    hold: str
    sampling: str
    point_mass: Floats
    ends: NDArray[np.intp]
    stiffness: Floats
    damping: Floats

    def __post_init__(self) -> None:
        mass = checks.vector("channel_mass", self.channel_mass, above=0.0)
        point_mass = checks.vector("point_mass", self.point_mass, above=0.0)
        ends = checks.link_ends("ends", self.ends, mass.size + point_mass.size)
        checked: dict[str, Any] = {
            "rate": checks.positive("rate", self.rate),
            "channel_mass": mass,
            "channel_friction": checks.vector("channel_friction", self.channel_friction, mass.size, least=0.0),
            "delay": checks.not_negative("delay", self.delay),
            "hold": checks.one_of("hold", self.hold, HOLDS),
            "sampling": checks.one_of("sampling", self.sampling, SAMPLINGS),
            "point_mass": point_mass,
            "ends": ends,
            "stiffness": checks.vector("stiffness", self.stiffness, len(ends)),
            "damping": checks.vector("damping", self.damping, len(ends)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @_quietly
    def transition(self) -> Floats:
        """The square matrix that takes the state at one sample to the state at the next.

        The state is, in metres: the points' positions x[n] (C + M) and x[n-1] (C + M), the channels'
        velocities times T (C), with averaged sampling the channels' true positions (C), and the forces
        computed for them, newest first and times T²/m, that a later sample still needs (C each).
        """
        channels = self.channel_mass.size
        averaged = SAMPLINGS[self.sampling].reads_mean
        friction = self.channel_friction / (self.channel_mass * self.rate)
        steps = [device_step(damping, self.delay, self.hold) for damping in friction]
        remembered = steps[0].forces.shape[1] - 1 if steps else 0
        layout = _layout(channels, self.point_mass.size, averaged, remembered)

        unit = np.eye(layout.size)
        force = self._force_of_points() @ unit[: layout.before.stop]
        memory = np.concatenate([force[:channels], unit[layout.held]])  # computed forces, the newest first
        matrix = np.zeros_like(unit)
        # The centred scheme for every point; a channel's rows are replaced below.
        matrix[layout.now] = 2.0 * unit[layout.now] - unit[layout.before] + force
        matrix[layout.before] = unit[layout.now]
        matrix[layout.held] = memory[: remembered * channels]
        for channel, step in enumerate(steps):
            state = [layout.position.start + channel, layout.velocity.start + channel]
            moved = step.motion @ unit[state] + step.forces @ memory[channel::channels]
            if averaged:
                matrix[channel] = moved[2]
            matrix[state] = moved[:2]
        return matrix

    @_quietly
    def poles(self) -> Complexes:
        """All eigenvalues (N,) of the transition matrix, by decreasing modulus; some are zero, memories."""
        matrix = self.transition()
        if not np.isfinite(matrix).all():
            return np.full(len(matrix), complex(np.nan, np.nan))
        return sort_by_modulus(np.linalg.eigvals(matrix).astype(complex))

    def spectral_radius(self) -> float:
        """The largest modulus of a pole; 0 for a scene without points."""
        return float(np.abs(self.poles()).max(initial=0.0))

    @_quietly
    def modes(self) -> list[Mode]:
        """The scene's motions, the slowest to decay first; without the poles at zero, which are memories.

        Empty where the transition matrix is not finite.
        """
        mass = np.concatenate([self.channel_mass, self.point_mass])
        matrix = self.transition()
        if not np.isfinite(matrix).all():
            return []
        poles, vectors = np.linalg.eig(matrix)
        slowest_first = np.lexsort((-poles.real, -np.abs(poles)))
        kept = [i for i in slowest_first if poles[i].imag >= 0.0 and abs(poles[i]) > NO_MOTION]
        energy = mass[:, None] * np.abs(vectors[: mass.size]) ** 2
        return [_mode(complex(poles[i]), self.rate, energy[:, i] / energy[:, i].sum()) for i in kept]

    def _force_of_points(self) -> Floats:
        """(C + M, 2 (C + M)): the forces T²/m F on the points, from their positions x[n] and x[n-1]."""
        mass = np.concatenate([self.channel_mass, self.point_mass])
        joins = np.zeros((len(self.ends), mass.size + 1))  # the last column is the ground
        link = np.arange(len(self.ends))
        np.add.at(joins, (link, self.ends[:, 0]), 1.0)
        np.add.at(joins, (link, self.ends[:, 1]), -1.0)
        joins = joins[:, :-1]
        elastic = joins.T @ (self.stiffness[:, None] * joins)
        viscous = joins.T @ (self.damping[:, None] * self.rate * joins)
        return np.hstack([-(elastic + viscous), viscous]) / (mass[:, None] * self.rate**2)


class _Layout(NamedTuple):
    """Where the state's parts are."""

    now: slice
    before: slice
    velocity: slice
    position: slice
    held: slice

    @property
    def size(self) -> int:
        return self.held.stop


def _layout(channels: int, masses: int, averaged: bool, remembered: int) -> _Layout:
    points = channels + masses
    velocity = slice(2 * points, 2 * points + channels)
    position = slice(velocity.stop, velocity.stop + channels) if averaged else slice(0, channels)
    start = max(velocity.stop, position.stop)
    held = slice(start, start + remembered * channels)
    return _Layout(slice(0, points), slice(points, 2 * points), velocity, position, held)


def _mode(pole: complex, rate: float, participation: Floats) -> Mode:
    s = rate * cmath.log(pole)
    ratio = -s.real / abs(s) if s else math.nan
    return Mode(pole, abs(s) / (2.0 * math.pi), ratio, participation)
