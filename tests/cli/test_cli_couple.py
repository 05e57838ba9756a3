"""`hapsim couple`: what it prints can be put into the file, and is then stable."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]


def test_the_printed_modules_can_be_put_into_the_file(hapsim: Hapsim, scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    found = hapsim("couple", scene)
    assert found.status == 0
    modules = found.out.partition("add under modules:\n")[2]
    text = scene.read_text("utf-8")
    between = "between:\n    - hand\n"
    assert between in text
    scene.write_text(text.replace(between, between.replace("hand", "hand_proxy")) + modules, "utf-8")
    needed = re.search(r"this scene needs a friction of (\S+) N·s/m", " ".join(found.out.split()))
    assert needed is not None
    (part,) = hapsim("check", scene, "--json").document["any_hands"]
    assert (part["device_points"], part["passive"]) == (["hand"], True)
    assert part["needed_friction"][0] == pytest.approx(float(needed[1]), rel=1e-5)
    again = hapsim("couple", scene)
    assert (again.status, "found hand_coupling, so hand is coupled already" in again.err) == (2, True)
    (hand,) = hapsim("couple", scene_file("spring"), "--json").document["hands"]
    assert hand["any_hand"]["stiffness"] == pytest.approx(4.0 * hand["friction"] / (27.0**0.5 * 1e-3), rel=1e-9)
    assert hand["this_hand"]["stiffness"] > hand["any_hand"]["stiffness"]
    assert hand["needed_friction"] == pytest.approx(float(needed[1]), rel=1e-5)


def test_what_cannot_be_coupled_is_refused(hapsim: Hapsim, scene_file: SceneFile) -> None:
    scene = scene_file("spring")
    for words, sentence in (
        (("--proxy-mass", "1e-9"), "--proxy-mass: found 1e-09 kg, expected more than"),
        (("--proxy-mass", "-1"), "--proxy-mass: found -1, expected a finite number of kg above 0"),
    ):
        refused = hapsim("couple", scene, *words)
        assert refused.status == 2
        assert sentence in refused.err
    refused = hapsim("couple", "bell")
    assert (refused.status, "substeps: found 44, expected 1" in refused.err) == (2, True)
