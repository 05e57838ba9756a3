"""Source -> shared library, built once for this machine and kept in a folder that is only the user's."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import stat
import subprocess
import tempfile
import time
from collections.abc import Sequence
from ctypes import CDLL
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
PLAIN_FLAGS = ("-O3", "-march=native")
C_FLAGS = ("-std=c11", "-O3", "-march=native", "-ffp-contract=fast")
_WIDE = "-mprefer-vector-width=512"  # gcc and clang stay at 256 bits of their own accord


class BuildError(Exception):
    """There is no compiler, or it refused, or it took too long: why."""


@dataclass(frozen=True)
class Built:
    """`path` of the shared library; `seconds` that it took to make."""

    path: Path
    seconds: float

    def load(self) -> CDLL:
        return CDLL(str(self.path))


def build_c(name: str, *defines: str, plain: bool = False) -> Built:
    """The C program `name` beside this file, with `defines` such as MASSES=100; `plain`: with -O3 -march=native and
    nothing else."""
    flags = list(PLAIN_FLAGS) if plain else [*C_FLAGS, *_wide("cc"), *(f"-D{define}" for define in defines)]
    return build(HERE / name, "cc", flags)


def compiler_words(compiler: str = "cc") -> str:
    """Returns the compiler's version and options."""
    first = (_output_of(compiler, "--version").splitlines() or ["none"])[0]
    return f"{first}, {' '.join(PLAIN_FLAGS)}"


def why_no_compiler(compiler: str = "cc") -> str:
    """ "" where there is one."""
    return "" if shutil.which(compiler) else f"There is no compiler ({compiler}) on PATH."


def build(source: Path, compiler: str, flags: Sequence[str], limit_s: float = 120.0) -> Built:
    """The shared library of `source`, from the cache where it was made before by the same compiler with `flags`."""
    if reason := why_no_compiler(compiler):
        raise BuildError(reason)
    key = _key(source.read_text(encoding="utf-8"), compiler, *flags, _output_of(compiler, "--version"), _processor())
    library = cache() / f"{source.stem}-{key}.so"
    noted = library.with_suffix(".seconds")
    if not (library.exists() and noted.exists()):
        seconds = _compile(source, compiler, flags, library, limit_s)
        noted.write_text(repr(seconds), encoding="utf-8")
    return Built(library, float(noted.read_text(encoding="utf-8")))


def cache() -> Path:
    """The folder; only this user can write to it."""
    folder = Path(tempfile.gettempdir()) / f"hapsim-schemes-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    about = folder.lstat()
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o022:
        raise BuildError(f"{folder} is not a folder that only you can write to.")
    return folder


def _compile(source: Path, compiler: str, flags: Sequence[str], library: Path, limit_s: float) -> float:
    made = library.with_suffix(f".{os.getpid()}")
    command = [compiler, *flags, "-fPIC", "-shared", "-o", str(made), str(source), "-lm"]
    begin = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=limit_s)
    except subprocess.TimeoutExpired:
        made.unlink(missing_ok=True)
        raise BuildError(f"{compiler} gave up after {limit_s:.0f} s") from None
    if done.returncode != 0:
        raise BuildError(f"{compiler} refuses {source.name}: {done.stderr.strip()[:300]}")
    made.replace(library)
    return time.perf_counter() - begin


def _wide(compiler: str) -> list[str]:
    """The flag for the widest vectors, where the compiler knows it."""
    if shutil.which(compiler) is None:
        return []
    command = [compiler, _WIDE, "-x", "c", "-fsyntax-only", os.devnull]
    return [_WIDE] if subprocess.run(command, capture_output=True, check=False).returncode == 0 else []


def _output_of(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return "".join(line for line in lines if line.startswith(("model name", "flags", "Features")))


def _key(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]
