"""Machine code is kept under what it is compiled from: an edit starts afresh what contains it, and nothing else.

Each test copies the packages, edits the copy and asks the copy's own cache where it would look.
"""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import code_cache
from hapsim.compiling import COMPILED_ROOMS

REPOSITORY = Path(code_cache.__file__).resolve().parents[1]
ROOMS = [room.relative_to(REPOSITORY) for room in COMPILED_ROOMS]

#: Entries and actions, by file: what has machine code of its own.
RUN, SERVE, DECODER = "hapsim/loop/run.py", "hapsim/device/mock/serve.py", "firmware_protocol/decoder.py"
POINTS, LINEAR, NONLINEAR, STRING, MEMBRANE = (
    f"hapsim/cordis/modules/{name}.py" for name in ("points", "linear_links", "nonlinear_links", "string", "membrane")
)
DESCRIPTOR, GRID = "hapsim/loop/transport.py", "hapsim/loop/clocks.py"
KEPT = (RUN, SERVE, DECODER, POINTS, LINEAR, NONLINEAR, STRING, MEMBRANE, DESCRIPTOR, GRID)


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The sources of both packages, and a cache of the test's own."""
    for package in ("hapsim", "firmware_protocol"):
        shutil.copytree(REPOSITORY / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def directories(root: Path, *files: str) -> dict[str, Path]:
    """Where a process that begins now would keep what is compiled from each of these files."""
    specification = importlib.util.spec_from_file_location(
        "code_cache_of_copy", root / "firmware_protocol/code_cache.py"
    )
    assert specification is not None
    assert specification.loader is not None
    cache: Any = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(cache)
    rooms = tuple(root / room for room in ROOMS)
    found = {file: cache.directory_for(frozenset([root / file]), rooms) for file in files or KEPT}
    assert all(directory.parent == root / "cache" / "hapsim" for directory in found.values())
    return found


def append(file: Path) -> None:
    with file.open("a", encoding="utf-8") as source:
        source.write("\nEDITED = True\n")


def changed_by(root: Path, edit: Callable[[], None]) -> set[str]:
    """What has another directory after an edit."""
    before = directories(root)
    edit()
    after = directories(root)
    return {file for file in KEPT if before[file] != after[file]}


def test_files_share_no_directory_unless_they_are_made_of_the_same(copy: Path) -> None:
    assert len(set(directories(copy).values())) == len(KEPT)
    assert directories(copy) == directories(copy)


def is_compiled(file: Path, root: Path) -> bool:
    return any(file.is_relative_to(root / room) for room in ROOMS)


def test_an_edit_outside_the_rooms_keeps_all_machine_code(copy: Path) -> None:
    outside = [file for file in (copy / "hapsim").rglob("*.py") if not is_compiled(file, copy)]
    assert {"scene.py", "session.py", "conversation.py", "command_line.py"} <= {file.name for file in outside}

    def edit() -> None:
        for file in outside:
            append(file)

    assert changed_by(copy, edit) == set()


@pytest.mark.parametrize(
    ("edited", "changed"),
    [
        ("hapsim/cordis/modules/linear_links.py", {LINEAR}),
        ("hapsim/cordis/modules/link.py", {LINEAR, NONLINEAR}),
        ("hapsim/cordis/modules/string.py", {STRING}),
        ("hapsim/cordis/modules/structure.py", {STRING, MEMBRANE}),
        ("hapsim/cordis/modules/points.py", {POINTS}),
        ("hapsim/cordis/registry.py", set()),
        ("hapsim/loop/histogram.py", {RUN, SERVE, GRID}),
        ("firmware_protocol/encoding.py", {RUN, SERVE, DECODER}),
        ("hapsim/device/mock/firmware.py", {SERVE}),
        ("hapsim/compiling/native.py", set(KEPT) - {DECODER, GRID}),
        ("firmware_protocol/compiled.py", set(KEPT)),
    ],
)
def test_an_edit_starts_afresh_what_contains_it_and_nothing_else(copy: Path, edited: str, changed: set[str]) -> None:
    assert changed_by(copy, lambda: append(copy / edited)) == changed


def test_going_back_finds_what_was_kept_before(copy: Path) -> None:
    edited = copy / LINEAR
    text, first = edited.read_bytes(), directories(copy)
    append(edited)
    assert directories(copy) != first
    edited.write_bytes(text)
    assert directories(copy) == first


# --- what counts as an import ---


def package(root: Path, sources: dict[str, str]) -> None:
    """A made-up package beside a copy of the cache, all of it one room."""
    for name, text in {"hapsim/__init__.py": "", "firmware_protocol/__init__.py": "", **sources}.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    shutil.copy(code_cache.__file__, root / "firmware_protocol")


@pytest.mark.parametrize(
    "statement",
    [
        "import hapsim.loop.two",
        "import os, hapsim.loop.two as second",
        "from hapsim.loop import two",
        "from hapsim.loop import one_more, two as second  # and why",
        "from hapsim.loop import (\n    one_more,\n    two,\n)",
        "from hapsim.loop.two import something",
        "from hapsim.loop.two import (\n    something,\n)",
        "def late():\n    from hapsim.loop.two import something",
        "from hapsim.loop.between import anything",
    ],
)
def test_what_is_imported_in_any_way_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, statement: str) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    sources = {f"hapsim/loop/{name}.py": "" for name in ("__init__", "one_more", "two")}
    package(tmp_path, sources | {"hapsim/loop/one.py": statement, "hapsim/loop/between.py": "import hapsim.loop.two"})
    before = directories(tmp_path, "hapsim/loop/one.py")
    append(tmp_path / "hapsim/loop/two.py")
    assert directories(tmp_path, "hapsim/loop/one.py") != before


def test_what_is_not_imported_does_not_count_nor_what_is_only_spoken_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    sources = {f"hapsim/loop/{name}.py": "" for name in ("__init__", "two", "three")}
    one = "import numpy\nfrom hapsim.loop import three  # instead of hapsim.loop.two\nx = 'hapsim.loop.two'\n"
    package(tmp_path, sources | {"hapsim/loop/one.py": one})
    before = directories(tmp_path, "hapsim/loop/one.py")
    append(tmp_path / "hapsim/loop/two.py")
    assert directories(tmp_path, "hapsim/loop/one.py") == before


def test_packages_that_a_module_stands_in_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python runs them first, and what they hold may be compiled in."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    package(tmp_path, {f"hapsim/{name}.py": "" for name in ("loop/__init__", "loop/inner/__init__", "loop/inner/two")})
    (tmp_path / "hapsim/loop/one.py").write_text("from hapsim.loop.inner.two import something\n", encoding="utf-8")
    for name in ("hapsim/loop/__init__.py", "hapsim/loop/inner/__init__.py"):
        before = directories(tmp_path, "hapsim/loop/one.py")
        append(tmp_path / name)
        assert directories(tmp_path, "hapsim/loop/one.py") != before
