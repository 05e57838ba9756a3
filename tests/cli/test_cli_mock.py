"""`hapsim mock` in a process of its own, and the commands beside running and measuring."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy
import pytest
from serial.tools.list_ports_common import ListPortInfo

from firmware_protocol.schema import SCHEMA_HASH, VERSION
from hapsim import __version__
from hapsim.device.mock import terminal as serving_command
from hapsim.scene.shipped import SCENES

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

HAPSIM = [sys.executable, "-m", "hapsim"]


@contextlib.contextmanager
def mock_of(*words: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The mock's process, and the first thing that it printed."""
    command = [*HAPSIM, "mock", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().strip()
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            process.communicate()


def test_a_mock_in_another_process_is_measured_as_predicted(hapsim: Hapsim, scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    hapsim("run", scene, "--transport", "terminal", "--duration", 0.05)  # whatever is not compiled yet is compiled here
    with mock_of(scene) as (process, port):
        answer = hapsim("measure", scene, "--port", port, "--json")
        assert answer.status == 0, answer.err
        document = answer.document
        following = hapsim("identify", scene, "--port", port, "--duration", 1, "--write").out.splitlines()[-1]
        assert following == f"Next: hapsim measure {scene} --port {port}"
        titles = [hapsim("measure", scene, *at, "--duration", 0.5).out for at in ((), ("--port", port))]
        assert ["What the hand feels at hand, channel 0, on the built-in mock\n" in one for one in titles] == [
            True,
            False,
        ]
        assert document["measured"]["k"] == pytest.approx(document["predicted"]["k"], rel=1e-5)
        assert document["measured"]["b"] == pytest.approx(document["predicted"]["b"], rel=1e-5)
        assert (document["lost_frames"], document["crc_errors"], document["deadline_misses"]) == (0, 0, 0)
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 0


@pytest.mark.thorough
def test_a_mock_takes_its_link_away_at_the_end(scene_file: SceneFile, tmp_path: Path) -> None:
    link = tmp_path / "device"
    with mock_of(scene_file("spring"), "--link", link, "--json") as (process, first):
        assert process.stdout is not None
        text = first + process.stdout.readline() + process.stdout.readline()
        assert json.loads(text) == {"port": str(link)}
        assert str(link.readlink()).startswith("/dev/")
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0
    assert not link.is_symlink()


def test_a_mock_behind_an_address_is_run_and_has_one_peer(hapsim: Hapsim, scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    with mock_of(scene, "--listen", "udp://127.0.0.1:0", "--peer", "localhost", "--json") as (process, first):
        assert process.stdout is not None
        address = json.loads(first + process.stdout.readline() + process.stdout.readline())["port"]
        answer = hapsim("run", scene, "--port", address, "--duration", 0.05, "--json")
        assert (answer.status, answer.document["ending"]) == (0, "done")
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 0


@pytest.mark.parametrize(
    "words", ["--listen tcp://127.0.0.1:0", "--peer localhost", "--listen tcp://h:0 --peer h --link here"]
)
def test_options_of_an_address_that_do_not_go_together_are_status_2(
    hapsim: Hapsim, scene_file: SceneFile, words: str
) -> None:
    refusal = hapsim("mock", scene_file("spring"), *words.split()).refusal
    assert "expected --listen ADDRESS and --peer HOST together, without --link" in refusal


def test_a_link_whose_name_is_taken_is_status_2_and_left_alone(
    hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine", encoding="utf-8")
    refusal = hapsim("mock", scene_file("spring"), "--link", taken).refusal
    assert f"{taken}: found a file, a directory or a device, expected a free name" in refusal
    assert taken.read_text(encoding="utf-8") == "mine"


def test_a_link_that_a_killed_mock_left_is_gone_before_the_next_has_a_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The system gives the number of a pseudo-terminal that is gone to the next: the link would seem to be in use.
    link = tmp_path / "device"
    link.symlink_to("/dev/pts/99999")

    @contextlib.contextmanager
    def serving(*_: object) -> Iterator[str]:
        assert not link.is_symlink()
        yield "/dev/pts/99999"

    def stop(name: str) -> None:
        assert (name, os.readlink(link)) == (str(link), "/dev/pts/99999")
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(serving_command, "serving", serving)
    serving_command.serve_until_stopped(lambda: None, link, stop, lambda _: None)
    assert not link.is_symlink()


def test_a_new_scene_can_be_checked_and_run_at_once(
    hapsim: Hapsim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert hapsim("new").status == 0
    assert hapsim("check", "scene.yaml").status == 0
    assert hapsim("run", "scene.yaml", "--duration", 0.05, "--json").document["ending"] == "done"


def test_a_board_has_a_first_scene_of_its_own(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    assert hapsim("new", "--board", "hapkit", path).status == 0
    assert path.read_text("utf-8") == (SCENES / "boards" / "hapkit.yaml").read_text("utf-8")
    sentence = hapsim("new", "--board", "hapkid", tmp_path / "other.yaml").sentence
    assert "--board: found 'hapkid', expected one of " in sentence
    assert "firefader" in sentence
    assert "expected one of them" in hapsim("new", "--board", "hapkit", "--from", "wall", path).sentence


def test_a_new_scene_overwrites_nothing(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "mine[1].yaml"
    answer = hapsim("new", path)
    assert answer.status == 0
    commands = [f"  hapsim {command} {shlex.quote(str(path))}" for command in ("check", "measure")]
    assert answer.out.splitlines() == [f"Wrote {path}. Next:", *commands]
    path.write_text("mine", encoding="utf-8")
    assert "the file exists and is not replaced" in hapsim("new", path).refusal
    assert path.read_text(encoding="utf-8") == "mine"
    assert "there is no directory" in hapsim("new", tmp_path / "none" / "scene.yaml").sentence


def test_the_ports_are_listed_under_headings(hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch) -> None:
    """Missing properties of a port stay blank."""
    board, bare = ListPortInfo("/dev/ttyACM0"), ListPortInfo("/dev/ttyS0")
    board.description, board.hwid = "Haptic [board]", "USB VID:PID=2341:0043"
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [board, bare])
    answer = hapsim("ports")
    assert answer.status == 0
    lines = [re.split(r" *[┃│] *", line)[1:-1] for line in answer.out.splitlines() if line.startswith(("┃", "│"))]
    assert lines == [["port", "description", "hardware"], list(board), [bare.device, "", ""]]
    for listed, port in zip(hapsim("ports", "--json").document["ports"], (board, bare), strict=True):
        assert listed == {"port": port.device, "description": port.description, "hardware": port.hwid}
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    answer = hapsim("ports")
    assert (answer.status, answer.out) == (0, "")
    assert "No serial port was found" in answer.err
    assert hapsim("ports", "--json").document == {"ports": []}


QUICK = """
import sys
from hapsim.cli import main
try:
    main()
except SystemExit as end:
    assert not end.code
heavy = {'numba', 'numpy', 'matplotlib', 'scipy', 'serial', 'pydantic', 'yaml'} & sys.modules.keys()
assert not heavy, heavy
"""


def quick(option: str) -> str:
    """Returns the output of an option that loads nothing heavy."""
    done = subprocess.run([sys.executable, "-c", QUICK, option], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_help_names_every_command_and_loads_nothing_heavy() -> None:
    told = quick("--help")
    for command in ("run", "check", "measure", "mock", "ports", "new", "schema"):
        assert f" {command} " in told


def test_the_version_prints_what_a_bug_report_needs() -> None:
    """One item a line, and numba is not loaded to be asked."""
    assert quick("--version").splitlines() == [
        f"hapsim {__version__}",
        f"wire protocol {VERSION}, schema 0x{SCHEMA_HASH:08x}",
        f"Python {platform.python_version()} ({platform.python_implementation()})",
        f"numba {numba.__version__}",
        f"numpy {numpy.__version__}",
        f"platform {platform.platform()}",
    ]


def test_an_output_that_knows_ascii_only_is_written_all_the_same(scene_file: SceneFile) -> None:
    command = [sys.executable, "-c", "from hapsim.cli import main; main()", "check", str(scene_file("free"))]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "moves freely" in done.stdout
