"""Where the model of a device does not fit: with the position, with the velocity, or at the reversals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapsim.measuring.device_balance import balance_of, width_for
from hapsim.measuring.device_fit import DeviceFit
from hapsim.measuring.device_model import Converters
from hapsim.measuring.device_motion import Motion

Vector = NDArray[np.float64]

BINS = 12
_LEAST_SHARE = 0.15  # of the variance of the force that is lacking: with less it goes with nothing in particular
_LOUD = 2.0  # times the noise at rest and the rounding


@dataclass(frozen=True)
class ForceResidual:
    """What force the model lacks, and where, in windows of a third of a swing. Arrays (R,), SI units."""

    motion: NDArray[np.int64]
    """Which run of the record."""
    row: NDArray[np.int64]
    """Of that run."""
    position: Vector
    """m from where the device was found."""
    velocity: Vector
    in_swing: Vector
    """Share of its swing that has passed, 0 at one reversal to 1 at the next."""
    force: Vector
    """N that acted beside the modelled ones."""
    noise: float
    """N rms that what is left of the positions would make of it, were it noise."""
    typical_force: float
    """N rms that was sent."""


def force_residual(
    motions: list[Motion], fit: DeviceFit, count_m: float, rate_hz: float, converters: Converters
) -> ForceResidual:
    """Of the swings of a fit. `count_m`: m per count."""
    swings = fit.swings
    balance = balance_of(motions, list(swings), count_m, converters, fit.delay.value, width_for(list(swings)))
    inertia = fit.mass.value * rate_hz**2
    factors = [inertia, fit.friction.value * rate_hz, fit.stiffness.value, fit.coulomb.value, fit.constant_force.value]
    first = np.array([swings[i].first for i in balance.swing])
    rows = np.array([swings[i].rows for i in balance.swing])
    return ForceResidual(
        motion=np.array([swings[i].motion for i in balance.swing], dtype=np.int64),
        row=balance.row,
        position=balance.position,
        velocity=balance.velocity * rate_hz,
        in_swing=(balance.row - first) / rows,
        force=balance.terms @ np.array(factors) - balance.force,
        noise=balance.noise_gain * fit.residual_counts * count_m * inertia,
        typical_force=math.sqrt(float(np.mean(balance.force**2))),
    )


def misfit_of(fit: DeviceFit, lacking: ForceResidual, noise_counts: float) -> str:
    """In a sentence, where the model does not fit; "" where what is left is noise and rounding. `noise_counts`: of a
    position of the device at rest, rms."""
    expected = math.hypot(noise_counts, 1.0 / math.sqrt(12.0))
    if fit.is_white and fit.residual_counts < _LOUD * expected:
        return ""
    size = math.sqrt(float(np.mean(lacking.force**2)))
    return (
        f"the model does not fit: it leaves {fit.residual_counts:.3g} counts rms of the positions, where rounding and "
        f"noise explain {expected:.2g}. The force that it lacks, {size:.2g} N rms beside pushes of "
        f"{lacking.typical_force:.2g} N rms, {_where(lacking)}."
    )


def _where(lacking: ForceResidual) -> str:
    at_position, position = _explained(lacking.position, lacking.force)
    at_velocity, velocity = _explained(lacking.velocity, lacking.force)
    # On either side of a reversal the same law lacks a force with the other sign.
    in_swing, moment = _explained(lacking.in_swing, lacking.force * np.sign(lacking.velocity))
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
    """(the bin of each, the middles of the bins, the mean of `force` in each): bins of as many values each."""
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, BINS - 1)
    means = np.bincount(number, force, minlength=BINS) / np.maximum(np.bincount(number, minlength=BINS), 1)
    return number, 0.5 * (edges[1:] + edges[:-1]), means


def _explained(along: Vector, force: Vector) -> tuple[float, float]:
    """(share of the force's variance that the means over bins explain, beyond chance; where they are largest)."""
    if force.size < 4 * BINS:
        return 0.0, 0.0
    number, middles, means = binned(along, force)
    left = float(np.sum((force - means[number]) ** 2)) / (force.size - BINS)
    total = float(np.var(force)) * force.size / (force.size - 1)
    worst = int(np.argmax(np.abs(means - np.mean(force))))
    return (1.0 - left / total if total > 0.0 else 0.0), float(middles[worst])
