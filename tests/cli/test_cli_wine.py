"""hapsim on a Windows Python under Wine, where `tools/wine` made one: one process answers to all commands."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import select
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.recording.trace import load_trace
from hapsim.scene import load_scene

PLACE = Path(os.environ.get("HAPSIM_WINE", Path.home() / ".cache" / "hapsim-wine"))
CLONE = Path(__file__).parents[2]
PORT = f"COM{5 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}"
"""Port of this worker's device."""

LONGEST = 600.0  # seconds for an answer, on the slowest machine

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

pytestmark = [
    pytest.mark.skipif(not (PLACE / "hapsim").exists(), reason="no Windows Python: `tools/wine` makes one"),
    pytest.mark.thorough,
]


class Answer(NamedTuple):
    status: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        assert self.status == 0, self.err[-2000:]
        return json.loads(self.out)


class Windows:
    """`hapsim …` of this clone on Windows, all in one process, whose start takes seconds."""

    def __init__(self) -> None:
        self._crashed = ""
        with open(PLACE / "lock", "w") as lock:  # of the workers of a test run only one makes it
            fcntl.flock(lock, fcntl.LOCK_EX)
            made = subprocess.run([CLONE / "tools" / "wine", PLACE], stdout=subprocess.DEVNULL, check=False)
            if made.returncode:
                pytest.skip(f"`tools/wine` ended with status {made.returncode}")
            self._process = subprocess.Popen(
                [PLACE / "windows-python", CLONE / "tests" / "cli" / "answers.py"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | {"COLUMNS": "200"},
                encoding="utf-8",
            )
            assert "Windows" in self("--version").out

    def __call__(self, *words: object) -> Answer:
        if self._crashed:
            pytest.fail(self._crashed)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps([*map(str, words)]), file=self._process.stdin, flush=True)
        answers, _, _ = select.select([self._process.stdout], [], [], LONGEST)
        line = self._process.stdout.readline() if answers else ""
        if not line:  # one that has crashed may neither end nor close its pipe
            self._process.kill()
            self._crashed = f"the Windows Python crashed at `hapsim {' '.join(map(str, words))[:200]}`"
            pytest.fail(self._crashed)
        return Answer(*json.loads(line))

    def python(self, code: str, **values: object) -> str:
        """Returns the output of Python code with these values."""
        given = "".join(f"{name} = {value!r}\n" for name, value in values.items())
        answer = self("-c", given + code)
        assert answer.status == 0, answer.err[-2000:]
        return answer.out

    def close(self) -> None:
        if not self._crashed:
            self._process.communicate()


@pytest.fixture(scope="module")
def windows() -> Iterator[Windows]:
    made = Windows()
    yield made
    made.close()


@contextlib.contextmanager
def plugged_in(scene: Path | None = None, port: str = "") -> Iterator[None]:
    """The scene's mock on Linux, or the device at this port of Linux, is at PORT of Windows inside."""
    link = PLACE / "prefix" / "dosdevices" / PORT.lower()
    with serving(assemble_mock(load_scene(scene))) if scene else contextlib.nullcontext(port) as there:
        link.unlink(missing_ok=True)
        link.symlink_to(there)
        yield
    link.unlink()


# The values that are not equal to Linux's to 1e-9, with the reason: LAPACK and the library of C are others there.
PLACES_OF_MAXIMA = re.compile(r"parts\[\d+\]\.any_hand\.(shaking_hand\.)?(frequency_hz|stiffness)")
"""Frequencies of a maximum, and what follows from them. A curve is flat there: a value that differs in its last bit
moves the place by the square root of that, 1.5e-8."""

SCENES = [
    *("first_touch", "zero_order_hold", "buzzing_contact", "sensed_acceleration", "two_hands", "disc", "puck"),
    *("knob_24", "toggle", "four_keys", "bowed_string", "struck_membrane"),
]
"""One for each way of a prediction: poles of one hand and of large scenes, corrections, states, the plane."""

EQUAL_PARTS = {"four_keys": ("cd", "ef")}
"""Points of equal keys. Their modes have one pole, so that each key's part in them is arbitrary; the sum of both keys'
parts is not."""

_SHARES = 1e-9  # of 1, as a point's part in a mode is a share


def values_of(document: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yields every value of a JSON document, with its place."""
    if isinstance(document, dict):
        for key, one in document.items():
            yield from values_of(one, f"{name}.{key}" if name else key)
    elif isinstance(document, list):
        for number, one in enumerate(document):
            yield from values_of(one, f"{name}[{number}]")
    else:
        yield name, document


def _checked(document: Any, scene: str) -> dict[str, Any]:
    for mode in document.get("modes") or () if scene in EQUAL_PARTS else ():
        parts = mode["participation"]
        mode["participation"] = {pair: sum(parts.get(key, 0.0) for key in pair) for pair in EQUAL_PARTS[scene]}
    return dict(values_of(document))


@pytest.mark.parametrize("scene", SCENES)
def test_a_prediction_is_that_of_linux(windows: Windows, hapsim: Hapsim, scene: str) -> None:
    there = _checked(windows("check", scene, "--json").document, scene)
    here = _checked(hapsim("check", scene, "--json").document, scene)
    assert there.keys() == here.keys()
    for name, value in here.items():
        if PLACES_OF_MAXIMA.fullmatch(name) and isinstance(value, float):
            assert there[name] == pytest.approx(value, rel=2e-8), name
        elif isinstance(value, float):
            assert there[name] == pytest.approx(value, rel=1e-9, abs=_SHARES if "participation" in name else 0.0), name
        elif name != "scene" and not name.endswith("path"):
            assert there[name] == value, name


def test_a_measurement_in_lockstep_is_that_of_linux(windows: Windows, hapsim: Hapsim, scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    words = ("measure", scene, "--duration", 0.5, "--json")
    there, here = (call(*words).document["measured"] for call in (windows, hapsim))
    for key in ("k", "b", "mass"):
        assert there[key] == pytest.approx(here[key], rel=1e-9), key


def test_a_path_has_spaces_and_umlauts_and_a_scene_errors(
    windows: Windows, scene_file: SceneFile, tmp_path: Path
) -> None:
    scene = scene_file("spring").rename(tmp_path / "ein schönes Maß.yaml")
    answer = windows("check", scene)
    assert answer.status == 0
    assert f'hapsim measure "{scene}"' in answer.out
    assert "N·s/m" in answer.out
    scene.write_text(scene.read_text("utf-8").replace("mass: 0.2", "mass: heavy"), "utf-8")
    answer = windows("check", scene)
    assert (answer.status, answer.out) == (2, "")
    assert f"{scene}:4:" in answer.err
    assert "heavy" in answer.err


def test_a_device_at_a_com_port_runs_is_measured_identified_and_probed(
    windows: Windows, scene_file: SceneFile, tmp_path: Path
) -> None:
    """In virtual time, but for a run of ten samples and the probe."""
    scene, record = scene_file("spring"), tmp_path / "kept.trace"
    on_port = ("--port", PORT, "--json")
    with plugged_in(scene):
        measured = windows("measure", scene, "--duration", 0.5, *on_port).document
        assert measured["measured"]["k"] == pytest.approx(measured["predicted"]["k"], rel=1e-5)
    with plugged_in(scene):
        identified = windows("identify", scene, "--duration", 0.4, *on_port).document
        assert identified["identified"]["mass"]["value"] == pytest.approx(0.2, rel=1e-3)
    paced = scene_file("damper", clock="device", rate=20.0)
    with plugged_in(paced):
        words = ("--duration", 0.5, "--unstable", "--record", record)
        report = windows("run", paced, *on_port, *words).document
        assert (report["ending"], report["released"]) == ("done", True)
        assert windows("probe", PORT, "--only", "registers", "--json").document["failed"] == 0
        assert windows("frames", PORT, "--duration", 0.1, "--json").document["counters"]["bytes"] == 0
    assert load_trace(record).sample.size == report["ticks"]
    assert "all forces are identical" in windows("replay", record).out
    assert windows("export", record, tmp_path / "kept.csv").status == 0
    assert np.genfromtxt(tmp_path / "kept.csv", delimiter=",", skip_header=1).shape[0] == report["ticks"]


def test_the_reference_firmware_at_a_com_port_is_run_and_measured(
    windows: Windows, start_board: Callable[..., Any], built: Path, tmp_path: Path
) -> None:
    scene, board = tmp_path / "knob.yaml", start_board("arduino_as5600", built, "lockstep=1")
    text = (CLONE / "configs" / "boards" / "arduino.yaml").read_text("utf-8")
    scene.write_text(text.replace("clock: device", "clock: lockstep"), "utf-8")
    with plugged_in(port=board.port):
        report = windows("run", scene, "--port", PORT, "--duration", 0.2, "--json").document
        assert (report["ending"], report["ticks"]) == ("done", 50)
        found = windows("measure", scene, "--port", PORT, "--json").document
    assert found["measured"]["k"] == pytest.approx(found["predicted"]["k"], rel=0.05)


BOARD_LAW = """
import functools, sys
sys.path.insert(0, folder)
from late_hosts import MissesThird
import hapsim
made = []
run = functools.partial(hapsim.run, between=lambda transport: made.append(MissesThird(transport)) or made[-1])
found, predicted = hapsim.measure(scene, duration=0.6, run=run), hapsim.predict(scene)
print(found.k, predicted.k, found.b, predicted.b, made[0].missed)
"""
"""Measures a scene whose host misses a third of its deadlines."""


def test_the_law_on_the_board_is_felt_as_predicted_though_a_third_of_the_deadlines_is_missed(
    windows: Windows, start_board: Callable[..., Any], built: Path, tmp_path: Path
) -> None:
    scene, board = tmp_path / "board.yaml", start_board("avr_lines", built, "lockstep=1")
    text = (CLONE / "configs" / "first_touch.yaml").read_text("utf-8")
    device = f"clock: lockstep\n  law: board\n  board_rate: 5000\n  port: {PORT}\n "
    scene.write_text(text.replace("clock: device ", device), "utf-8")
    with plugged_in(port=board.port):
        code = windows.python(BOARD_LAW, scene=str(scene), folder=str(CLONE / "tests" / "firmware"))
    k, predicted_k, b, predicted_b, missed = map(float, code.split())
    assert missed > 150
    assert (k, b) == pytest.approx((predicted_k, predicted_b), rel=0.01)


def test_a_port_that_is_unplugged_ends_the_run_and_the_record_stays(
    windows: Windows, scene_file: SceneFile, tmp_path: Path
) -> None:
    scene, record = scene_file("damper"), tmp_path / "kept.trace"
    answers: list[Answer] = []
    words = ("run", scene, "--port", PORT, "--unstable", "--record", record)
    run = threading.Thread(target=lambda: answers.append(windows(*words)))
    with plugged_in(scene):
        run.start()
        while run.is_alive() and not (record.exists() and record.stat().st_size > 10_000):
            run.join(0.05)
    run.join()
    (answer,) = answers
    assert answer.status == 3
    assert f"{PORT}: the device went away after" in answer.err
    assert load_trace(record).sample.size > 10


STOPPED = """
import signal, sys, threading, time
import hapsim, hapsim.running
from hapsim import cli

def stop():
    while not (running := hapsim.sessions()) or running[0].progress().ticks < 5:
        time.sleep(0.01)
    for _ in range(times):
        signal.raise_signal(signal.SIGINT)  # without a console Wine sends no event of one
        time.sleep(0.02)

threading.Thread(target=stop).start()
sys.argv = ["hapsim", "run", scene, "--port", port, "--unstable", "--json"]
cli.main()
"""


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_ends_a_run(windows: Windows, scene_file: SceneFile, times: int) -> None:
    scene = scene_file("damper")
    with plugged_in(scene):
        report = json.loads(windows.python(STOPPED, scene=str(scene), port=PORT, times=times))
    assert report["ending"] == "stopped"
    assert report["released"] or times == 2  # the second does not wait for the device's answer


def test_a_session_of_a_program(windows: Windows, scene_file: SceneFile) -> None:
    code = """
import hapsim
with hapsim.start(scene) as session:
    session.set({"touch": {"stiffness": 500.0}})
print(session.trace.report.ending, session.parameters["touch.stiffness"].value)
"""
    assert windows.python(code, scene=str(scene_file("spring"))) == "stopped 500.0\n"


def test_a_sweep_on_two_processes_is_that_of_linux(
    windows: Windows, hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path
) -> None:
    """The fourth point is the first that another process gets: each start of one takes seconds."""
    sweep = ("sweep", scene_file("spring"), "touch.stiffness=500,1000,1500,2000", "--duration", 0.5)
    words = (*sweep, "--json", "--out")
    there = windows(*words, tmp_path / "there.nc", "--jobs", 2).document
    here = hapsim(*words, tmp_path / "here.nc").document
    assert there["failed"] == 0
    for name in ("predicted_k", "predicted_b", "measured_k", "measured_b"):
        for key in ("least", "most"):
            assert there["variables"][name][key] == pytest.approx(here["variables"][name][key], rel=1e-9), name


def test_a_file_that_another_program_has_open_stays(windows: Windows, tmp_path: Path, scene_file: SceneFile) -> None:
    record, table = tmp_path / "kept.trace", tmp_path / "kept.csv"
    assert windows("run", scene_file("spring"), "--duration", 0.05, "--record", record).status == 0
    code = """
import sys
from hapsim import cli
with open(table, "w") as file:
    file.write("theirs")
    file.flush()
    sys.argv = ["hapsim", "export", record, table, "--overwrite"]
    cli.main()
"""
    answer = windows("-c", f"record, table = {str(record)!r}, {str(table)!r}\n{code}")
    assert answer.status == 2
    assert "the file cannot be written" in answer.err
    assert "is it open in another program?" in answer.err
    assert table.read_text("utf-8") == "theirs"
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]


def test_what_is_missing_ends_in_a_sentence(windows: Windows, scene_file: SceneFile) -> None:
    scene, takes = scene_file("spring", clock="device"), "takes Linux; this system (win32) has no clock_gettime, "
    sockets = "take unix sockets, which this system does not have"
    for words, status, sentence in (
        (("run", scene, "--port", "/dev/ttyACM0"), 3, "/dev/ttyACM0: no such port. Ports found: "),
        (("run", scene, "--port", "COM99"), 3, "COM99: no such port. Ports found: "),
        (("run", scene, "--realtime"), 2, f"--realtime {takes}"),
        (("doctor", "--realtime"), 2, f"--realtime {takes}"),
        (("mock", scene), 2, f"the mock on a pseudo-terminal {takes}"),
        (("faults", "noisy_wire", "--port", PORT), 2, f"faults on a pseudo-terminal {takes}"),
        (("service", scene, "--port", PORT), 2, f"a service of systemd {takes}"),
        (("run", scene, "--status", "auto"), 2, sockets),
        (("status",), 2, sockets),
        (("ports",), 0, "`hapsim run SCENE` has a mock in memory"),
    ):
        answer = windows(*words)
        assert (answer.status, answer.out) == (status, ""), answer
        assert sentence in answer.err


def test_the_doctor_measures_wake_ups_and_exchanges(windows: Windows) -> None:
    found = windows("doctor", "--seconds", 0.1, "--rates", 200, "--json").document
    assert found["machine"]["system"].startswith("Windows")
    assert found["shortest_sleep_s"] > 0.0
    assert all(one["lateness"]["count"] > 0 for one in found["wakeups"])
    assert all(one["ticks"] > 0 for one in found["exchanges"])
