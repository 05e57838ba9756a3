"""First help for an unstable scene: each change by itself makes it stable, and hardly less of it does not."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from hapsim import predict
from hapsim.cli.check import check_lines
from hapsim.prediction.first_help import Help, first_help, ways_to_stability
from hapsim.running.requirements import refusal_to_arm
from hapsim.scene import Scene
from hapsim.scene.shipped import shipped_scene
from hapsim.theory.network import SURELY
from tests.correction.test_correction_scenes import link, scene_of

FAST = [[-1.0, -1.0], [-0.001, -1.0], [-0.0009, 0.0], [0.0009, 0.0], [0.001, 1.0], [1.0, 1.0]]
"""Karnopp's friction as a table over velocity: none at rest, and then so much that the loop is unstable."""
KARNOPP = {"rub": {"type": "nonlinear", "between": ["hand", "wall"], "force_over_velocity": FAST}}
CHAIN = {
    "m": {"type": "mass", "mass": 0.05},
    "touch": link(("hand", "m"), 9000.0, 3.0),
    "end": link(("m", "wall"), 4000.0, 1.0, "buffer"),
}
BUFFER = {"buffer": link(("hand", "wall"), 10000.0, 5.0, "buffer")}
ADAPTIVE = {"correction": "adaptive", "mass": {"from": 0.05, "to": 1.0}}


def changed(scene: Scene, one: Help, factor: float) -> Scene:
    """The scene as a user would write it."""
    if one.what == "rate":
        return scene.model_copy(update={"rate": factor * scene.rate})
    if one.what == "mass":
        device = scene.device.model_copy(update={"mass": factor * 0.2})
        return scene.model_copy(update={"device": device})
    modules = dict(scene.modules)
    old = modules[one.name]
    if hasattr(old, "force_over_velocity"):
        more: dict[str, Any] = {"force_over_velocity": [(v, factor * f) for v, f in old.force_over_velocity]}
    else:
        more = {one.what: factor * getattr(old, one.what)}
    modules[one.name] = old.model_copy(update=more)
    return scene.model_copy(update={"modules": type(scene.modules)(modules)})


@pytest.mark.parametrize(
    ("modules", "device", "whats"),
    [
        (KARNOPP, {}, {"damping"}),
        (CHAIN, {}, {"stiffness", "damping", "rate", "mass"}),
        (BUFFER, ADAPTIVE, {"stiffness", "damping", "rate"}),
    ],
)
def test_each_change_is_enough_and_hardly_more_than_that(
    modules: dict[str, Any], device: dict[str, Any], whats: set[str]
) -> None:
    scene = scene_of(modules, **device)
    prediction = predict(scene, with_margins=False)
    assert prediction.spectral_radius > SURELY
    found = first_help(prediction)
    assert {one.what for one in found} <= whats
    assert found
    for one in found:
        assert predict(changed(scene, one, one.factor), with_margins=False).spectral_radius <= SURELY
        less = one.factor**0.98
        assert predict(changed(scene, one, less), with_margins=False).spectral_radius > SURELY
        assert one.name in ways_to_stability(prediction)


def test_of_a_scene_in_the_plane_each_change_is_tried_in_the_file() -> None:
    disc = yaml.safe_load(shipped_scene("disc"))
    disc["modules"]["disc"]["stiffness"] *= 30.0
    prediction = predict(scene := Scene.model_validate(disc), with_margins=False)
    (one,) = first_help(prediction)
    assert (one.what, one.name) == ("stiffness", "disc")
    assert predict(changed(scene, one, one.factor), with_margins=False).judge.shaking is None
    assert predict(changed(scene, one, one.factor**0.98), with_margins=False).judge.shaking is not None
    assert f"{one.factor:.3f}"[:4] in ways_to_stability(prediction)
    assert ways_to_stability(prediction) in " ".join(map(str, check_lines(scene, prediction, None, explain=False)))


def test_the_changes_are_in_the_answer_of_check_and_in_the_refusal_to_run() -> None:
    scene = scene_of(CHAIN, force_limit=10.0)
    prediction = predict(scene)
    sentence = ways_to_stability(prediction)
    assert "N·s/m)" in sentence
    assert sentence in refusal_to_arm("chain.yaml", scene, prediction)
    lines = " ".join(str(one) for one in check_lines(scene, prediction, None, explain=False))
    assert sentence in lines


def test_a_stable_scene_needs_none() -> None:
    assert not first_help(predict(scene_of({"touch": link(("hand", "wall"), 100.0, 1.0)}), with_margins=False))


def test_a_hand_that_is_unstable_in_a_state_of_its_contacts_is_not_called_passive() -> None:
    """At rest the friction has no slope, and nothing is needed; while it slides fast the scene is unstable."""
    prediction = predict(scene_of(KARNOPP), with_margins=False)
    (part,) = prediction.parts
    assert prediction.verdict == "unstable"
    assert part.any_hand.needed[0] == 0.0
    assert part.any_hand.grows == "rub is fast"
    assert part.passive is False
