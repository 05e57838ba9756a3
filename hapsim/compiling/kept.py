"""What is kept of a compiled function from run to run, beside numba's own files: that it is there, and whole.

numba trusts its files: of one that is cut off it raises whatever reading it raises, and one with other bytes it
executes. So a mark beside them says what was written, and what does not agree with it is compiled anew. Where nothing
can be written the function is compiled all the same, and not kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from hapsim.compiling import compiler

Compiled = TypeVar("Compiled")

_OF_A_FILE = re.compile(r"([0-9a-f]{64}) ([\w./<>-]+)")


class Kept:
    """The machine code of a function for one signature. `classes`: those of the named tuples in it, which numba does
    not tell apart itself."""

    def __init__(self, function: Any, signature: Any, *classes: type) -> None:
        self.directory = compiler.directory_of(function, *classes)
        """Where it is kept; None where nothing can be written."""
        self._function = function
        self._mark = None if self.directory is None else self.directory / _name_of_mark(function, signature, classes)

    def is_whole(self) -> bool:
        """Whether it is there from an earlier run, as it was written."""
        written = self._written()
        return written is not None and all(_digest(file) == digest for file, digest in written)

    def compile(self, compile_or_load: Callable[[], Compiled]) -> Compiled:
        """What `compile_or_load` gives, called a second time where what was kept was of no use."""
        if self._written() is not None and not self.is_whole():
            self._forget()
        before = self._files()
        try:
            compiled = compile_or_load()
        except Exception:
            if not before:
                raise
            self._forget()
            compiled = compile_or_load()
        self._note(before)
        return compiled

    def _written(self) -> list[tuple[Path, str]] | None:
        """The files that were written, and their digests; None where there is no mark, or none that can be read."""
        if self._mark is None:
            return None
        try:
            lines = self._mark.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            return None
        found = [_OF_A_FILE.fullmatch(line) for line in lines]
        return [(self._mark.parent / one[2], one[1]) for one in found if one] if found and all(found) else None

    def _note(self, before: dict[Path, int]) -> None:
        """Writes the mark, where something was written."""
        if self._mark is None:
            return
        now = self._files()
        fresh = [file for file, written_ns in now.items() if before.get(file) != written_ns]
        if not fresh and self._written() is None:
            fresh = list(now)  # the mark was lost, or another process writes its own
        if not fresh:
            return
        text = "".join(f"{_digest(file)} {file.relative_to(self._mark.parent)}\n" for file in fresh)
        _remove(self._mark)
        with contextlib.suppress(OSError):
            self._mark.write_text(text, encoding="utf-8")

    def _forget(self) -> None:
        for file in [*self._files(), *self._indices()] + ([] if self._mark is None else [self._mark]):
            _remove(file)

    def _files(self) -> dict[Path, int]:
        """numba's files with machine code of this function, for any signature, and when each was written, in ns."""
        found = {}
        for file in self._named("nbc"):
            with contextlib.suppress(OSError):
                found[file] = file.stat().st_mtime_ns
        return found

    def _indices(self) -> Iterator[Path]:
        return self._named("nbi")

    def _named(self, suffix: str) -> Iterator[Path]:
        if self.directory is None:
            return iter(())
        code = self._function.__code__
        return self.directory.rglob(f"*.{self._function.__qualname__}-{code.co_firstlineno}.*{suffix}")


def _name_of_mark(function: Any, signature: Any, classes: tuple[type, ...]) -> str:
    """numba compiles anew when the file of a function was touched, so when that was is in the name."""
    source = Path(function.__code__.co_filename).stat()
    names = sorted(f"{one.__module__}.{one.__qualname__}" for one in classes)
    text = f"{signature} {names} {source.st_mtime_ns} {source.st_size}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    return f"{function.__module__.rpartition('.')[2]}.{function.__name__}-{digest}.kept"


def _remove(file: Path) -> None:
    with contextlib.suppress(OSError):
        file.rmdir() if file.is_dir() else file.unlink()


def _digest(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""
