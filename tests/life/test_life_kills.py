"""After host or device is killed or stopped during a run, no force, no process and no lock on the port remain. The
record and the report can be read.

This machine's clock measures nothing here: the board reports its output, with times of its own clock.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import schema
from hapsim.device.connection import arm, describe, disarm, read_register
from hapsim.device.ports import open_serial_port
from hapsim.errors import DeviceError
from hapsim.recording.report_file import read_report
from hapsim.recording.trace import load_trace

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="ports of Linux, and its signals")

CONFIGS = Path(__file__).parents[2] / "configs"
SWINGING = Path(__file__).parents[2] / "tools" / "bench" / "swinging.yaml"
TIME_TO_LIVE = 20  # samples: what hapsim asks for at 1 kHz
PATIENCE_S = 60.0  # for a machine that hangs
Start = Callable[..., Any]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Each sample has a force of its own."""
    path = tmp_path / "swinging.yaml"
    path.write_text(SWINGING.read_text("utf-8"), "utf-8")
    return path


def require_over(host: Any) -> None:
    """It has ended, and nothing of it is left."""
    host.wait(PATIENCE_S)
    with pytest.raises(ProcessLookupError):
        os.killpg(host.pid, 0)


@pytest.fixture
def start_host(start_hapsim: Start, scene: Path, tmp_path: Path) -> Start:
    """Starts a host; returns it and its record once it has played with a board for a second of its samples. Where a
    machine that is busy with other tests held it up so long that the board latched, another one."""

    def start(board: Any) -> tuple[Any, Path]:
        for attempt in range(10):
            record, before = tmp_path / f"{attempt}.npz", len(board.forces())
            words = ("--record", record, "--reports", tmp_path / "reports")
            host = start_hapsim("run", scene, "--port", board.port, "--duration", 1e6, *words)
            board.wait_for(lambda forces: len(forces) > before + 1000 or host.poll() is not None)  # noqa: B023
            if host.poll() is None:
                break
        return host, record

    return start


def require_port_is_free(port: str) -> None:
    """It can be opened, and the device armed and disarmed again. An armed device answers no DESCRIBE until its watchdog
    has latched it."""
    with contextlib.closing(open_serial_port(port, 2_000_000)) as connection:
        for _ in range(60):
            with contextlib.suppress(DeviceError):
                description = describe(connection)
                break
        else:
            pytest.fail("the device does not answer any more")
        assert read_register(connection, schema.REG_FAULT) in (schema.NO_FAULT, schema.HOST_QUIET)
        wire = arm(connection, description, schema.PACED_BY_DEVICE, description.max_watchdog_samples)
        assert disarm(connection, wire)


def test_of_a_host_that_is_killed_the_record_is_read_up_to_the_last_second(
    start_board: Start, start_host: Start
) -> None:
    board = start_board("linux")
    host, record = start_host(board)
    first = len(board.forces())
    os.kill(host.pid, signal.SIGKILL)
    require_over(host)
    assert host.poll() == -signal.SIGKILL
    forces = board.wait_for(lambda forces: forces[-1][1] == 0)
    assert first > 1000
    last = max(i for i, (_, counts) in enumerate(forces) if counts)
    assert forces[last + 1][0] - forces[last][0] <= (TIME_TO_LIVE + 1.5) * 1000
    assert not record.exists()
    trace = load_trace(record.with_name(f"{record.name}.part"))
    assert trace.report.ending == f"not finished: the record stops after {trace.sample.size} ticks"
    # Of the record's last forces the board has put out some, and after them no more than a second of its samples.
    ends = {int(count) for count in trace.force_counts[-50:, 0]}
    put_out = [i for i, (_, count) in enumerate(forces) if count in ends]
    assert put_out
    assert last - put_out[-1] < 1000
    require_port_is_free(board.port)


def test_a_device_that_is_killed_ends_the_run_with_a_report_and_a_whole_record(
    start_hapsim: Start, scene: Path, tmp_path: Path
) -> None:
    """The device is killed in lockstep over its port, where a busy machine delays nothing."""
    scene.write_text(scene.read_text("utf-8").replace("clock: device", "clock: lockstep"), "utf-8")
    record, reports = tmp_path / "t.trace", tmp_path / "reports"
    mock = start_hapsim("mock", scene)
    while not (port := mock.out.strip()).startswith("/dev/"):
        assert mock.poll() is None, mock.err
        time.sleep(0.01)
    words = ("--record", record, "--reports", reports, "--json")
    host = start_hapsim("run", scene, "--port", port, "--duration", 1e6, *words)
    while not (record.exists() and load_whole(record) > 100):
        assert host.poll() is None, host.err
        time.sleep(0.05)
    mock.kill()
    require_over(host)
    assert host.poll() == 3
    assert "Traceback" not in host.err
    document = json.loads(host.out)
    assert document["ending"] in ("device gone", "port failed")
    assert document["released"] is False
    assert "did not confirm that it released its force" in document["error"]
    trace, (report,) = load_trace(record), reports.iterdir()
    assert str(report) in document["error"]
    assert (trace.report.ending, trace.report.ticks) == (document["ending"], document["ticks"])
    assert trace.sample.size == document["ticks"]
    assert load_trace(report).sample.tolist() == trace.sample[-1000:].tolist()
    assert read_report(report).wire.from_device


def load_whole(record: Path) -> int:
    """Returns the number of readable rows of a stream while it is written."""
    with contextlib.suppress(Exception):
        return int(load_trace(record).sample.size)
    return 0


def test_a_device_that_is_stopped_and_goes_on_puts_out_nothing_but_what_it_had(
    start_board: Start, start_host: Start, tmp_path: Path
) -> None:
    """A stopped device keeps its force while its tick stands still. The force then lives no longer than any other."""
    board = start_board("linux")
    for _ in range(5):
        host, record = start_host(board)
        os.kill(board.process.pid, signal.SIGSTOP)
        try:
            require_over(host)
            stopped = board.put_out()
        finally:
            os.kill(board.process.pid, signal.SIGCONT)
        if load_trace(record).report.ending == "device silent":
            break  # else a machine that is busy with other tests made the board latch just before
    assert host.poll() == 3
    err = host.err
    assert "the device was silent" in err
    assert "did not confirm that it released its force" in err
    assert "Traceback" not in err
    reports = [str(path) for path in (tmp_path / "reports").iterdir()]
    assert any(path in err for path in reports)
    board.wait_for(lambda forces: forces[-1][1] == 0)
    after = board.put_out()[len(stopped) :]
    assert sum(1 for _, counts in after if counts) <= TIME_TO_LIVE + 1
    require_port_is_free(board.port)


def test_a_run_whose_output_is_not_read_leaves_its_record(start_hapsim: Start, tmp_path: Path) -> None:
    text = (CONFIGS / "first_touch.yaml").read_text("utf-8").replace("clock: device ", "clock: lockstep ")
    (tmp_path / "scene.yaml").write_text(text, "utf-8")
    unread = "read, write = os.pipe()\nos.close(read)\nos.dup2(write, 1)\nos.close(write)\ncli.main()"
    host = start_hapsim("run", tmp_path / "scene.yaml", "--duration", 1, "--record", tmp_path / "t.npz", program=unread)
    assert host.wait() == 0, host.err
    assert [path.name for path in tmp_path.glob("t.*")] == ["t.npz"]
    assert load_trace(tmp_path / "t.npz").report.ticks == 1000
