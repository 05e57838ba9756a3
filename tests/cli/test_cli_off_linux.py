"""hapsim where there is no Linux: what needs no real time works, the rest says so (see another_system.py)."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hapsim.recording.trace import load_trace

ANOTHER_SYSTEM = Path(__file__).with_name("another_system.py")
Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

IMPORT_EVERYTHING = """
import importlib, pkgutil, sys
sys.path.insert(0, sys.argv[1])
import another_system
another_system.become_another_system()
for name in ("hapsim", "firmware_protocol"):
    package = importlib.import_module(name)
    for found in pkgutil.walk_packages(package.__path__, name + "."):
        if not found.name.endswith("__main__"):
            importlib.import_module(found.name)
print(len([name for name in sys.modules if name.startswith(("hapsim.", "firmware_protocol."))]))
"""


def python(*words: object, given: str = "") -> str:
    """Returns the output of a new Python process."""
    answer = subprocess.run(
        [sys.executable, *map(str, words)], input=given, capture_output=True, text=True, check=False, timeout=300
    )
    assert answer.returncode == 0, answer.stderr[-2000:]
    return answer.stdout


def elsewhere(*commands: Sequence[object]) -> list[tuple[int, str, str]]:
    """(status, output, errors) of each `hapsim …`, all in one process on another system."""
    given = json.dumps([list(map(str, words)) for words in commands])
    return [tuple(answer) for answer in json.loads(python(ANOTHER_SYSTEM, given=given))]


def done(*commands: Sequence[object]) -> list[str]:
    """Returns the outputs of commands, all of which must succeed."""
    answers = elsewhere(*commands)
    for words, (status, _, errors) in zip(commands, answers, strict=True):
        assert status == 0, (words, errors[-2000:])
        assert "armed" not in errors
    return [output for _, output, _ in answers]


def test_everything_can_be_imported() -> None:
    assert int(python("-c", IMPORT_EVERYTHING, ANOTHER_SYSTEM.parent)) > 200


def test_what_needs_no_real_time_works(hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path) -> None:
    """The portable loop sends the forces of the compiled one in memory. It runs to its end on a port and on the mock in
    real time, without being asked for."""
    scene, picture, first = scene_file("spring"), tmp_path / "plane.svg", tmp_path / "first.yaml"
    briefly = ("--duration", 0.2, "--unstable", "--json")
    runs = {}
    for clock, rate in (("lockstep", 1000.0), ("device", 100.0), ("host", 100.0)):  # at 100 Hz the spring is too stiff
        runs[clock, rate] = scene_file("spring", clock=clock, rate=rate).rename(tmp_path / f"{clock}.yaml")
    told = done(
        ("--help",),
        ("--version",),
        ("check", scene_file("spring"), "--json"),
        ("chart", "plane", scene, "--picture", picture),
        ("new", first),
        ("schema",),
        ("ports", "--json"),
        ("compile", runs["device", 100.0]),
        ("measure", scene, "--json", "--record", tmp_path / "there.npz"),
        *(("run", path, "--port", "COM3", *briefly) for path in runs.values()),
        *(("run", path, *briefly) for path in runs.values()),
        ("run", runs["lockstep", 1000.0], "--portable", *briefly),
    )
    for part, said in zip(("Commands", "numba", '"stable": true', "Picture", "Wrote"), told[:5], strict=True):
        assert part in said
    assert picture.stat().st_size > 10_000
    assert yaml.safe_load(first.read_text(encoding="utf-8"))["version"] == 1
    assert json.loads(told[5])["type"] == "object"
    assert json.loads(told[6])["ports"][0]["port"] == "COM3"
    assert "kept in" in told[7]
    measured = json.loads(told[8])
    assert measured["measured"]["k"] == pytest.approx(measured["predicted"]["k"], rel=1e-5)
    for (clock, rate), said in zip([*runs, *runs, next(iter(runs))], told[9:], strict=True):
        report = json.loads(said)
        assert report["ending"] == "done"
        assert report["ticks"] == round(0.2 * rate) or (report["duration_s"] > 0.2 and clock != "lockstep")
    assert hapsim("measure", scene, "--record", tmp_path / "here.npz").status == 0
    here, there = load_trace(tmp_path / "here.npz"), load_trace(tmp_path / "there.npz")
    for name in ("sample", "flags", "position_counts", "force_counts", "asked_force"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))


def test_what_takes_linux_states_it_in_a_sentence(scene_file: SceneFile, tmp_path: Path) -> None:
    device = scene_file("spring", clock="device").rename(tmp_path / "device.yaml")
    lockstep = scene_file("spring")
    mock = "the mock on a pseudo-terminal takes Linux"
    refused = {
        ("mock", lockstep): mock,
        ("run", lockstep, "--realtime"): "--realtime takes Linux",
        ("doctor", device): "hapsim doctor, which examines the compiled loop, takes Linux",
    }
    for told, (status, output, errors) in zip(refused.values(), elsewhere(*refused), strict=True):
        assert (status, output) == (2, "")
        *before, sentence = errors.splitlines()
        assert sentence.startswith(f"{told}; this system (freebsd14) has no clock_gettime, ")
        assert not [line for line in before if not line.startswith("Warning: ")]
