"""The mass of the temporary hybrid system, estimated while it runs, and a force that follows the estimate.

The second difference of the positions that are read is what the forces that acted make of it,

    y[n] - 2 y[n-1] + y[n-2] = phi[n] / m,      phi[n] = T² (sum of w f) - b0 T (y[n] - y[n-2]) / 2 - k0 T² y[n-1]

with the weights w of the hold, the sampling and the delay. Both sides lose their slow part, in which a hand's own push
is, and m is the ratio of their sums of squares and products, which forget with a time of MEMORY_S. It counts only
where the motion is clearly above the counts, and is what the forces explain: else the estimate stays, or, where the
forces do not explain the motion, goes back to the least mass. What is simulated follows it no faster than by a factor e
in SLEW_S.

For which masses there is something to simulate, and that it is stable for all of them, is worked out before
(`prediction/correction/adaptive.py`) and comes as a table. Who adapts nothing never compiles this.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.records import new_record
from hapsim.compiling import entry, helper
from hapsim.compiling.memory_fence import fence
from hapsim.compiling.native import address_of, array_at, native, record_at
from hapsim.loop.io_buffer import IO_BUFFER
from hapsim.loop.predictor import ADD, IN_ALL, PREDICT, PREDICTOR, keep_forces, predict_state

MEMORY_S, LEAST_MEMORY = 0.03, 24  # s, samples
SLOW_S = 0.1  # what changes more slowly is a hand's own push, or gravity
SLEW_S, LEAST_SLEW = 0.05, 25  # s, samples: for a factor e of the mass
CLEARLY = 25.0  # the motion's mean square over that of the counts
UNEXPLAINED = 0.1  # of the motion's energy, from which on the forces do not explain it
MOST_WEIGHTS = 8

_EACH = (schema.MAX_CHANNELS,)

ADAPTIVE = np.dtype(
    [
        ("table", np.uint64),  # address of (channels, rows, 3 + 2 (2 + lags)): dK, dB, dK rest; then the weights
        ("before", np.uint64),  # of the one before it, while one follows the other
        ("posted", np.uint64),  # of one that shall follow; 0: none
        ("posted_samples", np.int64),
        ("samples", np.int64),  # in so many
        ("left", np.int64),  # samples until the one before is left
        ("rows", np.int64),
        ("adapts", np.int64, _EACH),  # 1: this channel's force follows an estimate
        ("log_least", np.float64, _EACH),  # of the span, ln kg
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # for which the force is now
        ("dK", np.float64, _EACH),  # N/m, N·s/m and N: what comes to the scene's force now
        ("dB", np.float64, _EACH),
        ("dF", np.float64, _EACH),
        ("slew", np.float64),  # of ln m in a sample, at most
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

_predictor_at, _io_at, _doubles_at = record_at(PREDICTOR), record_at(IO_BUFFER), array_at(np.float64)
_adaptive_at = record_at(ADAPTIVE)
_ROW = schema.MAX_CHANNELS


@native(PREDICT.return_type, *PREDICT.args)
def predict_adaptively(predictor, io, gap, late, age):
    """As `predict`, with the weights for the mass that is estimated."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    adaptive = _adaptive_at(predictor.adaptive)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * 2 * _ROW)
    if predictor.begun:
        keep_forces(predictor, io, forces, gap, late, age)
    _take_posted(adaptive)
    adaptive.seen = adaptive.seen + 1 if gap == 1 else 1
    for c in range(io.channels):
        if adaptive.adapts[c]:
            _estimate(adaptive, predictor, forces, c, io.measured[c])
            _set_weights(adaptive, predictor, c)
    if adaptive.left > 0:
        adaptive.left -= 1
    predict_state(predictor, io, forces, gap)


@native(ADD.return_type, *ADD.args)
def add_difference(predictor, io):
    """What comes to the scene's force, since the scene's links are those for the least mass."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    adaptive = _adaptive_at(predictor.adaptive)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            io.asked[c] += adaptive.dF[c] - adaptive.dK[c] * io.measured[c] - adaptive.dB[c] * io.velocity[c]


@helper
def _take_posted(adaptive):
    if adaptive.posted != 0 and adaptive.left == 0:
        adaptive.before, adaptive.table = adaptive.table, adaptive.posted
        adaptive.samples = adaptive.left = adaptive.posted_samples
        fence()
        adaptive.posted = np.uint64(0)


@helper
def _estimate(adaptive, predictor, forces, c, position):
    """One sample more of what moves and of what it is moved by; then the mass goes to where they say."""
    motion = position - 2.0 * adaptive.last[c] + adaptive.last_but_one[c]
    phi = -adaptive.braked[c] * (position - adaptive.last_but_one[c]) - adaptive.sprung[c] * adaptive.last[c]
    adaptive.last_but_one[c], adaptive.last[c] = adaptive.last[c], position
    if adaptive.seen < 3 + adaptive.first_lag + adaptive.count:
        return
    for i in range(adaptive.count):
        row = (predictor.newest - (adaptive.first_lag - 1 + i)) & predictor.mask
        phi += adaptive.weights[i] * forces[row * 2 * _ROW + IN_ALL + c]
    adaptive.slow_motion[c] += adaptive.slow * (motion - adaptive.slow_motion[c])
    adaptive.slow_phi[c] += adaptive.slow * (phi - adaptive.slow_phi[c])
    motion -= adaptive.slow_motion[c]
    phi -= adaptive.slow_phi[c]
    kept = adaptive.forget
    adaptive.samples_kept[c] = kept * adaptive.samples_kept[c] + 1.0
    adaptive.phi_phi[c] = kept * adaptive.phi_phi[c] + phi * phi
    adaptive.phi_motion[c] = kept * adaptive.phi_motion[c] + phi * motion
    adaptive.motion_motion[c] = kept * adaptive.motion_motion[c] + motion * motion
    step = _wanted(adaptive, c) - adaptive.log_mass[c]
    adaptive.log_mass[c] += min(max(step, -adaptive.slew), adaptive.slew)


@helper
def _wanted(adaptive, c):
    """ln of the mass, within the span; as it is where too little moves, the least where the forces do not explain
    it."""
    moved, explained = adaptive.motion_motion[c], adaptive.phi_motion[c]
    if not moved > CLEARLY * adaptive.noise[c] * adaptive.samples_kept[c]:
        return adaptive.log_mass[c]
    pushed = adaptive.phi_phi[c]
    if not explained > 0.0 or explained * explained < (1.0 - UNEXPLAINED) * pushed * moved:
        return adaptive.log_least[c]
    return min(max(math.log(pushed / explained), adaptive.log_least[c]), adaptive.log_most[c])


@helper
def _set_weights(adaptive, predictor, c):
    """From the table: between the two rows, and, while one table follows another, between the two tables."""
    width = 2 + predictor.lags
    row_width = 3 + 2 * width
    size = _ROW * adaptive.rows * row_width
    table, before = _doubles_at(adaptive.table, size), _doubles_at(adaptive.before, size)
    s = 1.0 - adaptive.left / adaptive.samples
    newer = s * s * (3.0 - 2.0 * s)
    span = adaptive.log_most[c] - adaptive.log_least[c]
    at = (adaptive.log_mass[c] - adaptive.log_least[c]) / span * (adaptive.rows - 1)
    row = min(np.int64(at), adaptive.rows - 2)
    share = at - row
    first = (c * adaptive.rows + row) * row_width
    weights = _doubles_at(predictor.weights, _ROW * 2 * width)
    for i in range(row_width):
        value = table[first + i] + share * (table[first + row_width + i] - table[first + i])
        if newer < 1.0:
            older = before[first + i] + share * (before[first + row_width + i] - before[first + i])
            value = older + newer * (value - older)
        if i == 0:
            adaptive.dK[c] = value
        elif i == 1:
            adaptive.dB[c] = value
        elif i == 2:
            adaptive.dF[c] = value
        else:
            weights[2 * c * width + i - 3] = value


class AdaptiveChannel(NamedTuple):
    """What follows the estimate on a channel: R rows, for masses in equal ratios from the least to the most, in kg."""

    span: tuple[float, float]
    stiffness: NDArray[np.float64]
    """(R,) N/m, that come to the scene's,"""
    damping: NDArray[np.float64]
    """(R,) N·s/m,"""
    rest: float
    """and the position in m at which they are at rest"""
    weights: NDArray[np.float64]
    """(R, 2, 2 + lags): those of the predictor"""
    friction: float
    """N·s/m, of the device"""
    device_stiffness: float
    """N/m"""


class Adaptation:
    """Fills an ADAPTIVE, and keeps what it points to."""

    def __init__(
        self,
        predictor: Any,
        channels: dict[int, AdaptiveChannel],
        *,
        period_s: float,
        numerator: NDArray[np.float64],
        first_lag: int,
        count_m: NDArray[np.float64],
    ) -> None:
        """`predictor`: its PREDICTOR, already filled. `numerator`: how much of T²/m f[n - first_lag], and of the forces
        before it, is in the second difference of the positions at sample n. `count_m`: m per count, each channel's."""
        self.record = record = new_record(ADAPTIVE)
        self._predictor = predictor
        self._channels = channels
        record.rows = len(next(iter(channels.values())).stiffness)
        self._tables = [self._table(channels)]
        record.table = record.before = self._tables[0].ctypes.data
        record.samples = 1
        record.first_lag, record.count = first_lag, len(numerator)
        record.weights[: len(numerator)] = period_s**2 * numerator
        record.slew = 1.0 / max(SLEW_S / period_s, LEAST_SLEW)
        record.forget = 1.0 - 1.0 / max(MEMORY_S / period_s, LEAST_MEMORY)
        record.slow = 1.0 / max(SLOW_S / period_s, 4.0 * LEAST_MEMORY)
        for channel, one in channels.items():
            record.adapts[channel] = 1
            record.log_least[channel], record.log_most[channel] = np.log(one.span)
            record.log_mass[channel] = record.log_least[channel]
            record.braked[channel] = 0.5 * one.friction * period_s
            record.sprung[channel] = one.device_stiffness * period_s**2
            record.noise[channel] = 6.0 * count_m[channel] ** 2 / 12.0
        predictor.adaptive = address_of(record)
        predictor.predict = predict_adaptively.address()
        predictor.add = add_difference.address()

    def follow(self, channels: dict[int, AdaptiveChannel], samples: int) -> None:
        """Other tables for the same channels, over so many samples, once the last have taken their place."""
        self._tables = [*self._tables[-8:], self._table(channels)]
        post_table(self.record, self._tables[-1].ctypes.data, samples)

    def masses_kg(self) -> dict[int, float]:
        """For which mass the force is now, on every channel that adapts."""
        return {channel: float(np.exp(self.record.log_mass[channel])) for channel in self._channels}

    def _table(self, channels: dict[int, AdaptiveChannel]) -> NDArray[np.float64]:
        rows, lags = int(self.record.rows), int(self._predictor.lags)
        table = np.zeros((_ROW, rows, 3 + 2 * (2 + lags)))
        for channel, one in channels.items():
            table[channel, :, 0], table[channel, :, 1] = one.stiffness, one.damping
            table[channel, :, 2] = one.stiffness * one.rest
            table[channel, :, 3:] = one.weights.reshape(rows, -1)
        return table


@entry
def post_table(adaptive, table, samples):
    """`Adaptation.follow`, compiled."""
    adaptive.posted_samples = samples
    fence()
    adaptive.posted = np.uint64(table)
