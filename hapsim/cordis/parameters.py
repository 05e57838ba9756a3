"""Live parameters: stiffness, damping and rest positions, changed while the loop runs.

Another thread posts a whole set of values. The loop takes it between two samples, and moves every value along a ramp to
its target,

    v(s) = v0 + (v1 - v0) (3 s² - 2 s³),     s = 1/N, 2/N, ... 1

over N samples: it begins and ends without a kink, and no value moves by more than 1.5/N of its way in one sample. A
later set retargets the ramp at once, from the current values.

If the energy of changes is accounted for, a step that adds more than the tank holds is shortened, for all values alike,
and the ramp takes longer (stored_energy.py).

The loop never waits, and posting takes no lock: a set counts once it is written, and is taken when the count has grown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from hapsim.compiling import helper
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.cordis.dispatch import Column
from hapsim.cordis.spring_energy import number_at, put_number, stored_at
from hapsim.cordis.stored_energy import affordable_share, call_evaluate, remaining_ramp, spend, tank_at

PARAMETERS = np.dtype(
    [
        ("address", np.uint64),  # of all this,
        ("move", np.uint64),  # and of the function that moves the values; 0 before the first set is posted
        ("count", np.int64),  # P
        ("single", np.int64),  # 1: `now` has numbers of single precision
        ("now", np.uint64),  # addresses of P numbers each: what the tick works with, in the program's units,
        ("following", np.uint64),  # what it will work with,
        ("ramps", np.uint64),  # and three rows behind one another: posted, origin, target
        ("posted", np.int64),  # sets so far
        ("taken", np.int64),  # `posted` of the set that was taken last
        ("sets", np.int64),  # that were taken
        ("posted_samples", np.int64),  # N of the posted set
        ("samples", np.int64),  # N of the set that was taken last
        ("straight", np.int64),  # 1: the ramp is a straight line, v0 + (v1 - v0) s
        ("left", np.float64),  # samples until the values are at their targets
        ("share", np.float64),  # of the way, that is behind them
        ("moved", np.int64),  # samples that the last set has taken so far
        ("stored", np.uint64),  # address of a STORED; 0: no energy is accounted for
    ],
    align=True,
)


class LiveValues:
    """P live values, shape (P,), and the memory of their ramps. `record`: PARAMETERS, for compiled code."""

    def __init__(self, values: Column, record: Any) -> None:
        self.values = values
        """Values of the tick, not a copy."""
        self._following = values.copy()
        self._ramps = np.tile(values.astype(np.float64), (3, 1))
        self.record = record
        record.address = address_of(record)
        record.count = values.size
        record.single = values.dtype == np.float32
        record.now, record.following = values.ctypes.data, self._following.ctypes.data
        record.ramps = self._ramps.ctypes.data

    def post(self, values: Column, samples: int, put: Callable[[Any, str, int], None] = setattr) -> None:
        """Posts targets, reached `samples` (>= 1) samples after the loop takes it. For one thread at a time. `put`:
        writes a word of the record [default: at once]; that of a mailbox does so at its next change."""
        self.record.move = move.address()
        self._ramps[0] = values
        put(self.record, "posted_samples", samples)
        put(self.record, "posted", int(self.record.posted) + 1)


_doubles_at, _parameters_at = array_at(np.float64), record_at(PARAMETERS)
call_move = function_at(types.int64(*[types.uint64] * 3))
"""Calls `move`, with its arguments. Returns 1 if any value moved."""


@native(types.int64, *[types.uint64] * 3)
def move(parameters, position, previous):
    """Takes a posted set, and moves the values by one sample; call it before the sample. Returns 1 if any value moved.
    `position`, `previous`: addresses of the points at this sample and the one before. Its address is set when a set is
    posted, so that it is compiled only if a value ever changes."""
    parameters = _parameters_at(parameters)
    count = parameters.count
    ramps = _doubles_at(parameters.ramps, 3 * count)
    posted, origin, target = ramps[:count], ramps[count:], ramps[2 * count :]
    if parameters.posted != parameters.taken:
        parameters.taken = parameters.posted  # first: one that is posted meanwhile is taken at the next sample
        for i in range(count):
            origin[i] = number_at(parameters.now, i, parameters.single)
            target[i] = posted[i]
        parameters.sets += 1
        parameters.samples = parameters.left = parameters.posted_samples
        parameters.share, parameters.moved = 0.0, 0
    if parameters.left == 0:
        return 0
    before = parameters.share
    parameters.moved += 1
    parameters.left = max(parameters.left - 1.0, 0.0)
    s = 1.0 - parameters.left / parameters.samples
    parameters.share = s if parameters.straight else s * s * (3.0 - 2.0 * s)
    _set_following(parameters, origin, target)
    if parameters.stored != 0:
        stored = stored_at(parameters.stored)
        tank = tank_at(stored.tank)
        change = (stored.address, position, previous, parameters.following - parameters.now)
        work = call_evaluate(stored.evaluate, change)
        share = affordable_share(tank, work)
        if share < 1.0:
            parameters.share = before + share * (parameters.share - before)
            parameters.left = parameters.samples * remaining_ramp(parameters.share)
            _set_following(parameters, origin, target)
            work = call_evaluate(stored.evaluate, change)
        spend(tank, work)
    for i in range(count):
        put_number(parameters.now, i, parameters.single, number_at(parameters.following, i, parameters.single))
    return 1


@helper
def _set_following(parameters, origin, target):
    """Computes the next values, at the completed share of their way."""
    for i in range(parameters.count):
        value = target[i]  # to the last digit
        if parameters.left > 0:
            value = origin[i] + parameters.share * (target[i] - origin[i])
        put_number(parameters.following, i, parameters.single, value)
