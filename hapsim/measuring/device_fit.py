"""Mass, friction, stiffness, dry friction and delay of a device, from records of its motion under known forces.

The forces that were sent are known exactly and the positions to their rounding and noise, which is white: the most
likely parameters are those whose motion lies closest to the positions, by least squares (output error). Each swing,
in which the velocity keeps its sign, has an initial position and velocity of its own; these are linear, and projected
out. The covariance is that of least squares; where what is left is not white, it is worked out swing by swing instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from hapsim.measuring.device_balance import Rough
from hapsim.measuring.device_model import Converters, sampled_motion
from hapsim.measuring.device_motion import ROUNDING, Motion, Swing

Vector = NDArray[np.float64]

_STEP = 1e-5  # of a parameter's scale, for differences
_WHITE = 5.0  # standard deviations of the correlation from row to row that white noise has
_FEW_SWINGS = 12  # with fewer their scatter does not tell a covariance
_NAMES = 6
_MARGIN = 4  # rows beyond the longest delay that is tried


@dataclass(frozen=True)
class Estimate:
    """A value with its standard uncertainty, in the value's unit."""

    value: float
    uncertainty: float


@dataclass(frozen=True)
class DeviceFit:
    """What was found, in SI units; the delay in sample periods."""

    mass: Estimate
    friction: Estimate
    stiffness: Estimate
    coulomb: Estimate
    constant_force: Estimate
    """N: gravity, or an offset of the force."""
    delay: Estimate
    residual_counts: float
    """rms, of the positions."""
    correlation: float
    """Of what is left, from one row to the next; 0 where it is noise."""
    rows: int
    swings: tuple[Swing, ...] = field(repr=False)
    residuals: tuple[Vector, ...] = field(repr=False)
    """What is left in each swing, counts."""

    @property
    def is_white(self) -> bool:
        """Whether what is left is noise."""
        return self.correlation * math.sqrt(self.rows) < _WHITE


@dataclass(frozen=True)
class _Table:
    """The swings side by side, padded to the longest."""

    force: Vector
    """N, of all motions laid end to end, each between zeros: no force acted before."""
    index: NDArray[np.int64]
    """(S, L) where each row is among them."""
    inside: NDArray[np.bool_]
    """(S, L)"""
    position: Vector
    """(S, L) counts."""
    side: Vector
    """(S, 1)"""
    delays: tuple[float, float]
    """Beyond which no delay is tried, sample periods."""


def fit_device(
    motions: list[Motion],
    swings: list[Swing],
    start: Rough,
    count_m: float,
    rate_hz: float,
    converters: Converters,
) -> DeviceFit:
    """The fit from `start` on. `count_m`: m per count."""
    table = _table(motions, swings, start.delay + 1.0)
    push = max(float(np.max(np.abs(motion.force))) for motion in motions)
    typical = float(np.median([swing.rows for swing in swings]))
    gain = 1.0 / (start.mass * count_m)  # counts per sample period squared and N
    scale = np.array([gain, 1.0 / typical, 1.0 / typical**2, gain * push, gain * push, 1.0])
    begin = np.array(
        [
            gain,
            start.friction / start.mass,
            start.stiffness / start.mass,
            gain * start.coulomb,
            gain * start.constant,
            start.delay,
        ]
    )

    def left(scaled: Vector) -> Vector:
        return _left(table, scaled * scale, converters)[table.inside]

    found = least_squares(left, begin / scale, jac="3-point", diff_step=_STEP, xtol=1e-10, ftol=1e-12, gtol=1e-12).x
    slopes = _slopes(left, found)
    found = found - np.linalg.lstsq(slopes, left(found), rcond=None)[0]  # to the last digit that the record has
    residual = np.zeros(table.inside.shape)
    residual[table.inside] = left(found)
    spread, rms, correlation = _spread(table, residual, slopes)
    values = found * scale
    rows = int(np.count_nonzero(table.inside))
    in_si, conversion = _in_si(values, count_m, 1.0 / rate_hz)
    uncertainty = np.linalg.norm((conversion * scale) @ spread, axis=1)
    mass, friction, stiffness, coulomb, constant, delay = (
        Estimate(float(a), float(b)) for a, b in zip(in_si, uncertainty, strict=True)
    )
    lengths = np.sum(table.inside, axis=1)
    return DeviceFit(
        mass=mass,
        friction=friction,
        stiffness=stiffness,
        coulomb=coulomb,
        constant_force=constant,
        delay=delay,
        residual_counts=rms,
        correlation=correlation,
        rows=rows,
        swings=tuple(swings),
        residuals=tuple(residual[i, :length] for i, length in enumerate(lengths)),
    )


def _table(motions: list[Motion], swings: list[Swing], most_delay: float) -> _Table:
    pad = math.ceil(most_delay) + _MARGIN
    starts = np.cumsum([pad, *(motion.position.size + 2 * pad for motion in motions)])
    lengths = np.array([swing.rows for swing in swings])
    along = np.arange(int(np.max(lengths)))
    inside = along[None, :] < lengths[:, None]
    first = np.array([starts[swing.motion] + swing.first for swing in swings])
    index = np.where(inside, first[:, None] + along[None, :], pad)
    position = np.concatenate([np.pad(motion.position, pad) for motion in motions])
    force = np.concatenate([np.pad(motion.force, pad) for motion in motions])
    side = np.array([[swing.side] for swing in swings])
    return _Table(force, index, inside, position[index] * inside, side, (_MARGIN - pad, pad - _MARGIN))


def _left(table: _Table, values: Vector, converters: Converters) -> Vector:
    """(S, L) positions less the modelled ones, with the initial positions and velocities that fit them best."""
    gain, friction, stiffness, coulomb, constant, delay = values
    shortest, longest = table.delays
    motion = sampled_motion(friction, stiffness, min(max(delay, shortest), longest), converters)
    newest, length = table.index - motion.whole_delay - 1, table.inside.shape[1]
    pushed = gain * motion.answer_to(table.force[newest], table.force[newest - 1])
    pushed += (constant - coulomb * table.side) * motion.answer_to_constant(length)
    left = (table.position - pushed) * table.inside
    free = motion.free(length) * table.inside[:, :, None]
    basis, _ = np.linalg.qr(free / np.linalg.norm(free, axis=1, keepdims=True))
    return np.asarray(left - np.einsum("slk,sk->sl", basis, np.einsum("slk,sl->sk", basis, left)))


def _slopes(left: Callable[[Vector], Vector], at: Vector) -> Vector:
    """(rows, parameters), by central differences."""
    columns = [(left(at + step) - left(at - step)) / (2.0 * _STEP) for step in _STEP * np.eye(at.size)]
    return np.column_stack(columns)


def _spread(table: _Table, residual: Vector, slopes: Vector) -> tuple[Vector, float, float]:
    """(a square root of the scaled parameters' covariance, rms of what is left, its correlation from row to row). Kept
    so, no variance comes out negative."""
    rows, swings = slopes.shape[0], residual.shape[0]
    freedom = max(rows - 2 * swings - _NAMES, 1)
    rms = math.sqrt(float(np.sum(residual**2)) / freedom)
    correlation = _correlation(table, residual)
    q, r = np.linalg.qr(slopes)
    inverse = solve_triangular(r, np.eye(_NAMES))
    spread = inverse * max(rms, ROUNDING)
    if correlation * math.sqrt(rows) > _WHITE and swings > _FEW_SWINGS:
        by_swing = np.zeros((swings, _NAMES))
        np.add.at(by_swing, np.nonzero(table.inside)[0], q * residual[table.inside][:, None])
        scatter = inverse @ by_swing.T * math.sqrt(swings / (swings - _NAMES))
        grown = np.linalg.norm(scatter, axis=1) / np.linalg.norm(spread, axis=1)
        spread = spread * np.maximum(grown, 1.0)[:, None]
    return spread, rms, correlation


def _correlation(table: _Table, residual: Vector) -> float:
    """Beyond what the two projected motions of each swing leave of white noise."""
    both = table.inside[:, 1:]
    product = np.sum(residual[:, 1:] * residual[:, :-1] * both)
    power = float(np.sum(residual**2))
    lengths = np.sum(table.inside, axis=1)
    taken = 2.0 * lengths.size / np.sum(lengths)  # each motion takes its own, slow, share
    return float(product / power + taken) if power > 0.0 else 0.0


def _in_si(values: Vector, count_m: float, period: float) -> tuple[Vector, Vector]:
    """(mass, friction, stiffness, coulomb, constant force, delay) and their slopes by the fitted parameters."""
    gain, friction, stiffness, coulomb, constant, delay = values
    mass_gain = period**2 / count_m  # mass = mass_gain / gain
    mass = mass_gain / gain
    si = np.array(
        [mass, friction * mass / period, stiffness * mass / period**2, coulomb / gain, constant / gain, delay]
    )
    slopes = np.diag([0.0, mass / period, mass / period**2, 1.0 / gain, 1.0 / gain, 1.0])
    slopes[:5, 0] = -si[:5] / gain
    return si, slopes
