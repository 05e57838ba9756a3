"""Scenes to call the command line with."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from hapsim.stopping import STOPS

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
        "ball": {"type": "cell", "mass": 1e-12, "stiffness": 1e12, "velocity": 1.0},  # grows in every substep
        "touch": SPRING | {"between": ["hand", "ball"]},
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


@pytest.fixture(autouse=True)
def _signals_stay() -> Iterator[None]:
    """Handlers are as before after each test."""
    before = {number: signal.getsignal(number) for number in STOPS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> int:
    """The number of states above which a scene counts as large: fewer than usual."""
    for module in ("theory.sample", "prediction.states", "prediction.swings"):
        monkeypatch.setattr(f"hapsim.{module}.LARGE", 200)
    return 200


@pytest.fixture
def coarse_planes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts of the plane have few points: for tests that compare them."""
    from hapsim.chart import plane_curves

    mesh = plane_curves.Sheet.mesh
    monkeypatch.setattr(plane_curves.Sheet, "mesh", lambda sheet, coarse=1: mesh(sheet, 8 * coarse))
    monkeypatch.setattr(plane_curves, "_FINE", 0.05)
    monkeypatch.setattr("hapsim.chart.admittance_plane._POINTS", (12, 6))


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes one of the scenes above. `touch`: changes of its link; `more`: more modules; `device`: its keys."""

    def write(name: str, *, rate: float = 1000.0, touch: Any = None, more: Any = None, **device: Any) -> Path:
        path, modules = tmp_path / f"{name}.yaml", MODULES[name] | (more or {})
        if touch:
            modules |= {"touch": modules["touch"] | touch}
        given = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | device
        document = {"version": 1, "rate": rate, "device": given, "modules": modules}
        document |= {"substeps": 1000} if name == "no_number" else {}
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return path

    return write


@pytest.fixture
def explained(hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], Any]:
    """Returns the answer of `check --explain` about a scene's prediction, without compiling it."""
    monkeypatch.setattr("hapsim.cli.check._explanation", lambda _: None)
    return lambda path: hapsim("check", path, "--explain")


@pytest.fixture
def checked(hapsim: Callable[..., Any]) -> Callable[[Path], dict[str, Any]]:
    """Returns what `check --json` prints of a scene."""

    def check(path: Path) -> dict[str, Any]:
        answer = hapsim("check", path, "--json")
        assert (answer.status, answer.err) == (0, "")
        document: dict[str, Any] = answer.document
        return document

    return check


@pytest.fixture(params=[name for name in MODULES if name != "no_number"])
def every_scene(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name
