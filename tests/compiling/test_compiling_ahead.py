"""What is compiled ahead of a run, half of it in a second process: it helps where it can, and is needed nowhere."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.compiling.progress import Counted
from hapsim.progress import Progress
from hapsim.running import compile_ahead as ahead
from hapsim.running import run
from hapsim.running.compile_ahead import UNITS, CompileUnit, compile_ahead
from hapsim.scene import Scene, parse_scene
from hapsim.scene.shipped import shipped_scene

NAMES = ("loop", "port", "mock")

AFTERWARDS = """
from hapsim.running.compile_ahead import UNITS, main
print([name for name, unit in UNITS.items() if unit.is_kept()])
main(["mock"])
"""


def test_the_second_process_tells_what_it_compiles_and_leaves_it_where_the_first_finds_it(tmp_path: Path) -> None:
    def call(*words: str) -> str:
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, *words], env=environment, capture_output=True, text=True, check=False, timeout=300
        )
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    told = call("-m", "hapsim.running.compile_ahead", "mock").splitlines()
    assert {"firmware._take_bytes", "firmware._take_sample", "motion.move_gliding", "serve"} <= set(told)
    assert all(line.replace("_", "").replace(".", "").isalnum() for line in told)
    assert call("-c", AFTERWARDS) == "['mock']\n"  # and it compiles nothing any more


@pytest.fixture
def scene() -> Scene:
    return parse_scene(shipped_scene("first_touch.yaml").replace("clock: device", "clock: lockstep"), "first_touch")


@pytest.fixture
def missing(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The units of which nothing is said to be kept, so that they are compiled ahead; loading them is quick."""
    names: list[str] = [*UNITS]
    of_unit = {unit: name for name, unit in UNITS.items()}
    monkeypatch.setattr(CompileUnit, "is_kept", lambda unit: of_unit[unit] not in names)
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
    """In place of the second process's Python stands this shell script."""

    def write(script: str) -> None:
        path = tmp_path / "python"
        path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        path.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(path))

    return write


def require_over(processes: list[subprocess.Popen[str]]) -> None:
    """Nobody is left to compile, or to listen."""
    assert all(process.returncode is not None for process in processes)
    assert not [thread for thread in threading.enumerate() if thread.name == "compiling beside"]


@pytest.mark.usefixtures("missing")
def test_what_the_second_process_tells_is_counted_with_the_rest(
    started: list[subprocess.Popen[str]], python_is: Callable[[str], None], tmp_path: Path
) -> None:
    python_is(f'echo "$@" > {tmp_path}/words; echo _take_bytes; echo serve')
    told: list[tuple[str, float | None]] = []
    compile_ahead(NAMES, Counted(lambda name, share: told.append((name, share))))
    expected = sum(UNITS[name].functions for name in NAMES)  # type: ignore[index]
    assert told == [("_take_bytes", 1 / expected), ("serve", 2 / expected)]
    assert (tmp_path / "words").read_text(encoding="utf-8") == "-P -m hapsim.running.compile_ahead mock\n"
    assert len(started) == 1
    require_over(started)


def test_the_second_process_takes_no_module_from_where_the_user_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside scenes may stand whatever is called as a module of ours, or of Python's."""
    for name in ("numba", "queue", "hapsim"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(7)\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    process = ahead._start_compiling(["changes"])
    assert process is not None
    with process:
        assert process.wait(300) == 0


@pytest.mark.usefixtures("missing")
@pytest.mark.parametrize("script", ["exit 1", "exit 0", "kill -9 $$", "echo nonsense; echo; exit 3", "exec 1>&-"])
def test_where_the_second_process_fails_everything_works_all_the_same(
    scene: Scene, started: list[subprocess.Popen[str]], python_is: Callable[[str], None], script: str
) -> None:
    python_is(script)
    told: list[Progress] = []
    trace = run(scene, duration=0.05, transport="terminal", on_progress=told.append)
    assert trace.sample.tolist() == list(range(50))
    assert len(started) >= 1
    require_over(started)


@pytest.mark.usefixtures("missing")
def test_where_there_is_no_second_python_everything_works_all_the_same(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where Python stands inside another program, it does not know of a program of its own."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    for path in ("", "/nowhere/python", "/dev/null"):
        monkeypatch.setattr(sys, "executable", path)
        assert run(scene, duration=0.05, transport="terminal").report.ticks == 50


def test_no_process_is_started_where_none_would_help(
    missing: list[str], started: list[subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    counted = Counted(lambda name, _: told.append(name))
    for names in (["mock"], ["loop", "port"], []):  # what is missing is compiled here: there is nothing beside it
        missing[:] = names
        compile_ahead(NAMES, counted)
    missing[:] = NAMES
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    compile_ahead(NAMES, counted)
    assert (started, told) == ([], [])


@pytest.mark.usefixtures("missing")
def test_an_interrupt_of_the_first_process_ends_the_second(
    started: list[subprocess.Popen[str]], python_is: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    python_is("exec sleep 1000")

    def interrupt(_unit: CompileUnit) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(CompileUnit, "compile", interrupt)
    with pytest.raises(KeyboardInterrupt):
        compile_ahead(NAMES, Counted(lambda *_: None))
    assert [process.returncode for process in started] == [-signal.SIGTERM]
    require_over(started)


@pytest.mark.usefixtures("missing")
def test_an_interrupt_while_the_second_process_is_waited_for_ends_it(
    started: list[subprocess.Popen[str]], python_is: Callable[[str], None]
) -> None:
    python_is("echo begun; exec sleep 1000")
    waits = threading.Event()

    def interrupt(_name: str) -> None:
        waits.wait(60.0)
        os.kill(os.getpid(), signal.SIGINT)

    def wait_in_vain() -> None:
        with ahead._second_process(["mock"], interrupt) as finished:
            waits.set()
            finished()

    with pytest.raises(KeyboardInterrupt):
        wait_in_vain()
    assert [process.returncode for process in started] == [-signal.SIGTERM]
    require_over(started)
