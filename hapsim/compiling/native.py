"""Functions, records and arrays behind addresses: one compiled loop moves every scene over every transport.

A loop that knew the type of its scene would be compiled for each scene. It knows addresses instead: of functions, each
compiled for the numbers that it works on, and of these numbers. `Behind` puts a tuple of arrays behind an address.
`NativeFunction` compiles a function for it, which begins with `value_of` to read the tuple. An address has no type, and
a wrong pair of function and numbers would end the process. So only `NativeFunction.call_on` makes the pairs. A call
through an address costs 1.7 ns.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from firmware_protocol.code_cache import numba_cache_in
from firmware_protocol.compiled import BULK_WHOLE, OPTIONS, WHOLE
from hapsim.compiling.kept import Kept, note_unkept, require_compiler
from hapsim.compiling.progress import compiling

ir = cgutils.ir
types: Any = numba.types  # numba's own annotations omit some of them

_WORD = ir.IntType(64)
_CFUNC_OPTIONS = {key: OPTIONS[key] for key in ("error_model", "no_rewrites", "_nrt")} | BULK_WHOLE


class Behind:
    """A value behind an address: numbers, contiguous arrays, records, and named tuples of these.

    `address` is valid as long as this object, which keeps everything that it refers to.
    """

    def __init__(self, value: Any) -> None:
        self.value = value
        self.type = numba.typeof(value)
        self._words = np.array(_words_of(value), np.uint64)
        self.address = int(self._words.ctypes.data)


def address_of(record: Any) -> int:
    """Returns the address of a record or an array, valid as long as that exists."""
    array = record if isinstance(record, np.ndarray) else np.frombuffer(record, np.uint8)
    return int(array.ctypes.data)


def _words_of(value: Any) -> list[int]:
    """Returns the value as 64-bit words, in the order of `_read`."""
    if isinstance(value, tuple):
        return [word for field in value for word in _words_of(field)]
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous or not value.flags.aligned:
            raise TypeError("an array behind an address has to be contiguous and aligned")
        return [value.ctypes.data, *value.shape]
    if isinstance(value, np.void):
        return [address_of(value)]
    if isinstance(value, float | np.float64):
        return [int(np.float64(value).view(np.uint64))]
    if isinstance(value, int | np.int64 | np.uint64) and not isinstance(value, bool):
        return [int(value) & (2**64 - 1)]
    raise TypeError(f"found {type(value).__name__}, which does not go behind an address")


@intrinsic
def value_of(_typing: Any, pointer: Any) -> Any:
    """Returns the value behind an address, in a function that was compiled for its type."""
    if not isinstance(pointer, types.CPointer):
        return None  # numba then reports that it fits no call

    def _generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        words = builder.bitcast(arguments[0], _WORD.as_pointer())
        return _read(context, builder, words, pointer.dtype, 0)[0]

    return pointer.dtype(pointer), _generate


def _read(context: Any, builder: Any, words: Any, kind: Any, at: int) -> tuple[Any, int]:
    """Returns (the value of this type whose first word is number `at`, the number of the next word)."""

    def word(i: int) -> Any:
        return builder.load(builder.gep(words, [ir.Constant(_WORD, i)]))

    if isinstance(kind, types.BaseTuple):
        fields = []
        for each in kind.types:
            field, at = _read(context, builder, words, each, at)
            fields.append(field)
        return context.make_tuple(builder, kind, fields), at
    if isinstance(kind, types.Array):
        shape = [word(at + 1 + axis) for axis in range(kind.ndim)]
        return _array(context, builder, kind, word(at), shape), at + 1 + kind.ndim
    if isinstance(kind, types.Record):
        return builder.inttoptr(word(at), context.get_value_type(kind)), at + 1
    if isinstance(kind, types.Float):
        return builder.bitcast(word(at), ir.DoubleType()), at + 1
    return word(at), at + 1


def _array(context: Any, builder: Any, kind: Any, address: Any, shape: list[Any]) -> Any:
    """Returns a contiguous array over memory that its owner keeps."""
    number = context.get_data_type(kind.dtype)
    strides = [context.get_constant(types.intp, context.get_abi_sizeof(number))]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    array = context.make_array(kind)(context, builder)
    data = builder.inttoptr(address, number.as_pointer())
    populate_array(array, data, shape, strides, strides[-1], None)
    return array._getvalue()


@intrinsic
def address_in_memory(_typing: Any, record: Any) -> Any:
    """Returns the address of a record, in compiled code."""

    def _generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.ptrtoint(arguments[0], _WORD)

    return types.uint64(record), _generate


def record_at(dtype: np.dtype[np.void]) -> Any:
    """Returns a function for compiled code that turns an address into a record."""
    kind = numba.from_dtype(dtype)

    @intrinsic
    def record(_typing: Any, _address: Any) -> Any:
        def _generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(kind))

        return kind(types.uint64), _generate

    return record


def array_at(dtype: Any) -> Any:
    """Returns a function for compiled code that turns an address and a count of numbers into an array."""
    kind = types.Array(numba.from_dtype(np.dtype(dtype)), 1, "C")

    @intrinsic
    def array(_typing: Any, _address: Any, _count: Any) -> Any:
        def _generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return _array(context, builder, kind, arguments[0], [arguments[1]])

        return kind(types.uint64, types.intp), _generate

    return array


def function_at(signature: Any) -> Any:
    """Returns a function for compiled code that calls another by its address, with the arguments in a tuple."""

    @intrinsic
    def call(_typing: Any, _function: Any, _arguments: Any) -> Any:
        def _generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            kinds = [context.get_value_type(kind) for kind in signature.args]
            returns_nothing = signature.return_type == types.void
            returned = ir.VoidType() if returns_nothing else context.get_value_type(signature.return_type)
            pointer = builder.inttoptr(values[0], ir.FunctionType(returned, kinds).as_pointer())
            result = builder.call(pointer, cgutils.unpack_tuple(builder, values[1], len(kinds)))
            return context.get_dummy_value() if returns_nothing else result

        return signature.return_type(types.uint64, types.Tuple(signature.args)), _generate

    return call


class NativeFunction:
    """A function that compiled code calls by its address.

    Its arguments are values behind addresses, which it reads first: `links = value_of(links)`. It is compiled for each
    choice of their types on first use, and kept. Its loops are compiled for many numbers.
    """

    def __init__(self, function: Callable[..., Any], returns: Any = types.void, **options: Any) -> None:
        self.function = function
        self._returns, self._options = returns, _CFUNC_OPTIONS | options
        self._compiled: dict[tuple[Any, ...], Any] = {}  # by the types of the arguments

    def call_on(self, *values: Behind) -> tuple[int, ...]:
        """Returns its address, compiled for these values, followed by their addresses."""
        return self._address(*(types.CPointer(value.type) for value in values)), *(value.address for value in values)

    def _address(self, *kinds: Any) -> int:
        if kinds not in self._compiled:
            self._compiled[kinds] = self._compile(self._returns(*kinds))
        return int(self._compiled[kinds].address)

    def _compile(self, signature: Any) -> Any:
        require_compiler()
        kept = Kept(self.function, signature, *_classes_in(signature))
        name = f"{self.function.__module__.rpartition('.')[2]}.{self.function.__name__}"

        def _compile_in(directory: Path | None) -> Any:
            with numba_cache_in(directory):
                return numba.cfunc(signature, cache=directory is not None, **self._options)(self.function)

        def _compile_or_load() -> Any:
            with contextlib.nullcontext() if kept.is_whole else compiling(self.function, name):
                try:
                    return _compile_in(kept.directory)
                except OSError as error:
                    note_unkept(error)
                    return _compile_in(None)

        return kept.compile(_compile_or_load)


class PlainNative(NativeFunction):
    """A native function whose arguments are numbers, addresses among them. Python may call it too. `bulk`: its loops
    run over many numbers."""

    def __init__(self, function: Callable[..., Any], signature: Any, bulk: bool = False) -> None:
        super().__init__(function, signature.return_type, **(BULK_WHOLE if bulk else WHOLE))
        self._signature = signature
        self._callable: Any = None

    def address(self) -> int:
        """Returns its address; compiles it on first use."""
        return self._address(*self._signature.args)

    def is_kept(self) -> bool:
        """Returns whether an earlier run left its machine code."""
        return Kept(self.function, self._signature).is_whole

    def __call__(self, *arguments: int) -> Any:
        if self._callable is None:
            kinds = (self._returns, *self._signature.args)
            self._callable = ctypes.CFUNCTYPE(*(_CTYPES[kind] for kind in kinds))(self.address())
        return self._callable(*arguments)


def native(returns: Any, *arguments: Any, bulk: bool = False) -> Callable[[Callable[..., Any]], PlainNative]:
    """Decorates a native function with these numba types: int64, float64, or uint64 for an address."""
    return lambda function: PlainNative(function, returns(*arguments), bulk)


_CTYPES: dict[Any, Any] = {
    types.void: None,
    types.int64: ctypes.c_int64,
    types.uint64: ctypes.c_uint64,
    types.float64: ctypes.c_double,
}


def _classes_in(kind: Any) -> set[type]:
    """Returns the classes of the named tuples in a type. The order of their fields determines the machine code."""
    if isinstance(kind, types.CPointer):
        return _classes_in(kind.dtype)
    inner = kind.args if hasattr(kind, "args") else getattr(kind, "types", ())
    own = {kind.instance_class} if isinstance(kind, types.BaseNamedTuple) else set()
    return own.union(*(_classes_in(each) for each in inner))
