"""The scene at one sample: what every module reads, and where it leaves its force.

A hand on a single link is the smallest scene there is, and the one that must be quickest. There the moment is no part
of the program's arrays but a few numbers of the tick's own, which the compiler keeps in registers: in memory, each
would have to be read again behind every store that might have changed it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

from hapsim.compiled import inlined, overload
from hapsim.cordis.device_point import DevicePoints, keep


class Moment(NamedTuple):
    """N points at sample n. Positions in m, force in N, shape (N,) each; the arrays are the program's, not copies."""

    position: NDArray[np.float64]
    """x[n]"""
    previous: NDArray[np.float64]
    """x[n-1]"""
    following: NDArray[np.float64]
    """x[n+1], to be written."""
    force: NDArray[np.float64]
    devices: DevicePoints
    velocity: NDArray[np.float64]
    """m/s, what the device senses, one per channel."""


@inlined
def moment_of(program, velocity):
    """The program's moment. Its three rows of positions take turns, so that no sample is ever copied."""
    now, after, before = _turns(program.turn)
    rows = program.rows
    return Moment(rows[now], rows[before], rows[after], program.force, program.devices, velocity)


def at_hand(program, velocity, registers):
    """The moment that a tick works on: the program's, or its own, in `registers`; chosen as it is compiled."""
    return _own(program, velocity, registers) if program.force is None else moment_of(program, velocity)


@overload(at_hand)
def _at_hand_compiled(program, velocity, registers):  # noqa: ARG001  (numba matches the names)
    if isinstance(program.types[program.fields.index("force")], types.NoneType):
        return lambda program, velocity, registers: _own(program, velocity, registers)  # noqa: PLW0108
    return lambda program, velocity, registers: moment_of(program, velocity)  # noqa: ARG005


@inlined
def _own(program, velocity, registers):
    """Of a hand, which was where the program still has it, and a ground."""
    now, before = program.rows[0], program.rows[2]
    position, previous, force = registers[0], registers[1], registers[2]
    position[0], position[1] = now[0], now[1]
    previous[0], previous[1] = now[0], before[1]
    force[0] = force[1] = 0.0
    return Moment(position, previous, now, force, program.devices, velocity)


@inlined
def pass_on(program, moment):
    """The following sample becomes the one at hand; where nothing but the hand moves, it is kept where it was."""
    _pass_on(program.turn, moment)
    _keep_hand(program.force, program.rows, moment)


@inlined
def _keep_hand(force, rows, moment):
    """Back from the registers."""
    if force is None:
        rows[0][0] = moment.position[0]


@intrinsic
def registers_for(_typing: Any, program: Any) -> Any:
    """An array (3, 2) of the program's kind of number, for a tick that works on its own: it lives as long as the call
    that asks for it, and where nobody asks for more than its numbers, in registers."""
    rows = program.types[program.fields.index("rows")]

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        number = context.get_data_type(rows.dtype)
        size = context.get_abi_sizeof(number)
        array = context.make_array(rows)(context, builder)
        shape, strides = (
            [context.get_constant(types.intp, one) for one in pair] for pair in ((3, 2), (2 * size, size))
        )
        room = cgutils.alloca_once(builder, number, size=6)
        populate_array(array, room, shape, strides, context.get_constant(types.intp, size), None)
        return array._getvalue()

    return rows(program), generate


@inlined
def _turns(turn):
    if turn is None:
        return np.uint64(0), np.uint64(1), np.uint64(2)
    now = turn[0]
    before = now - np.uint64(1) if now > 0 else np.uint64(2)
    return now, now + np.uint64(1) if now < 2 else np.uint64(0), before


@inlined
def _pass_on(turn, moment):
    if turn is None:
        keep(moment.devices, moment.velocity, moment.position, moment.previous)
    else:
        now = turn[0]
        turn[0] = now + np.uint64(1) if now < 2 else np.uint64(0)
