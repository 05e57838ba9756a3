"""Terminals, pipes and shells: narrow and dumb terminals, FIFOs, standard input, completion, the manual page."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import hapsim as package
from hapsim.cli import frames_command, live
from hapsim.cli.command_line import ChartCommands, Commands
from hapsim.cli.output import table
from hapsim.device.mock.terminal import serving
from hapsim.errors import DeviceError
from hapsim.loop.counts import Progress
from hapsim.prediction import Part, predict
from hapsim.scene import load_scene
from tests.loaded_files import module_of

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "hapsim" / "hapsim.1"


def numbers_in(text: str) -> list[str]:
    return sorted(re.findall(r"-?\d+\.\d+", text))


def test_no_number_is_cut_however_narrow_the_terminal(
    explained: Callable[[Path], Any], scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scene_file("two_hands", correction="poles")
    monkeypatch.chdir(path.parent)
    monkeypatch.setattr("hapsim.cli.check.predict", cache(predict))  # only the width differs
    monkeypatch.setattr(Part, "tolerances", cache(Part.tolerances))
    wide = explained(Path(path.name)).out
    assert len(numbers_in(wide)) > 40
    for columns in (24, 80):
        monkeypatch.setenv("COLUMNS", str(columns))
        narrow = explained(Path(path.name)).out
        assert numbers_in(narrow) == numbers_in(wide), columns
        assert "…" not in narrow, columns
        *lines, command = narrow.splitlines()  # which stays in one piece, to be copied
        assert max(map(len, lines)) <= columns
        assert command.startswith("Next: ")


@pytest.mark.parametrize("columns", ["0", ""])
def test_a_terminal_without_a_width_gets_an_ordinary_one(
    hapsim: Hapsim, scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch, columns: str
) -> None:
    path = scene_file("spring")
    monkeypatch.chdir(path.parent)
    monkeypatch.setenv("COLUMNS", columns)
    lines = hapsim("check", path.name).out.splitlines()
    assert len(lines) > 5
    assert max(map(len, lines)) <= 80


def test_rows_without_room_are_stacked_and_a_phrase_wraps() -> None:
    rows = [("k  N/m", "1234.567890", "", "a phrase of several words"), ("b", "1", "2", "")]
    made = table("Title", ("", "predicted", "measured", "<about"), rows, "caption")
    out = io.StringIO()
    Console(file=out, width=30).print(made)
    assert [line.rstrip() for line in out.getvalue().splitlines()] == [
        "Title",
        "k  N/m",
        "  predicted  1234.567890",
        "  about      a phrase of",
        "             several words",
        "b",
        "  predicted  1",
        "  measured   2",
        "caption",
    ]


@pytest.mark.parametrize("show", [live.at_work, lambda console, _: live.live_words(console)])
def test_a_dumb_terminal_gets_lines(monkeypatch: pytest.MonkeyPatch, show: Any) -> None:
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(live, "_STEP_S", 0.001)
    written = threading.Event()

    class Terminal(io.StringIO):
        def write(self, text: str) -> int:
            if "compiling" in text:
                written.set()
            return super().write(text)

    out = Terminal()
    with show(Console(file=out, force_terminal=True), "starting") as tell:
        tell("compiling the loop")
        assert written.wait(60.0)
    assert "compiling the loop\n" in out.getvalue()


def test_that_something_is_compiled_is_one_line_of_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_STEP_S", 0.0)
    out = io.StringIO()
    with live.live_line(Console(file=out, width=200), warn_not_cached=False) as show:
        for phase in ("compiling", "compiling", "running", "compiling", "running"):
            show(Progress(phase, share=0.5))
    assert [line.split()[0].rstrip(",") for line in out.getvalue().splitlines()] == ["compiling", "running", "running"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_fifo_without_a_writer_can_be_left(
    hapsim: Hapsim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    fifo, waits, rescued = tmp_path / "fifo", threading.Event(), []
    os.mkfifo(fifo)

    def select(*_: object) -> tuple[list[int], ...]:
        waits.set()
        signal.raise_signal(number)
        return [], [], []

    def rescue() -> None:
        if not waits.wait(20.0):
            rescued.append(os.open(fifo, os.O_WRONLY))  # else a failure would hang

    monkeypatch.setattr(frames_command.select, "select", select)
    helper = threading.Thread(target=rescue)
    helper.start()
    answer = hapsim("frames", fifo)
    helper.join()
    assert (answer.status, answer.err, rescued) == (0, "", [])
    assert answer.out.startswith("0 bytes")


def test_a_full_disk_is_one_sentence_for_files_and_output(hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    class Full(io.StringIO):
        def write(self, _text: str) -> int:
            raise full

    def fail(_: object) -> None:
        raise full

    monkeypatch.setattr("hapsim.cli.prepare.document", fail)
    monkeypatch.setattr(sys, "stdout", Full())
    answer = hapsim("scenes", "--json")
    assert (answer.status, answer.err) == (2, "hapsim: the output cannot be written: No space left on device\n")


# A scene on standard input


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Puts a text on standard input."""
    return lambda text: monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))


def test_a_scene_on_standard_input_is_the_scene_of_its_file(
    hapsim: Hapsim, scene_file: SceneFile, given: Callable[[str], None]
) -> None:
    path = scene_file("spring")
    given(path.read_text("utf-8"))
    assert hapsim("check", "-", "--json").document == hapsim("check", path, "--json").document | {"scene": "-"}
    for words in (("check", "-"), ("run", "-", "--duration", 0.05), ("chart", "plane", "-", "--json")):
        given(path.read_text("utf-8"))
        assert hapsim(*words).status == 0, words
    given("version: 1\nrate: x\n")
    assert "standard input:2:7: rate" in hapsim("check", "-").sentence


@pytest.mark.parametrize("words", [("run", "-", "--watch"), ("identify", "-", "--write"), ("service", "-")])
def test_what_follows_or_rewrites_the_file_needs_one(hapsim: Hapsim, words: tuple[str, ...]) -> None:
    assert "found a scene on standard input (-), expected the scene's file" in hapsim(*words).refusal


def test_a_name_with_a_dash_is_suggested_as_a_command_takes_it(
    hapsim: Hapsim, scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scene_file("spring")
    monkeypatch.chdir(path.parent)
    path.rename("-string.yaml")
    assert "did you mean './-string.yaml'?" in hapsim("check", "string.yaml").sentence
    assert hapsim("check", "./-string.yaml").status == 0
    assert "hapsim check ./-n.yaml\n" in hapsim("new", "./-n.yaml").out


def test_no_pseudo_terminal_names_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise OSError(errno.ENOENT, "out of pty devices")

    monkeypatch.setattr(os, "openpty", refuse)
    with pytest.raises(DeviceError, match=r"out of pty devices .*With `clock: lockstep`"), serving(None):
        pass


# An interrupt


def interrupt(progress: Progress) -> None:
    if progress.phase == "running" and progress.ticks > 0:
        raise KeyboardInterrupt


def test_an_interrupted_run_returns_what_it_has(scene_file: SceneFile) -> None:
    trace = package.run(scene_file("spring"), on_progress=interrupt)
    assert trace.report.ending == "interrupted"
    assert trace.report.released
    assert trace.position.shape[0] == trace.report.ticks > 0
    assert package.sessions() == []


def test_an_interrupt_before_arming_or_in_a_measurement_is_raised(
    scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_once(*_: object) -> None:
        raise KeyboardInterrupt

    scene = load_scene(scene_file("spring"))
    with pytest.raises(KeyboardInterrupt):
        package.measure(scene, duration=1000.0, on_progress=interrupt)
    monkeypatch.setattr("hapsim.running.session.arm", at_once)
    with pytest.raises(KeyboardInterrupt):
        package.run(scene)
    assert package.sessions() == []


# Completion and the manual page


@pytest.fixture
def completed(hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[str]]:
    """Returns bash's completions of the last word of a line."""

    def complete(line: str) -> list[str]:
        monkeypatch.setenv("_HAPSIM_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
        words: list[str] = hapsim().out.split()
        return words

    return complete


def test_a_shell_completes_scenes_scripts_ports_and_options(
    completed: Callable[[str], list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wave.yaml").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [type("P", (), {"device": "/dev/ttyACM7"})()])
    assert completed("hapsim me") == ["measure"]
    assert completed("hapsim check wa") == ["wall", "wave.yaml"]
    assert completed("hapsim compile wall wa") == ["wall", "wave.yaml"]
    assert completed("hapsim chart plane wa") == ["wall", "wave.yaml"]
    assert completed("hapsim new --from plu") == ["plucked_string"]
    assert completed("hapsim new --board hapk") == ["hapkit"]
    assert completed("hapsim faults noi") == ["noisy_wire"]
    assert completed("hapsim run wall --port ") == completed("hapsim probe ") == ["/dev/ttyACM7"]
    assert completed("hapsim run wall --re") == ["--record", "--realtime", "--reports", "--reconnect", "--record-dir"]
    assert completed("hapsim check nothing/of/this/name") == []  # the shell offers files


def test_completion_imports_nothing_heavy() -> None:
    program = (
        "import atexit, sys\nsys.argv = ['hapsim']\n"
        "heavy = ('numba', 'numpy', 'scipy', 'matplotlib', 'hapsim.prediction')\n"
        "atexit.register(lambda: print([one for one in heavy if one in sys.modules]))\n"
        "from hapsim.cli import main\nmain()\n"
    )
    words = {"_HAPSIM_COMPLETE": "complete_bash", "COMP_WORDS": "hapsim run --rec", "COMP_CWORD": "2"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=os.environ | words, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["--record", "--reconnect", "--record-dir", "[]"], done.stderr


def test_the_manual_page_agrees_with_the_help() -> None:
    manual = module_of(ROOT / "tools" / "manual").manual()
    assert PAGE.read_text("utf-8") == manual, "run tools/manual"
    sections = re.findall(r"^\.SS hapsim (?:chart )?(\S+)", PAGE.read_text("utf-8").replace("\\-", "-"), re.MULTILINE)
    assert sections == [*Commands.table, *ChartCommands.table]


def test_man_renders_it_without_a_warning(hapsim: Hapsim) -> None:
    if shutil.which("man") is None:
        pytest.skip("no man on this machine (Debian: man-db)")
    (page,) = re.findall(r"^manual +(.*)$", hapsim("files").out, re.MULTILINE)
    done = subprocess.run(["man", "--warnings", "-l", page], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "hapsim measure [OPTIONS] SCENE" in done.stdout
