"""`hapsim probe` on ports: the mock's, and one that no device answers at. What it finds is tested in virtual time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tty
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.scene import Scene

Hapsim = Callable[..., Any]

TO_REFUSALS = ("--until", "refusals")


@pytest.fixture
def port() -> Iterator[str]:
    """The mock's: sixteen channels, so that its frames are long and soon find no room."""
    scene = Scene.model_validate(
        {
            "version": 1,
            "rate": 500.0,
            "device": {"clock": "device", "mass": 0.2},
            "modules": {"hand": {"type": "device", "channel": 15}},
        }
    )
    with serving(assemble_mock(scene)) as path:
        yield path


def test_the_mock_keeps_the_protocol_on_a_port(hapsim: Hapsim, port: str) -> None:
    answer = hapsim("probe", port, "--json")
    document = answer.document
    checks = {check["name"]: check for check in document["checks"]}
    # Its timer is this machine's: another program can slow it down.
    slowed = {"rate_kept", "tick_goes_on"}
    assert {name for name, check in checks.items() if check["result"] == "FAIL"} <= slowed, checks
    assert document["released"] is True
    assert (document["device"]["name"], document["ended_early"]) == ("hapsim mock", None)
    assert checks["whole_frames"]["result"] == "pass", checks["whole_frames"]
    assert checks["watchdog_blocked"]["section"] == "8"
    assert document["exit_status"] == answer.status == (3 if document["failed"] else 0)


def test_it_is_shown_within_80_columns(hapsim: Hapsim, port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    answer = hapsim("probe", port, *TO_REFUSALS)
    assert answer.status == 0, answer.out
    assert max(map(len, answer.out.splitlines())) <= 80
    assert "pass      damaged_frames (§ 2.3): 7 frames" in answer.out
    assert "300 bytes of noise directly in front of a frame;" in answer.out.replace("\n" + " " * 10, " ")
    assert "0 failed, 2 not seen." in answer.out
    assert "expected:" not in answer.out
    assert "refusals: step 3 of 3" in answer.err


def test_a_silent_port_is_reported_within_seconds(hapsim: Hapsim) -> None:
    near, far = os.openpty()
    try:
        tty.setraw(near)
        tty.setraw(far)
        answer = hapsim("probe", os.ttyname(far), "--json")
    finally:
        os.close(near)
        os.close(far)
    assert answer.status == 3
    first, *others = answer.document["checks"]
    assert (first["name"], first["result"], first["found"]) == ("answers", "FAIL", "not one byte")
    assert {check["result"] for check in others} == {"not seen"}
    assert answer.document["released"] is False


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--push", "0"), "--push: found 0, expected"),
        (("--push", "nan"), "--push: found nan, expected"),
        (("--push", "1", "--travel", "-1"), "--travel: found -1, expected"),
        (("--mass", "1"), "--mass needs --push"),
        (("--only", "arm"), "--only: found 'arm', expected one of conversation, registers"),
        (("--until", "end"), "--until: found 'end'"),
        (("--baud", "0"), "--baud: found 0"),
        (("--push", "1", "--channel", "-1"), "--channel: found -1"),
        (("--push", "1", "--channel", "16", "--only", "push"), "--channel: found 16, expected 0 to 15"),
    ],
)
def test_a_wrong_option_is_status_2(hapsim: Hapsim, port: str, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in hapsim("probe", port, *words, "--json").refusal


def test_no_port_is_status_3(hapsim: Hapsim) -> None:
    answer = hapsim("probe", "/dev/nothing_here", "--json")
    assert answer.status == 3
    assert "no such port" in answer.sentence


def test_an_interrupt_releases_the_device(port: str, hapsim: Hapsim) -> None:
    command = [sys.executable, "-m", "hapsim", "probe", port]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "arming" not in process.stderr.readline():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert process.returncode == 130
    assert "It ended early: stopped by a signal." in out
    assert "did not confirm that it is idle" not in out
    assert "Traceback" not in err
    assert hapsim("probe", port, *TO_REFUSALS).status == 0
