"""The command line, called in this process as the console script calls it, or in a process of its own; the firmware's
boards, built once; figures told at the end of a run."""

from __future__ import annotations

import fcntl
import gc
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import firmware_protocol
from hapsim import cli
from hapsim.cli.output import set_output_units
from hapsim.units import LINEAR
from tests import thorough

FIRMWARE = Path(firmware_protocol.__file__).parent / "firmware"

# What is there where a board can be run on this machine, and the Debian packages that bring what it takes.
ON_SIMAVR = "gcc libc6-dev gcc-avr avr-libc libsimavr-dev"
RUNNERS = {
    "linux": ("linux", "gcc libc6-dev"),
    "avr": ("run_avr", ON_SIMAVR),
    **{
        name: (f"run_{name}", "gcc libc6-dev gcc-avr avr-libc libsimavr-dev")
        for name in ("hapkit", "firefader", "faders4")
    },
    "cortex_m": ("on_terminal", "gcc libc6-dev gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"),
    "simplefoc": ("simplefoc", "g++ libc6-dev"),
    **{name: (name, "g++ libc6-dev") for name in ("arduino", "arduino_as5600", "arduino_potentiometer")},
    "arduino_uno": ("run_arduino_uno", f"{ON_SIMAVR} arduino-core-avr"),
    "simplefoc_cortex_m": ("on_terminal", "g++ libc6-dev gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"),
}

RUNNERS |= {f"{name}_lines": RUNNERS[name] for name in ("linux", "avr", "cortex_m")}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="also run what is marked thorough, and more random points")


def pytest_configure(config: pytest.Config) -> None:
    thorough.ALL = config.getoption("--all")
    config.addinivalue_line("markers", "thorough(keep=0): runs with --all alone, or `keep` of its cases without")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Collects without searches for garbage, and keeps what lives to the end out of every later one: it would take a
    tenth of the tests' processor time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what is thorough, unless HAPSIM_POINTS or a test by its name asks for it."""
    if "HAPSIM_POINTS" not in os.environ and not any("::" in one for one in config.args):
        left_out = thorough.left_out(items)
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]


@pytest.fixture(scope="session", autouse=True)
def _signals_are_not_ignored() -> None:
    """A shell that starts pytest in the background has it ignore SIGINT, nohup SIGHUP, and so would every program that
    a test starts."""
    for number, default in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, default)


@pytest.fixture(scope="session", autouse=True)
def _reports_stay_here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Redirects the reports of failed runs, so that no test writes to the user's own directories."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@dataclass(frozen=True)
class Answer:
    status: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """Standard output, which is one JSON document and holds no NaN or infinity."""

        def refuse(constant: str) -> None:
            pytest.fail(f"{constant} in JSON")

        document: dict[str, Any] = json.loads(self.out, parse_constant=refuse)
        return document

    @property
    def words(self) -> str:
        """Standard output without its line breaks."""
        return " ".join(self.out.split())

    @property
    def sentence(self) -> str:
        """Standard error after a failure: no traceback, no defect of ours; standard output has the same or nothing."""
        assert "Traceback" not in self.err
        assert "defect" not in self.err
        if self.out:
            assert self.document.keys() == {"error", "exit_status"}
            assert self.document["error"] in self.err
            assert self.document["exit_status"] == self.status
        return self.err

    @property
    def refusal(self) -> str:
        """The sentence of a command that ended with status 2."""
        assert self.status == 2, self.err
        return self.sentence


@pytest.fixture
def hapsim(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Callable[..., Answer]]:
    """Calls `hapsim …` and returns its answer; the units in which it printed (N·m of a knob) end with the test."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("HAPSIM_TRACEBACK", raising=False)

    def call(*words: object) -> Answer:
        monkeypatch.setattr("sys.argv", ["hapsim", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        captured = capfd.readouterr()
        return Answer(int(caught.value.code or 0), captured.out, captured.err)

    yield call
    set_output_units(LINEAR)


class Forked:
    """A program in a process, and a process group, of its own, which `fork_server.py` started."""

    def __init__(self, server: subprocess.Popen[str], argv: list[str], program: str, outputs: list[Path]) -> None:
        self._server, self._outputs, self._status = server, outputs, None
        work = {"argv": argv, "program": program, "outputs": [*map(str, outputs)]}
        for output in outputs:
            output.touch()  # it is looked at as soon as the process has a number
        self.pid = int(self._ask(work))

    def _ask(self, request: Any) -> Any:
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        print(json.dumps(request), file=self._server.stdin, flush=True)
        return json.loads(self._server.stdout.readline())

    def poll(self) -> int | None:
        """The exit status, -N after signal N; None while it runs."""
        if self._status is None:
            self._status = self._ask(self.pid)
        return self._status

    def wait(self, timeout: float = 60.0) -> int:
        give_up = time.monotonic() + timeout
        while (status := self.poll()) is None:
            assert time.monotonic() < give_up, "a program that hangs"
            time.sleep(0.01)
        return status

    def kill(self) -> None:
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
            self.wait()

    @property
    def out(self) -> str:
        return self._outputs[0].read_text("utf-8")

    @property
    def err(self) -> str:
        return self._outputs[1].read_text("utf-8")


@pytest.fixture(scope="session")
def fork_server() -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, Path(__file__).with_name("fork_server.py")]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, start_new_session=True, **pipes) as server:
        yield server
        server.communicate()


@pytest.fixture
def start_hapsim(fork_server: subprocess.Popen[str], tmp_path: Path) -> Iterator[Callable[..., Forked]]:
    """Starts `hapsim …`, or another program, in a process of its own that has everything imported; kills it when the
    test ends."""
    started: list[Forked] = []

    def start(*words: object, program: str = "cli.main()") -> Forked:
        outputs = [tmp_path / f"{len(started)}.{name}" for name in ("out", "err")]
        started.append(Forked(fork_server, ["hapsim", *map(str, words)], program, outputs))
        return started[-1]

    yield start
    for one in started:
        one.kill()


@pytest.fixture(scope="session")
def compiler() -> str:
    found = shutil.which("gcc")
    if found is None:
        pytest.skip("no C compiler on this machine (Debian: gcc libc6-dev)")
    return found


@pytest.fixture(scope="session")
def once(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, list[str], dict[str, str]], Path]:
    """Runs a build that writes into the directory that is its last word, once for all workers of this run."""
    assert compiler
    shared = tmp_path_factory.getbasetemp()
    if os.environ.get("PYTEST_XDIST_WORKER"):
        shared = shared.parent

    def build(name: str, command: list[str], environment: dict[str, str]) -> Path:
        to = shared / name
        with open(shared / f"{name}.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (to / "done").exists():
                to.mkdir(exist_ok=True)
                words = [*command, str(to)]
                built = subprocess.run(words, env=os.environ | environment, capture_output=True, text=True, check=False)
                assert built.returncode == 0, built.stderr
                (to / "done").write_text(built.stdout, "utf-8")
        return to

    return build


@pytest.fixture(scope="session")
def built(once: Any) -> Path:
    """Directory of the built boards."""
    return once("firmware", [str(FIRMWARE / "build")], {})


@pytest.fixture(scope="session")
def built_broken(once: Any) -> Path:
    """Directory of the Linux boards that are built broken on purpose."""
    return once("broken", [str(FIRMWARE / "linux" / "broken")], {})


class Board:
    """A board that runs: its port, and what it says of the force that it puts out."""

    def __init__(self, command: list[str | Path], built: Path, log: Path, properties: tuple[str, ...] = ()) -> None:
        self.log = log
        self.process = subprocess.Popen(
            [*command, log, *properties],
            env=os.environ | {"HAPSIM_FIRMWARE": str(built)},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        self.port = self.process.stdout.readline().strip()
        assert self.port.startswith("/dev/"), f"{command}: no port"

    def put_out(self) -> list[tuple[int, int]]:
        """Each force put out, be it the same again: microseconds of the board's clock, counts."""
        lines = self.log.read_text("ascii").splitlines(keepends=True) if self.log.exists() else []
        words = [line.split() for line in lines if line.endswith("\n")]
        return [(int(us, 16), int.from_bytes(bytes.fromhex(counts), signed=True)) for us, counts in words]

    def forces(self) -> list[tuple[int, int]]:
        """Returns the forces put out that differ from the one before."""
        put_out = self.put_out()
        return [one for before, one in zip([(0, None), *put_out], put_out, strict=False) if one[1] != before[1]]

    def wait_for(self, what: Callable[[list[tuple[int, int]]], bool]) -> list[tuple[int, int]]:
        """The changes so far, as soon as `what` is true of them. The minute is for a machine that hangs."""
        give_up = time.monotonic() + 60.0
        while not what(forces := self.forces()):
            assert time.monotonic() < give_up, f"not seen within a minute; the last forces: {forces[-3:]}"
            time.sleep(0.02)
        return forces

    def stop(self) -> None:
        self.process.terminate()
        self.process.communicate()


@pytest.fixture
def boards() -> Iterator[list[Board]]:
    """Running boards, stopped at the end of the test."""
    running: list[Board] = []
    yield running
    for board in running:
        board.stop()


@pytest.fixture
def start_board(built: Path, boards: list[Board], tmp_path: Path) -> Callable[..., Board]:
    """Starts a board by its name, from `built` or from elsewhere, with its properties; skips where this machine lacks
    what it takes."""

    def start(name: str, where: Path = built, *properties: str) -> Board:
        needed, packages = RUNNERS[name]
        if not (where / needed).exists():
            pytest.skip(f"{name} was not built on this machine (Debian: {packages})")
        boards.append(Board([FIRMWARE / "board", name], where, tmp_path / f"{name}.log", properties))
        return boards[-1]

    return start


@pytest.fixture
def start_broken_board(built_broken: Path, boards: list[Board], tmp_path: Path) -> Callable[[str], Board]:
    """Starts a Linux board that is broken on purpose, by the name of what is wrong with it."""

    def start(name: str) -> Board:
        boards.append(Board([built_broken / name], built_broken, tmp_path / f"{name}.log"))
        return boards[-1]

    return start


@dataclass(frozen=True)
class Figures:
    """Measured values of tests, for the pages that quote them. They are printed once, after the last test of all
    processes."""

    _record: Callable[[str, object], None]

    def most(self, what: str, value: float) -> None:
        """Records the largest value of the run; NaN if one was."""
        self._record("most", [what, float(value)])

    def count(self, what: str, number: int) -> None:
        """The sum of them."""
        self._record("count", [what, int(number)])

    def note(self, sentence: str) -> None:
        self._record("note", [sentence, 0])


@pytest.fixture
def figures(record_property: Callable[[str, object], None]) -> Figures:
    return Figures(record_property)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    told: dict[tuple[str, str], list[Any]] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport) and report.when == "call":
                for kind, (what, value) in (p for p in report.user_properties if p[0] in ("most", "count", "note")):
                    told.setdefault((kind, what), []).append(value)
    if told:
        terminalreporter.section("figures")
    for (kind, what), values in sorted(told.items()):
        if kind == "most":
            worst = math.nan if any(map(math.isnan, values)) else max(values)
            terminalreporter.line(f"{what}: {worst:.2g} at most, of {len(values)}")
        else:
            terminalreporter.line(what if kind == "note" else f"{what}: {sum(values)}")
