"""`hapsim faults`: what it prints, and how it ends."""

from __future__ import annotations

import os
import sys
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

sys.path.insert(0, str(Path(__file__).parent))
from wire_session import injector_of, positions_through

from hapsim.bringup.faults import KINDS
from hapsim.cli.faults import faults_document, show_faults
from hapsim.errors import DeviceError
from hapsim.loop.histogram import Spread

SCENE = """\
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0, clock: lockstep}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 5}
"""
Hapsim = Callable[..., Any]

linux = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def test_every_kind_is_listed_with_its_sentence_within_80_columns(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    answer = hapsim("faults", "--list")
    assert answer.status == 0
    assert max(map(len, answer.out.splitlines())) <= 80
    document = hapsim("faults", "--list", "--json").document
    assert document == {
        "kinds": {kind: fault.__doc__ for kind, fault in KINDS.items()},
        "scripts": ["bad_device", "loose_plug", "noisy_wire"],
    }
    assert all(kind in answer.out for kind in KINDS)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "found no SCRIPT, expected one, or --list"),
        (["noisy_wire"], "found neither --port nor --scene, expected one of them"),
        (["nosuch"], "Shipped scripts: bad_device, loose_plug, noisy_wire"),
        (["noisy_wire", "bad_device", "--port", "/dev/x"], "expected one script at a time"),
        (["noisy_wire", "--port", "/dev/x", "--scene", "y"], "found both --port and --scene, expected one of them"),
        (["loose_plug", "--port", "/dev/x"], "--path: found none, expected a name for the port: replug puts it back"),
        (["refresh", "--port", "/dev/x"], "refresh:2:10: faults[0]: found neither every nor every_samples"),
        (["freeze"], "found neither --port nor --scene, expected one of them"),
        (["nowhere.yaml", "--port", "/dev/x"], "nowhere.yaml: no such file, expected a script of faults in YAML"),
        (["noisy_wire", "--port", "/dev/x", "--duration", "-1"], "--duration: found -1"),
        (["noisy_wire", "--scene", "nowhere.yaml"], "nowhere.yaml: no such file, expected a scene in YAML"),
    ],
)
def test_a_wrong_call_is_status_2(hapsim: Hapsim, words: list[str], sentence: str) -> None:
    answer = hapsim("faults", *words, "--json")
    assert answer.status == 2
    assert sentence in answer.sentence


def test_a_port_that_is_not_there_is_status_3(hapsim: Hapsim) -> None:
    answer = hapsim("faults", "noisy_wire", "--port", "/dev/nowhere", "--json")
    assert (answer.status, "no such port" in answer.sentence) == (3, True)


@linux
def test_it_prints_where_it_is_and_at_its_end_what_it_did(hapsim: Hapsim, scene: Path, tmp_path: Path) -> None:
    name = tmp_path / "port"
    answer = hapsim("faults", "noisy_wire", "--scene", scene, "--path", name, "--duration", 0.05, "--json")
    assert answer.status == 0
    assert str(name) in answer.err.splitlines()
    document = answer.document
    assert document["port"] == str(name)
    nothing = {"frames_in": 0, "frames_out": 0, "bytes_in": 0, "bytes_out": 0}
    assert document["to_device"] == document["from_device"] == nothing
    assert [entry["kind"] for entry in document["faults"]] == ["corrupt", "drop", "delay", "garbage"]
    assert (document["release"], document["forces"]["count"]) == (None, 0)
    assert document["passed_on"] == {"frames": 0, "p50_s": None, "p99_s": None}
    shown = hapsim("faults", "noisy_wire", "--scene", scene, "--path", name, "--duration", 0.05)
    assert "passing on: 0 frames, 0 faults" in shown.err
    assert shown.out.splitlines()[0] == str(name)
    assert "No force reached the device." in shown.out


def test_two_faults_of_a_kind_are_listed_apart_and_what_is_counted_is_named() -> None:
    injector = injector_of(
        "kind: silence, at: 0.002, for: 0.002", "kind: silence, after_samples: 7, for: 1", "kind: drop, probability: 0"
    )
    positions_through(injector, 10)
    times = Spread(1, 2e-4, 2e-4, 2e-4, 2e-4)
    console = Console(record=True, width=80)
    show_faults(console, injector, 0, times)
    told = console.export_text()
    assert "What was done to it\n" in told
    latency = "Latency of a frame, without the delays of faults: 0.2 ms in the median, at most 0.2 ms for 99 %."
    assert latency in " ".join(told.split())
    cells = [
        [cell.strip() for cell in line.strip("│ \n").split("│")] for line in told.splitlines() if "silence" in line
    ]
    assert cells == [
        ["1", "silence", "at 0.002 s", "2 frames lost"],
        ["2", "silence", "after 7 samples", "3 frames lost"],
    ]
    faults = faults_document("", injector, 0, times, None)["faults"]
    assert [(fault.place, fault.when, fault.times) for fault in faults] == [
        (1, "at 0.002 s", 2),
        (2, "after 7 samples", 3),
        (3, "from the first byte", 0),
    ]


@linux
def test_a_device_that_goes_away_is_status_3_and_reported_with_what_passed(hapsim: Hapsim, tmp_path: Path) -> None:
    near, far = os.openpty()
    tty.setraw(far)
    path = tmp_path / "device"
    path.symlink_to(os.ttyname(far))
    script = tmp_path / "s.yaml"
    script.write_text("version: 1\nfaults: [{kind: drop, probability: 0}]\n", encoding="utf-8")

    def leave() -> None:
        while not (tmp_path / "port").exists():
            time.sleep(0.01)
        os.close(far)
        os.close(near)

    thread = threading.Thread(target=leave)
    thread.start()
    answer = hapsim("faults", script, "--port", path, "--path", tmp_path / "port", "--json")
    thread.join()
    assert answer.status == 3
    assert "the device went away" in answer.document["error"]
    assert answer.document["exit_status"] == 3


@linux
def test_a_link_that_was_left_over_is_gone_before_the_mock_has_a_port(
    hapsim: Hapsim, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The system gives the number of a pseudo-terminal that is gone to the next: the link would seem to be in use.
    name = tmp_path / "port"
    name.symlink_to("/dev/pts/99999")

    def start(_mock: object) -> None:
        raise DeviceError("still there" if name.is_symlink() else "free")

    monkeypatch.setattr("hapsim.cli.faults.serving", start)
    answer = hapsim("faults", "noisy_wire", "--scene", scene, "--path", name, "--json")
    assert answer.document["error"] == "free"
