"""`when` of links and of the motor in a scene's file: what it names, and what it does not go with."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from hapsim.errors import SceneError
from hapsim.scene import Scene, parse_scene
from hapsim.scene.input_states import input_states
from hapsim.scene.modules import Link

WALL = {"type": "buffer", "between": ["hand", "post"], "stiffness": 1000.0, "when": "touch"}
SPRING = {"type": "spring", "between": ["hand", "post"], "stiffness": 100.0}
DISC = {"type": "shape", "between": ["hand", "post"], "form": {"disc": 0.01}, "stiffness": 100.0}


def scene_of(modules: dict[str, Any], device: Any = None, count: int = 1, **more: Any) -> Scene:
    points = {"hand": {"type": "device", "channel": 0}, "post": {"type": "ground"}}
    if more.get("space") == 2:
        points["hand"] = {"type": "device", "channels": [0, 1]}
    inputs = {name: {"bit": i} for i, name in enumerate(["touch", "grip", "a", "b", "c"][:count])}
    document = {"version": 1, "rate": 1000, "device": {"mass": 0.2} | (device or {}), "inputs": inputs}
    return parse_scene(yaml.safe_dump(document | {"modules": points | modules} | more, sort_keys=False), "a.yaml")


@pytest.mark.parametrize(
    ("scene", "key", "words"),
    [
        (
            {"modules": {"wall": WALL | {"when": "tuch"}}},
            "when",
            "found 'tuch', expected the name of an input of this scene, such as inputs: {touch: {bit: 0}}; did you "
            "mean 'touch'?",
        ),
        ({"modules": {"wall": WALL | {"when": 3}}}, "when", "found 3, expected the name of an input"),
        (
            {"modules": {"wall": WALL}, "device": {"when": "hold"}},
            "when",
            "found 'hold', expected the name of an input of this scene",
        ),
        (
            {"modules": {"ball": {"type": "mass", "mass": 0.1, "when": "touch"}}},
            "when",
            "unknown key, expected type, mass",
        ),
        (
            {"modules": {"wall": WALL}, "device": {"correction": "predictor"}},
            "when",
            "found a gate with correction: predictor, whose predictor follows the scene without it; expected "
            "correction: none, poles or sensed",
        ),
        (
            {"modules": {"wall": WALL, "soft": SPRING}, "device": {"correction": "poles"}},
            "soft",
            "found no when, unlike a link of 'hand' before it, and correction: poles is for all of them together; "
            "expected the same",
        ),
        (
            {"modules": {"one": DISC, "two": DISC | {"when": "touch"}, "three": DISC}, "space": 2},
            "two",
            "found when: touch, unlike a shape with the same ends before it, with which it is one surface; expected "
            "the same",
        ),
        (
            {"modules": {"cup": {"type": "proxy", "hand": "hand", "mass": 0.1, "stiffness": 50.0}},
             "device": {"when": "touch"}},
            "when",
            "found a motor with a gate in a scene with a proxy, expected none: write when at its links",
        ),
    ],
)  # fmt: skip
def test_a_gate_that_cannot_be_is_an_error_with_its_place(scene: dict[str, Any], key: str, words: str) -> None:
    with pytest.raises(SceneError) as error:
        scene_of(**scene)
    (line,) = str(error.value).splitlines()
    assert f": {key}: {words}" in line


def test_corrections_take_the_gates_that_are_worked_out() -> None:
    assert scene_of({"wall": WALL, "soft": SPRING | {"when": "touch"}}, {"correction": "poles"}).gated.keys() == {
        "wall",
        "soft",
    }


def test_a_scene_with_inputs_off_has_no_links_of_theirs_and_no_gates() -> None:
    scene = scene_of({"wall": WALL, "soft": SPRING, "other": SPRING | {"when": "grip"}}, count=2)
    found = scene.with_inputs(frozenset({"grip"}))
    assert [*found.modules] == ["hand", "post", "soft", "other"]
    assert not found.gated
    assert found.modules["soft"] is scene.modules["soft"]
    assert parse_scene(scene.to_yaml(), "b.yaml").gated == scene.gated


def test_without_its_motor_a_hand_drives_masses_and_feels_none() -> None:
    ball = {"type": "mass", "mass": 0.1}
    tied, hung = SPRING | {"between": ["hand", "ball"]}, SPRING | {"between": ["post", "ball"]}
    scene = scene_of({"ball": ball, "tied": tied, "hung": hung, "wall": WALL}, {"when": "touch"})
    found = scene.with_inputs(frozenset())
    links = {name: one.between for name, one in found.modules.items() if isinstance(one, Link)}
    assert links == {"tied": ("hand-held", "ball"), "hung": ("post", "ball")}
    assert found.device.when is None
    Scene.model_validate(found.document)


@pytest.mark.parametrize(("count", "states"), [(0, 0), (1, 1), (2, 3), (4, 15), (5, 11)])
def test_the_states_that_are_judged(count: int, states: int) -> None:
    names = ["touch", "grip", "a", "b", "c"][:count]
    scene = scene_of({name: SPRING | {"when": name} for name in names} or {"soft": SPRING}, count=5)
    found = input_states(scene)
    assert len({*found}) == len(found) == states
    assert frozenset(names) not in found
    assert not names or frozenset() in found
    for name in names:
        assert {frozenset({name}), frozenset(names) - {name}} - {frozenset(names)} <= {*found}
