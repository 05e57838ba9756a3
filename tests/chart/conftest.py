"""`hapsim chart …` as a user calls it, in a directory of its own; scenes and configurations to draw."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml


@pytest.fixture
def chart(hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Any]:
    """Calls `hapsim chart …` in an empty directory and tells what came of it."""
    monkeypatch.chdir(tmp_path)

    def call(*words: object) -> Any:
        answer = hapsim("chart", *words)
        assert "Traceback" not in answer.err
        assert "defect" not in answer.err
        return answer

    return call


@pytest.fixture
def coarse_felt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Computes the felt chart at a tenth of its points, for a few masses and delays."""
    monkeypatch.setattr("hapsim.chart.felt_chart._POINTS", (45, 23))
    monkeypatch.setattr("hapsim.chart.felt_chart._POINTS_OF_A_SHARE", (20, 10))
    few_masses_and_delays(monkeypatch)


def few_masses_and_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves a few of the felt chart."""
    monkeypatch.setattr("hapsim.chart.felt_chart._MASSES", np.array([0.5, 0.75, 0.95, 1.0, 1.05, 1.4, 2.0]))
    monkeypatch.setattr("hapsim.chart.felt_chart._DELAYS", np.array([0.0, 0.5, 1.0, 2.0, 3.0]))


@pytest.fixture
def rows_of() -> Callable[[str], list[dict[str, str]]]:
    """Reads a data file."""

    def read(name: str) -> list[dict[str, str]]:
        with Path(name).open(newline="", encoding="utf-8") as stream:
            return list(csv.DictReader(stream))

    return read


@pytest.fixture
def columns_of(rows_of: Callable[[str], list[dict[str, str]]]) -> Callable[[str], dict[str, Any]]:
    """Reads the columns of a data file that has numbers alone."""

    def read(name: str) -> dict[str, Any]:
        rows = rows_of(name)
        return {column: np.array([float(row[column]) for row in rows]) for column in rows[0]}

    return read


WALL = {"type": "ground"}
TOUCH = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 2000.0, "damping": 5.0}
MODULES: dict[str, dict[str, Any]] = {
    "nothing": {},
    "spring": {"touch": TOUCH},
    "damper": {"touch": TOUCH | {"stiffness": 0.0}},
    "stiff": {"touch": TOUCH | {"stiffness": 4.2e5}},
    "two_hands": {
        "other": {"type": "device", "channel": 1},
        "touch": TOUCH,
        "hold": TOUCH | {"between": ["other", "wall"], "stiffness": 500.0},
    },
    "coupled": {
        "ball": {"type": "mass", "mass": 0.05},
        "touch": TOUCH | {"between": ["hand", "ball"]},
        "hold": TOUCH | {"between": ["ball", "wall"]},
    },
}


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes one of the scenes above."""

    def write(name: str, **device: Any) -> Path:
        path = tmp_path / f"{name}.yaml"
        modules = {"hand": {"type": "device", "channel": 0}, "wall": WALL} | MODULES[name]
        given = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | device
        document = {"version": 1, "rate": 1000.0, "device": given, "modules": modules}
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return path

    return write
