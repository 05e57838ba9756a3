"""Recordings in files."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hapsim.curves.recording import Recording, recording_of
from hapsim.scene.curve_file import read_table

sys.path.insert(0, str(Path(__file__).parent))

from recordings import Floats, text_of


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Recording]:
    """Returns the recording of rows in a file."""

    def read(mm: Floats, force: Floats, head: str = "mm,gf") -> Recording:
        (tmp_path / "recording.csv").write_text(text_of(mm, force, head), encoding="utf-8")
        return recording_of([read_table(str(tmp_path / "recording.csv"))])

    return read
