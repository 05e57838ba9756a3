"""Runs of a device that follows lines (`law: board`): recorded, replayed to the last bit, kept and exported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.loop.ring import LINES
from hapsim.recording.trace import Trace, load_trace
from hapsim.replaying.export import Columns
from hapsim.replaying.replay import Record, compare
from hapsim.running import run
from hapsim.scene import Scene
from tests import one_hand

DETENTS = {"type": "detent", "pitch": 0.003, "depth": 1, "shape": "snap", "damping": 0.5}
CONTACT = {"type": "buffer", "stiffness": 3000, "damping": 2, "distance": -0.002}
SPRING = {"type": "viscoelastic", "stiffness": 2000, "damping": 5}
BODY = {
    "body": {"type": "mass", "mass": 0.5},
    "spring": {"type": "spring", "between": ["body", "wall"], "stiffness": 900},
}


def scene_of(link: dict[str, Any], **modules: Any) -> Scene:
    links = {"touch": {"between": ["hand", "wall"]} | link} | modules
    return one_hand.scene_of(links, device={"law": "board"}, mock={"initial": {"velocity": -0.2}})


DETENTS_TOO = pytest.param("detents", marks=pytest.mark.thorough)  # predicted in 3 s


@pytest.fixture(scope="module", params=["spring", "contact", "mass", DETENTS_TOO])
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Trace, Path]:
    scenes = {"spring": (SPRING, {}), "detents": (DETENTS, {}), "contact": (CONTACT, {})}
    link, modules = scenes.get(request.param, (SPRING | {"between": ["hand", "body"]}, BODY))
    path = tmp_path_factory.mktemp("lines") / "run.trace"
    return run(scene_of(link, **modules), duration=0.25, record=path), path


def test_every_number_of_a_line_is_replayed_to_the_last_bit(recorded: tuple[Trace, Path]) -> None:
    trace, path = recorded
    assert compare(Record(path), None, None, False).difference is None
    assert trace.line_counts["stiffness_counts"].any()
    assert trace.line_counts["acted_force"].any()


@pytest.mark.parametrize("recorded", ["contact"], indirect=True)
def test_a_replay_that_changes_only_a_stiffness_is_another_one(recorded: tuple[Trace, Path]) -> None:
    softer = compare(Record(recorded[1]), scene_of(CONTACT | {"stiffness": 2990}), None, False)
    assert softer.difference is not None


@pytest.mark.parametrize("ending", [".npz", ".trace"])
def test_a_saved_trace_keeps_its_lines(recorded: tuple[Trace, Path], tmp_path: Path, ending: str) -> None:
    trace, path = recorded
    trace.save(tmp_path / f"kept{ending}")
    for again in (load_trace(tmp_path / f"kept{ending}"), load_trace(path), trace.since(0)):
        assert again.line_counts.keys() == LINES.keys()
        for name, values in trace.line_counts.items():
            np.testing.assert_array_equal(again.line_counts[name], values)


@pytest.mark.parametrize("recorded", ["spring"], indirect=True)
def test_an_export_has_lines_in_si_units_and_the_force_that_acted(recorded: tuple[Trace, Path]) -> None:
    trace, path = recorded
    values = next(Columns(path).pieces())
    np.testing.assert_allclose(values["line_stiffness"], 2000.0, rtol=1e-3)
    np.testing.assert_allclose(values["line_damping"], 5.0, rtol=1e-3)
    np.testing.assert_allclose(values["line_force"], -2000.0 * trace.position, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(np.stack([values["line_low"], values["line_high"]])[..., 0].T, [[-10.0, 10.0]] * 250)
    middle = 0.5 * (trace.position[2:] + trace.position[1:-1])
    speed = np.diff(trace.position[1:], axis=0) * 1000.0
    np.testing.assert_allclose(values["force"][2:], -2000.0 * middle - 5.0 * speed, rtol=2e-3, atol=1e-4)
