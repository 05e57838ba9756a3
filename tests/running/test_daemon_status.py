"""A daemon reports its status to its owner; no reader holds it up."""

from __future__ import annotations

import contextlib
import io
import json
import os
import socket
import stat
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hapsim.cli.output import document
from hapsim.cli.status_command import show_status
from hapsim.errors import UsageError
from hapsim.running import start, status
from hapsim.running.status import RunState, path_for, request_status, serve_status, sockets
from hapsim.scene import parse_scene

SCENE = """
version: 1
rate: 1000
device: {mass: 0.2, clock: lockstep, friction: 1.0}
mock: {initial: {velocity: 0.1}}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 2}
"""


@pytest.fixture
def tmp_path() -> Iterator[Path]:
    """A short one: the name of a socket has 107 bytes at most."""
    with tempfile.TemporaryDirectory() as short:
        yield Path(short)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Default directory of sockets."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "run"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "login"))
    return tmp_path / "run"


def test_a_running_scene_reports_its_status_to_its_owner_only(folder: Path) -> None:
    state = RunState("scene.yaml", "/dev/serial/by-id/usb-1", 1000.0)
    path = path_for("/dev/serial/by-id/usb-1")
    with serve_status(path, lambda: document(state.document())):
        assert json.loads(request_status(path))["phase"] == "starting"
        with start(parse_scene(SCENE, "scene.yaml"), duration=0.5) as session:
            state.observer.started(session)
            session.wait()
            told = json.loads(request_status(path))
        assert (path, stat.S_IMODE(path.stat().st_mode)) == (folder / "usb-1.sock", 0o600)
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        state.observer.over()
        over = json.loads(request_status(path))
        nothing_runs = [over[name] for name in ("armed_since", "force_n", "position_m", "age_samples")]
        assert (nothing_runs, told["released"], over["released"]) == ([None] * 4, None, True)
        state.observer.over()  # a try that did not arm: what became of it is not known
        assert json.loads(request_status(path))["released"] is None
    assert not path.exists()
    assert told.keys() >= {"rate_hz", "deadline_misses", "limited_ticks", "age_samples", "estimated_mass_kg", "news"}
    assert told["frozen"] == ""
    assert (told["pid"], told["scene"], told["phase"], told["ticks"]) == (os.getpid(), "scene.yaml", "running", 500)
    assert (len(told["force_n"]), told["position_m"]) == (1, list(session.trace.position[-1]))


def test_the_state_of_a_lost_device_is_reported_until_it_is_back() -> None:
    state = RunState("scene.yaml", "/dev/ttyACM0", 1000.0)
    assert state.document()["lost"] is None
    state.observer.report("lost", "it went away. If it still pushes, power it off")
    state.observer.report("waiting", "no such port")
    told = state.document()
    assert (told["news"], told["lost"]) == ("no such port", "it went away. If it still pushes, power it off")
    with start(parse_scene(SCENE, "scene.yaml"), duration=0.01) as session:
        state.observer.started(session)
    assert state.document()["lost"] is None


@pytest.mark.parametrize(("released", "told"), [(True, "confirmed"), (False, "not confirmed"), (None, "not known")])
def test_people_read_words_and_units(released: bool | None, told: str) -> None:
    state = RunState("scene.yaml", "/dev/ttyACM0", 1000.0)
    document = state.document() | {"phase": "waiting", "released": released, "force_n": [-0.0], "later": 1}
    console = Console(record=True, width=200)
    show_status(console, document)
    rows = dict(row.rsplit("  ", 1) for row in console.export_text().splitlines())
    rows = {label.strip(): value for label, value in rows.items()}
    assert (rows["force released"], rows["force  N"], rows["nominal rate  Hz"]) == (told, "0", "1000")
    assert rows["later"] == "1"
    assert not rows.keys() & {"estimated mass  kg", "news", "device lost", "position  m", "released", "force_n"}


def test_on_a_terminal_a_sentence_breaks_at_its_words_and_a_path_stays_whole() -> None:
    path = "/long" * 20
    console = Console(file=io.StringIO(), width=60, force_terminal=True, color_system=None)
    show_status(console, {"news": f"{'it went away and ' * 5}{path}"})
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert len(lines) == 3
    assert (lines[1].startswith("      "), lines[2].strip()) == (True, path)


def test_readers_that_do_not_read_hold_nothing_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "_TIMEOUT_S", 60.0)  # who waited for such a reader would wait for ever
    path = tmp_path / "s"
    with serve_status(path, lambda: json.dumps("x" * 900_000)):
        idle = [socket.socket(socket.AF_UNIX) for _ in range(5)]
        for one in idle:
            one.connect(str(path))
        assert request_status(path).startswith('"xxx')
        for one in idle:
            one.close()
        assert request_status(path).startswith('"xxx')


def test_one_failed_report_is_no_end(tmp_path: Path) -> None:
    values: list[Any] = [{"ticks": 1}]
    with serve_status(tmp_path / "s", lambda: json.dumps(values[0])):
        values[0] = object()
        assert json.loads(request_status(tmp_path / "s")) == {"error": "the status cannot be reported: TypeError"}
        values[0] = 7
        assert request_status(tmp_path / "s") == "7"


def _answering(path: Path, answer: Callable[[socket.socket], object]) -> socket.socket:
    """A socket whose thread calls `answer` with each new connection."""
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(path))
    listening.listen(8)

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listening.accept()
                with connection, contextlib.suppress(OSError):
                    answer(connection)

    threading.Thread(target=serve, daemon=True).start()
    return listening


def test_what_is_no_document_is_reported(tmp_path: Path, hapsim: Callable[..., Any]) -> None:
    with _answering(tmp_path / "s", lambda connection: connection.sendall(b"[" * 100_000)):
        told = hapsim("status", tmp_path / "s")
    assert told.status == 2
    assert "the answer is not from hapsim" in told.sentence


def test_what_another_user_put_where_sockets_are_is_passed_over(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with serve_status(path_for("/dev/ttyACM0"), lambda: "{}"):
        assert sockets() == [folder / "ttyACM0.sock"]
        someone = os.geteuid() + 1
        monkeypatch.setattr(os, "geteuid", lambda: someone)
        stat_of = Path.stat
        monkeypatch.setattr(Path, "stat", lambda path, **how: _owned(stat_of(path, **how), someone + 1))
        assert sockets() == []
        monkeypatch.setattr(Path, "stat", lambda path, **how: _owned(stat_of(path, **how), someone))
        assert sockets() == [folder / "ttyACM0.sock"]


def _owned(found: os.stat_result, user: int) -> os.stat_result:
    return os.stat_result([*found[:4], user, *found[5:]])


def test_a_socket_that_was_left_is_replaced_and_one_that_is_served_is_not(tmp_path: Path) -> None:
    path = tmp_path / "s"
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(path))
    left.close()
    with serve_status(path, lambda: "1"):
        second = serve_status(path, lambda: "2")
        with pytest.raises(UsageError, match="another hapsim reports its status there"), second:
            pass
        assert request_status(path) == "1"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match="a file that is no socket"), serve_status(path, lambda: "3"):
        pass
    assert path.read_text(encoding="utf-8") == "mine"
    for nowhere in (tmp_path / "no" / "s", tmp_path / ("s" * 120)):
        with pytest.raises(UsageError, match="no socket can be made there"), serve_status(nowhere, lambda: "4"):
            pass


def test_a_directory_that_others_may_enter_is_none_for_it(folder: Path) -> None:
    folder.mkdir(mode=0o755)
    with pytest.raises(UsageError, match=r"\(mode 0700\): found mode 0755"):
        path_for(None)
    folder.rmdir()
    folder.symlink_to("/tmp")
    with pytest.raises(UsageError, match="not a directory of this user's alone"):
        path_for(None)


def test_the_command_finds_it(
    folder: Path, hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapsim.loop.background.exit_with_unfinished", lambda _: None)  # both sides are this process
    assert "no running hapsim was found" in hapsim("status", "--json").sentence
    with serve_status(path_for("/dev/ttyACM0"), lambda: '{"ticks": 5, "force_n": [0.5, null]}'):
        left = socket.socket(socket.AF_UNIX)
        left.bind(str(folder / "left.sock"))
        left.close()
        assert hapsim("status", "--json").document == {"ticks": 5, "force_n": [0.5, None]}
        assert hapsim("status", "/dev/ttyACM0").out.splitlines() == ["ticks     5", "force  N  0.5 –"]
        news = "the report: " + "/long" * 40 + "/x.json"
        with serve_status(tmp_path / "news", lambda: json.dumps({"news": f"{news}\n\x1b[2Jlate"})):
            assert hapsim("status", tmp_path / "news").out == f"news  {news} ?[2Jlate\n"
        assert hapsim("status", "/dev/ttyACM1").status == 2
        with serve_status(tmp_path / "other", lambda: "\x1b[2J"):
            assert hapsim("status", tmp_path / "other").status == 2
        with serve_status(path_for(None), lambda: "{}"):
            assert "Name one of them" in hapsim("status").sentence
