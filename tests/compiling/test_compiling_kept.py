"""Machine code that is damaged, cannot be written, or goes away: it is compiled anew, never executed, and nothing
fails."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

# A native function and an entry, both quick to compile, and what numba compiled of them.
SCRIPT = """
import numpy as np
from hapsim.running.compile_ahead import UNITS
from hapsim.compiling.progress import on_compilation
from hapsim.cordis import parameters
from firmware_protocol.compiled import new_record
names = []
with on_compilation(names.append):
    parameters.move.address()
    record = new_record(parameters.PARAMETERS)
    from hapsim.compiling.kept import compile_for, is_kept
    compile_for(parameters.post, record, np.zeros(0), 1)
parameters.post(record, np.zeros(0), 1)
compiled = sorted(set(names) & {"parameters.move", "post"})
print(compiled, parameters.move.is_kept(), is_kept(parameters.post, record, np.zeros(0), 1))
"""
COMPILED = "['parameters.move', 'post'] True True\n"
KEPT = "[] True True\n"
NOT_KEPT = "['parameters.move', 'post'] False False\n"


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that holds both."""
    cache = tmp_path_factory.mktemp("kept")
    assert call(cache) == COMPILED
    assert call(cache) == KEPT
    return cache


@pytest.fixture
def cache(once: Path, tmp_path: Path) -> Path:
    """A copy of it to be damaged."""
    return Path(shutil.copytree(once, tmp_path / "cache", copy_function=shutil.copy2))


def call(cache: Path, *before: str) -> str:
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    command = [*before, sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def empty(file: Path) -> None:
    file.write_bytes(b"")


def cut_off(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def other_bytes(file: Path) -> None:
    """In the middle, where the machine code is."""
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(64)
    file.write_bytes(content)


def a_directory(file: Path) -> None:
    file.unlink()
    file.mkdir()


@pytest.mark.parametrize("damage", [cut_off, other_bytes, a_directory, Path.unlink])
def test_damaged_machine_code_is_compiled_anew_and_kept_again(cache: Path, damage: Callable[[Path], object]) -> None:
    files = list(cache.rglob("*.nbc"))
    assert len(files) == 2
    for file in files:
        damage(file)
    assert call(cache) == COMPILED
    assert call(cache) == KEPT


@pytest.mark.parametrize("damage", [empty, cut_off])
def test_a_damaged_index_of_it_too(cache: Path, damage: Callable[[Path], object]) -> None:
    for file in cache.rglob("*.nbi"):
        damage(file)
    call(cache)
    assert call(cache) == KEPT


@pytest.mark.parametrize("damage", [cut_off, a_directory, Path.unlink])
def test_a_damaged_mark_too(cache: Path, damage: Callable[[Path], object]) -> None:
    for file in cache.rglob("*.kept"):
        damage(file)
    call(cache)
    call(cache)
    assert call(cache) == KEPT


@pytest.mark.skipif(shutil.which("prlimit") is None, reason="needs util-linux")
def test_what_cannot_be_written_is_compiled_all_the_same(tmp_path: Path) -> None:
    """As on a disk that is full."""
    assert call(tmp_path, "prlimit", "--fsize=1024") == NOT_KEPT


def test_a_cache_that_goes_away_between_two_starts_is_made_anew(cache: Path) -> None:
    again = (
        SCRIPT
        + f"import shutil; shutil.rmtree({str(cache)!r}); compile_for(parameters.post, record, np.zeros(0), 1.0)\n"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", again]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert call(cache) == COMPILED
