"""Compiling ahead of a run, half of it in a second process, and `hapsim compile`. That a run from nothing
keeps all of it is seen of the wheel (tests/package)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest

from firmware_protocol import code_cache
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.cordis.modules.linear_links import SCALED
from hapsim.cordis.modules.proxy import PROXY
from hapsim.cordis.program import PART_TYPES, compile_scene
from hapsim.prediction.linear import linear_scene
from hapsim.running import compile_ahead as ahead
from hapsim.running import run
from hapsim.running.compile_ahead import UNITS, CompileUnit, Prepared, compile_ahead, prepare, scenes_with_every_module
from hapsim.scene import Scene, SchemeName, parse_scene
from hapsim.scene.modules import MODULE_TYPES
from hapsim.scene.shipped import shipped_scene

FIRST_TOUCH = "configs/first_touch.yaml"
NAMES = ("loop", "port", "mock")


def scene_with(clock: str) -> Scene:
    return parse_scene(shipped_scene("first_touch.yaml").replace("clock: device", f"clock: {clock}"), FIRST_TOUCH)


# The second process.


@pytest.fixture
def missing(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The units reported as not kept, so that they are compiled ahead; loading them is quick."""
    names: list[str] = [*UNITS]
    of_unit = {unit: name for name, unit in UNITS.items()}
    monkeypatch.setattr(CompileUnit, "is_kept", lambda unit: of_unit[unit] not in names)
    monkeypatch.setattr(ahead, "_loaded", set())
    return names


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[str]]:
    """The processes that were started."""
    processes: list[subprocess.Popen[str]] = []

    class NotedPopen(subprocess.Popen[str]):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", NotedPopen)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    return processes


@pytest.fixture
def python_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], None]:
    """Replaces the second process's Python by a shell script."""

    def write(script: str) -> None:
        path = tmp_path / "python"
        path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        path.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(path))

    return write


def require_over(processes: list[subprocess.Popen[str]]) -> None:
    """No process compiles any more, and no thread listens."""
    assert all(process.returncode is not None for process in processes)
    assert not [thread for thread in threading.enumerate() if thread.name == "second process"]


@pytest.mark.usefixtures("missing")
def test_the_second_process_s_functions_are_counted_with_the_rest(
    started: list[subprocess.Popen[str]], python_is: Callable[[str], None], tmp_path: Path
) -> None:
    python_is(f'echo "$@" > {tmp_path}/words; echo _take_bytes; echo serve')
    told: list[tuple[str, float | None]] = []
    compile_ahead(NAMES, Counted(lambda name, share: told.append((name, share))))
    expected = sum(UNITS[name].functions for name in NAMES)
    assert told == [("_take_bytes", 1 / expected), ("serve", 2 / expected)]
    assert (tmp_path / "words").read_text(encoding="utf-8") == "-P -m hapsim.running.compile_ahead mock\n"
    assert len(started) == 1
    require_over(started)


def test_the_second_process_takes_no_module_from_the_user_s_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file beside scenes may have the name of a module of ours, or of Python's."""
    for name in ("numba", "queue", "hapsim"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(7)\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    process = ahead._start_compiling([])
    assert process is not None
    with process:
        assert process.wait(300) == 0


@pytest.mark.usefixtures("missing")
@pytest.mark.parametrize("script", ["exit 1", "kill -9 $$", "echo nonsense; echo; exit 3", "exec 1>&-"])
def test_a_second_process_that_fails_changes_nothing(
    started: list[subprocess.Popen[str]], python_is: Callable[[str], None], script: str
) -> None:
    python_is(script)
    trace = run(scene_with("lockstep"), duration=0.05, transport="terminal")
    assert trace.sample.tolist() == list(range(50))
    assert len(started) >= 1
    require_over(started)


@pytest.mark.usefixtures("missing")
def test_a_missing_second_python_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python inside another program does not know a program of its own."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    for path in ("", "/nowhere/python"):
        monkeypatch.setattr(sys, "executable", path)
        assert run(scene_with("lockstep"), duration=0.05, transport="terminal").report.ticks == 50


def test_no_process_is_started_where_none_would_help(
    missing: list[str], started: list[subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    counted = Counted(lambda name, _: told.append(name))
    for names in (["mock"], ["loop", "port"], []):  # one process has nothing to do
        missing[:] = names
        compile_ahead(NAMES, counted)
    missing[:] = NAMES
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    compile_ahead(NAMES, counted)
    assert (started, told) == ([], [])


@pytest.mark.usefixtures("missing")
@pytest.mark.parametrize("moment", ["compiling", "waiting"])
def test_an_interrupt_of_the_first_process_ends_the_second(
    started: list[subprocess.Popen[str]], python_is: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """An interrupt ends the second process, whether the first is compiling or waiting for it."""
    python_is("echo begun; exec sleep 1000")
    waits = threading.Event()

    def interrupt(_unit: CompileUnit) -> None:
        raise KeyboardInterrupt

    def interrupt_wait(_name: str, _share: float | None) -> None:
        waits.wait(60.0)
        time.sleep(0.2)  # a signal just before the first process begins to wait would only be seen after the wait
        os.kill(os.getpid(), signal.SIGINT)

    if moment == "compiling":
        monkeypatch.setattr(CompileUnit, "compile", interrupt)
    counted = Counted(interrupt_wait if moment == "waiting" else lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        compile_ahead(NAMES, counted, then=waits.set)
    assert [process.returncode for process in started] == [-signal.SIGTERM]
    require_over(started)


# hapsim compile.


@pytest.fixture(scope="module")
def everything() -> None:
    """Compiles everything in this process alone, where the cache is loaded anyway."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "cpu_count", lambda: 1)
        prepare()


@pytest.mark.parametrize("precision", ["single", "double"])
def test_every_type_of_module_and_every_scheme_is_in_it(precision: str) -> None:
    *scenes, plane = scenes_with_every_module(precision)
    assert {scene.scheme for scene in scenes} == set(get_args(SchemeName))
    assert {scene.precision for scene in (*scenes, plane)} == {precision}
    of_plane = [kind for kind in PART_TYPES if kind.select(plane)]
    assert {kind.name for kind in of_plane if "plane" not in kind.name} == {"grounds", "masses", "shapes", "guides"}
    of_line = [kind for kind in PART_TYPES if kind not in of_plane or kind.name in ("grounds", "masses")]
    for scene in scenes:
        has_proxy = scene.scheme == "cordis"  # the only scheme that has it, and scales
        missing = [part_type.name for part_type in of_line if not part_type.select(scene)]
        assert missing == ([] if has_proxy else [SCALED.name, PROXY.name])
        of_space = {name for name, kind in MODULE_TYPES.items() if 1 in kind.spaces}
        assert {module.type for module in scene.modules.values()} == of_space - ({"proxy"} if not has_proxy else set())
        selected = {name for part_type in PART_TYPES for name in part_type.select(scene)}
        assert selected == (scene.modules.keys() | scene.sound.keys()) - scene.device_points.keys()
        assert linear_scene(scene).links.keys() == scene.links.keys()
    points = plane.grounds.keys() | plane.material_points.keys()
    assert {name for kind in of_plane for name in kind.select(plane)} == points | plane.plane_links.keys()
    # Links with knots are one type.
    of_plane_types = {name for name, kind in MODULE_TYPES.items() if 2 in kind.spaces} - {"nonlinear", "click"}
    assert {module.type for module in plane.modules.values()} == of_plane_types


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize("precision", ["single", "double"])
def test_afterwards_no_shipped_scene_compiles_anything(precision: str) -> None:
    names: list[str] = []
    for path in sorted(Path("configs").glob("*.yaml")):
        scene = parse_scene(path.read_text(encoding="utf-8"), str(path)).model_copy(update={"precision": precision})
        scene = scene.at_port(scene.ports[0]) if scene.ports else scene
        for scheme in get_args(SchemeName) if scene.space == 1 else ("cordis",):
            with on_compilation(names.append):
                compile_scene(scene.model_copy(update={"scheme": scheme}))
            assert names == [], (path, scheme)


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize("clock", ["lockstep", "host", "device"])
@pytest.mark.parametrize("transport", ["auto", "terminal"])
@pytest.mark.parametrize("portable", [False, True])
def test_afterwards_no_run_compiles_anything(clock: str, transport: Any, portable: bool) -> None:
    names: list[str] = []
    with on_compilation(names.append):
        run(scene_with(clock), duration=0.02, transport=transport, portable=portable)
    assert names == []


@pytest.mark.parametrize("law", ["host", "board"])
def test_what_a_scene_needs_is_compiled_and_no_more(law: str, missing: list[str]) -> None:
    compiled: list[str] = []
    of_unit = {unit: name for name, unit in UNITS.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CompileUnit, "compile", lambda unit: compiled.append(of_unit[unit]))
        patch.setattr(os, "cpu_count", lambda: 1)
        prepare([parse_scene(shipped_scene("first_touch.yaml").replace("device:", f"device:\n  law: {law}", 1), "")])
    of_lines = {"lines", "following"} if law == "board" else set()
    usual = {"loop", "port", "guards", "changes", "measuring", "mock", "motion", "loopback"}
    assert set(compiled) == usual | of_lines
    assert missing == [*UNITS]


def test_its_result(hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    for prepared in (Prepared(12, 3.5, Path("/var/kept")), Prepared(12, 3.5, None, "/var/kept: the disk is full")):
        monkeypatch.setattr("hapsim.running.compile_ahead.prepare", lambda *_, prepared=prepared: prepared)
        answer, problem = hapsim("compile", "--json"), prepared.problem
        assert answer.document["directory"] == (None if problem else "/var/kept")
        assert (answer.document["functions"], answer.document["seconds"]) == (12, 3.5)
        assert answer.status == (2 if problem else 0)
        assert (f"compiled code is not kept, and the next start compiles again: {problem}." in answer.err) == bool(
            problem
        )
    assert "kept in" not in hapsim("compile").out
    monkeypatch.setattr("hapsim.running.compile_ahead.prepare", lambda *_: Prepared(0, 3.5, Path("/var/kept")))
    assert hapsim("compile").out == "Nothing to compile: everything is kept in /var/kept\n"


@pytest.mark.parametrize("words", ["--cache {} compile", "compile --cache {}", "compile --cache={}"])
def test_the_directory_is_chosen_before_anything_is_loaded(
    hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    monkeypatch.setenv("HAPSIM_CACHE", "/another")
    monkeypatch.setattr("hapsim.running.compile_ahead.prepare", lambda *_: Prepared(12, 3.5, Path("/home/kept")))
    answer = hapsim(*words.format(tmp_path).split())
    assert os.environ["HAPSIM_CACHE"] == str(tmp_path)
    assert answer.status == 2
    assert f"{tmp_path}: compiled code cannot be kept there; it is kept in /home/kept" in answer.err
    for empty in ("--cache", "--cache="):
        assert "--cache: found nothing, expected a directory" in hapsim("compile", empty).sentence
    assert "found a file, expected a directory" in hapsim("compile", "--cache", __file__).sentence


@pytest.mark.parametrize("mode", [0o700, 0o777])
def test_a_run_warns_of_a_directory_that_it_cannot_use(
    hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int
) -> None:
    (scene := tmp_path / "scene.yaml").write_text(shipped_scene("zero_order_hold.yaml"), "utf-8")
    (named := tmp_path / "named").mkdir()
    named.chmod(mode)
    monkeypatch.setenv("HAPSIM_CACHE", "")
    code_cache.directory_for.cache_clear()
    answer = hapsim("run", "--cache", named, scene, "--duration", 0.02)
    code_cache.directory_for.cache_clear()
    assert answer.status == 0
    assert answer.err.count(f"Warning: {named}: compiled code cannot be kept there; it is kept in ") == (mode == 0o777)
    assert bool(list(named.iterdir())) == (mode == 0o700)


def test_a_wrong_scene_is_reported_before_anything_is_compiled(
    hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapsim.running.compile_ahead.prepare", lambda *_: pytest.fail("compiled"))
    assert "no_such.yaml" in hapsim("compile", FIRST_TOUCH, "no_such.yaml").sentence
