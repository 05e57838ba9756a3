"""The command to try next, with which `check`, `measure` and `identify --write` end."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]


def next_words(answer: Any) -> list[str]:
    """The words of the last line behind "Next: hapsim"."""
    assert answer.status == 0, answer.err
    before, _, words = answer.out.splitlines()[-1].partition("Next: hapsim ")
    assert (before, answer.out.count("Next:")) == ("", 1), answer.out
    return shlex.split(words)


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(
    ("words", "following"),
    [
        (("check", "spring"), ("measure", "spring")),
        (("check", "spring", "--at", "-2mm"), ("measure", "spring", "--at=-2mm")),
        (("check", "hand_in_hand"), ("measure", "hand_in_hand", "--hands")),
        (("check", "unstable"), ("check", "unstable", "--explain")),
        (("check", "no_number"), ("check", "no_number", "--explain")),
        (("identify", "spring", "--write"), ("measure", "spring")),
        (
            ("identify", "spring", "--write", "--channel", "0", "--transport", "loopback"),
            ("measure", "spring", "--transport", "loopback", "--channel", "0"),
        ),
        (("measure", "spring"), ("run", "spring", "--duration", "10")),
        (("measure", "spring", "--mock"), ("run", "spring", "--mock", "--duration", "10")),
        (("measure", "hand_in_hand", "--hands"), ("run", "hand_in_hand", "--duration", "10")),
    ],
)
def test_they_end_with_a_command_that_runs_as_it_stands(
    hapsim: Hapsim, scene_file: SceneFile, words: tuple[str, ...], following: tuple[str, ...]
) -> None:
    path = scene_file(words[1])
    found = next_words(hapsim(words[0], path, *words[2:]))
    assert found == [following[0], str(path), *following[2:]]
    assert hapsim(*found).status == 0


def test_a_scene_in_real_time_is_run_with_its_page(hapsim: Hapsim, scene_file: SceneFile) -> None:
    path = scene_file("spring", clock="device", rate=200.0, touch={"stiffness": 100.0, "damping": 1.0})
    found = next_words(hapsim("measure", path, "--transport", "terminal", "--duration", 1))
    assert found == ["run", str(path), "--transport", "terminal", "--serve"]


def test_a_hand_of_another_mass_is_identified_first(hapsim: Hapsim, scene_file: SceneFile) -> None:
    path = scene_file("spring")
    path.write_text(path.read_text("utf-8") + "mock: {mass: 0.4}\n", encoding="utf-8")
    assert next_words(hapsim("measure", path)) == ["identify", str(path), "--channel", "0"]


def test_a_path_that_a_shell_would_split_is_quoted(hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path) -> None:
    path = scene_file("spring").rename(tmp_path / "my spring.yaml")
    assert next_words(hapsim("check", path)) == ["measure", str(path)]


@pytest.mark.parametrize(
    "words",
    [
        ("check", "spring", "--json"),
        ("measure", "spring", "--json"),
        ("identify", "spring"),
        ("identify", "spring", "--write", "--json"),
        ("check", "unstable", "--explain"),
        ("measure", "unstable"),
        ("measure", "spring", "--unstable"),
    ],
)
def test_nothing_follows_documents_and_refused_scenes(hapsim: Hapsim, scene_file: SceneFile, words: Any) -> None:
    answer = hapsim(words[0], scene_file(words[1]), *words[2:])
    assert "Next:" not in answer.out + answer.err


def test_a_scene_on_standard_input_cannot_be_read_again(scene_file: SceneFile) -> None:
    with scene_file("spring").open("rb") as text:
        command = [sys.executable, "-m", "hapsim", "check", "-"]
        told = subprocess.run(command, stdin=text, capture_output=True, text=True, check=True).stdout
    assert "stable" in told
    assert "Next:" not in told
