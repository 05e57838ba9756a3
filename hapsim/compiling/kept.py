"""Compiling functions that Python calls, and checking the machine code that earlier runs left.

numba trusts its files: a truncated file raises any error, and wrong bytes are executed. So a mark beside the files
holds their digests; a file that does not match is compiled again. Code in a read-only directory, as in an image, is
loaded; missing code is kept elsewhere. If no directory can be written, a function is compiled but not kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np

from firmware_protocol.code_cache import numba_cache_in
from hapsim.compiling import compiler
from hapsim.errors import UsageError, address_space_limit

Compiled = TypeVar("Compiled")


def compile_for(function: Any, *arguments: Any) -> None:
    """Compiles an `entry` for arguments of these types, or loads it, without calling it."""
    require_compiler()
    signature = signature_of(*arguments)
    if signature in function.overloads:
        return
    kept = Kept(function.py_func, signature)

    def _compile_or_load() -> None:
        if kept.directory is not None:
            with numba_cache_in(kept.directory):
                function.enable_caching()  # again: the code may be in a read-only directory
        try:
            function.compile(signature)
        except OSError as error:
            if signature not in function.overloads:  # else it is compiled, and could not be written
                raise
            note_unkept(error)

    kept.compile(_compile_or_load)


def is_kept(function: Any, *arguments: Any) -> bool:
    """Returns whether an earlier run left an `entry`'s machine code for arguments of these types."""
    require_compiler()
    return Kept(function.py_func, signature_of(*arguments)).is_whole


def signature_of(*arguments: Any) -> tuple[Any, ...]:
    """Returns numba's types of the arguments. numba makes the type of a record anew each time, which takes
    milliseconds; here it is cached."""
    return tuple(
        _type_of_record(one.dtype, one.dtype.isalignedstruct) if isinstance(one, np.void) else numba.typeof(one)
        for one in arguments
    )


@cache
def _type_of_record(dtype: Any, _is_aligned: bool) -> Any:
    return numba.from_dtype(dtype)


def require_compiler() -> None:
    """Raises UsageError if numba does not compile, or would hang."""
    if numba.config.DISABLE_JIT:
        raise UsageError("the loop has to be compiled, which NUMBA_DISABLE_JIT in the environment prevents: unset it")
    if (limit := address_space_limit()) and limit < _LEAST_ADDRESS_SPACE:
        raise UsageError(
            f"the address space is limited to {limit / 1e6:.0f} MB, and the compiler takes at least "
            f"{_LEAST_ADDRESS_SPACE / 1e6:.0f} MB: raise the limit (`ulimit -v unlimited`)"
        )


_LEAST_ADDRESS_SPACE = 600_000_000  # bytes; with less, OpenBLAS, which numba loads, tries again for ever (measured)


def note_unkept(error: OSError) -> None:
    """Records that machine code could not be written."""
    _unkept.append(error)


def why_not_kept() -> str:
    """Returns why the machine code of this process is not kept; "" if it is."""
    directory = directory_of_kept_code()
    if directory is None:
        return "no directory for it can be written"
    return f"{directory} cannot be written: {_unkept[0].strerror}" if _unkept else ""


_unkept: list[OSError] = []


def directory_of_kept_code(*, found: bool = False) -> Path | None:
    """Returns the directory above hapsim's machine code, None if nothing can be kept. `found`: the directory from which
    code was loaded, which may be read-only."""
    read_only = compiler.read_only_directories_of(compile_for) if found else ()
    directory = next(iter(read_only), compiler.directory_of(compile_for))
    return None if directory is None else directory.parent


class Kept:
    """The machine code of a function for one signature. `classes`: of its named tuples, all alike to numba."""

    def __init__(self, function: Any, signature: Any, *classes: type) -> None:
        self._function = function
        self._name = _name_of_mark(function, signature, classes)
        self._writable = compiler.directory_of(function, *classes)
        for directory in (*compiler.read_only_directories_of(function, *classes), self._writable):
            self._look_in(directory)
            if self.is_whole:
                break

    def _look_in(self, directory: Path | None) -> None:
        self.directory = directory
        """Directory of the machine code; None if nothing can be written."""
        self._mark = None if directory is None else directory / self._name
        self._digests = self._read_mark()
        self.is_whole = bool(self._digests) and self._digests.items() <= self._digests_of_files().items()
        """True if an earlier run left it, with the digests of its mark."""

    def compile(self, compile_or_load: Callable[[], Compiled]) -> Compiled:
        """Returns the result of `compile_or_load`, called a second time if the kept files are unusable."""
        if self._digests and not self.is_whole:
            self._forget()
        had_files = bool(self._files("nbc"))
        try:
            compiled = compile_or_load()
        except Exception:
            if not had_files:
                raise
            self._look_in(self._writable)
            self._forget()
            self.is_whole = False
            compiled = compile_or_load()
        if not self.is_whole and self._mark is not None and (digests := self._digests_of_files()):
            try:
                self._mark.write_text(json.dumps(digests), encoding="utf-8")
            except OSError as error:
                note_unkept(error)
        return compiled

    def _read_mark(self) -> dict[str, str]:
        """Returns the digest of each file as it was written; {} without a readable mark."""
        with contextlib.suppress(OSError, ValueError):
            return dict(json.loads(self._mark.read_text(encoding="utf-8"))) if self._mark else {}
        return {}

    def _digests_of_files(self) -> dict[str, str]:
        digests = {}
        for file in self._files("nbc"):
            with contextlib.suppress(OSError):  # another process may have removed it
                digests[file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
        return digests

    def _forget(self) -> None:
        for file in [*self._files("nbc"), *self._files("nbi"), *([self._mark] if self._mark else [])]:
            with contextlib.suppress(OSError):
                file.unlink()

    def _files(self, suffix: str) -> list[Path]:
        """Returns numba's files of this function for any signature: machine code (nbc) or index (nbi)."""
        if self.directory is None:
            return []
        code = self._function.__code__
        return list(self.directory.rglob(f"*.{self._function.__qualname__}-{code.co_firstlineno}.*{suffix}"))


def _name_of_mark(function: Any, signature: Any, classes: tuple[type, ...]) -> str:
    """Returns the name of the mark. It depends on the source's time: numba compiles again when that changes."""
    source = Path(function.__code__.co_filename).stat()
    names = sorted(f"{one.__module__}.{one.__qualname__}" for one in classes)
    text = f"{signature} {names} {source.st_mtime_ns} {source.st_size}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    return f"{function.__module__.rpartition('.')[2]}.{function.__name__}-{digest}.kept"
