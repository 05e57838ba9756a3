"""The correction `adaptive`: the force follows the estimated mass (mass_estimate.py), by a factor e in SLEW_S at most.

`prediction/correction/adaptive.py` computes the predictor's table beforehand: what to simulate for which mass, stable
for all of them. A scene without this correction never compiles it.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.compiling.native import array_at, native, record_at
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.mass_estimate import MASS_ESTIMATE, estimate_mass, note_sample, take_spans
from hapsim.loop.predictor import ADD, PREDICT, PREDICTOR, look_ahead, observe, set_numbers, take_posted

SLEW_S, LEAST_SLEW = 0.05, 25  # s, samples: for a factor e of the mass

_EACH = (schema.MAX_CHANNELS,)

ADAPTIVE = np.dtype(
    [
        ("adapts", np.int64, _EACH),  # 1: this channel's force follows an estimate
        ("log_least", np.float64, _EACH),  # ln kg: the span of masses,
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # and the mass that the force is for
        ("slew", np.float64),  # the largest change of ln m in a sample
        ("estimate", MASS_ESTIMATE),
    ],
    align=True,
)

_predictor_at, _io_at, _doubles_at = record_at(PREDICTOR), record_at(IO_BUFFER), array_at(np.float64)
_adaptive_at = record_at(ADAPTIVE)
_ROW = schema.MAX_CHANNELS

ADDED = 3
"""The last of a channel's numbers: N/m, N·s/m and N, which are added to the scene's force."""


@native(PREDICT.return_type, *PREDICT.args)
def predict_adaptively(predictor, io, gap, late, age):
    """As `predict`, with the numbers for the estimated mass."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    adaptive = _adaptive_at(predictor.adaptive)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * 2 * _ROW)
    observe(predictor, io, gap, late, age)
    if take_posted(predictor):
        take_spans(adaptive.estimate)
    follows = predictor.left > 0
    predictor.left -= follows
    note_sample(adaptive.estimate, gap, late)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            step = estimate_mass(adaptive.estimate, predictor, forces, c, io.measured[c]) - adaptive.log_mass[c]
            adaptive.log_mass[c] += min(max(step, -adaptive.slew), adaptive.slew)
            span = adaptive.log_most[c] - adaptive.log_least[c]
            set_numbers(predictor, c, (adaptive.log_mass[c] - adaptive.log_least[c]) / span * (predictor.rows - 1))
        elif follows:
            set_numbers(predictor, c, 0.0)
    look_ahead(predictor, io)


@native(ADD.return_type, *ADD.args)
def add_difference(predictor, io):
    """Adds to the scene's force: the scene's links are those for the least mass."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    numbers = _doubles_at(predictor.numbers, _ROW * predictor.width)
    for c in range(io.channels):
        dK = (c + 1) * predictor.width - ADDED
        io.asked[c] += numbers[dK + 2] - numbers[dK] * io.measured[c] - numbers[dK + 1] * io.velocity[c]
