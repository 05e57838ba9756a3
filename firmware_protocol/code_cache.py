"""The directories in which the machine code of compiled functions is kept between runs.

numba keeps compiled code on disk but looks only at the file that a function stands in: it does not notice a change in
another file whose functions this one calls (numba issues 1833 and 9483). So each function's code goes to a directory
named after the text of every source that it may have been compiled from: its own file and its imports, direct and
indirect, as far as they lie in the rooms that hold compiled code. An edit elsewhere keeps everything; an edit of one
module's recurrence recompiles what contains it, and nothing else.

A directory that cannot be written, as in the image of a container, is read: `read_only_directories_for`.
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
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Self

import numba
from llvmlite import binding  # type: ignore[import-untyped]
from numba.core.caching import UserProvidedCacheLocator
from numba.core.codegen import get_host_cpu_features

CHOSEN = "HAPSIM_CACHE"
"""The environment variable that names the directory for compiled code."""

_IMPORT = re.compile(r"^\s*from ([\w.]+) import (?:\(([^)]*)\)|([^\n#]*))|^\s*import ([\w., ]+)", re.MULTILINE)
_KEY = re.compile("[0-9a-f]{16}")
_UNUSED_DAYS = 30.0  # after which a directory is removed


@functools.cache
def directory_for(sources: frozenset[Path], rooms: tuple[Path, ...]) -> Path | None:
    """Returns the directory for code compiled from `sources` and their imports within `rooms` (directories or files);
    None where no place can be written to."""
    key = _key_of(sources, rooms)
    for root, mode in private_roots():
        with contextlib.suppress(OSError):
            directory = root / key
            is_new = not directory.exists()
            directory.mkdir(mode, exist_ok=True)
            if _is_private(directory):
                os.utime(directory)
                if is_new:
                    _remove_unused(directory.parent)
                return directory
    return None


def private_roots() -> Iterator[tuple[Path, int]]:
    """Yields the directories where code may be kept, made and writable by this user alone, best first, each with the
    mode of what is made there. In a directory of others no link is followed: anyone may have planted it."""
    for root, mode in _roots():
        with contextlib.suppress(OSError):
            root.mkdir(mode, parents=True, exist_ok=True)
            planted = root.is_symlink() and _is_open_to_others(root.parent.stat())
            if not planted and _is_private(root.resolve()):
                yield root.resolve(), mode


@functools.cache
def read_only_directories_for(sources: frozenset[Path], rooms: tuple[Path, ...]) -> tuple[Path, ...]:
    """Returns the directories that may have such code and cannot be written, best first."""
    directories = [root / _key_of(sources, rooms) for root, _ in _roots()]
    return tuple(directory for directory in directories if _is_read_only(directory))


@contextlib.contextmanager
def numba_cache_in(directory: Path | None) -> Iterator[None]:
    """Sets the directory that numba reads when it decorates; a program that uses hapsim keeps its own setting."""
    config: Any = numba.config
    with _choosing:
        before = config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES
        if directory is not None:
            config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(directory), f"{__name__}.{Locator.__name__}"
        try:
            yield
        finally:
            config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = before


class Locator(UserProvidedCacheLocator):
    """Locator of numba's cache directory. Unlike numba's own, it also accepts one that can only be read."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Self:
        """Returns the locator of a function's code."""
        return cls(py_func, py_file)


_choosing = threading.RLock()  # the setting is the whole process's


def sources_of(sources: Iterable[Path], rooms: tuple[Path, ...]) -> tuple[Path, ...]:
    """Returns `sources` and every file in `rooms` that they import, directly or through others; sorted."""
    found, ahead = set(sources), list(sources)
    while ahead:
        new = _imports_of(ahead.pop(), rooms) - found
        found |= new
        ahead += new
    return tuple(sorted(found))


@functools.cache
def _imports_of(source: Path, rooms: tuple[Path, ...]) -> frozenset[Path]:
    """The files in `rooms` that a source imports. They are found by a pattern: Python's own parser would add tenths of
    a second to every start."""
    names: set[str] = set()
    for module, several, alone, plain in _IMPORT.findall(source.read_text(encoding="utf-8")):
        listed = [name.split()[0] for name in (several or alone or plain).split(",") if name.split()]
        names.update([module, *(f"{module}.{name}" for name in listed)] if module else listed)
    return frozenset(file for name in names for file in _files_of(name) if any(map(file.is_relative_to, rooms)))


@functools.cache
def _files_of(name: str) -> tuple[Path, ...]:
    """The file of a module of ours and those of its packages; nothing for others' modules."""
    root, parts = Path(__file__).resolve().parent.parent, name.split(".")
    if not (root / parts[0] / "__init__.py").is_file():
        return ()
    packages = [root.joinpath(*parts[:i], "__init__.py") for i in range(1, len(parts) + 1)]
    return tuple(file for file in [*packages, root.joinpath(*parts).with_suffix(".py")] if file.is_file())


@functools.cache
def _key_of(sources: frozenset[Path], rooms: tuple[Path, ...]) -> str:
    """The directory's name: a digest of the sources' names and texts, the compiler and the processor."""
    config: Any = numba.config
    name = config.CPU_NAME or binding.get_host_cpu_name()
    features = get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES
    made_by = numba.__version__, platform.python_version(), platform.machine(), name, features
    digest = hashlib.sha256(" ".join(made_by).encode())
    for source in sources_of(sources, rooms):
        digest.update(source.as_posix().encode())
        digest.update(_digest_of(source))
    return digest.hexdigest()[:16]


@functools.cache
def _digest_of(source: Path) -> bytes:
    return hashlib.sha256(source.read_bytes()).digest()


def _is_private(directory: Path) -> bool:
    """Returns whether only this user can put code there: numba's index files are pickles and run as ours."""
    status = directory.lstat()
    ours = stat.S_ISDIR(status.st_mode) and status.st_uid == _user() and not _is_open_to_others(status)
    return ours and os.access(directory, os.W_OK)


def _is_open_to_others(status: os.stat_result) -> bool:
    # A system without users reports every directory as open to all.
    return hasattr(os, "getuid") and bool(status.st_mode & (stat.S_IWOTH | stat.S_IWGRP))


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0  # a system without users reports owner 0 for every file


def _is_read_only(directory: Path) -> bool:
    """Returns whether code is there that only root or this user can write, and not this process."""
    with contextlib.suppress(OSError):
        places = [directory.parent.resolve(), directory.resolve(strict=True)]
        owned = all(place.stat().st_uid in (0, _user()) and not _is_open_to_others(place.stat()) for place in places)
        return owned and not os.access(directory, os.W_OK) and os.access(directory, os.R_OK | os.X_OK)
    return False


def _roots() -> Iterator[tuple[Path, int]]:
    """Yields the directories where code may be kept, best first, each with the mode to create it with. The chosen
    directory may be readable by others, as in an image. The installed package is never used: it may be read-only (numba
    issue 5566)."""
    if chosen := os.environ.get(CHOSEN):
        yield Path(chosen).absolute(), 0o755
    with contextlib.suppress(RuntimeError):
        of_user = os.environ.get("XDG_CACHE_HOME")
        yield (Path(of_user) if of_user else Path.home() / ".cache") / "hapsim", 0o700
    with contextlib.suppress(OSError):  # there may be no directory for temporary files
        yield Path(tempfile.gettempdir()) / f"hapsim-{_user()}", 0o700


def _remove_unused(root: Path) -> None:
    oldest = time.time() - 86400.0 * _UNUSED_DAYS
    with contextlib.suppress(OSError):  # another process may be removing the same ones
        for directory in root.iterdir():
            if _KEY.fullmatch(directory.name) and directory.stat().st_mtime < oldest:
                shutil.rmtree(directory, ignore_errors=True)
