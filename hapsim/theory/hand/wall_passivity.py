"""Real friction that a sampled virtual wall needs to be passive.

Colgate and Schenkel, "Passivity of a class of sampled-data systems" (1997). For a wall H(z) behind a zero-order hold
and a whole number D of samples of delay, with theta = wT,

    b0 > h_D(theta) = T/(2 (1 - cos theta)) Re[(1 - exp(-j theta)) H(exp(j theta)) exp(-j D theta)],  0 < theta <= pi

which is K T (D + 1/2) for a spring alone and K T/2 + |B| for a backward damper without delay.

A fraction f of a sample is more than a phase. It delays each of the hold's images of a motion, at theta + 2 pi n, by
another phase, and a hand may move at all of them at once. Their power is a quadratic form of rank two in the images. By
the sums over 1/(theta + 2 pi n)², its largest value is

    (R + sqrt(R² + f (1 - f) (T |H|)²))/2,    R = (1 - f) h_D + f h_(D+1)

Any other hold without impulses has other weights and another factor f (1 - f): those of ``interface.Lag``.

At the middle of a sample it exceeds the demands of both whole delays: 1.059 K T at a delay of half a sample, where K T
(delay + 1/2) (Gil et al., "Stability analysis of a 1 DOF haptic interface", 2004) would be K T.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.dampers import DamperModel
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.interface import Lag, damper_velocity

POINTS_PER_SWING = 64  # of theta, for a half oscillation of the fastest term
REFINED_SPACING = (1.0, 0.02, 0.02)  # of that grid: the last parabola is accurate to rounding
SLOWEST = 1e-7  # of theta: the demand is smooth and even at 0
ROWS_AT_ONCE = 1024


def needed_friction(elastic: Floats, viscous: Floats, lag: Lag, damper: DamperModel) -> Floats:
    """Least upper bound (n,), N·s/m, over theta, of the friction that each of n walls K T and B, N·s/m, demands."""
    parts = (slice(i, i + ROWS_AT_ONCE) for i in range(0, elastic.size, ROWS_AT_ONCE))
    found = [_upper_bound(elastic[rows, None], viscous[rows, None], lag, damper) for rows in parts]
    return np.concatenate(found) if found else np.empty(0)


def _upper_bound(elastic: Floats, viscous: Floats, lag: Lag, damper: DamperModel) -> Floats:
    """Returns the best point of a grid, refined by parabolas through three points around it."""

    def demand_at(theta: Floats) -> Floats:
        theta = np.maximum(np.abs(theta), SLOWEST)
        return _demand(elastic + viscous * damper_velocity(damper, theta), theta, lag)

    late = lag.lags[-1] - 1.0 + len(damper.of_positions) - len(damper.of_velocities)
    count = math.ceil(POINTS_PER_SWING * late)
    spacing = math.pi / count
    # One point beyond either end, where the demand continues smoothly.
    theta = spacing * np.arange(-1.0, count + 2.0, dtype=np.float64)
    demand = demand_at(theta[None, :])
    rise, bend = _slope_and_bend(demand[:, :-2], demand[:, 1:-1], demand[:, 2:])
    summit = demand[:, 1:-1] + np.where(np.abs(rise) < -bend, -0.5 * rise**2 / np.minimum(bend, -1e-300), 0.0)
    best = np.argmax(np.nan_to_num(summit, nan=-np.inf), axis=-1)
    at = theta[1 + best]
    bound = np.take_along_axis(demand, 1 + best[:, None], axis=-1)[:, 0]

    for fraction in REFINED_SPACING:
        step = fraction * spacing
        three = demand_at(at[:, None] + np.array([-step, 0.0, step]))
        rise, bend = _slope_and_bend(three[:, 0], three[:, 1], three[:, 2])
        move = np.divide(-rise, bend, out=np.zeros_like(rise), where=bend < 0.0)
        at = np.clip(at + step * np.clip(move, -1.0, 1.0), 0.0, math.pi)
        bound = np.maximum(bound, demand_at(at[:, None])[:, 0])
    return bound


def _slope_and_bend(before: Floats, here: Floats, after: Floats) -> tuple[Floats, Floats]:
    return 0.5 * (after - before), after - 2.0 * here + before


def _demand(reaction: Complexes, theta: Floats, lag: Lag) -> Floats:
    """Friction that walls with this ``reaction`` demand at theta, (1 or n, points): (n, points)."""
    # With (1 - exp(-j theta))/(2 (1 - cos theta)) = (1 + j cot(theta/2))/2.
    turned = reaction * lag.read(np.exp(-1j * theta)) * np.exp(1j * theta)
    between = np.asarray(0.5 * (turned.real - turned.imag / np.tan(0.5 * theta)))
    unread = lag.unread(theta)
    return 0.5 * (between + np.sqrt(between**2 + unread * np.abs(reaction) ** 2))
