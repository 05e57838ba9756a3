"""The reader of a run's output may go at any time: the run ends as usual, disarms the device and keeps its record."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import schema
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.recording.trace import load_trace
from hapsim.scene import load_scene

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

HAPSIM = [sys.executable, "-m", "hapsim"]


class Broken:
    """A stream whose reader went away."""

    encoding = "utf-8"

    def __init__(self, number: int) -> None:
        self._number = number
        self.tried = 0

    def write(self, _text: str) -> int:
        self.tried += 1
        raise OSError(self._number, os.strerror(self._number))

    def flush(self) -> None:
        raise OSError(self._number, os.strerror(self._number))

    def isatty(self) -> bool:
        return False

    def fileno(self) -> int:
        return os.open(os.devnull, os.O_WRONLY)


@pytest.mark.thorough(keep=6)
@pytest.mark.parametrize("number", [errno.EIO, errno.EPIPE])
@pytest.mark.parametrize("which", ["stdout", "stderr"])
@pytest.mark.parametrize(("name", "status"), [("spring", 0), ("no_number", 4)])
@pytest.mark.parametrize("words", [[], ["--json", "--log", "json"]])
def test_a_run_ends_as_usual_without_a_reader(
    hapsim: Hapsim,
    scene_file: SceneFile,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    which: str,
    name: str,
    status: int,
    words: list[str],
) -> None:
    record, broken = tmp_path / "trace.npz", Broken(number)
    monkeypatch.setattr(sys, which, broken)
    answer = hapsim("run", scene_file(name), "--duration", 0.05, "--record", record, *words)
    assert broken.tried
    assert answer.status == status
    assert load_trace(record).report.released
    assert "Traceback" not in answer.err + answer.out
    assert "defect" not in answer.err + answer.out


def test_a_run_without_standard_streams_keeps_their_numbers_free(scene_file: SceneFile, tmp_path: Path) -> None:
    """A port that is opened as number 2 would get every error message."""
    record = tmp_path / "trace.npz"
    program = (
        "import os, sys\n"
        "from hapsim import cli\n"
        "from hapsim.cli.streams import resilient_streams\n"
        "with resilient_streams():\n"
        "    assert os.open(os.devnull, os.O_RDONLY) > 2\n"
        "    print(1, file=sys.stderr)\n"
        "cli.main()\n"
    )
    words = ["run", str(scene_file("spring")), "--duration", "0.05", "--record", str(record)]
    command = ["sh", "-c", 'exec "$@" 0<&- 1>&- 2>&-', "sh", sys.executable, "-c", program, *words]
    assert subprocess.run(command, check=False).returncode == 0
    assert load_trace(record).report.ticks == 50


def own_terminal() -> None:
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def test_a_terminal_that_is_closed_ends_the_run_in_good_order(scene_file: SceneFile, tmp_path: Path) -> None:
    """A closed terminal sends SIGHUP, and every later write fails. The run still ends in order."""
    path, record = scene_file("spring"), tmp_path / "trace.npz"
    mock = assemble_mock(load_scene(path))
    near, far = os.openpty()
    with serving(mock) as port:
        process = subprocess.Popen(
            [*HAPSIM, "run", str(path), "--port", port, "--record", str(record)],
            stdin=far,
            stdout=far,
            stderr=far,
            start_new_session=True,
            preexec_fn=own_terminal,  # noqa: PLW1509 (one system call)
        )
        os.close(far)
        while mock.board.state != schema.ARMED and process.poll() is None:
            os.read(near, 1024)  # the live line
        os.close(near)
        assert process.wait() == 0
        assert mock.board.state == schema.IDLE
    assert load_trace(record).report.ending == "stopped"
