"""The command line, called in this process as the console script calls it; and scenes to call it with."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from hapsim import cli


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
    def sentence(self) -> str:
        """Standard error after a failure: no traceback, no defect of ours, nothing on standard output."""
        assert "Traceback" not in self.err
        assert "defect" not in self.err
        assert self.out == ""
        return self.err


@pytest.fixture
def hapsim(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """Calls `hapsim …` and tells what came of it."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("HAPSIM_TRACEBACK", raising=False)

    def call(*words: object) -> Answer:
        monkeypatch.setattr("sys.argv", ["hapsim", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        captured = capfd.readouterr()
        return Answer(int(caught.value.code or 0), captured.out, captured.err)

    return call


WALL = {"type": "ground"}
SPRING = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 1000.0, "damping": 5.0}
MODULES: dict[str, dict[str, Any]] = {
    "spring": {"hand": {"type": "device", "channel": 0}, "wall": WALL, "touch": SPRING},
    "unstable": {"hand": {"type": "device", "channel": 0}, "wall": WALL, "touch": SPRING | {"stiffness": 50000.0}},
    "damper": {"hand": {"type": "device", "channel": 0}, "wall": WALL, "touch": SPRING | {"stiffness": 0.0}},
    "free": {"hand": {"type": "device", "channel": 0}},
    "no_number": {
        "hand": {"type": "device", "channel": 0},
        "wall": WALL,
        "touch": SPRING | {"stiffness": 1e308, "damping": 1e308},
    },
    "channel_3": {"hand": {"type": "device", "channel": 3}, "wall": WALL, "touch": SPRING},
    "two_hands": {
        "hand": {"type": "device", "channel": 0},
        "other": {"type": "device", "channel": 1},
        "wall": WALL,
        "touch": SPRING,
        "hold": SPRING | {"between": ["wall", "other"], "stiffness": 500.0, "damping": 2.0},
    },
    "hand_in_hand": {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "device", "channel": 1},
        "touch": SPRING,
    },
    "mass": {
        "hand": {"type": "device", "channel": 0},
        "ball": {"type": "mass", "mass": 0.05},
        "wall": WALL,
        "touch": SPRING | {"between": ["hand", "ball"], "stiffness": 500.0},
        "hold": SPRING | {"between": ["ball", "wall"], "stiffness": 500.0},
    },
    "mass_on_channel_2": {
        "hand": {"type": "device", "channel": 2},
        "ball": {"type": "mass", "mass": 0.05},
        "wall": WALL,
        "touch": SPRING | {"between": ["hand", "ball"], "stiffness": 500.0},
        "hold": SPRING | {"between": ["ball", "wall"], "stiffness": 500.0},
    },
}


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes one of the scenes above."""

    def write(name: str, *, rate: float = 1000.0, **device: Any) -> Path:
        path = tmp_path / f"{name}.yaml"
        given = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | device
        document = {"version": 1, "rate": rate, "device": given, "modules": MODULES[name]}
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return path

    return write


@pytest.fixture(params=[name for name in MODULES if name != "no_number"])
def every_scene(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name
