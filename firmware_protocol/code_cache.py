"""Where the machine code of compiled functions is kept between runs.

numba keeps compiled code on disk but looks only at the file that a function stands in: it does not notice that another
file, whose functions this one calls, has changed (numba issues 1833 and 9483). So the code of each function is kept in
a directory named after the text of every source that it may have been compiled from: its own file, and what that file
imports, directly or through others, as far as it lies in the rooms that hold compiled code. An edit anywhere else keeps
everything; an edit of one module's recurrence starts afresh what contains it, and nothing else.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import re
import shutil
import stat
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numba

_IMPORT = re.compile(r"^\s*from ([\w.]+) import (?:\(([^)]*)\)|([^\n#]*))|^\s*import ([\w., ]+)", re.MULTILINE)
_KEPT_DAYS = 30.0  # what nobody has loaded for so long is removed


@functools.cache
def directory_for(sources: frozenset[Path], rooms: tuple[Path, ...]) -> Path | None:
    """The directory for code that is compiled from `sources`, and from what they import that lies in `rooms`
    (directories or files); None where no place can be written to."""
    key = _key_of(sources_of(sources, rooms))
    for root in _roots():
        try:
            root.mkdir(mode=0o700, parents=True, exist_ok=True)
            root = root.resolve()  # noqa: PLW2901
            directory = root / key
            fresh = not directory.exists()
            directory.mkdir(mode=0o700, exist_ok=True)
            if not (_is_ours(root) and _is_ours(directory)):
                continue
            os.utime(directory)
        except OSError:
            continue
        if fresh:
            _remove_unused(root)
        return directory
    return None


@contextlib.contextmanager
def numba_cache_in(directory: Path | None) -> Iterator[None]:
    """numba chooses the place when it decorates; a program that uses hapsim keeps its own setting."""
    with _choosing:
        before = numba.config.CACHE_DIR
        if directory is not None:
            numba.config.CACHE_DIR = str(directory)
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


_choosing = threading.RLock()  # the place is the whole process's


def sources_of(sources: Iterable[Path], rooms: Sequence[Path]) -> tuple[Path, ...]:
    """`sources` and every file in `rooms` that they import, directly or through others; sorted."""
    found, ahead = set(sources), list(sources)
    while ahead:
        for imported in _imports_of(ahead.pop()):
            if imported not in found and any(imported.is_relative_to(room) for room in rooms):
                found.add(imported)
                ahead.append(imported)
    return tuple(sorted(found))


@functools.cache
def _imports_of(source: Path) -> tuple[Path, ...]:
    """The files of our own packages that a source's import statements name."""
    names: set[str] = set()
    for module, several, alone, plain in _IMPORT.findall(source.read_text(encoding="utf-8")):
        if plain:
            names.update(name.split()[0] for name in plain.split(",") if name.split())
        else:
            names.add(module)
            names.update(f"{module}.{name.split()[0]}" for name in (several or alone).split(",") if name.split())
    return tuple(file for name in sorted(names) for file in _files_of(name))


@functools.cache
def _files_of(name: str) -> tuple[Path, ...]:
    """The file of a module by its full name, and those of the packages it stands in; nothing for others' modules."""
    root, parts = Path(__file__).resolve().parent.parent, name.split(".")
    if not (root / parts[0] / "__init__.py").is_file():
        return ()
    packages = [root.joinpath(*parts[:i], "__init__.py") for i in range(1, len(parts) + 1)]
    return tuple(file for file in [*packages, root.joinpath(*parts).with_suffix(".py")] if file.is_file())


def _key_of(sources: Sequence[Path]) -> str:
    """Returns the name of the directory: a digest of the sources' names and texts, the compiler and the machine."""
    digest = hashlib.sha256(f"{numba.__version__} {platform.python_version()} {platform.machine()}".encode())
    for source in sources:
        digest.update(source.as_posix().encode())
        digest.update(_digest_of(source))
    return digest.hexdigest()[:16]


@functools.cache
def _digest_of(source: Path) -> bytes:
    return hashlib.sha256(source.read_bytes()).digest()


def _is_ours(directory: Path) -> bool:
    """Whether nobody else can put code there, which would then run as ours: numba's index files are pickles."""
    status = directory.lstat()
    # A system without users says of every directory that all may write to it; who may is then another matter.
    open_to = status.st_mode & (stat.S_IWOTH | stat.S_IWGRP) if hasattr(os, "getuid") else 0
    mine = stat.S_ISDIR(status.st_mode) and status.st_uid == _user() and not open_to
    return mine and os.access(directory, os.W_OK)


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0  # a system without users reports 0 as the owner of every file


def _roots() -> Iterator[Path]:
    """Where code may be kept, best first. Never the installed package: it may be read-only (numba issue 5566)."""
    chosen = os.environ.get("XDG_CACHE_HOME")
    with contextlib.suppress(RuntimeError):
        yield (Path(chosen) if chosen else Path.home() / ".cache") / "hapsim"
    yield Path(tempfile.gettempdir()) / f"hapsim-{_user()}"


def _remove_unused(root: Path) -> None:
    oldest = time.time() - 86400.0 * _KEPT_DAYS
    with contextlib.suppress(OSError):  # another process may be removing the same ones
        for directory in root.iterdir():
            if directory.stat().st_mtime < oldest:
                shutil.rmtree(directory, ignore_errors=True)
