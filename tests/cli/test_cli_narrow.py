"""Text on a narrow terminal wraps at words, and file:line:column stays whole."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.cli.output import fitted

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

COLUMNS = 80
SENTENCE = "found 'stiffnes', expected one of damping, stiffness, damper, cutoff; did you mean 'stiffness'?"


def shown(*words: object) -> list[str]:
    """The lines that `hapsim …` writes to a terminal of 80 columns and no colours, before it breaks any itself."""
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, bytes([24, 0, COLUMNS, 0, 0, 0, 0, 0]))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "hapsim", *map(str, words)]
    process = subprocess.Popen(command, stdout=far, stderr=far, env=environment | {"TERM": "dumb"})
    os.close(far)
    received = b""
    try:
        while part := os.read(near, 65536):
            received += part
    except OSError:
        pass  # the far end is closed
    finally:
        process.wait()
        os.close(near)
    return received.decode("utf-8").replace("\r\n", "\n").rstrip("\n").split("\n")


def test_an_error_breaks_at_words_and_names_its_place_in_one_piece(scene_file: SceneFile, tmp_path: Path) -> None:
    path = tmp_path / "a name with spaces, and rather long, as the names of the scenes of a museum are.yaml"
    text = scene_file("mass").read_text(encoding="utf-8")
    path.write_text(text.replace("stiffness:", "stiffnes:"), encoding="utf-8")
    lines = shown("check", path)
    places = [line for line in lines if line.startswith(f"{path}:")]
    assert lines[0] in places
    assert all(re.fullmatch(r"\d+:\d+:", place.removeprefix(f"{path}:")) for place in places)
    assert len(lines) > 2 * len(places)
    assert all(len(line) <= COLUMNS for line in lines if line not in places)
    said = " ".join(line.strip() for line in lines)
    assert "stiffnes: unknown key, expected type, between" in said
    assert "did you mean 'stiffness'?" in said


def test_a_prediction_breaks_at_words_and_names_its_scene_in_one_piece(scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    path = scene.rename(scene.with_name("the-name-of-a-scene-that-is-longer-than-a-terminal-is-wide-and-whole.yaml"))
    assert len(str(path)) > COLUMNS
    lines = shown("check", path)
    assert str(path) in lines
    assert all(len(line) <= COLUMNS for line in lines if line not in (str(path), f"Next: hapsim measure {path}"))
    assert "(spectral radius" in " ".join(lines)


def test_a_frame_breaks_at_words_and_its_bytes_stay_whole(tmp_path: Path) -> None:
    path = tmp_path / "capture"
    path.write_bytes(bytes(range(1, 256)))
    lines = shown("frames", path, "--hex")
    assert all(len(line) <= COLUMNS for line in lines)
    assert lines[1].startswith(" " * 10)
    said = " ".join(line.strip() for line in lines)
    assert bytes(range(1, 256)).hex(" ") in said
    assert "Nothing in it is a frame: is it raw bytes of the wire?" in said


def test_what_a_pipe_takes_stays_in_one_line(hapsim: Hapsim, scene_file: SceneFile) -> None:
    path = scene_file("mass")
    path.write_text(path.read_text(encoding="utf-8").replace("stiffness:", "stiffnes:"), encoding="utf-8")
    lines = hapsim("check", path).sentence.splitlines()
    assert len(lines[0]) > COLUMNS
    assert all(line.startswith(f"{path}:") for line in lines)


@pytest.mark.parametrize("columns", [20, 40, 79, 80, 81, 200])
def test_a_sentence_keeps_every_word(columns: int) -> None:
    place = "/tmp/my scenes/first touch.yaml:12:7:"
    text = f"{place} {SENTENCE}\nscene.yaml:1:1: {SENTENCE}\n\nshort\n{'x' * 90}"
    broken = fitted(text, columns)
    assert broken.split() == text.split()
    assert place in broken
    assert all(len(line) <= max(columns, len(place)) for line in broken.split("\n") if "xxx" not in line)


def test_a_sentence_that_fits_stays_as_it_is() -> None:
    assert fitted(SENTENCE, len(SENTENCE)) == SENTENCE
    assert fitted(SENTENCE, None) == SENTENCE
    assert fitted(SENTENCE, len(SENTENCE) - 1).count("\n") == 1


@pytest.mark.parametrize("words", [["sweep"], ["run"], ["measure"], ["check"], ["replay"], ["chart", "plane"]])
def test_no_example_of_help_becomes_a_picture(hapsim: Hapsim, words: list[str]) -> None:
    """Help keeps its colons: rich would replace words such as :100: by emoji."""
    assert not [letter for letter in hapsim(*words, "--help").out if ord(letter) >= 0x1F000]


@pytest.mark.parametrize("words", [[], ["frames"], ["faults"], ["probe"], ["identify"], ["chart"], ["chart", "felt"]])
def test_help_has_no_line_break_within_a_paragraph(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "600")  # the longest paragraph has room in a line
    answer = hapsim(*words, "--help")
    assert answer.status == 0
    prose = [line.strip() for line in answer.out.splitlines() if line.startswith(" ") and "Usage:" not in line]
    commands = [line.strip("│ ") for line in answer.out.split("Commands ─")[-1].splitlines()[1:] if line.strip("│╰╯─ ")]
    told = [line for line in prose if line] + (commands if len(words) == 0 or words == ["chart"] else [])
    assert told
    assert all(line.endswith(".") for line in told), told
