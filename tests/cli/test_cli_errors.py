"""An error prints a sentence on standard error and sets the exit status; there is never a traceback."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.frames import armed_format
from hapsim import errors
from hapsim.device.connection import Connection, disarm
from hapsim.scene.shipped import shipped_scene
from hapsim.stopping import STOPS, stopping_on_signals

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]


@pytest.mark.parametrize("command", ["run", "check", "measure", "mock"])
@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "scene.yaml"),
        ("", "found nothing, expected a scene"),
        ("version: 1\nrate: -5\ndevice: {mass: 0.2}\nmodules: {hand: {type: device, channel: 0}}\n", ":2:"),
        ("version: [1\n", "scene.yaml:"),
        ("\x00\x01", "scene.yaml:"),
    ],
)
def test_a_bad_scene_is_status_2_in_every_command(
    hapsim: Hapsim, tmp_path: Path, command: str, text: str | None, told: str
) -> None:
    path = tmp_path / "scene.yaml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    assert told in hapsim(command, path).refusal


@pytest.mark.parametrize("words", [["fly"], ["run"], ["check", "a", "b"], ["run", "x", "--duration", "soon"], ["-x"]])
def test_a_bad_command_is_status_2(hapsim: Hapsim, words: list[str]) -> None:
    assert hapsim(*words).refusal


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["run", "--duration", "0"], "duration"),
        (["run", "--duration", "-1"], "duration"),
        (["run", "--duration", "nan"], "duration"),
        (["run", "--duration", "inf"], "duration"),
        (["run", "--duration", "1e300"], "duration"),
        (["run", "--duration", "x"], "--duration: found 'x', expected a number\n"),
        (["identify", "--force", "x"], "--push: found 'x', expected a number\n"),
        (["measure", "--channel", "1.5"], "--channel: found '1.5', expected a whole number\n"),
        (["sweep", "--jobs", "0"], "--jobs: found '0', expected a whole number >= 1\n"),
        (["measure", "--travel", "0,5"], "--travel: found '0,5', expected a number\n"),
        (["measure", "--duration", "0"], "duration"),
        (["measure", "--duration", "inf"], "duration"),
        (["measure", "--duration", "nan"], "duration"),
        (["measure", "--channel", "1"], "channel 1: the scene has nothing there"),
        (["measure", "--channel", "-1"], "channel -1"),
        (["run", "--transport", "carrier pigeon"], "expected loopback, paced or terminal"),
        (["run", "--record", "trace.txt"], "expected .npz, .csv, .trace"),
        (["run", "--record", "nowhere/trace.npz"], "there is no directory"),
        (["measure", "--picture", "p.bmp"], "expected .svg, .png, .pdf"),
        (["measure", "--picture", "nowhere/p.svg"], "there is no directory"),
        (["measure", "--data", "d.txt"], "expected .csv"),
        (["measure", "--record", "trace"], "expected .npz, .csv, .trace"),
    ],
)
def test_what_cannot_be_had_is_status_2_before_anything_runs(
    hapsim: Hapsim, scene_file: SceneFile, words: list[str], told: str
) -> None:
    command, *options = words
    refusal = hapsim(command, scene_file("spring"), *options).refusal
    assert told in refusal
    assert "running" not in refusal


def test_the_loopback_has_no_real_time(hapsim: Hapsim, scene_file: SceneFile) -> None:
    refusal = hapsim("run", scene_file("spring", clock="host"), "--transport", "loopback", "--duration", "0.1").refusal
    assert "the loopback takes clock: lockstep, found host: expected paced for real time" in refusal


def test_a_port_that_a_transport_of_the_mock_replaces_is_named(hapsim: Hapsim, tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(shipped_scene("two_devices").replace("  left:\n", "  left:\n    port: /dev/ttyNOPE7\n", 1))
    answer = hapsim("run", scene, "--transport", "paced", "--duration", "0.01")
    assert answer.status == 0
    assert "Warning: --transport paced is of the mock, which runs in place of /dev/ttyNOPE7." in answer.err
    assert "--transport" not in hapsim("run", scene, "--mock", "--duration", "0.01").err


@pytest.mark.parametrize("command", ["run", "measure"])
@pytest.mark.parametrize("port", ["/dev/ttyNOPE7", "/dev/null", "/tmp", ""])
def test_a_port_that_cannot_be_opened_is_status_3(
    hapsim: Hapsim, scene_file: SceneFile, command: str, port: str
) -> None:
    answer = hapsim(command, scene_file("spring"), "--port", port, "--json")
    assert answer.status == 3
    assert answer.sentence.startswith(port)
    assert len(answer.sentence.splitlines()) == 1


def test_a_device_that_stops_is_status_3_with_a_document(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "far.yaml"
    path.write_text(
        "{version: 1, rate: 1000, device: {mass: 0.2, clock: lockstep}, modules: {hand: {type: device, channel: 0}}, "
        "mock: {quantum: 1.0e-12, initial: {velocity: 1}}}",
        encoding="utf-8",
    )
    answer = hapsim("run", path, "--duration", 5, "--json")
    assert answer.status == 3
    assert "a position left the range of its counts" in answer.err
    assert answer.document["exit_status"] == 3


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (MemoryError(), "the system has no more memory"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "the system has no more memory"),
        (RuntimeError("can't start new thread"), "the system refused another thread or process. Raise the limit"),
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "pids.max"),
        (FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']"), "set TMPDIR"),
        (PermissionError(errno.EACCES, "Permission denied", "/srv/x"), "hapsim: /srv/x: Permission denied"),
        (OSError(errno.EROFS, "Read-only file system", "/srv/x"), "hapsim: /srv/x: Read-only file system"),
        (OSError(errno.EMFILE, "Too many open files"), "hapsim: Too many open files"),
    ],
    ids=lambda value: value.strerror or type(value).__name__ if isinstance(value, OSError) else None,
)
def test_what_the_system_refuses_is_no_defect(
    hapsim: Hapsim, scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    def fail(_scene: object, **_options: object) -> None:
        raise ValueError("because of this") from error

    monkeypatch.setattr("hapsim.cli.check.predict", fail)
    assert told in hapsim("check", scene_file("spring")).refusal


def test_a_library_that_finds_no_address_space_is_no_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = ImportError("libopenblas.so: failed to map segment from shared object")
    assert errors.refused_by_system(missing) == ""  # without a limit, the library itself is at fault
    monkeypatch.setattr(errors, "address_space_limit", lambda: 256_000_000)
    assert "the address space is limited to 256 MB (`ulimit -v`)" in errors.refused_by_system(missing)


def test_a_defect_while_a_refusal_is_handled_is_a_defect() -> None:
    refusal, defect = PermissionError(errno.EACCES, "Permission denied", "/srv/x"), ZeroDivisionError("of ours")
    defect.__context__ = refusal
    assert errors.refused_by_system(defect) == ""
    defect.__cause__ = refusal
    assert errors.refused_by_system(defect) == "/srv/x: Permission denied"


@pytest.mark.parametrize(("words", "nearest"), [(["chek"], "'check'"), (["chart", "plan"], "'plane'")])
def test_the_nearest_command_is_suggested(hapsim: Hapsim, words: list[str], nearest: str) -> None:
    pytest.importorskip("typer", "0.20")
    assert f"No such command '{words[-1]}'. Did you mean {nearest}" in hapsim(*words).refusal


def test_a_file_that_never_ends_is_no_scene(hapsim: Hapsim) -> None:
    assert "/dev/zero: found a file of more than 4 MB, expected a scene" in hapsim("check", "/dev/zero").sentence


def test_a_defect_of_ours_is_status_1_and_can_be_traced(
    hapsim: Hapsim, scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_scene: object, **_options: object) -> None:
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr("hapsim.cli.check.predict", fail)
    answer = hapsim("check", scene_file("spring"))
    assert answer.status == 1
    assert "a defect of hapsim itself: ZeroDivisionError: of ours" in answer.err
    assert "Traceback" not in answer.err
    monkeypatch.setenv("HAPSIM_TRACEBACK", "1")
    from hapsim import cli

    with pytest.raises(ZeroDivisionError):
        cli.main()


@pytest.mark.parametrize("number", STOPS)
@pytest.mark.parametrize("command", [["run"], ["measure"], ["identify"], ["mock"], ["faults", "noisy_wire", "--scene"]])
def test_a_signal_before_anything_is_armed_is_status_130_with_a_sentence(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch, command: list[str], number: int
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        os.kill(os.getpid(), number)

    before = [signal.getsignal(one) for one in STOPS]
    monkeypatch.setattr("hapsim.scene.load_scene", interrupt)
    answer = hapsim(*command, "configs/first_touch.yaml", "--json")
    assert answer.status == 130
    assert answer.sentence == "hapsim: stopped before anything was armed\n"
    assert answer.document["exit_status"] == 130
    assert [signal.getsignal(one) for one in STOPS] == before


TO_STOP: dict[str, tuple[str, str]] = {  # by command: what it calls late, and what it says it did, beside its words
    "check": ("hapsim.cli.check.predict", "while working out modes and gain margins"),
    "check --explain": ("hapsim.cordis.offline.explain", "while compiling"),
    "chart plane": ("hapsim.chart.plane.draw_plane", ""),
    "chart felt": ("hapsim.chart.felt_chart.felt_chart", ""),
    "chart force": ("hapsim.chart.force.draw_force", ""),
    "chart transparency": ("hapsim.chart.impedance_chart.transparency", ""),
    "chart table1": ("hapsim.chart.table1.table1", ""),
    "compile": ("hapsim.cli.prepare.load", ""),
    "sweep touch.stiffness=1,2 --out s.nc": ("hapsim.sweeping.sweep.sweep", ""),
}


@pytest.mark.thorough(keep=18)
@pytest.mark.parametrize("number", STOPS)
@pytest.mark.parametrize("command", TO_STOP)
@pytest.mark.parametrize("raises", ["itself", "another failure"])
def test_a_command_without_a_device_states_in_a_line_what_ended(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str, number: int, raises: str
) -> None:
    called, said = TO_STOP[command]

    def interrupt(*_: object, **__: object) -> None:
        try:
            os.kill(os.getpid(), number)
        except KeyboardInterrupt:
            if raises == "itself":
                raise
            raise RuntimeError("a library's") from None

    monkeypatch.setattr(called, interrupt)
    scene = Path("configs/first_touch.yaml").resolve()
    monkeypatch.chdir(tmp_path)
    first, *rest = command.split()
    words = [first, rest.pop(0), scene] if first == "chart" else [first, scene]
    answer = hapsim(*words, *rest)
    said = said or f"before hapsim {' '.join(map(str, words + rest)).partition(' --')[0]} was finished"
    assert (answer.status, answer.sentence) == (130, f"hapsim: stopped {said}\n")
    assert not any(tmp_path.iterdir())


def test_a_sweep_that_is_stopped_states_in_the_same_line_what_it_keeps(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        (tmp_path / "s.nc.parts").mkdir()
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("hapsim.sweeping.sweep.sweep", interrupt)
    answer = hapsim("sweep", "configs/first_touch.yaml", "touch.stiffness=1,2", "--out", tmp_path / "s.nc")
    resumed = f"run the same command again to go on with what {tmp_path}/s.nc.parts keeps"
    assert (answer.status, answer.sentence) == (130, f"hapsim: stopped before it was finished; {resumed}\n")


def test_a_record_whose_export_is_stopped_leaves_no_file(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch, scene_file: SceneFile, tmp_path: Path
) -> None:
    record, out = tmp_path / "r.trace", tmp_path / "r.csv"
    assert hapsim("run", scene_file("spring"), "--duration", "1", "--record", record).status == 0

    def interrupt(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("hapsim.replaying.export.export", interrupt)
    answer = hapsim("export", record, out)
    assert (answer.status, answer.sentence) == (130, f"hapsim: stopped while exporting {record}\n")
    assert not out.exists()
    monkeypatch.setattr("hapsim.replaying.replay.compare", interrupt)
    assert hapsim("replay", record).sentence == f"hapsim: stopped before hapsim replay {record} was finished\n"
    monkeypatch.setattr("hapsim.chart.trace_chart.draw_trace", interrupt)
    answer = hapsim("chart", "trace", record, "--picture", tmp_path / "p.svg")
    assert answer.sentence == f"hapsim: stopped before hapsim chart trace {record} was finished\n"


LOADING = """
import os, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "typer":
            os.kill(os.getpid(), int(sys.argv[-1]))
sys.meta_path.insert(0, Finder())
from hapsim.cli import main
main()
"""


@pytest.mark.parametrize("number", STOPS)
@pytest.mark.parametrize(("command", "said"), [("run", "anything was armed"), ("check", "hapsim check x was finished")])
def test_a_signal_while_the_command_is_loaded_is_reported_like_a_later_one(
    number: int, command: str, said: str
) -> None:
    words = [sys.executable, "-c", LOADING, command, "x", "--json", str(int(number))]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (130, f"hapsim: stopped before {said}\n")
    assert json.loads(ended.stdout) == {"error": ended.stderr.strip(), "exit_status": 130}


def test_a_run_that_is_stopped_while_its_device_is_opened_is_reported(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapsim.running.session.describe", lambda _: os.kill(os.getpid(), signal.SIGINT))
    answer = hapsim("run", "configs/first_touch.yaml", "--json")
    assert (answer.status, answer.sentence) == (130, "hapsim: stopped before anything was armed\n")
    assert json.loads(answer.out)["exit_status"] == 130


def test_a_wrong_command_line_is_named_in_the_document(hapsim: Hapsim) -> None:
    answer = hapsim("check", "configs/fader.yaml", "--nope", "--json")
    assert (answer.status, answer.document) == (2, {"error": "No such option: --nope", "exit_status": 2})


def test_a_signal_after_all_is_printed_changes_nothing() -> None:
    code = "import atexit, os; from hapsim.cli import main; atexit.register(os.kill, os.getpid(), 2); main()"
    ended = subprocess.run([sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr, ended.stdout[:7]) == (0, "", "hapsim ")


def test_a_library_that_makes_another_failure_of_an_interrupt_is_not_believed(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("a part failed to import") from None

    monkeypatch.setattr("hapsim.scene.load_scene", interrupt)
    answer = hapsim("run", "configs/first_touch.yaml", "--json")
    assert (answer.status, answer.sentence) == (130, "hapsim: stopped before anything was armed\n")


def test_what_is_stopped_after_a_run_does_not_report_that_nothing_was_armed(
    hapsim: Hapsim, scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("hapsim.measuring.measure.measure_trace", interrupt)
    answer = hapsim("measure", scene_file("spring"), "--json")
    assert (answer.status, "while no run was under way" in answer.sentence) == (130, True)


def test_after_a_second_signal_the_force_is_released_without_waiting_for_the_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sent: list[bytes] = []
    waited: list[float] = []
    monkeypatch.setattr(Connection, "send", lambda _, frame: sent.append(frame))
    monkeypatch.setattr(Connection, "wait_for", lambda *asked: (waited.append(asked[2]), []))
    transport: Any = None
    connection = Connection(transport, "nowhere", close=lambda: None)
    stops: list[int] = []
    with stopping_on_signals(lambda: stops.append(1)):
        signal.raise_signal(signal.SIGINT)
        disarm(connection, armed_format(1))
        assert min(waited) > 0.0
        waited.clear()
        sent.clear()
        signal.raise_signal(signal.SIGTERM)
        assert not disarm(connection, armed_format(1))
    assert (len(stops), set(waited)) == (2, {0.0})
    assert len(set(sent)) == 2


def test_what_the_parent_has_ignored_stays_ignored() -> None:
    """A SIGHUP that nohup ignores stays ignored."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stopping_on_signals(pytest.fail):
        signal.raise_signal(signal.SIGHUP)
