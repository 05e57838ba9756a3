"""Machine code is kept under the text of its sources: an edit starts afresh what contains it, and nothing else.

Every compiled function is in a directory that the cache looks at; so is all that it is made of. Tests of edits copy the
packages, edit the copy and ask the copy's own cache where it would look."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import firmware_protocol
from firmware_protocol import code_cache
from hapsim.compiling import COMPILED_ROOMS
from tests.loaded_files import module_of

REPOSITORY = Path(code_cache.__file__).resolve().parents[1]
ROOMS = [room.relative_to(REPOSITORY) for room in COMPILED_ROOMS]

#: Entries and actions, by file: what has machine code of its own.
RUN, SERVE, DECODER = "hapsim/loop/compiled_loop.py", "hapsim/device/mock/terminal.py", "firmware_protocol/decoder.py"
POINTS, LINEAR, NONLINEAR, STRING, MEMBRANE = (
    f"hapsim/cordis/modules/{name}.py" for name in ("points", "linear_links", "nonlinear_links", "string", "membrane")
)
DESCRIPTOR, GRID = "hapsim/loop/transport.py", "hapsim/loop/clocks.py"
KEPT = (RUN, SERVE, DECODER, POINTS, LINEAR, NONLINEAR, STRING, MEMBRANE, DESCRIPTOR, GRID)


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources of both packages, and a cache of these tests' own."""
    root = tmp_path_factory.mktemp("copy")
    for package in ("hapsim", "firmware_protocol"):
        names = shutil.ignore_patterns("__pycache__", "*.md", "firmware", "page")
        shutil.copytree(REPOSITORY / package, root / package, ignore=names)
    return root


@pytest.fixture(scope="module")
def unedited(copied: Path) -> dict[str, Path]:
    """The cache's directories for the sources as they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(copied / "cache"))
        return directories(copied)


@pytest.fixture
def append_to_copy(copied: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Edits a file of the copy until the end of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(copied / "cache"))
    texts: dict[Path, bytes] = {}

    def edit(name: str) -> None:
        texts[copied / name] = (copied / name).read_bytes()
        append(copied / name)

    yield edit
    for file, text in texts.items():
        file.write_bytes(text)


def directories(root: Path, *files: str) -> dict[str, Path]:
    """Returns the cache directory that a new process would use for code compiled from each of these files."""
    cache = module_of(root / "firmware_protocol" / "code_cache.py")
    rooms = tuple(root / room for room in ROOMS)
    found = {file: cache.directory_for(frozenset([root / file]), rooms) for file in files or KEPT}
    assert all(directory.parent == root / "cache" / "hapsim" for directory in found.values())
    return found


def append(file: Path) -> None:
    with file.open("a", encoding="utf-8") as source:
        source.write("\nEDITED = True\n")


def test_files_share_no_directory_unless_they_are_made_of_the_same(unedited: dict[str, Path]) -> None:
    assert len(set(unedited.values())) == len(KEPT)


def is_compiled(file: Path, root: Path) -> bool:
    return any(file.is_relative_to(root / room) for room in ROOMS)


def test_an_edit_outside_the_rooms_keeps_all_machine_code(
    copied: Path, unedited: dict[str, Path], append_to_copy: Callable[[str], None]
) -> None:
    outside = [file for file in (copied / "hapsim").rglob("*.py") if not is_compiled(file, copied)]
    assert {"scene.py", "session.py", "connection.py", "command_line.py"} <= {file.name for file in outside}
    for file in outside:
        append_to_copy(str(file.relative_to(copied)))
    assert directories(copied) == unedited


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize(
    ("edited", "changed"),
    [
        ("hapsim/cordis/modules/linear_links.py", {LINEAR}),
        ("hapsim/cordis/modules/link.py", {LINEAR, NONLINEAR}),
        ("hapsim/cordis/modules/string.py", {STRING}),
        ("hapsim/cordis/modules/structure.py", {STRING, MEMBRANE}),
        ("hapsim/cordis/modules/points.py", {POINTS}),
        ("hapsim/cordis/program.py", set()),
        ("hapsim/loop/histogram.py", {RUN, SERVE, GRID}),
        ("firmware_protocol/frames.py", {RUN, SERVE, DECODER}),
        ("hapsim/device/mock/firmware.py", {SERVE}),
        ("hapsim/compiling/native.py", set(KEPT) - {DECODER, GRID}),
        ("firmware_protocol/compiled.py", set(KEPT)),
    ],
)
def test_an_edit_starts_afresh_what_contains_it_and_nothing_else(
    edited: str, changed: set[str], copied: Path, unedited: dict[str, Path], append_to_copy: Callable[[str], None]
) -> None:
    """And each finds what was kept before: the edits of the other tests are taken back."""
    append_to_copy(edited)
    after = directories(copied)
    assert {file for file in KEPT if unedited[file] != after[file]} == changed


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


def test_what_is_not_imported_does_not_count_nor_what_is_only_mentioned(
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


PROTOCOL = Path(firmware_protocol.__file__).resolve().parent
HAPSIM = PROTOCOL.parent / "hapsim"


def is_in(file: Path, rooms: tuple[Path, ...]) -> bool:
    return any(file.is_relative_to(room) for room in rooms)


def sources_of(file: Path) -> set[Path]:
    """Returns the sources in the cache key of a file's functions; firmware_protocol is compiled from itself alone."""
    return set(code_cache.sources_of([file], (PROTOCOL,) if is_in(file, (PROTOCOL,)) else COMPILED_ROOMS))


def test_what_is_looked_for_is_found(every_compiled: list[Any]) -> None:
    """Else the tests below would hold of nothing."""
    found = {(one.kind, one.file.name, one.name) for one in every_compiled}
    assert {
        ("entry", "compiled_loop.py", "run_loop"),
        ("entry", "terminal.py", "serve"),
        ("native", "linear_links.py", "add_forces"),
        ("native", "crossfade.py", "cross_fade"),
        ("piece", "frames.py", "crc_of"),
        ("piece", "structure.py", "next_position"),
        ("overload", "structure.py", "_choose_update"),
        ("overload", "system.py", "_compiled_now_ns"),
        ("intrinsic", "native.py", "value_of"),
        ("lowering", "__init__.py", "_lower_fence"),
    } <= found
    (run_loop,) = (one for one in every_compiled if one.name == "run_loop")
    assert {
        PROTOCOL / "frames.py",
        HAPSIM / "cordis" / "substep_loop.py",
        HAPSIM / "loop" / "system.py",
    } <= run_loop.reached


def test_no_compiled_function_of_the_packages_stands_outside_the_rooms(every_compiled: list[Any]) -> None:
    ours = [one for one in every_compiled if is_in(one.file, (HAPSIM, PROTOCOL))]
    assert [str(one) for one in ours if not is_in(one.file, COMPILED_ROOMS)] == []


def test_no_machine_code_is_made_of_what_the_cache_does_not_look_at(every_compiled: list[Any]) -> None:
    """Not the benches' either, whose functions stand outside the rooms: each in the file that is looked at with it."""
    roots = [one for one in every_compiled if one.kind in ("entry", "native")]
    assert [f"{one}: {file}" for one in roots for file in sorted(one.reached - sources_of(one.file))] == []


def imports_of(source: Path) -> set[Path]:
    """The files of our packages that a source imports, by Python's own grammar."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: a relative import, which the cache does not look for"
            names |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    files = set()
    for name in names:
        parts = name.split(".")
        if parts[0] in (HAPSIM.name, PROTOCOL.name):
            packages = [HAPSIM.parent.joinpath(*parts[:i], "__init__.py") for i in range(1, len(parts) + 1)]
            files |= {*packages, HAPSIM.parent.joinpath(*parts).with_suffix(".py")}
    return {file for file in files if file.is_file()}


def test_the_cache_sees_every_import_of_a_source(every_compiled: list[Any]) -> None:
    """It looks for them in the text, without Python's grammar."""
    sources = {file for room in COMPILED_ROOMS for file in room.rglob("*.py")} | {one.file for one in every_compiled}
    assert len(sources) > 80
    for source in sources:
        assert code_cache._imports_of(source, (HAPSIM, PROTOCOL)) == imports_of(source), source


COMPILE = """
import json, sys
from numba.core import event
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import SETUP
from hapsim.compiling.native import NativeFunction
from hapsim.cordis.program import compile_scene
from hapsim.scene import Scene

at_hand, found = [], set()

class Listener(event.Listener):
    def on_start(self, event):
        at_hand.append(event.data["dispatcher"].py_func.__code__.co_filename)
        found.add((at_hand[0], at_hand[-1]))
    def on_end(self, event):
        at_hand.pop()

compile_native = NativeFunction._compile

def compile_noted(self, signature):
    at_hand.append(self.function.__code__.co_filename)
    found.add((at_hand[0], at_hand[-1]))
    try:
        return compile_native(self, signature)
    finally:
        at_hand.pop()

NativeFunction._compile = compile_noted
with event.install_listener("numba:compile", Listener()):
    program = compile_scene(Scene.model_validate(json.loads(sys.argv[1])))
    list(frames_in(new_decoder(SETUP, to_device=True), bytes(4)))
print(json.dumps(sorted(found)))
"""
VALUES = {"mass": 0.01, "stiffness": 100.0}
LINK = {"between": ["ball", "hand"]}
MODULES = {
    "hand": {"type": "device", "channel": 0},
    "wall": {"type": "ground"},
    "ball": {"type": "mass", "mass": 0.1},
    "cell": {"type": "cell", **VALUES},
    "string": {"type": "string", "masses": 5, **VALUES},
    "stiff_string": {"type": "string", "masses": 5, "bending": 9.0, **VALUES},
    "membrane": {"type": "membrane", "rows": 2, "columns": 3, **VALUES},
    "sensed": {"type": "viscoelastic", "stiffness": 9.0, "damper": "sensed", **LINK},
    "buffer": {"type": "buffer", "stiffness": 9.0, **LINK},
    "nonlinear": {"type": "nonlinear", "force_over_distance": [[-0.1, -1.0], [0.1, 1.0]], **LINK},
    "friction": {"type": "friction", "force": 1.0, "stiffness": 9.0, **LINK},
    "detent": {"type": "detent", "pitch": 0.01, "depth": 1.0, **LINK},
    "click": {"type": "click", "travel": 0.01, "peak": 1.0, "drop": 0.5, "bottom": 9.0, **LINK},
    "plectrum": {"type": "plectrum", "stiffness": 9.0, "release": 0.1, **LINK},
}


@pytest.mark.thorough
def test_all_that_numba_compiles_for_a_function_is_looked_at(tmp_path: Path) -> None:
    """Functions that numba chooses by type, such as the steps of a stencil, are included: they are found with an empty
    cache."""
    scene = {"version": 1, "rate": 1000, "device": {"mass": 0.2}, "modules": MODULES}
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_OPT": "0"}
    command = [sys.executable, "-P", "-c", COMPILE, json.dumps(scene)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    found = [(Path(root).resolve(), Path(file).resolve()) for root, file in json.loads(done.stdout)]
    ours = [(root, file) for root, file in found if is_in(file, (HAPSIM, PROTOCOL))]
    names = {(root.stem, file.stem) for root, file in ours}
    assert {
        ("string", "structure"),
        ("membrane", "structure"),
        ("nonlinear_links", "link"),
        ("decoder", "frames"),
    } <= names
    assert [(root, file) for root, file in ours if file not in sources_of(root)] == []


def test_no_code_is_kept_behind_a_link_in_a_directory_of_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shared, own = tmp_path / "tmp", tmp_path / "own"
    shared.mkdir()
    own.mkdir(0o700)
    (shared / "cache").symlink_to(own)
    monkeypatch.setenv(code_cache.CHOSEN, str(shared / "cache"))
    for mode, followed in ((0o755, True), (0o777, False), (0o1777, False)):
        shared.chmod(mode)
        assert (own in [root for root, _ in code_cache.private_roots()]) is followed
