"""Live parameters: stiffness, damping and rest positions, changed while the loop runs.

Another thread posts a whole set of values. The loop takes it between two samples, and moves every value along a ramp to
its target,

    v(s) = v0 + (v1 - v0) (3 s² - 2 s³),     s = 1/N, 2/N, ... 1

over N samples: it begins and ends without a kink, and no value moves by more than 1.5/N of its way in one sample. A
later set retargets the ramp at once, from the current values.

**Gates.** A value that is a force, of a link with `when: touch`, is multiplied by a weight w. It moves between 0 and 1
by the same law over FADE_S whenever that input changes; one that changes back turns round where it is. A ramp moves the
value under its gate.

If the energy of changes is accounted for, a step that adds more than the tank holds is shortened, for all values and
gates alike, and takes longer (stored_energy.py).

The loop never waits, and posting takes no lock: a set counts once it is written, and is taken when the count has grown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types

from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at, value_of
from hapsim.cordis.dispatch import Column, action
from hapsim.cordis.spring_energy import number_at, put_number, stored_at
from hapsim.cordis.stored_energy import affordable_share, call_evaluate, remaining_ramp, smooth, spend, tank_at

FADE_S = 5e-3
"""Duration of a gate's fade, s."""

PARAMETERS = np.dtype(
    [
        ("address", np.uint64),  # of all this,
        ("move", np.uint64),  # and of the function that moves the values; 0 before the first set, without gates
        ("count", np.int64),  # P
        ("single", np.int64),  # 1: `now` has numbers of single precision
        ("own", np.uint64),  # addresses of P numbers each: the values without their gates; without gates `now`,
        ("now", np.uint64),  # what the tick works with, in the program's units,
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
        ("gates", np.int64),  # G, how many there are,
        ("masks", np.uint64),  # address of their bits of the word of inputs,
        ("phases", np.uint64),  # and of two rows of s, of which w = 3 s² - 2 s³: now, and with the next sample
        ("gate_of", np.uint64),  # address of P numbers of gates; -1: none
        ("inverted", np.int64),  # bits of the inputs that are on while theirs is 0
        ("inputs", np.uint64),  # address of the word of inputs
        ("fade", np.float64),  # samples of a whole fade
    ],
    align=True,
)


class Gates(NamedTuple):
    """G gates of live values: `masks` of their inputs, by name; the gate of each of the P values, -1 for none."""

    masks: Mapping[str, int]
    gate_of: Sequence[int]
    inverted: int = 0
    """Bits of the inputs that are on while theirs is 0."""
    fade: float = 1.0
    """Samples of a whole fade."""


class LiveValues:
    """P live values, shape (P,), and the memory of their ramps and gates. `record`: PARAMETERS, for compiled code."""

    def __init__(self, values: Column, record: Any, gates: Gates | None = None) -> None:
        self.values = values
        """Values of the tick, not a copy."""
        self.own = values if gates is None else values.copy()
        """The same without their gates."""
        gates = gates or Gates({}, ())
        self.phases = np.ones((2, len(gates.masks)))
        """s of every gate, now and with the next sample."""
        self.gates = tuple(gates.masks)
        """Inputs of the gates, by name."""
        self._following = values.copy()
        self._ramps = np.tile(values.astype(np.float64), (3, 1))
        self._masks = np.array([*gates.masks.values()], np.int64)
        self._gate_of = np.array(gates.gate_of, np.int64)
        self.inputs = np.array([~gates.inverted])
        """Word of inputs for a program without a loop: every input is on at first."""
        self.record = record
        record.address = address_of(record)
        record.count = values.size
        record.single = values.dtype == np.float32
        record.own, record.now, record.following = map(address_of, (self.own, values, self._following))
        record.ramps = address_of(self._ramps)
        record.gates, record.inverted, record.fade = len(gates.masks), gates.inverted, gates.fade
        if gates.masks:
            record.move = move.address()
            record.masks, record.phases, record.gate_of = map(address_of, (self._masks, self.phases, self._gate_of))
            record.inputs = address_of(self.inputs)

    def post(self, values: Column, samples: int, put: Callable[[Any, str, int], None] = setattr) -> None:
        """Posts targets, reached `samples` (>= 1) samples after the loop takes it. For one thread at a time. `put`:
        writes a word of the record [default: at once]; that of a mailbox does so at its next change."""
        self.record.move = move.address()
        self._ramps[0] = values
        put(self.record, "posted_samples", samples)
        put(self.record, "posted", int(self.record.posted) + 1)


_doubles_at, _words_at, _parameters_at = array_at(np.float64), array_at(np.int64), record_at(PARAMETERS)


class GateNumbers(NamedTuple):
    """PARAMETERS, for actions on gates."""

    parameters: Any


@action
def set_gates(gates, _state):
    """Opens the gates whose inputs are on, and closes the others, at once."""
    parameters = value_of(gates).parameters
    phases = _doubles_at(parameters.phases, 2 * parameters.gates)
    _aim_gates(parameters, phases, 1.0)
    _apply_gates(parameters)


@action
def apply_gates(gates, _state):
    """Computes the values of the tick from the values and gates that were carried over."""
    parameters = value_of(gates).parameters
    phases = _doubles_at(parameters.phases, 2 * parameters.gates)
    for g in range(parameters.gates):
        phases[parameters.gates + g] = phases[g]
    _apply_gates(parameters)


call_move = function_at(types.int64(*[types.uint64] * 3))
"""Calls `move`, with its arguments. Returns 1 if any value moved."""


@native(types.int64, *[types.uint64] * 3)
def move(parameters, position, previous):
    """Takes a posted set, and moves the values and gates by one sample; call it before the sample. Returns 1 if any
    moved. `position`, `previous`: addresses of the points at this sample and the one before. Its address is set when a
    set is posted, or where there are gates, so that it is compiled only if a value ever changes."""
    parameters = _parameters_at(parameters)
    count, gates = parameters.count, parameters.gates
    ramps, phases = _doubles_at(parameters.ramps, 3 * count), _doubles_at(parameters.phases, 2 * gates)
    posted, origin, target = ramps[:count], ramps[count:], ramps[2 * count :]
    if parameters.posted != parameters.taken:
        parameters.taken = parameters.posted  # first: one that is posted meanwhile is taken at the next sample
        for i in range(count):
            origin[i] = number_at(parameters.own, i, parameters.single)
            target[i] = posted[i]
        parameters.sets += 1
        parameters.samples = parameters.left = parameters.posted_samples
        parameters.share, parameters.moved = 0.0, 0
    turning = _aim_gates(parameters, phases, 1.0 / parameters.fade)
    if parameters.left == 0 and not turning:
        return 0
    before = parameters.share
    if parameters.left > 0:
        parameters.moved += 1
        parameters.left = max(parameters.left - 1.0, 0.0)
        s = 1.0 - parameters.left / parameters.samples
        parameters.share = s if parameters.straight else smooth(s)
    _set_following(parameters, origin, target)
    if parameters.stored != 0:
        stored = stored_at(parameters.stored)
        tank = tank_at(stored.tank)
        change = (stored.address, position, previous, parameters.following - parameters.now)
        work = call_evaluate(stored.evaluate, change)
        share = affordable_share(tank, work)
        if share < 1.0:
            if parameters.share != before:
                parameters.share = before + share * (parameters.share - before)
                parameters.left = parameters.samples * remaining_ramp(parameters.share)
            for g in range(gates):
                phases[gates + g] = part_of_fade(phases[g], phases[gates + g], share)
            _set_following(parameters, origin, target)
            work = call_evaluate(stored.evaluate, change)
        spend(tank, work)
    for i in range(count):
        put_number(parameters.own, i, parameters.single, _own_following(parameters, origin, target, i))
        put_number(parameters.now, i, parameters.single, number_at(parameters.following, i, parameters.single))
    for g in range(gates):
        phases[g] = phases[gates + g]
    return 1


@inlined
def part_of_fade(before, after, share):
    """Returns the s of a gate that moves by a share of the way of its weight from one s to another."""
    if before == after:
        return after
    weight = smooth(before)
    return 1.0 - remaining_ramp(weight + share * (smooth(after) - weight))


@helper
def _aim_gates(parameters, phases, step):
    """Moves s of every gate with the next sample by `step` towards 1 where its input is on, else towards 0. Returns
    whether any moves."""
    gates, turning = parameters.gates, False
    if gates > 0:
        word = _words_at(parameters.inputs, 1)[0] ^ parameters.inverted
        masks = _words_at(parameters.masks, gates)
        for g in range(gates):
            s = min(phases[g] + step, 1.0) if word & masks[g] else max(phases[g] - step, 0.0)
            turning = turning or s != phases[g]
            phases[gates + g] = s
    return turning


@inlined
def _gated(parameters, i, value):
    """Returns a value with the weight of its gate in the next sample."""
    if parameters.gates == 0:
        return value
    gate = _words_at(parameters.gate_of, parameters.count)[np.uint64(i)]
    if gate < 0:
        return value
    return value * smooth(_doubles_at(parameters.phases, 2 * parameters.gates)[np.uint64(parameters.gates + gate)])


@helper
def _apply_gates(parameters):
    phases = _doubles_at(parameters.phases, 2 * parameters.gates)
    for i in range(parameters.count):
        own = number_at(parameters.own, i, parameters.single)
        put_number(parameters.now, i, parameters.single, _gated(parameters, i, own))
    for g in range(parameters.gates):
        phases[g] = phases[parameters.gates + g]


@inlined
def _own_following(parameters, origin, target, i):
    """Returns the next value without its gate, at the completed share of its way; at its end to the last digit."""
    return origin[i] + parameters.share * (target[i] - origin[i]) if parameters.left > 0 else target[i]


@helper
def _set_following(parameters, origin, target):
    """Computes the next values, at the completed share of their way and of the gates' fades."""
    for i in range(parameters.count):
        own = _own_following(parameters, origin, target, i)
        put_number(parameters.following, i, parameters.single, _gated(parameters, i, own))
