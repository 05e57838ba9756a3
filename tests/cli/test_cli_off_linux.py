"""hapsim where there is no Linux: what needs no real time works, the rest says so (see another_system.py)."""

from __future__ import annotations

import ast
import io
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from hapsim.cli.streams import resilient_streams
from hapsim.device.open_connection import open_connection
from hapsim.device.ports import open_portable_port
from hapsim.errors import UsageError
from hapsim.loop.endings import TIMED_OUT
from hapsim.loop.portable import PortableTransport
from hapsim.recording.trace import load_trace
from hapsim.scene import load_scene

sys.path.insert(0, str(Path(__file__).parent))
from another_system import FUNCTIONS, MODULES

ANOTHER_SYSTEM = Path(__file__).with_name("another_system.py")
Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]
Elsewhere = Callable[..., list[tuple[int, str, str]]]
Done = Callable[..., list[str]]

IMPORT_EVERYTHING = """
import importlib, pkgutil, sys
sys.path.insert(0, sys.argv[1])
import another_system
another_system.become_another_system()
for name in ("hapsim", "firmware_protocol"):
    package = importlib.import_module(name)
    for found in pkgutil.walk_packages(package.__path__, name + "."):
        if not found.name.endswith("__main__"):
            importlib.import_module(found.name)
print(len([name for name in sys.modules if name.startswith(("hapsim.", "firmware_protocol."))]))
"""

BREAK_A_RUN = """
import os, signal
import hapsim
stop = lambda _: os.kill(os.getpid(), signal.SIGBREAK)  # as Windows calls it; here SIGUSR1
print(hapsim.run(SCENE, stop_on_signals=True, on_start=stop).report.ending)
"""


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[Elsewhere]:
    """Returns (status, output, errors) of each `hapsim …`, all in one process on another system."""
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, ANOTHER_SYSTEM], text=True, **pipes) as process:

        def answer(words: Sequence[object]) -> tuple[int, str, str]:
            print(json.dumps(list(map(str, words))), file=process.stdin, flush=True)
            status, output, errors = json.loads(process.stdout.readline())
            return status, output, errors

        yield lambda *commands: [*map(answer, commands)]
        process.communicate()


@pytest.fixture
def done(elsewhere: Elsewhere) -> Callable[..., list[str]]:
    """Returns the outputs of commands on another system, all of which must succeed."""

    def outputs(*commands: Sequence[object]) -> list[str]:
        answers = elsewhere(*commands)
        for words, (status, _, errors) in zip(commands, answers, strict=True):
            assert status == 0, (words, errors[-2000:])
            assert "armed" not in errors
        return [output for _, output, _ in answers]

    return outputs


@pytest.mark.thorough
def test_everything_can_be_imported() -> None:
    words = [sys.executable, "-c", IMPORT_EVERYTHING, str(ANOTHER_SYSTEM.parent)]
    answer = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300)
    assert answer.returncode == 0, answer.stderr[-2000:]
    assert int(answer.stdout) > 200


def test_what_needs_no_real_time_works(hapsim: Hapsim, done: Done, scene_file: SceneFile, tmp_path: Path) -> None:
    """The portable loop sends the forces of the compiled one in memory. It runs to its end on a port and on the mock in
    real time, without being asked for."""
    scene, first = scene_file("spring"), tmp_path / "first.yaml"
    briefly = ("--duration", 0.2, "--unstable", "--json")
    runs = {}
    for clock, rate in (("lockstep", 1000.0), ("device", 100.0), ("host", 100.0)):  # at 100 Hz the spring is too stiff
        runs[clock, rate] = scene_file("spring", clock=clock, rate=rate).rename(tmp_path / f"{clock}.yaml")
    told = done(
        ("--help",),
        ("--version",),
        ("check", scene_file("spring"), "--json"),
        ("new", first),
        ("schema",),
        ("ports", "--json"),
        ("compile", runs["device", 100.0]),
        ("measure", scene, "--duration", 0.5, "--json", "--record", tmp_path / "there.npz"),
        *(("run", path, "--port", "COM3", *briefly) for path in runs.values()),
        *(("run", path, *briefly) for path in runs.values()),
        ("run", runs["lockstep", 1000.0], "--portable", *briefly),
    )
    for part, said in zip(("Commands", "numba", '"stable": true', "Wrote"), told[:4], strict=True):
        assert part in said
    assert yaml.safe_load(first.read_text(encoding="utf-8"))["version"] == 1
    assert json.loads(told[4])["type"] == "object"
    assert json.loads(told[5])["ports"][0]["port"] == "COM3"
    assert "kept in" in told[6]
    measured = json.loads(told[7])
    assert measured["measured"]["k"] == pytest.approx(measured["predicted"]["k"], rel=1e-5)
    for (clock, rate), said in zip([*runs, *runs, next(iter(runs))], told[8:], strict=True):
        report = json.loads(said)
        assert report["ending"] == "done"
        assert report["ticks"] == round(0.2 * rate) or (report["duration_s"] > 0.2 and clock != "lockstep")
    assert hapsim("measure", scene, "--duration", 0.5, "--record", tmp_path / "here.npz").status == 0
    here, there = load_trace(tmp_path / "here.npz"), load_trace(tmp_path / "there.npz")
    for name in ("sample", "flags", "position_counts", "force_counts", "asked_force"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))


START = """
import hapsim
with hapsim.start(SCENE, duration=0.2) as session:
    session.set({"touch": {"stiffness": 500.0}})
    session.wait()
print(session.trace.report.ending, session.parameters["touch.stiffness"].value)
"""


def test_whatever_opens_a_port_works_on_it(hapsim: Hapsim, done: Done, scene_file: SceneFile, tmp_path: Path) -> None:
    """Measured values are equal to Linux's, a sweep's as well, which come without a session."""
    scene, on_port = scene_file("spring"), ("--port", "COM3", "--json")
    sweep = ("sweep", scene, "touch.stiffness=500,1000", "--duration", 0.5, "--json", "--out")
    kept = tmp_path / "kept.trace"
    told = done(
        ("measure", scene, "--duration", 0.5, *on_port),
        ("probe", "COM3", "--only", "arming", "--json"),
        ("frames", os.devnull, "--duration", 0.05, "--json"),
        (*sweep, tmp_path / "there.nc"),
        ("-c", START.replace("SCENE", repr(str(scene)))),
        ("run", scene, "--duration", 0.1, "--record", kept),
        ("replay", kept),
    )
    measured, probed, listened = map(json.loads, told[:3])
    assert measured["measured"] == hapsim("measure", scene, "--duration", 0.5, "--json").document["measured"]
    assert (probed["failed"], listened["counters"]["bytes"]) == (0, 0)
    here = hapsim(*sweep, tmp_path / "here.nc").document
    assert json.loads(told[3])["variables"] == here["variables"]
    assert told[4] == "done 500.0\n"
    assert "all forces are identical" in told[6]


def test_the_doctor_measures_the_loop_in_python(done: Done, scene_file: SceneFile) -> None:
    device = scene_file("spring", clock="device", rate=100.0)
    told = done(
        ("doctor", device, "--port", "COM3", "--seconds", 0.1, "--rates", 100),
        ("doctor", "--seconds", 0.1, "--rates", "100,200", "--json"),
    )
    assert "exchanges of" in told[0].lower()
    assert "Real-time scheduling, the governor" in " ".join(told[0].split())
    found = json.loads(told[1])
    assert found["shortest_sleep_s"] > 0.0
    assert [one["lateness"]["count"] > 0 for one in found["wakeups"]] == [True] * 3  # and the scene's own rate
    assert {(one["where"], one["clock"]) for one in found["exchanges"]} == {("mock", "device"), ("mock", "host")}
    assert all(one["ticks"] > 0 for one in found["exchanges"])
    (advice,) = found["advice"]
    assert advice["found"].startswith("This system is not Linux (")
    assert (found["load"], found["machine"]["governors"]) == (None, [])


def test_what_takes_linux_states_it_in_a_sentence(elsewhere: Elsewhere, scene_file: SceneFile, tmp_path: Path) -> None:
    device = scene_file("spring", clock="device").rename(tmp_path / "device.yaml")
    lockstep = scene_file("spring")
    refused = {
        ("mock", lockstep): "the mock on a pseudo-terminal",
        ("run", lockstep, "--realtime"): "--realtime",
        ("doctor", device, "--realtime"): "--realtime",
        ("faults", "noisy_wire", "--port", "COM3"): "faults on a pseudo-terminal",
        ("service", device, "--port", "COM3"): "a service of systemd",
        ("run", device, "--transport", "terminal", "--realtime"): "--realtime",
    }
    for told, (status, output, errors) in zip(refused.values(), elsewhere(*refused), strict=True):
        assert (status, output) == (2, "")
        *before, sentence = errors.splitlines()
        assert sentence.startswith(f"{told} takes Linux; this system (freebsd14) has no clock_gettime, ")
        assert not [line for line in before if not line.startswith("Warning: ")]


def test_a_status_takes_unix_sockets(elsewhere: Elsewhere, scene_file: SceneFile) -> None:
    run = ("run", scene_file("spring"), "--duration", 0.05, "--status")
    for status, _, errors in elsewhere((*run, "auto"), (*run, "here.sock"), ("status",), ("status", "COM3")):
        assert status == 2
        assert errors.endswith("--status and `hapsim status` take unix sockets, which this system does not have\n")


POSIX_ONLY = {*MODULES, "readline"}
"""Modules that Python has on POSIX alone."""


@pytest.mark.parametrize("package", ["hapsim", "firmware_protocol"])
def test_no_file_needs_posix_when_it_is_imported(package: str) -> None:
    """Not those either that an import of everything leaves out, such as the firmware's tools."""
    names = {one for names in FUNCTIONS.values() for one in names}
    suspect, needed = re.compile(rf"\b({'|'.join(names | POSIX_ONLY)})\b"), list[str]()
    texts = {file: file.read_text("utf-8") for file in Path(find_spec(package).origin).parent.rglob("*.py")}  # type: ignore
    for file, text in texts.items():
        for node in _run_at_import(ast.parse(text).body) if suspect.search(text) else ():
            imported = [node.module] if isinstance(node, ast.ImportFrom) else []
            imported = [alias.name for alias in node.names] if isinstance(node, ast.Import) else imported
            needed += [f"{file}: {one}" for one in imported if str(one).partition(".")[0] in POSIX_ONLY]
            if isinstance(node, ast.Attribute) and node.attr in names and isinstance(node.value, ast.Name):
                needed += [f"{file}: {node.value.id}.{node.attr}"] * (node.value.id in ("os", "time", "signal"))
    assert needed == []


def _run_at_import(statements: Sequence[ast.stmt]) -> Iterator[ast.AST]:
    """Yields every node that an import evaluates: not the bodies of functions."""
    ahead: list[ast.AST] = list(statements)
    while ahead:
        node = ahead.pop()
        yield node
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            ahead += [*node.args.defaults, *filter(None, node.args.kw_defaults), *getattr(node, "decorator_list", ())]
        else:
            ahead += ast.iter_child_nodes(node)


def test_ctrl_break_ends_a_run_as_ctrl_c_does(done: Done, scene_file: SceneFile) -> None:
    assert done(("-c", BREAK_A_RUN.replace("SCENE", repr(str(scene_file("spring")))))) == ["stopped\n"]


def test_windows_pipes_and_files_have_utf_8(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(written, "cp1252", write_through=True))
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.delenv("PYTHONIOENCODING", raising=False)
    with resilient_streams():
        print("N·s/m ┃ ←", end="")
    assert written.getvalue().decode("utf-8") == "N·s/m ┃ ←"


def test_windows_commands_are_quoted_for_its_shell(
    hapsim: Hapsim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapsim.scene.issue.sys", SimpleNamespace(platform="win32"))
    path = tmp_path / "my scene.yaml"
    assert f'  hapsim check "{path}"\n' in hapsim("new", path).out
    assert f'Next: hapsim measure "{path}"\n' in hapsim("check", path).out


def test_a_clock_with_long_steps_is_refused(scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "get_clock_info", lambda _: SimpleNamespace(resolution=0.015625))
    monkeypatch.setattr("hapsim.device.open_connection.missing_calls", lambda: ["clock_nanosleep"])
    scene = load_scene(scene_file("spring"))
    for opened in (lambda: open_portable_port("COM3", 115_200), lambda: open_connection(scene, "paced").__enter__()):
        with pytest.raises(
            UsageError, match=r"steps of 15\.62 ms, expected 0\.1 ms at most: on Windows, use Python 3\.13"
        ):
            opened()


@pytest.mark.thorough
def test_a_port_of_windows_is_not_set_up_again_for_each_position(monkeypatch: pytest.MonkeyPatch) -> None:
    """There pyserial sets the baud rate again with each new timeout, which a device may take for a new connection."""
    timeouts: list[float] = []

    class Port:
        timeout = property(lambda _: timeouts[-1] if timeouts else 0.0, lambda _, seconds: timeouts.append(seconds))
        in_waiting = 3

        def read(self, size: int) -> bytes:
            return bytes(size)

    monkeypatch.setattr("hapsim.loop.portable.sys", SimpleNamespace(platform="win32"))
    transport, buffer = PortableTransport(Port()), np.zeros(16, np.uint8)
    for timeout_ns in (100_000_000, 99_990_000, 600_000, 0, 1_000_000):
        assert transport.receive(buffer, timeout_ns) == 6
    assert timeouts == [0.001]
    monkeypatch.setattr(Port, "in_waiting", 0)
    monkeypatch.setattr(Port, "read", lambda *_: pytest.fail("a read would wait for a millisecond"))
    assert transport.receive(buffer, 0) == transport.receive(buffer, 100_000) == TIMED_OUT
