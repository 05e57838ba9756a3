"""The decorators that compile the hot path, and where its machine code is kept between runs.

`jit` is for a function that stands by itself: Python calls it, its machine code is kept. `inlined` is for the parts
that such a function is made of: they are woven into whichever compiled function calls them, which saves each of them
the passing of dozens of arrays, and the wrapper and the file that nobody would use. Called from Python, a part runs as
plain Python. `jit_inlined` is for what is called from both sides in the hot path, `part` for what is off it: woven in
everywhere, it would only make the compilation longer.

numba keeps compiled code on disk but looks only at the file a function stands in: it does not notice that a compiled
function which that one calls has changed (numba issues 1833 and 9483). So the code is kept in a directory named after
the text of *all* sources it may have been built from; an edit anywhere starts a fresh one.

Nothing is allocated in the hot path, and no array in it outlives the call that brought it. So numba's counting of
references is switched off there (`_nrt`): an atomic addition for every array at every step was most of an exchange's
time. What tries to allocate all the same does not compile.

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
from numba.extending import overload, register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}

_PART = _OPTIONS | {"no_cpython_wrapper": True}
_WOVEN = _PART | {"forceinline": True}

_KEPT = 6  # builds kept side by side: a few branches and Python versions


class Compiler:
    """Decorators for functions whose machine code depends on the sources under `packages` (directories)."""

    def __init__(self, *packages: Path) -> None:
        self._packages = packages

    def jit(self, function: Function) -> Function:
        """Compiles a function that Python calls."""
        return self._entry(function)

    def jit_inlined(self, function: Function) -> Function:
        """Compiles a function that Python calls, and weaves it into compiled functions that call it."""
        return self._entry(function, forceinline=True)

    def inlined(self, function: Function) -> Function:
        """Weaves a function into the compiled functions that call it."""
        woven: Function = register_jitable(**_WOVEN)(function)
        return woven

    def fused(self, function: Function) -> Function:
        """Like `inlined`, for arithmetic: a product and the sum that it goes into may be rounded once instead of twice.

        Nothing else of `fastmath` is allowed: a NaN stays one.
        """
        woven: Function = register_jitable(**_WOVEN, fastmath={"contract"})(function)
        return woven

    def summed(self, function: Function) -> Function:
        """Like `fused`, for long sums: their terms may be added in any order, many at once. A NaN stays one."""
        woven: Function = register_jitable(**_WOVEN, fastmath={"contract", "reassoc", "nsz"})(function)
        return woven

    def part(self, function: Function) -> Function:
        """Compiles a function that compiled functions call; whether it is woven in is the compiler's choice."""
        kept: Function = register_jitable(**_PART)(function)
        return kept

    def overload(self, function: Callable[..., Any]) -> Callable[[Function], Function]:
        """numba's `overload` of `function`; what it chooses is woven in like any part."""
        chosen: Callable[[Function], Function] = overload(function, jit_options=_WOVEN)
        return chosen

    def _entry(self, function: Function, **options: Any) -> Function:
        directory = _build_directory(self._packages)
        with _numba_cache_in(directory):
            compiled: Function = numba.njit(cache=directory is not None, **_OPTIONS, **options)(function)
        return compiled


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
    mine = (
        stat.S_ISDIR(status.st_mode) and status.st_uid == _user() and not status.st_mode & (stat.S_IWOTH | stat.S_IWGRP)
    )
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


_compiler = Compiler(Path(__file__).parent)
jit, inlined, jit_inlined = _compiler.jit, _compiler.inlined, _compiler.jit_inlined
"""For functions of this package."""
