"""The mass of the temporary hybrid system, estimated while it runs.

The second difference of the positions that are read is what the forces that acted make of it,

    y[n] - 2 y[n-1] + y[n-2] = phi[n] / m,      phi[n] = T² (sum of w f) - b0 T (y[n] - y[n-2]) / 2 - k0 T² y[n-1]

with the weights w of the hold, the sampling and the delay. Both sides lose their slow part, in which a hand's own push
is, and m is the ratio of their sums of squares and products, which forget with a time of MEMORY_S. It counts only
where the motion is clearly above the counts, and is what the forces explain: else the estimate stays, or, where the
forces do not explain the motion, goes back to the least mass.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.loop.predictor import IN_ALL

MEMORY_S, LEAST_MEMORY = 0.03, 24  # s, samples
SLOW_S = 0.1  # what changes more slowly is a hand's own push, or gravity
CLEARLY = 25.0  # the motion's mean square over that of the counts
UNEXPLAINED = 0.1  # of the motion's energy, from which on the forces do not explain it
MOST_WEIGHTS = 8

_EACH = (schema.MAX_CHANNELS,)
_ROW = schema.MAX_CHANNELS

MASS_ESTIMATE = np.dtype(
    [
        ("log_least", np.float64, _EACH),  # of the span, ln kg
        ("forget", np.float64),  # what a sample leaves of the sums
        ("slow", np.float64),  # what a sample adds to the slow parts
        ("first_lag", np.int64),  # f[n - first_lag] has the first of the weights
        ("count", np.int64),
        ("weights", np.float64, (MOST_WEIGHTS,)),  # s²
        ("braked", np.float64, _EACH),  # b0 T / 2, kg
        ("sprung", np.float64, _EACH),  # k0 T², kg
        ("noise", np.float64, _EACH),  # m², the mean square of the counts' second difference
        ("last", np.float64, _EACH),  # m, y[n-1]
        ("last_but_one", np.float64, _EACH),
        ("seen", np.int64),  # samples in a row
        ("slow_motion", np.float64, _EACH),
        ("slow_phi", np.float64, _EACH),
        ("samples_kept", np.float64, _EACH),
        ("phi_phi", np.float64, _EACH),
        ("phi_motion", np.float64, _EACH),
        ("motion_motion", np.float64, _EACH),
    ],
    align=True,
)


@helper
def estimate_mass(estimate, predictor, forces, c, position, now):
    """Takes one sample more, and returns ln of the mass in kg; `now` where the sample does not tell."""
    motion = position - 2.0 * estimate.last[c] + estimate.last_but_one[c]
    phi = -estimate.braked[c] * (position - estimate.last_but_one[c]) - estimate.sprung[c] * estimate.last[c]
    estimate.last_but_one[c], estimate.last[c] = estimate.last[c], position
    if estimate.seen < 3 + estimate.first_lag + estimate.count:
        return now
    for i in range(estimate.count):
        row = (predictor.newest - (estimate.first_lag - 1 + i)) & predictor.mask
        phi += estimate.weights[i] * forces[row * 2 * _ROW + IN_ALL + c]
    estimate.slow_motion[c] += estimate.slow * (motion - estimate.slow_motion[c])
    estimate.slow_phi[c] += estimate.slow * (phi - estimate.slow_phi[c])
    motion -= estimate.slow_motion[c]
    phi -= estimate.slow_phi[c]
    kept = estimate.forget
    estimate.samples_kept[c] = kept * estimate.samples_kept[c] + 1.0
    estimate.phi_phi[c] = kept * estimate.phi_phi[c] + phi * phi
    estimate.phi_motion[c] = kept * estimate.phi_motion[c] + phi * motion
    estimate.motion_motion[c] = kept * estimate.motion_motion[c] + motion * motion
    return _estimated(estimate, c, now)


@helper
def _estimated(estimate, c, now):
    """ln of the mass; `now` where too little moves, the least where the forces do not explain
    it."""
    moved, explained = estimate.motion_motion[c], estimate.phi_motion[c]
    if not moved > CLEARLY * estimate.noise[c] * estimate.samples_kept[c]:
        return now
    pushed = estimate.phi_phi[c]
    if not explained > 0.0 or explained * explained < (1.0 - UNEXPLAINED) * pushed * moved:
        return estimate.log_least[c]
    return math.log(pushed / explained)


def fill_mass_estimate(record: Any, period_s: float, numerator: NDArray[np.float64], first_lag: int) -> None:
    """Sets up a MASS_ESTIMATE, except for its channels. `numerator`: how much of T²/m f[n - first_lag], and of the
    forces before it, is in the second difference of the positions at sample n."""
    record.first_lag, record.count = first_lag, len(numerator)
    record.weights[: len(numerator)] = period_s**2 * numerator
    record.forget = 1.0 - 1.0 / max(MEMORY_S / period_s, LEAST_MEMORY)
    record.slow = 1.0 / max(SLOW_S / period_s, 4.0 * LEAST_MEMORY)
