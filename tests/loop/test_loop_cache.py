"""Where compiled code is kept: apart for every state of the sources, and only where nobody else can put any."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from firmware_protocol import compiled


@pytest.fixture
def package(tmp_path: Path) -> Path:
    (tmp_path / "package" / "room").mkdir(parents=True)
    (tmp_path / "package" / "one.py").write_text("x = 1\n", encoding="utf-8")
    (tmp_path / "package" / "room" / "two.py").write_text("y = 2\n", encoding="utf-8")
    return tmp_path / "package"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(compiled.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return tmp_path / "cache" / "hapsim"


def directory_for(*packages: Path) -> Path | None:
    """As a process that begins now would choose it."""
    compiled._build_directory.cache_clear()
    try:
        return compiled._build_directory(packages)
    finally:
        compiled._build_directory.cache_clear()


@pytest.mark.usefixtures("cache")
def test_the_same_sources_keep_their_directory(package: Path) -> None:
    assert directory_for(package) == directory_for(package)


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("name", ["one.py", "room/two.py", "room/new.py"])
def test_a_change_of_any_source_gives_another_directory(package: Path, name: str) -> None:
    before = directory_for(package)
    with (package / name).open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert directory_for(package) != before


@pytest.mark.usefixtures("cache")
def test_a_source_that_moves_or_goes_gives_another_directory(package: Path) -> None:
    first = directory_for(package)
    (package / "one.py").rename(package / "other.py")
    second = directory_for(package)
    (package / "other.py").unlink()
    assert len({first, second, directory_for(package)}) == 3


@pytest.mark.usefixtures("cache")
def test_a_file_that_is_no_source_changes_nothing(package: Path) -> None:
    before = directory_for(package)
    (package / "notes.md").write_text("notes", encoding="utf-8")
    assert directory_for(package) == before


def test_the_directory_is_ours_alone(package: Path, cache: Path) -> None:
    directory = directory_for(package)
    assert directory is not None
    assert directory.parent == cache
    assert directory.stat().st_mode & 0o777 == 0o700


def test_a_cache_that_others_can_write_to_is_passed_over(package: Path, cache: Path, tmp_path: Path) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    directory = directory_for(package)
    assert directory is not None
    assert directory.is_relative_to(tmp_path / "temporary")


def test_where_the_cache_cannot_be_made_the_temporary_directory_serves(
    package: Path, cache: Path, tmp_path: Path
) -> None:
    cache.parent.write_text("a file is in the way", encoding="utf-8")
    directory = directory_for(package)
    assert directory is not None
    assert directory.is_relative_to(tmp_path / "temporary")


def test_where_nothing_can_be_written_functions_are_compiled_all_the_same(
    package: Path, cache: Path, tmp_path: Path
) -> None:
    cache.parent.write_text("a file is in the way", encoding="utf-8")
    (tmp_path / "temporary").rmdir()
    (tmp_path / "temporary").write_text("here too", encoding="utf-8")
    assert directory_for(package) is None

    @compiled.Compiler(package).jit
    def double(x: int) -> int:
        return 2 * x

    compiled._build_directory.cache_clear()
    assert double(21) == 42


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("setting", ["", "/somewhere/of/theirs"])
def test_a_program_that_uses_hapsim_keeps_its_own_setting_of_numba(
    package: Path, monkeypatch: pytest.MonkeyPatch, setting: str
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", setting)

    @compiled.Compiler(package).jit
    def half(x: float) -> float:
        return x / 2

    compiled._build_directory.cache_clear()
    assert setting == numba.config.CACHE_DIR


def test_old_builds_are_forgotten_and_the_newest_kept(package: Path, cache: Path) -> None:
    for change in range(10):
        (package / "one.py").write_text(f"x = {change}\n", encoding="utf-8")
        newest = directory_for(package)
    assert newest in cache.iterdir()
    assert len(list(cache.iterdir())) <= compiled._KEPT


def test_what_another_program_left_in_the_cache_is_compiled_anew(tmp_path: Path) -> None:
    """numba's index of what was kept names the types of a port that only the other program has."""
    program = (
        "import sys; sys.path.insert(0, {where!r})\n"
        "import numpy as np\n"
        "{port}\n"
        "from hapsim.compiled import compile_for\n"
        "from hapsim.loop.port import send_from\n"
        "compile_for(send_from, {argument}, np.zeros(4, np.uint8), 1)\n"
        "print('compiled')\n"
    )
    (tmp_path / "theirs.py").write_text(
        "from typing import NamedTuple\n"
        "from hapsim.compiled import inlined\n"
        "from hapsim.loop.port import transport\n"
        "class TheirPort(NamedTuple):\n    number: int\n"
        "@inlined\ndef take(port, buffer, start, timeout_ns):\n    return 0\n"
        "@inlined\ndef give(port, buffer, stop):\n    return 0\n"
        "transport(TheirPort, take, give)\n",
        encoding="utf-8",
    )
    ours = program.format(
        where="", port="from hapsim.loop.descriptor import descriptor_port", argument="descriptor_port(0)"
    )
    theirs = program.format(where=str(tmp_path), port="from theirs import TheirPort", argument="TheirPort(1)")
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    for text in (theirs, ours, ours):
        done = subprocess.run(
            [sys.executable, "-c", text], env=environment, capture_output=True, text=True, check=False
        )
        assert done.stdout == "compiled\n", done.stderr
