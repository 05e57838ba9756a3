"""Where the model of a device does not fit: with the position, with the velocity, or at the reversals.

By a smoothed balance of forces. Multiplied by a window psi that vanishes at both ends, with its first two derivatives,
and integrated by parts, the equation of motion holds for positions instead of accelerations (Shinbrot's modulating
functions, 1957):

    m <psi'', x> - b0 <psi', x> + k0 <psi, x> + Fc side <psi, 1> - F0 <psi, 1> = <psi, F>
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from hapsim.measuring.converters import Converters
from hapsim.measuring.device_fit import DeviceFit
from hapsim.measuring.device_motion import Motion
from hapsim.measuring.trace_quality import ROUNDING

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

BINS = 12
LOUD = 2.0  # times the noise at rest and the rounding
_WINDOW = Polynomial([1.0, 0.0, -1.0]) ** 3  # (1 - s²)³ for s from -1 to 1
_LEAST_WIDTH, _LEAST_WINDOWS = 8, 20
_LEAST_SHARE = 0.3  # of the variance of the force that is lacking: with less it goes with nothing in particular
_QUIET = 0.25  # of the force: noise that hides nothing
_LATER = 0.1  # sample periods: a difference of the delay


@dataclass(frozen=True)
class ForceResidual:
    """What force the model lacks, and where, in windows of a third of a swing. Arrays (R,), SI units."""

    motion: NDArray[np.int64]
    """Which run of the record."""
    row: NDArray[np.int64]
    """Of that run, at the middle of the window."""
    position: Vector
    """m from where the device was found."""
    velocity: Vector
    in_swing: Vector
    """Share of its swing that has passed, 0 at one reversal to 1 at the next."""
    force: Vector
    """N that acted beside the modelled ones, whatever the model's parameters."""
    modelled: Matrix
    """(R, 6) forces that the parameters are factors of, the last by the delay."""
    noise: float
    """N rms that noise and rounding of the positions make of it."""
    typical_force: float
    """N rms that was sent."""


def force_residual(
    motions: list[Motion], fit: DeviceFit, noise_counts: float, count_m: float, rate_hz: float, converters: Converters
) -> ForceResidual:
    """Of the swings of a fit, in windows as short as noise allows, a third of a swing at most. `noise_counts`: of a
    position of the device at rest, rms; `count_m`: m per count."""
    noise = math.hypot(noise_counts, ROUNDING) * count_m
    rows = [swing.rows for swing in fit.swings]
    width = max(_LEAST_WIDTH, min(int(np.median(rows)) // 3, sum(rows) // _LEAST_WINDOWS))
    found = _in_windows(motions, fit, noise, count_m, rate_hz, converters, width)
    while width >= 2 * _LEAST_WIDTH:
        width //= 2
        finer = _in_windows(motions, fit, noise, count_m, rate_hz, converters, width)
        if not finer.noise < _QUIET * _rms(finer.force):
            break
        found = finer
    return found


def _in_windows(
    motions: list[Motion],
    fit: DeviceFit,
    noise: float,
    count_m: float,
    rate_hz: float,
    converters: Converters,
    width: int,
) -> ForceResidual:
    """In windows of `width` rows, half overlapping, inside of the swings. `noise`: m rms of a position."""
    swings = np.array(
        [
            (swing.motion, begin, swing.side, (begin + width // 2 - swing.first) / swing.rows)
            for swing in fit.swings
            for begin in range(swing.first, swing.last - width + 1, max(1, width // 2))
        ]
    ).reshape(-1, 4)
    motion, begin, side = swings[:, 0].astype(np.int64), swings[:, 1].astype(np.int64), swings[:, 2]
    kernels = _kernels(width)
    moved = count_m * _weighted([one.position for one in motions], motion, begin, kernels)
    # What is left moves like the device under the force that is lacking, and under no other.
    left = [np.zeros_like(one.position) for one in motions]
    for swing, error in zip(fit.swings, fit.residuals, strict=True):
        left[swing.motion][swing.first : swing.last] = error
    inertia = fit.mass.value * rate_hz**2
    lacking = (
        count_m
        * _weighted(left, motion, begin, kernels)
        @ np.array([inertia, fit.friction.value * rate_hz, fit.stiffness.value])
    )
    late = fit.delay.value + (0.5 if converters.averages else 0.0)
    sent, later = (_force_in(motions, motion, begin, one, converters, width) for one in (late, late + _LATER))
    modelled = np.column_stack([moved, side, -np.ones_like(side), later - sent])
    return ForceResidual(
        motion=motion,
        row=begin + width // 2,
        position=moved[:, 2],
        velocity=moved[:, 1] * rate_hz,
        in_swing=swings[:, 3],
        force=_beside(modelled, lacking),
        modelled=modelled,
        noise=float(np.linalg.norm(kernels[0])) * noise * inertia,
        typical_force=_rms(sent),
    )


def _kernels(width: int) -> Matrix:
    """(3, width): by what `width` positions become their acceleration, velocity (in sample periods) and mean."""
    half = 0.5 * width
    at = (np.arange(width) - 0.5 * (width - 1)) / half
    window, first, second = (p(at) for p in (_WINDOW, _WINDOW.deriv(), _WINDOW.deriv(2)))
    unit = float(np.sum(window))
    # The sums of the derivatives vanish exactly, so that a position may be counted from anywhere.
    first, second = first - np.mean(first), second - np.mean(second)
    second *= 2.0 / float(second @ (at * half) ** 2)
    first /= float(first @ (at * half))
    return np.stack([second, first, window / unit])


def _weighted(signals: list[Vector], motion: NDArray[np.int64], begin: NDArray[np.int64], kernels: Matrix) -> Matrix:
    """(R, kernels): each window's weighted sums."""
    width = kernels.shape[1]
    rows = [kernels @ signals[i][j : j + width] for i, j in zip(motion, begin, strict=True)]
    return np.array(rows).reshape(-1, kernels.shape[0])


def _force_in(
    motions: list[Motion],
    motion: NDArray[np.int64],
    begin: NDArray[np.int64],
    delay: float,
    converters: Converters,
    width: int,
) -> Vector:
    """(R,) N: the mean force in each window, of forces that act `delay` rows late; before a record none acted."""
    before, half = math.ceil(delay) + 1, 0.5 * width
    acts = np.arange(width + before) - before + delay - 0.5 * (width - 1)  # rows from the middle: where each begins
    weights = np.zeros(acts.size)
    for later, duration, impulse, level, slope in converters.pieces_of_one_force():
        since = (acts + later) / half
        edges = np.clip([since, since + duration / half], -1.0, 1.0)
        weights += np.where(np.abs(since) < 1.0, impulse * _WINDOW(since), 0.0)
        weights += half * (level - slope * half * since) * np.diff(_WINDOW.integ()(edges), axis=0)[0]
        weights += half**2 * slope * np.diff((_WINDOW * Polynomial([0.0, 1.0])).integ()(edges), axis=0)[0]
    unit = float(np.sum(_WINDOW((np.arange(width) - 0.5 * (width - 1)) / half)))
    padded = [np.pad(one.force, (before, 0)) for one in motions]
    return _weighted(padded, motion, begin, weights[None, :] / unit)[:, 0]


def _beside(explaining: Matrix, force: Vector) -> Vector:
    """What no combination of the columns explains."""
    size = np.linalg.norm(explaining, axis=0)
    q, _ = np.linalg.qr(explaining[:, size > 0.0] / size[size > 0.0])
    return np.asarray(force - q @ (q.T @ force))


def _rms(values: Vector) -> float:
    return math.sqrt(float(np.mean(values**2)))


def misfit_of(fit: DeviceFit, lacking: ForceResidual, noise_counts: float) -> str:
    """In a sentence, where the model does not fit; "" where what is left is noise and rounding. `noise_counts`: of a
    position of the device at rest, rms."""
    expected = math.hypot(noise_counts, ROUNDING)
    if fit.is_white and fit.residual_counts < LOUD * expected:
        return ""
    return (
        f"the model does not fit: it leaves {fit.residual_counts:.3g} counts rms of the positions, where rounding and "
        f"noise explain {expected:.2g}. The force that it lacks, {_rms(lacking.force):.2g} N rms beside pushes of "
        f"{lacking.typical_force:.2g} N rms, {_where(lacking)}."
    )


def _where(lacking: ForceResidual) -> str:
    at_position, position = _explained(lacking, lacking.position, 1.0)
    at_velocity, velocity = _explained(lacking, lacking.velocity, 1.0)
    # On either side of a reversal the same law lacks a force with the other sign.
    in_swing, moment = _explained(lacking, lacking.in_swing, np.sign(lacking.velocity))
    best = max(at_position, at_velocity, in_swing)
    if not best > _LEAST_SHARE:
        return "goes with neither position nor velocity nor reversals: a hand that moves by itself, or another force"
    if best == at_position:
        return f"goes with the position ({best:.0%} of it), and is largest at {1e3 * position:+.2g} mm"
    if best == at_velocity:
        return f"goes with the velocity ({best:.0%} of it), and is largest at {1e3 * velocity:+.2g} mm/s"
    where = "near the reversals" if abs(moment - 0.5) > 0.25 else "in the middle between two reversals"
    return f"is largest {where} ({best:.0%} of it)"


def binned(along: Vector, force: Vector) -> tuple[NDArray[np.int64], Vector, Vector]:
    """(the bin of each, the mean of `along` and of `force` in each): bins of as many values each."""
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, BINS - 1)
    counts = np.maximum(np.bincount(number, minlength=BINS), 1)
    middles, means = (np.bincount(number, one, minlength=BINS) / counts for one in (along, force))
    return number, middles, means


def _explained(lacking: ForceResidual, along: Vector, sign: float | Vector) -> tuple[float, float]:
    """(share of the force's variance, beyond that of noise, that a force by bins of `along` explains, beyond chance and
    beyond what other parameters of the model would; where it is largest)."""
    force, rows = lacking.force, lacking.force.size
    if rows < 4 * BINS:
        return 0.0, 0.0
    number, middles, means = binned(along, force * sign)
    bins = np.eye(BINS)[number] * np.reshape(sign, (-1, 1))
    columns = np.column_stack([lacking.modelled, bins])
    left = float(np.sum(_beside(columns, force) ** 2)) / (rows - columns.shape[1])
    total = float(np.sum(force**2)) / (rows - lacking.modelled.shape[1])
    beyond = total - lacking.noise**2
    worst = int(np.argmax(np.abs(means)))
    return (min((total - left) / beyond, 1.0) if beyond > 0.0 else 0.0), float(middles[worst])
