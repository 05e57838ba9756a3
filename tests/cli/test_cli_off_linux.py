"""hapsim where there is no Linux: what needs no real time works, the rest says so (see another_system.py)."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
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


def elsewhere(*words: object) -> subprocess.CompletedProcess[str]:
    """`hapsim …` on another system."""
    command = [sys.executable, str(ANOTHER_SYSTEM), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


def done(*words: object) -> str:
    """What a command printed that did as asked."""
    answer = elsewhere(*words)
    assert answer.returncode == 0, answer.stderr[-2000:]
    assert "armed" not in answer.stderr
    return answer.stdout


def test_everything_can_be_imported() -> None:
    command = [sys.executable, "-c", IMPORT_EVERYTHING, str(ANOTHER_SYSTEM.parent)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert answer.returncode == 0, answer.stderr[-2000:]
    assert int(answer.stdout) > 200


def test_what_needs_no_loop_works(scene_file: SceneFile, tmp_path: Path) -> None:
    scene, picture, first = scene_file("spring"), tmp_path / "plane.svg", tmp_path / "first.yaml"
    assert "Commands" in done("--help")
    assert "numba" in done("--version")
    assert json.loads(done("check", scene, "--json"))["stable"] is True
    assert "Picture" in done("chart", "plane", scene, "--picture", picture)
    assert picture.stat().st_size > 10_000
    assert "Wrote" in done("new", first)
    assert yaml.safe_load(first.read_text(encoding="utf-8"))["version"] == 1
    assert json.loads(done("schema"))["type"] == "object"
    assert json.loads(done("ports", "--json"))["ports"][0]["port"] == "COM3"


def test_in_memory_the_loop_in_python_sends_the_forces_of_the_compiled_one(
    hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path
) -> None:
    scene = scene_file("spring")
    measured = json.loads(done("measure", scene, "--json", "--record", tmp_path / "there.npz"))
    assert measured["measured"]["k"] == pytest.approx(measured["predicted"]["k"], rel=1e-5)
    assert hapsim("measure", scene, "--record", tmp_path / "here.npz").status == 0
    here, there = load_trace(tmp_path / "here.npz"), load_trace(tmp_path / "there.npz")
    for name in ("sample", "flags", "position_counts", "force_counts", "asked_force"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))


@pytest.mark.parametrize(("clock", "rate"), [("lockstep", 1000.0), ("device", 100.0), ("host", 100.0)])
def test_the_portable_loop_runs_on_a_port_to_its_end(scene_file: SceneFile, clock: str, rate: float) -> None:
    scene = scene_file("spring", clock=clock, rate=rate)  # at 100 Hz the spring is too stiff
    told = done("run", scene, "--portable", "--port", "COM3", "--duration", 0.2, "--unstable", "--json")
    report = json.loads(told)
    assert report["ending"] == "done"
    assert report["ticks"] == round(0.2 * rate) or (report["duration_s"] > 0.2 and clock != "lockstep")


def test_what_can_be_there_is_compiled_ahead(scene_file: SceneFile) -> None:
    assert "kept in" in done("compile", scene_file("spring", clock="device"))


@pytest.mark.parametrize(
    ("words", "clock", "told"),
    [
        (["run"], "device", "the mock on a pseudo-terminal takes Linux"),
        (["run", "--portable"], "lockstep", "the mock on a pseudo-terminal takes Linux"),
        (["mock"], "lockstep", "the mock on a pseudo-terminal takes Linux"),
        (["run", "--port", "COM3"], "device", "the compiled loop on a port takes Linux"),
        (["run", "--realtime"], "lockstep", "--realtime takes Linux"),
        (["doctor"], "device", "hapsim doctor, which examines the compiled loop, takes Linux"),
    ],
)
def test_what_takes_linux_says_so_in_a_sentence(scene_file: SceneFile, words: list[str], clock: str, told: str) -> None:
    command, *options = words
    answer = elsewhere(command, scene_file("spring", clock=clock), *options)
    assert (answer.returncode, answer.stdout) == (2, "")
    *before, sentence = answer.stderr.splitlines()
    assert sentence.startswith(f"{told}; this system (freebsd14) has no clock_gettime, ")
    assert not [line for line in before if not line.startswith("Warning: ")]
