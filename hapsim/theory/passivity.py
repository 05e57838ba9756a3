"""How much real friction a sampled virtual wall needs to be passive.

Colgate and Schenkel, "Passivity of a class of sampled-data systems" (1997); with a delay, Gil et al.,
"Stability analysis of a 1 DOF haptic interface" (2004). For the wall H(z) = K + B (1 - 1/z)/T behind a
zero-order hold, their

    b0 > T / (2 (1 - cos wT)) · Re[(1 - exp(-jwT)) H(exp(jwT)) exp(-jwT delay)]   for all 0 < w <= pi/T

is, with theta = wT,

    b0 > K T/2 · sin((delay + 1/2) theta) / sin(theta/2) - B cos((delay + 1) theta)

The right side is smooth and even at theta = 0, where it is K T (delay + 1/2) - B. Its upper bound is there
for a spring alone, at pi/T for a damper without delay, and between them in general.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.theory.arrays import Floats

POINTS_PER_SWING = 64  # of theta, for the fastest term to go from one extreme to the other
REFINED_SPACING = (1.0, 0.02, 0.02)  # of that grid: the last parabola is good to rounding
ROWS_AT_ONCE = 4096


def needed_friction(elastic: Floats, viscous: Floats, delay: float) -> Floats:
    """The least upper bound, over theta, of the friction that the wall demands, in the unit of the arguments.

    Args:
        elastic: K T/2, any shape.
        viscous: B, same shape.
        delay: sample periods, >= 0.
    """
    if delay == 0.0:
        return elastic + np.abs(viscous)
    walls = np.stack([elastic.ravel(), viscous.ravel()], axis=-1)
    parts = np.array_split(walls, math.ceil(len(walls) / ROWS_AT_ONCE) or 1)
    return np.concatenate([_upper_bound(part, delay) for part in parts]).reshape(elastic.shape)


def _upper_bound(walls: Floats, delay: float) -> Floats:
    """For walls (n, 2): the best point of a grid, then parabolas through three points about it."""
    count = math.ceil(POINTS_PER_SWING * (delay + 1.0))
    spacing = math.pi / count
    # One point beyond either end, where the demand goes on smoothly.
    theta = spacing * np.arange(-1.0, count + 2.0, dtype=np.float64)
    demand = _demand(walls[:, None], theta, delay)
    rise, bend = _slope_and_bend(demand[:, :-2], demand[:, 1:-1], demand[:, 2:])
    summit = demand[:, 1:-1] + np.where(np.abs(rise) < -bend, -0.5 * rise**2 / np.minimum(bend, -1e-300), 0.0)
    best = np.argmax(np.nan_to_num(summit, nan=-np.inf), axis=-1)
    at = theta[1 + best]
    bound = np.take_along_axis(demand, 1 + best[:, None], axis=-1)[:, 0]

    for fraction in REFINED_SPACING:
        step = fraction * spacing
        rise, bend = _slope_and_bend(*(_demand(walls, at + shift, delay) for shift in (-step, 0.0, step)))
        move = np.divide(-rise, bend, out=np.zeros_like(rise), where=bend < 0.0)
        at = np.clip(at + step * np.clip(move, -1.0, 1.0), 0.0, math.pi)
        bound = np.maximum(bound, _demand(walls, at, delay))
    return bound


def _slope_and_bend(before: Floats, here: Floats, after: Floats) -> tuple[Floats, Floats]:
    return 0.5 * (after - before), after - 2.0 * here + before


def _demand(walls: Floats, theta: Floats, delay: float) -> Floats:
    """The right side above, of walls (..., 2): K T/2 and B."""
    turns = 2.0 * delay + 1.0
    ratio = turns * np.sinc(0.5 * turns * theta / np.pi) / np.sinc(0.5 * theta / np.pi)
    return walls[..., 0] * ratio - walls[..., 1] * np.cos((delay + 1.0) * theta)
