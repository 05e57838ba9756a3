"""Live parameters: stiffness, damping and rest positions, changed while the loop runs.

Another thread posts a whole set of values; the loop takes it between two samples, all or nothing, and leads every value
along a ramp from where it is to its target,

    v(s) = v0 + (v1 - v0) (3 s² - 2 s³),     s = 1/N, 2/N, ... 1

over N samples: it begins and ends without a kink, and no value moves by more than 1.5/N of its way in one sample. A set
that comes meanwhile retargets the ramp at once, from wherever the values are.

Where the energy of changes is accounted for, a step that adds more than the tank has is shortened, for all values
alike, and the ramp takes longer (stored_energy.py).

The loop never waits: while a set is being written it goes on with what it has, and looks again at the next sample.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from hapsim.compiling import entry, helper
from hapsim.compiling.memory_fence import fence
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.cordis.stored_energy import call_evaluate, left_of, share_that_lasts, spend, stored_at, tank_at
from hapsim.cordis.tick_state import Column

PARAMETERS = np.dtype(
    [
        ("address", np.uint64),  # of all this,
        ("move", np.uint64),  # and of what moves the values; 0 until something is posted
        ("count", np.int64),  # P
        ("single", np.int64),  # 1: `now` has numbers of single precision
        ("now", np.uint64),  # addresses of P numbers each: what the tick works with, in the program's units,
        ("ramps", np.uint64),  # and four rows behind one another: posted, incoming, origin, target
        ("posted", np.int64),  # counts up by two a set; odd while one is being written
        ("taken", np.int64),  # `posted` of the set that was taken last
        ("sets", np.int64),  # that were taken
        ("posted_samples", np.int64),  # N of the posted set
        ("samples", np.int64),  # N of the set that was taken last
        ("left", np.float64),  # samples until the values are at their targets
        ("share", np.float64),  # of the way, that is behind them
        ("stored", np.uint64),  # address of a STORED; 0: no energy is accounted for
    ],
    align=True,
)


class LiveValues:
    """P values that can be changed, shape (P,), and the memory of their ramps; `record`: what compiled code sees."""

    def __init__(self, values: Column, record: Any) -> None:
        self.values = values
        """The tick's own numbers, not a copy."""
        self._ramps = np.tile(values.astype(np.float64), (4, 1))
        self.record = record
        record.address = address_of(record)
        record.count = values.size
        record.single = values.dtype == np.float32
        record.now = values.ctypes.data
        record.ramps = self._ramps.ctypes.data

    def post(self, values: Column, samples: int) -> None:
        """Posts a whole set, to be reached `samples` (>= 1) samples after it is taken. One thread at a time."""
        self.record.move = move.address()
        post(self.record, values.astype(np.float64), samples)


_doubles_at, _singles_at, _parameters_at = array_at(np.float64), array_at(np.float32), record_at(PARAMETERS)
call_move = function_at(types.int64(*[types.uint64] * 3))
"""Calls `move`, with its arguments: whether any moved."""


@entry
def post(parameters, values, samples):
    """`LiveValues.post`, compiled. `values`: (P,) of float64."""
    posted = _doubles_at(parameters.ramps, parameters.count)
    parameters.posted += 1
    fence()
    for i in range(values.size):
        posted[i] = values[i]
    parameters.posted_samples = samples
    fence()
    parameters.posted += 1


@native(types.int64, *[types.uint64] * 3)
def move(parameters, position, previous):
    """Before a sample: takes what was posted, and moves the values by one sample; 1 where any moved. `position`,
    `previous`: addresses of the points at this sample and the one before.

    It is called by its address, which is there once something was posted: who never changes a value never compiles it.
    """
    parameters = _parameters_at(parameters)
    count = parameters.count
    ramps = _doubles_at(parameters.ramps, 4 * count)
    posted, incoming, origin, target = ramps[:count], ramps[count : 2 * count], ramps[2 * count :], ramps[3 * count :]
    number = parameters.posted
    if number != parameters.taken and not number & 1:  # not being written at this moment
        fence()
        for i in range(count):
            incoming[i] = posted[i]
        samples = parameters.posted_samples
        fence()
        if parameters.posted == number:
            doubles, singles = _doubles_at(parameters.now, count), _singles_at(parameters.now, count)
            for i in range(count):
                origin[i] = singles[i] if parameters.single else doubles[i]
                target[i] = incoming[i]
            parameters.taken = number
            parameters.sets += 1
            parameters.samples = parameters.left = samples
            parameters.share = 0.0
    if parameters.left == 0:
        return 0
    before = parameters.share
    parameters.left = max(parameters.left - 1.0, 0.0)
    s = 1.0 - parameters.left / parameters.samples
    parameters.share = s * s * (3.0 - 2.0 * s)
    if parameters.stored == 0:
        _set_values(parameters, origin, target)
        return 1
    stored = stored_at(parameters.stored)
    tank = tank_at(stored.tank)
    arguments = (stored.address, position, previous, np.int64(0))
    held = call_evaluate(stored.evaluate, arguments)
    _set_values(parameters, origin, target)
    work = call_evaluate(stored.evaluate, arguments) - held
    lasts = share_that_lasts(tank, work)
    if lasts < 1.0:
        parameters.share = before + lasts * (parameters.share - before)
        parameters.left = parameters.samples * left_of(parameters.share)
        _set_values(parameters, origin, target)
        work = call_evaluate(stored.evaluate, arguments) - held
    spend(tank, work)
    return 1


@helper
def _set_values(parameters, origin, target):
    count = parameters.count
    doubles, singles = _doubles_at(parameters.now, count), _singles_at(parameters.now, count)
    for i in range(count):
        value = target[i]  # to the last digit
        if parameters.left > 0:
            value = origin[i] + parameters.share * (target[i] - origin[i])
        if parameters.single:
            singles[i] = value
        else:
            doubles[i] = value
