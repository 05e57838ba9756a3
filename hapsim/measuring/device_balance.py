"""The balance of forces on the device, smoothed: which force a fit lacks, and where.

Multiplied by a window psi that vanishes at both ends, with its first two derivatives, and integrated by parts, the
equation of motion holds for positions instead of accelerations (Shinbrot's modulating functions, 1957):

    m <psi'', x> - b0 <psi', x> + k0 <psi, x> + Fc side <psi, 1> - F0 <psi, 1> = <psi, F>
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from hapsim.measuring.device_model import Converters
from hapsim.measuring.device_motion import Motion, Swing

Vector = NDArray[np.float64]

_WINDOW = Polynomial([1.0, 0.0, -1.0]) ** 3  # (1 - s²)³ for s from -1 to 1
LEAST_WIDTH, _LEAST_WINDOWS = 8, 20


@dataclass(frozen=True)
class Balance:
    """Forces at the middle of R windows. Acceleration, velocity and position in m and sample periods, (R,)."""

    swing: NDArray[np.int64]
    """Index of the swing that each window lies in."""
    row: NDArray[np.int64]
    """Of its motion, at the middle of the window."""
    acceleration: Vector
    velocity: Vector
    position: Vector
    side: Vector
    force: Vector
    """N, at the delay that was asked for."""
    noise_gain: float
    """rms of an acceleration that white noise of 1 m rms makes."""

    @property
    def terms(self) -> NDArray[np.float64]:
        """(R, 5), what mass, friction, stiffness, dry friction and constant force are factors of."""
        columns = [self.acceleration, self.velocity, self.position, self.side, -np.ones_like(self.side)]
        return np.column_stack(columns)


def balance_of(
    motions: list[Motion], swings: list[Swing], count_m: float, converters: Converters, delay: float, width: int
) -> Balance:
    """Windows of `width` rows, half overlapping, inside of the swings. `count_m`: m per count."""
    half = 0.5 * width
    at = (np.arange(width) - 0.5 * (width - 1)) / half
    window, first, second = (p(at) for p in (_WINDOW, _WINDOW.deriv(), _WINDOW.deriv(2)))
    unit = float(np.sum(window))
    # The sums of the derivatives vanish exactly, so that a position may be counted from anywhere.
    first, second = first - np.mean(first), second - np.mean(second)
    second /= float(second @ (at * half) ** 2) / (2.0 * unit)
    first /= -float(first @ (at * half)) / unit
    late = delay + (0.5 if converters.sampling == "average" else 0.0)
    whole, weights = _force_weights(converters.hold, late, width)
    rows: list[tuple[float, ...]] = []
    for number, swing in enumerate(swings):
        motion = motions[swing.motion]
        for begin in range(swing.first, swing.last - width + 1, max(1, width // 2)):
            y = motion.position[begin : begin + width] * count_m
            push = _around(motion.force, begin - whole, weights.size) @ weights
            values = np.array([second @ y, -(first @ y), window @ y, push]) / unit
            rows.append((number, begin + width // 2, swing.side, *values))
    table = np.array(rows).reshape(-1, 7)
    number_of, row, side, acceleration, velocity, position, force = table.T
    return Balance(
        swing=number_of.astype(np.int64),
        row=row.astype(np.int64),
        acceleration=acceleration,
        velocity=velocity,
        position=position,
        side=side,
        force=force,
        noise_gain=float(np.linalg.norm(second)) / unit,
    )


def _force_weights(hold: str, delay: float, width: int) -> tuple[int, Vector]:
    """(w, weights of the forces from w rows before the window on): how much of each acts within it."""
    whole = math.ceil(delay) + 1
    acts = np.arange(width + whole) - whole + delay  # in rows of the window, when each begins to act
    scaled = (np.stack([acts, acts + 1.0]) - 0.5 * (width - 1)) / (0.5 * width)
    if hold == "impulse":
        return whole, np.asarray(np.where(np.abs(scaled[0]) < 1.0, _WINDOW(scaled[0]), 0.0))
    begin, end = (0.5 * width * _WINDOW.integ()(np.clip(edge, -1.0, 1.0)) for edge in scaled)
    return whole, np.asarray(end - begin)


def _around(force: Vector, begin: int, rows: int) -> Vector:
    """Forces from row `begin` on, which may lie before the record: then none acted."""
    if begin >= 0:
        return force[begin : begin + rows]
    return np.concatenate([np.zeros(-begin), force[: rows + begin]])


def width_for(swings: list[Swing]) -> int:
    """Rows of a window: a third of a swing, and less of a short record."""
    rows = [swing.rows for swing in swings]
    return max(LEAST_WIDTH, min(int(np.median(rows)) // 3, sum(rows) // _LEAST_WINDOWS))
