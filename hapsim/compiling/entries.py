"""Functions that Python calls: compiled, or loaded, before the first call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba

from hapsim.compiling import compiler
from hapsim.compiling.kept import Kept


def compile_for(function: Any, *arguments: Any) -> None:
    """Compiles an `entry` for arguments of these types, or loads it, without calling it."""
    signature = tuple(numba.typeof(argument) for argument in arguments)

    def _compile_or_load() -> None:
        try:
            function.compile(signature)
        except OSError:
            if signature not in function.overloads:  # else it is compiled, and could not be written
                raise

    if signature not in function.overloads:
        Kept(function.py_func, signature).compile(_compile_or_load)


def is_kept(function: Any, *arguments: Any) -> bool:
    """Whether the machine code for arguments of these types is there from an earlier run."""
    return Kept(function.py_func, tuple(numba.typeof(argument) for argument in arguments)).is_whole()


def directory_of_kept_code() -> Path | None:
    """The directory that all of hapsim's machine code is kept below; None where nothing can be kept."""
    directory = compiler.directory_of(compile_for)
    return None if directory is None else directory.parent
