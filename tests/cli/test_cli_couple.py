"""`hapsim couple`: what it prints can be put into the file, and is then stable."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]


def test_the_printed_modules_can_be_put_into_the_file(hapsim: Hapsim, scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    found = hapsim("couple", scene)
    (first,) = hapsim("couple", scene, "--json").document["hands"]
    assert found.status == 0
    assert "In this scene it is." in found.out
    modules = found.out.partition("add under modules:\n")[2]
    assert "type: proxy" in modules
    text = scene.read_text("utf-8")
    between = "between:\n    - hand\n"
    assert between in text
    scene.write_text(text.replace(between, between.replace("hand", "hand_proxy")) + modules, "utf-8")
    (part,) = hapsim("check", scene, "--json").document["parts"]
    assert (part["device_points"], part["any_hand"]["passive"]) == (["hand"], True)
    assert part["any_hand"]["needed_friction"][0] == pytest.approx(first["needed_friction"], rel=1e-5)
    assert first["any_hand"]["stiffness"] == pytest.approx(4.0 * first["friction"] / (27.0**0.5 * 1e-3), rel=1e-9)
    assert first["this_hand"]["stiffness"] > first["any_hand"]["stiffness"]
    assert first["present"] is None


def test_a_coupling_in_the_scene_is_judged(hapsim: Hapsim, scene_file: SceneFile) -> None:
    cup = {"type": "proxy", "hand": "hand", "mass": 0.02, "stiffness": 900.0, "damping": 0.3}
    at_cup = {"type": "viscoelastic", "between": ["cup", "wall"], "stiffness": 2000.0, "damping": 5.0}
    stiff = scene_file("spring", more={"cup": cup, "touch": at_cup})
    text = hapsim("couple", stiff).words
    (one,) = hapsim("couple", stiff, "--json").document["hands"]
    needed = one["present"]["needed_friction"]
    assert needed > one["friction"]
    assert f"needs a friction of {needed:.6g} N·s/m (declared: {one['friction']:g}) for any hand" in text
    assert "In this scene it is." in text
    assert "(in the scene)" in text
    assert "add under modules" not in text
    ball = {"type": "mass", "mass": 0.05}
    tied = {"type": "viscoelastic", "between": ["cup", "ball"], "stiffness": 500.0, "damping": 1.0}
    moved = scene_file("spring", more={"cup": cup, "touch": at_cup, "ball": ball, "tied": tied})
    text = hapsim("couple", moved).words
    (one,) = hapsim("couple", moved, "--json").document["hands"]
    (part,) = hapsim("check", moved, "--json").document["parts"]
    assert one["needed_friction"] == part["any_hand"]["needed_friction"][0]
    assert f"The friction that the scene needs for any hand is {one['needed_friction']:.6g} N·s/m" in text


def test_a_dash_is_explained(hapsim: Hapsim, scene_file: SceneFile) -> None:
    text = hapsim("couple", scene_file("spring")).words
    assert "–: no felt k and b, because the slowest motion creeps and the next one oscillates" in text


def test_what_cannot_be_coupled_is_refused(hapsim: Hapsim, scene_file: SceneFile) -> None:
    refused = hapsim("couple", scene_file("spring"), "--proxy-mass", "-1").refusal
    assert "--proxy-mass: found -1, expected a finite number of kg above 0" in refused
    refused = hapsim("couple", "bell")
    assert (refused.status, "substeps: found 44, expected 1" in refused.err) == (2, True)
    knob = hapsim("couple", "knob_24")
    assert knob.status == 0
    assert "Not every link of the scene can end on a proxy. detent.between: " in " ".join(knob.out.split())
