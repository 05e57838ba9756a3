"""Scenes that are valid in form, with one odd value, as `tools/bench/mutated_scenes odd` makes them: each is refused at
its line, or checked and run to a status that USING.md names, without a warning."""

from __future__ import annotations

import json
from typing import Any

import pytest
import yaml

from hapsim.prediction import plane_states, predict
from hapsim.scene import load_scene
from hapsim.scene.shipped import shipped_scene
from tests.loaded_files import BENCHES, module_of

SHORT = 0.01  # s, of a run


@pytest.fixture(scope="module")
def bench() -> Any:
    return module_of(BENCHES / "mutated_scenes.py")


@pytest.fixture(scope="module")
def odd(bench: Any) -> list[bytes]:
    found: list[bytes] = bench.odd_files(seed=1)
    return found


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("part", range(2))
def test_an_odd_scene_has_no_finding(bench: Any, odd: list[bytes], part: int) -> None:
    loaded = 0
    for i, data in enumerate(odd[part :: len(odd) // 24]):
        outcomes = bench.tried(data, runs=i % 4 == 0, duration=SHORT)
        assert [one.finding for one in outcomes if one.finding] == [], data
        loaded += outcomes[0].name == "loaded"
    assert loaded > 3


LATE = ("device", "delay")


@pytest.mark.parametrize(
    ("scene", "path", "value", "ended"),
    [
        ("knob_24", ("modules", "knob", "type"), ["device"], ["refused"]),
        ("knob_24", ("modules", "knob", "type"), {}, ["refused"]),
        ("paper_6_2_one_sample", LATE, 1e-12, ["loaded", "check: 0", "run: 0"]),
        ("paper_6_2_one_sample", LATE, 1.0 - 1e-12, ["loaded", "check: 0", "run: 0"]),
        ("toggle", ("device", "friction"), 1e12, ["loaded", "check: 0", "run: 0"]),
        ("fader", ("device", "friction"), 1e12, ["loaded", "check: 0", "run: 0"]),
        ("bowed_string", ("device", "mass"), 1e308, ["refused"]),
        ("disc", ("modules", "disc", "form"), {"disc": 5e-324}, ["refused"]),
        ("first_touch", ("rate",), 1e12, ["loaded", "check: 0", "run: 2"]),
        ("first_touch", ("rate",), 1e-12, ["loaded", "check: 0", "run: 2"]),
    ],
)
def test_what_crashed_once_ends_as_it_should(
    bench: Any, scene: str, path: tuple[str, ...], value: Any, ended: list[str]
) -> None:

    document = bench._replaced(yaml.safe_load(shipped_scene(scene)), path, value)
    outcomes = bench.tried(json.dumps(document).encode(), duration=SHORT)
    assert ([one.name for one in outcomes], [one.finding for one in outcomes if one.finding]) == (ended, [])


def test_places_of_the_plane_that_would_take_too_long_are_not_called_stable(monkeypatch: pytest.MonkeyPatch) -> None:
    maze = load_scene("maze")
    whole = predict(maze, with_margins=False)
    assert (whole.verdict, whole.states.unjudged, whole.states.count) == ("stable", 0, 10)
    monkeypatch.setattr(plane_states, "_WORK", 0.0)
    part = predict(maze, with_margins=False)
    assert (part.verdict, part.states.unjudged, part.states.count) == ("not judged", 9, 10)
