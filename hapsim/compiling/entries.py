"""Functions that Python calls: compiled, or loaded, before the first call."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numba

from hapsim.compiling import compiler


def compile_for(function: Any, *arguments: Any) -> None:
    """Compiles an `entry` for arguments of these types, or loads it, without calling it."""
    signature = tuple(numba.typeof(argument) for argument in arguments)
    function.compile(signature)
    mark = kept_mark(function.py_func, signature)
    if mark is not None:
        mark.touch()


def is_kept(function: Any, *arguments: Any) -> bool:
    """Whether the machine code for arguments of these types is there from an earlier run."""
    mark = kept_mark(function.py_func, tuple(numba.typeof(argument) for argument in arguments))
    return mark is not None and mark.exists()


def kept_mark(function: Any, signature: Any, *classes: type) -> Path | None:
    """The file that is there when machine code for a signature is kept, beside it; None where nothing can be kept.

    numba compiles anew when the file of a function was touched, so when that was is in the name. `classes`: those of
    the named tuples in the signature, which it does not tell apart itself.
    """
    directory = compiler.directory_of(function, *classes)
    if directory is None:
        return None
    source = Path(function.__code__.co_filename).stat()
    names = sorted(f"{one.__module__}.{one.__qualname__}" for one in classes)
    text = f"{signature} {names} {source.st_mtime_ns} {source.st_size}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    return directory / f"{function.__module__.rpartition('.')[2]}.{function.__name__}-{digest}.kept"


def directory_of_kept_code() -> Path | None:
    """The directory that all of hapsim's machine code is kept below; None where nothing can be kept."""
    directory = compiler.directory_of(compile_for)
    return None if directory is None else directory.parent
