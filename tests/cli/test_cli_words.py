"""Inputs and outputs of a scene in what commands print."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.cli.live import _Words
from hapsim.loop.counts import Progress
from tests.word_scenes import WORDS

Hapsim = Callable[..., Any]
NAMED = (
    "igital inputs: touch (bit 0), grip (bit 31, inverted); outputs: code (bits 8 to 15), led (bit 3), hit (bit 2: 1 "
    "while wall is closed)"
)


@pytest.fixture
def words(tmp_path: Path) -> Path:
    path = tmp_path / "words.yaml"
    path.write_text(WORDS, encoding="utf-8")
    return path


def test_check_names_their_bits(hapsim: Hapsim, words: Path) -> None:
    answer = hapsim("check", words)
    assert f"D{NAMED}." in answer.words
    document = hapsim("check", words, "--json").document
    assert document["inputs"] == {"touch": {"bit": 0, "inverted": False}, "grip": {"bit": 31, "inverted": True}}
    assert document["outputs"]["code"] == {"bits": [8, 15]}


def test_a_run_begins_with_their_names(hapsim: Hapsim, words: Path) -> None:
    answer = hapsim("run", words, "--duration", 0.05)
    assert answer.status == 0
    assert f"d{NAMED}" in " ".join(answer.err.split())


def test_the_live_line_has_their_values() -> None:
    progress = Progress("running", words={"inputs.touch": 1, "outputs.code": 17})
    assert " · touch 1, code 17 · " in _Words("").of(progress)
    assert "touch" not in _Words("").of(Progress("running"))


def test_a_bit_of_two_inputs_is_an_error_of_the_file(hapsim: Hapsim, words: Path) -> None:
    words.write_text(WORDS.replace("bit: 31", "bit: 0"), encoding="utf-8")
    refusal = hapsim("run", words).refusal
    assert "words.yaml:7:15: bit: found bit 0, which touch has; expected one that no other of the inputs has" in refusal
