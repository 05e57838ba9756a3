"""SIMD lanes: 64 bytes of neighbouring numbers, 8 in double or 16 in single precision, processed at once.

For a stencil written number by number, the compiler must find out which numbers can be processed together: it tests at
every sample whether arrays overlap, and processes the rest of the last round one by one. Code in lanes avoids both. The
compiler splits lanes into the processor's own vectors: one, two or four.

Rows of positions are laid out for lanes: `WIDEST` numbers are a whole number of lanes in either precision, so a
structure begins at a multiple of it and occupies a multiple of it.

A processor forwards a store to a soon following load only if one store holds all loaded bytes. So every write into a
row that is moved in lanes uses lanes, too: `put_one`.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model
from numpy.typing import DTypeLike, NDArray

from hapsim.compiling import inlined

ir = cgutils.ir

BYTES = 64
WIDEST = 16  # numbers of single precision


class Lanes(types.Type):
    """numba's type of lanes. `dtype`: of each number."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        self.width = 8 * BYTES // dtype.bitwidth
        super().__init__(f"Lanes({dtype})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        number = ir.DoubleType() if lanes.dtype.bitwidth == 64 else ir.FloatType()
        super().__init__(manager, lanes, ir.VectorType(number, lanes.width))


def padded(count: int) -> int:
    """Returns `count`, rounded up to whole lanes."""
    return -(-count // WIDEST) * WIDEST


def aligned(array: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """Returns a copy as `dtype`, aligned for lanes, so that no load crosses two cache lines."""
    size = array.size * np.dtype(dtype).itemsize
    room = np.zeros(size + BYTES, np.uint8)
    begin = -room.ctypes.data % BYTES
    copy = room[begin : begin + size].view(dtype).reshape(array.shape)
    copy[...] = array
    return copy


@intrinsic
def width_of(_typing: Any, row: Any) -> Any:
    """Returns the number of lanes for a row's type of number, a constant to the compiler."""

    def _generate(context: Any, _builder: Any, signature: Any, _arguments: Any) -> Any:
        return context.get_constant(signature.return_type, Lanes(row.dtype).width)

    return types.uint64(row), _generate


@intrinsic
def fetch(_typing: Any, row: Any, first: Any) -> Any:  # noqa: ARG001
    """Returns the lanes of a row from number `first` (uint64) on."""
    lanes = Lanes(row.dtype)

    def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, signature.args[0], arguments, lanes)
        return builder.load(place, align=row.dtype.bitwidth // 8)

    return lanes(row, types.uint64), _generate


@intrinsic
def put(_typing: Any, row: Any, first: Any, lanes: Any) -> Any:  # noqa: ARG001
    """Stores lanes in a row, from number `first` (uint64) on."""

    def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, signature.args[0], arguments, lanes)
        builder.store(arguments[2], place, align=row.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(row, types.uint64, lanes), _generate


@intrinsic(prefer_literal=True)
def shift_lanes(_typing: Any, terms: Any, which: Any, by: Any) -> Any:
    """Returns element `which` of `terms`, shifted by `by` lanes. `terms`: three tuples of lanes in a row (left, here,
    right). `which`, `by`: literals."""
    if not (isinstance(which, types.Literal) and isinstance(by, types.Literal)):
        return None
    element, shift = which.literal_value, by.literal_value
    lanes = terms[1][element]

    def _generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        left, here, right = (builder.extract_value(arguments[0], (i, element)) for i in range(3))
        if shift < 0:
            return _from_two(builder, left, here, range(lanes.width + shift, 2 * lanes.width + shift))
        return _from_two(builder, here, right, range(shift, lanes.width + shift))

    return lanes(terms, which, by), _generate


@intrinsic
def chosen(_typing: Any, lanes: Any, others: Any, first: Any, end: Any) -> Any:  # noqa: ARG001
    """Returns `lanes` from lane `first` to before `end` (int64, perhaps beyond either side), `others` elsewhere."""

    def _generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        inside, outside, begin, stop = arguments
        numbers = ir.VectorType(ir.IntType(64), lanes.width)
        above = builder.sub(ir.Constant(numbers, list(range(lanes.width))), _spread(builder, begin, numbers))
        is_inside = builder.icmp_unsigned("<", above, _spread(builder, builder.sub(stop, begin), numbers))
        return builder.select(is_inside, inside, outside)

    return lanes(lanes, lanes, types.int64, types.int64), _generate


@intrinsic
def all_equal(_typing: Any, row: Any, number: Any) -> Any:
    """Returns lanes of a row's type, each `number`."""
    lanes = Lanes(row.dtype)

    def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = context.cast(builder, arguments[1], signature.args[1], lanes.dtype)
        return _spread(builder, value, context.get_value_type(lanes))

    return lanes(row, number), _generate


@inlined
def put_one(row, i, number):
    """Stores one number in a row, together with all its lanes."""
    first = i & ~(width_of(row) - np.uint64(1))
    lane = np.int64(i - first)
    nothing = all_equal(row, row.dtype.type(0))
    # A sum: a choice would become a store of this lane alone.
    others = chosen(nothing, fetch(row, first), lane, lane + 1)
    put(row, first, others + chosen(all_equal(row, number), nothing, lane, lane + 1))


@inlined
def add_to_one(row, i, number):
    """Adds to one number in a row, and stores it together with all its lanes."""
    first = i & ~(width_of(row) - np.uint64(1))
    lane = np.int64(i - first)
    nothing = all_equal(row, row.dtype.type(0))
    put(row, first, fetch(row, first) + chosen(all_equal(row, number), nothing, lane, lane + 1))


def _place(context: Any, builder: Any, row: Any, arguments: Sequence[Any], lanes: Lanes) -> Any:
    data = context.make_array(row)(context, builder, arguments[0]).data
    return builder.bitcast(builder.gep(data, [arguments[1]]), context.get_value_type(lanes).as_pointer())


def _from_two(builder: Any, first: Any, second: Any, lanes: range) -> Any:
    return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes)))


def _spread(builder: Any, value: Any, lanes: Any) -> Any:
    one = builder.insert_element(ir.Constant(lanes, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), None))


def _arithmetic(operation: Any, instruction: str) -> None:
    """Registers `operation` between lanes, and between lanes and a number."""

    @infer_global(operation)
    class _Typed(AbstractTemplate):
        def generic(self, arguments: Any, _keywords: Any) -> Any:
            found = [one for one in arguments if isinstance(one, Lanes)]
            if found and all(isinstance(one, (Lanes, types.Float)) for one in arguments):
                return signature(found[0], *arguments)
            return None

    def _lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = signature.return_type
        sides = [
            value
            if isinstance(kind, Lanes)
            else _spread(builder, context.cast(builder, value, kind, lanes.dtype), context.get_value_type(lanes))
            for kind, value in zip(signature.args, arguments, strict=True)
        ]
        return getattr(builder, instruction)(*sides)

    for kinds in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(operation, *kinds)(_lower)


for _operation, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _arithmetic(_operation, _instruction)
