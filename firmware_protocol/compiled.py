"""The decorators that compile the hot path.

`entry` is for a function that Python calls: it stands by itself, its machine code is kept (`code_cache.py`). `inlined`
is for the pieces that such a function is made of: each is woven into the compiled functions that call it, and called
from Python it runs as plain Python. `helper` leaves it to the compiler whether to weave or to call: for what is called
in several places and is not small.

Numbers are passed as records, one pointer each, and records hold records: a function has few arguments, whatever the
loop has to remember, and little is compiled for each call. Depth costs more than length: numba makes an executable of
every function that another one calls, so what stands ten calls deep is compiled ten times.

Nothing is allocated in the hot path, and no array in it outlives the call that brought it. So numba's counting of
references is switched off there (`_nrt`): an atomic addition for every array at every step was most of an exchange's
time. What tries to allocate all the same does not compile.

`error_model="numpy"`: a division by zero gives an infinity that a guard can see, instead of an exception out of the
loop. `fastmath` stays off: it would let the compiler delete the guard's test for NaN (numba issue 2919).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba import types
from numba.extending import lower_builtin, overload, register_jitable, type_callable

from firmware_protocol.code_cache import directory_for, numba_cache_in

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_rewrites": True,  # of array expressions, of which there are none
    "_nrt": False,
}

_PIECE = OPTIONS | {"no_cpython_wrapper": True}
_HELPER = _PIECE | {"forceinline": False}  # said, lest it take after its caller
_INLINED = _PIECE | {"forceinline": True}


class Compiler:
    """Decorators for functions that are compiled from sources in `rooms` (directories or files)."""

    def __init__(self, *rooms: Path) -> None:
        self.rooms = rooms

    def entry(self, function: Function) -> Function:
        """Compiles a function that Python calls."""
        directory = self.directory_of(function)
        with numba_cache_in(directory):
            compiled: Function = numba.njit(cache=directory is not None, **OPTIONS)(function)
        return compiled

    def inlined(self, function: Function) -> Function:
        """Weaves a function into the compiled functions that call it."""
        woven: Function = register_jitable(**_INLINED)(function)
        return woven

    def helper(self, function: Function) -> Function:
        """Compiles a function that compiled functions call; whether it is woven in is the compiler's choice."""
        kept: Function = register_jitable(**_HELPER)(function)
        return kept

    def fma(self, function: Function) -> Function:
        """Like `inlined`, for arithmetic: a product and the sum that it goes into may be rounded once instead of twice.

        Nothing else of `fastmath` is allowed: a NaN stays one.
        """
        woven: Function = register_jitable(**_INLINED, fastmath={"contract"})(function)
        return woven

    def reassociated(self, function: Function) -> Function:
        """Like `fma`, for long sums: their terms may be added in any order, many at once. A NaN stays one."""
        woven: Function = register_jitable(**_INLINED, fastmath={"contract", "reassoc", "nsz"})(function)
        return woven

    def overload(self, function: Callable[..., Any]) -> Callable[[Function], Function]:
        """numba's `overload` of `function`; what it chooses is woven in like anything `inlined`."""
        chosen: Callable[[Function], Function] = overload(function, jit_options=_INLINED)
        return chosen

    def directory_of(self, *objects: Any) -> Path | None:
        """Where the machine code is kept that is compiled from these functions and classes; None where it cannot be."""
        files = {Path(inspect.getfile(one)).resolve() for one in objects}
        return directory_for(frozenset(files), self.rooms)


_compiler = Compiler(Path(__file__).resolve().parent)
entry, inlined, helper = _compiler.entry, _compiler.inlined, _compiler.helper
"""For functions of this package."""

ONE = np.uint64(1)
"""For the indices of hot loops: a signed index may count from the end, and compiled code checks that at every access.
Signed and unsigned must not be mixed: numba makes a floating-point number of the two."""


def new_record(dtype: np.dtype[np.void]) -> Any:
    """A record of zeros: a numpy scalar of a structured type, which compiled code and Python read and write by name.

    It keeps its own memory, which stays where it is. Compiled code gets one pointer, whatever the record holds; records
    hold records, and arrays of a fixed length.
    """
    return np.zeros(1, dtype).view(np.recarray)[0]


# What a compiled function calls at its beginning to keep the compiler from inlining it everywhere, or from turning a
# loop over channels into a dozen loops: of the loop's eighty functions that made 16 MB of intermediate code.


def out_of_line() -> None:
    """Has the function called and not inlined: it is rarely needed, or called from several places."""


def compact() -> None:
    """Has the loops of the function compiled as written: they are short."""


def _means(function: Callable[[], None], *attributes: str) -> None:
    """Makes a call of `function` in compiled code give these attributes of LLVM to the function that it stands in."""

    @type_callable(function)
    def typed(_context: Any) -> Any:
        return lambda: types.none

    @lower_builtin(function)
    def lower(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        for attribute in attributes:
            builder.function.attributes.add(attribute)
        return context.get_dummy_value()


_means(out_of_line, "noinline", "optsize")
_means(compact, "optsize")
