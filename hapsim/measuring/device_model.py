"""How a device's moving part answers to the forces that it was sent: the model that `device_fit` fits.

    m x'' + b0 x' + k0 x = F(t) + F0 - Fc sign(x')

In sample periods and forces per mass, with A = b0 T/m, W = k0 T²/m and the delay D + phi in sample periods, force n
acts from n + D + phi on, as the device's hold says. Between two changes of the force the motion is the exponential of
the equation's matrix; over samples it is a recurrence of second order, so that a whole record is one linear filter.
Where the velocity keeps its sign dry friction is a constant force, and the motion is linear in all but A, W and delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_POSITION, _VELOCITY, _FORCE, _AREA = range(4)
_STATE = slice(0, 2)


@dataclass(frozen=True)
class Converters:
    """How the device holds a force and measures its position, by the scene's names."""

    hold: str
    sampling: str


@dataclass(frozen=True)
class SampledMotion:
    """One sample of the motion, and what is measured at its end, in sample periods:

    state[n + 1] = step state[n] + newer f[n - D] + older f[n - D - 1], and
    y[n + 1] = row state[n] + seen_newer f[n - D] + seen_older f[n - D - 1],

    the state being position and velocity, f force per mass; `steady` and `seen_steady` the same for a constant force.
    """

    whole_delay: int
    step: Matrix
    newer: Vector
    older: Vector
    steady: Vector
    row: Vector
    seen_newer: float
    seen_older: float
    seen_steady: float

    def answer_to(self, newer: Vector, older: Vector) -> Vector:
        """Positions along the last axis, the first one sample after rest at 0, under f[n - D] and f[n - D - 1]."""
        return self._filtered(newer, self.newer, self.seen_newer) + self._filtered(older, self.older, self.seen_older)

    def answer_to_constant(self, samples: int) -> Vector:
        """Positions under a constant unit force, the first one sample after rest at 0."""
        return self._filtered(np.ones(samples), self.steady, self.seen_steady)

    def free(self, samples: int) -> Matrix:
        """(samples, 2) positions without a force, the first one sample after a unit position, or a unit velocity."""
        start = np.zeros(samples)
        start[0] = 1.0
        first, second = self.row, self.row @ self.step
        total = float(np.trace(self.step))
        columns = [
            lfilter([first[i], second[i] - total * first[i]], self._denominator, start) for i in (_POSITION, _VELOCITY)
        ]
        return np.column_stack(columns)

    @property
    def _denominator(self) -> list[float]:
        return [1.0, -float(np.trace(self.step)), float(np.linalg.det(self.step))]

    def _filtered(self, force: Vector, gain: Vector, seen: float) -> Vector:
        """y[n + 1] = [row (zI - step)^-1 gain + seen] force[n], as one filter."""
        _, minus_total, product = self._denominator
        adjoint = self.step + minus_total * np.eye(2)
        numerator = [seen, self.row @ gain + seen * minus_total, self.row @ adjoint @ gain + seen * product]
        return np.asarray(lfilter(numerator, self._denominator, force))


def sampled_motion(friction: float, stiffness: float, delay: float, converters: Converters) -> SampledMotion:
    """`friction` = b0 T/m, `stiffness` = k0 T²/m, `delay` in sample periods; any sign, for a fit tries any."""
    whole = math.floor(delay)
    part = delay - whole
    matrix = np.zeros((4, 4))
    matrix[_POSITION, _VELOCITY] = matrix[_VELOCITY, _FORCE] = matrix[_AREA, _POSITION] = 1.0
    matrix[_VELOCITY, _POSITION], matrix[_VELOCITY, _VELOCITY] = -stiffness, -friction
    before, after, through = expm(matrix * part), expm(matrix * (1.0 - part)), expm(matrix)
    if converters.hold == "zoh":  # the older force until the change, the newer one after it
        newer, older = after[:, _FORCE], after[:, _STATE] @ before[_STATE, _FORCE]
        older[_AREA] += before[_AREA, _FORCE]
    else:  # all of the newer one at the change
        newer, older = after[:, _VELOCITY].copy(), np.zeros(4)
    seen = _AREA if converters.sampling == "average" else _POSITION
    return SampledMotion(
        whole_delay=whole,
        step=through[_STATE, _STATE],
        newer=newer[_STATE],
        older=older[_STATE],
        steady=through[_STATE, _FORCE],
        row=through[seen, _STATE],
        seen_newer=float(newer[seen]),
        seen_older=float(older[seen]),
        seen_steady=float(through[seen, _FORCE]),
    )
