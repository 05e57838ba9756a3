"""Decorators that compile the hot path.

`entry` is for a function that Python calls; its machine code is kept (`code_cache.py`). `inlined` is for its pieces:
each is woven into the compiled functions that call it, and called from Python it runs as plain Python. `helper` lets
the compiler choose between weaving and calling: for what several places call and is not small. `fma` and `reassociated`
are `inlined` for arithmetic on many numbers.

Numbers are passed as records, one pointer each, and records hold records: little is compiled for each call.

Nothing is allocated in the hot path, and no array in it outlives the call that brought it. So numba's counting of
references is off (`_nrt`): an atomic addition for every array at every step was most of an exchange's time. What
allocates all the same does not compile.

`error_model="numpy"`: a division by zero gives an infinity that a guard can see, instead of an exception out of the
loop. `fastmath` stays off: it would let the compiler delete the guard's test for NaN (numba issue 2919).
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba import extending
from numba.np import linalg

from firmware_protocol.code_cache import directory_for, numba_cache_in, read_only_directories_for

Function = TypeVar("Function", bound=Callable[..., Any])

linalg.ensure_blas = lambda: None  # it imports scipy.linalg, a tenth of a start, lest a user be without scipy


def _lean_compiler() -> Any:
    """Returns `lean_compiler`; None where internal parts of numba that it uses have changed: all is compiled the
    ordinary way then."""
    try:
        from firmware_protocol import lean_compiler

        lean_compiler.try_out()
    except Exception as error:  # of any kind: these parts promise nothing
        why = " ".join(f"{type(error).__name__}: {error}".split())
        logging.getLogger("hapsim").warning(
            "numba %s is not one that hapsim knows, so it compiles more slowly (%.80s)", numba.__version__, why
        )
        return None
    return lean_compiler


_LEAN = _lean_compiler()
WHOLE, BULK_WHOLE, _PIECE, _BULK_PIECE = (
    {"pipeline_class": getattr(_LEAN, name)} if _LEAN else {} for name in ("Whole", "BulkWhole", "Piece", "BulkPiece")
)
"""Options of functions that are called from outside, with loops over a few numbers and over many; and of pieces."""

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_rewrites": True,  # of array expressions, of which there are none
    "_nrt": False,
    **WHOLE,
}
_HELPER = OPTIONS | {"no_cpython_wrapper": True, "forceinline": False, "fastmath": False, **_PIECE}
_INLINED = _HELPER | {"forceinline": True}


def _piece(options: dict[str, Any], **others: Any) -> Callable[[Function], Function]:
    """Returns a decorator. The options are explicit: numba gives those that are left out the caller's values."""

    def decorate(function: Function) -> Function:
        if _LEAN is None:
            extending.register_jitable(**options | others)(function)
        else:
            _LEAN.PieceType(function, numba.njit(**options | others)(function))
        return function

    return decorate


inlined = _piece(_INLINED)
helper = _piece(_HELPER)

fma = _piece(_INLINED | _BULK_PIECE, fastmath={"contract"})
"""A product and the sum that it goes into may be rounded once instead of twice. A NaN stays one."""

reassociated = _piece(_INLINED | _BULK_PIECE, fastmath={"contract", "reassoc", "nsz"})
"""Like `fma`, for long sums: their terms may be added in any order, many at once. A NaN stays one."""


def overload(function: Callable[..., Any]) -> Callable[[Function], Function]:
    """numba's `overload` of `function`; the code that it chooses is inlined, with its caller's `fastmath`."""
    options = {name: value for name, value in _INLINED.items() if name != "fastmath"}
    chosen: Callable[[Function], Function] = extending.overload(function, jit_options=options)
    return chosen


class Compiler:
    """Compiles entries whose sources are in `rooms` (directories or files)."""

    def __init__(self, *rooms: Path) -> None:
        self.rooms = rooms

    def entry(self, function: Function) -> Function:
        """Compiles a function that Python calls."""
        directory = self.directory_of(function)
        with numba_cache_in(directory):
            compiled: Function = numba.njit(cache=directory is not None, **OPTIONS)(function)
        return compiled

    def directory_of(self, *objects: Any) -> Path | None:
        """Returns where the machine code of these functions and classes is kept; None where it cannot be."""
        return directory_for(_files_of(objects), self.rooms)

    def read_only_directories_of(self, *objects: Any) -> tuple[Path, ...]:
        """Returns where else it may be found: in directories that cannot be written."""
        return read_only_directories_for(_files_of(objects), self.rooms)


def _files_of(objects: tuple[Any, ...]) -> frozenset[Path]:
    return frozenset(Path(inspect.getfile(one)).resolve() for one in objects)


entry = Compiler(Path(__file__).resolve().parent).entry
"""Decorator of this package's entry functions."""

ONE = np.uint64(1)
"""Unsigned one for the indices of hot loops: a signed index may count from the end, and compiled code checks that at
every access. Signed and unsigned must not be mixed: numba makes a floating-point number of the two."""


class Record(np.void):  # type: ignore[misc]  # final to mypy alone
    """A record whose fields are attributes, and those of the records in it. `np.record` takes three times as long."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except ValueError:
            raise AttributeError(f"no field '{name}'") from None

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            self[name] = value
        except ValueError as error:
            raise error if name in (self.dtype.names or ()) else AttributeError(f"no field '{name}'") from None


@cache
def _of_records(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Returns a data type whose records are of the class Record."""
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        return np.dtype((_of_records(element), shape))
    if dtype.fields is None:
        return dtype
    fields = {name: (_of_records(field[0]), field[1]) for name, field in dtype.fields.items()}
    formats, offsets = zip(*fields.values(), strict=True)
    layout = {"names": [*fields], "formats": formats, "offsets": offsets, "itemsize": dtype.itemsize}
    return np.dtype((Record, layout | {"aligned": dtype.isalignedstruct}))


def new_record(dtype: np.dtype[np.void]) -> Any:
    """Returns a record of zeros, which compiled code and Python read and write by name.

    It keeps its own memory, which stays where it is; compiled code gets one pointer to it.
    """
    return np.zeros(1, _of_records(dtype))[0]
