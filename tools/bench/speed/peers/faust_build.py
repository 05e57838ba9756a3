"""A Faust program -> C++ -> a shared library, each compiler with a limit to its time."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from speed.reference.build import BuildError, Built, build, cache, why_no_compiler

LIMIT_S = 120.0
_ARCHITECTURE = Path(__file__).resolve().parent / "faust_architecture.cpp"
# Every delay a ring, none copied along: 2 to 4 times as fast here as what Faust does of its own accord.
_FAUST_FLAGS = ("-lang", "cpp", "-double", "-mcd", "0", "-t", "0")
_FLAGS = ("-std=c++11", "-O3", "-march=native", "-ffp-contract=fast")


def why_no_faust() -> str:
    """ "" where Faust, its mi.lib and a C++ compiler are there."""
    if shutil.which("faust") is None:
        return "There is no compiler of Faust (faust) on PATH."
    place = subprocess.run(["faust", "-dspdir"], capture_output=True, text=True, check=False).stdout.strip()
    if not (Path(place) / "mi.lib").exists():
        return f"Faust has no mi.lib ({place})."
    return why_no_compiler("g++")


@dataclass(frozen=True)
class BuiltByFaust:
    """The library, and what each compiler took for it, in s."""

    built: Built
    faust_s: float

    @property
    def seconds(self) -> float:
        return self.faust_s + self.built.seconds


def build_faust(program: str) -> BuiltByFaust:
    """The library of `program`. BuildError where a compiler gave up, at once when it did so before."""
    text = "".join([program, _ARCHITECTURE.read_text(encoding="utf-8"), *_FAUST_FLAGS, _version()])
    source = cache() / f"faust-{hashlib.sha256(text.encode()).hexdigest()[:24]}.cpp"
    gave_up = source.with_suffix(".gave-up")
    if gave_up.exists():
        raise BuildError(gave_up.read_text(encoding="utf-8"))
    try:
        faust_s = _to_cpp(program, source)
        return BuiltByFaust(build(source, "g++", _FLAGS, LIMIT_S), faust_s)
    except BuildError as error:
        gave_up.write_text(str(error), encoding="utf-8")
        raise


def _to_cpp(program: str, source: Path) -> float:
    """The seconds that it took, when it was done."""
    noted = source.with_suffix(".faust-seconds")
    if not (source.exists() and noted.exists()):
        noted.write_text(repr(_run_faust(program, source)), encoding="utf-8")
    return float(noted.read_text(encoding="utf-8"))


def _run_faust(program: str, source: Path) -> float:
    text = source.with_suffix(".dsp")
    text.write_text(program, encoding="utf-8")
    command = ["faust", *_FAUST_FLAGS, "-a", _ARCHITECTURE.name, "-A", str(_ARCHITECTURE.parent)]
    begin = time.perf_counter()
    try:
        done = subprocess.run(
            [*command, "-o", str(source), str(text)], capture_output=True, text=True, check=False, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        raise BuildError(f"faust gave up after {LIMIT_S:.0f} s") from None
    if done.returncode != 0:
        raise BuildError(f"faust refuses the program: {(done.stderr.strip() or str(done.returncode))[:300]}")
    return time.perf_counter() - begin


def _version() -> str:
    return subprocess.run(["faust", "--version"], capture_output=True, text=True, check=False).stdout
