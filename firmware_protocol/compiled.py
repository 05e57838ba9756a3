"""The decorator that compiles the hot path, and where its machine code is kept between runs.

numba keeps compiled code on disk but looks only at the file a function stands in: it does not notice that a compiled
function which that one calls has changed (numba issues 1833 and 9483). So the code is kept in a directory named after
the text of *all* sources it may have been built from; an edit anywhere starts a fresh one.

`error_model="numpy"`: a division by zero gives an infinity that a guard can see, instead of an exception out of the
loop. `fastmath` stays off: it would let the compiler delete the guard's test for NaN (numba issue 2919).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_KEPT = 6  # builds kept side by side: a few branches and Python versions


def compiler_for(*packages: Path) -> Callable[[Function], Function]:
    """A decorator for functions whose machine code depends on the sources under `packages` (directories)."""

    def jit(function: Function) -> Function:
        directory = _build_directory(packages)
        with _numba_cache_in(directory):
            compiled: Function = numba.njit(cache=directory is not None, nogil=True, error_model="numpy")(function)
        return compiled

    return jit


@contextlib.contextmanager
def _numba_cache_in(directory: Path | None) -> Iterator[None]:
    """numba chooses the place when it decorates; a program that uses hapsim keeps its own setting."""
    before = numba.config.CACHE_DIR
    if directory is not None:
        numba.config.CACHE_DIR = str(directory)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


@functools.cache
def _build_directory(packages: tuple[Path, ...]) -> Path | None:
    """The directory for this state of the sources, or None where no place can be written to."""
    key = _source_key(packages)
    for root in _cache_roots():
        try:
            root.mkdir(mode=0o700, parents=True, exist_ok=True)
            root = root.resolve()  # noqa: PLW2901
            directory = root / key
            fresh = not directory.exists()
            directory.mkdir(mode=0o700, exist_ok=True)
            if not (_is_ours(root) and _is_ours(directory)):
                continue
            if not fresh:
                os.utime(directory)
        except OSError:
            continue
        if fresh:
            _forget_old_builds(root)
        return directory
    return None


def _is_ours(directory: Path) -> bool:
    """Whether nobody else can put code there, which would then run as ours: numba's index files are pickles."""
    status = directory.lstat()
    mine = stat.S_ISDIR(status.st_mode) and status.st_uid == _user() and not status.st_mode & stat.S_IWOTH
    return mine and os.access(directory, os.W_OK)


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0  # a system without users reports 0 as the owner of every file


def _cache_roots() -> Iterator[Path]:
    """Where builds may be kept, best first. Never the installed package: it may be read-only (numba issue 5566)."""
    chosen = os.environ.get("XDG_CACHE_HOME")
    with contextlib.suppress(RuntimeError):
        yield (Path(chosen) if chosen else Path.home() / ".cache") / "hapsim"
    yield Path(tempfile.gettempdir()) / f"hapsim-{_user()}"


def _source_key(packages: tuple[Path, ...]) -> str:
    digest = hashlib.sha256(f"{numba.__version__} {platform.python_version()} {platform.machine()}".encode())
    for package in packages:
        for source in sorted(package.rglob("*.py")):
            digest.update(source.relative_to(package).as_posix().encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _forget_old_builds(root: Path) -> None:
    with contextlib.suppress(OSError):  # another process may be forgetting the same ones
        builds = sorted(root.iterdir(), key=lambda build: build.stat().st_mtime, reverse=True)
        for build in builds[_KEPT:]:
            shutil.rmtree(build, ignore_errors=True)


jit = compiler_for(Path(__file__).parent)
"""Compiles a function of this package."""
