"""How the compiler shall treat the function that it stands in: said at the beginning of its body.

Left alone, it weaves a function into all of its callers, and turns a loop over channels into a dozen loops for many of
them. Of the loop's eighty functions it made 16 MB of intermediate code in that way, in more than a minute.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import lower_builtin, type_callable


def out_of_line() -> None:
    """This function is called, and not woven in: it is rarely needed, or called from several places."""


def compact() -> None:
    """The loops of this function are short: as written they are quick enough."""


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
