"""Quick judgement of a stream of changes: it never accepts a scene that its poles reject."""

from __future__ import annotations

import json
import random
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

import hapsim
from hapsim.errors import UsageError
from hapsim.prediction import Prediction, Shaking, surely_shaken_by
from hapsim.prediction.memory import VERDICTS
from hapsim.prediction.predict import is_soon_stable, prediction_of
from hapsim.prediction.swings import NetworkVerdict
from hapsim.running import changes
from hapsim.scene import Scene, load_scene, parse_scene
from hapsim.scene.section import Table
from hapsim.scene.shipped import shipped_scenes
from hapsim.theory.network import LARGE
from hapsim.units import LINEAR
from tests import piecewise_scenes, substep_scenes

#: Slow to predict in full, often; and of several devices, which change together.
SLOW = ("struck_membrane", "bowed_string", "knob_24", "two_devices")
NAMES = [name for name in shipped_scenes() if name not in SLOW]
KEYS = ("stiffness", "damping", "position", "force", "depth")


def varied(scene: Scene, chance: random.Random) -> Scene:
    """Returns the scene with some module values multiplied, most by little, some by a lot."""
    modules = dict(scene.modules)
    for name, module in modules.items():
        new = {
            key: getattr(module, key) * 10.0 ** chance.choice((0.1 * chance.random(), chance.uniform(-1.5, 2.0)))
            for key in KEYS
            if isinstance(getattr(module, key, None), float)
        }
        modules[name] = module.model_copy(update=new)
    device = scene.device.model_copy(update={"delay": chance.choice((0.0, 0.5, 1.0, 2.0))})
    return scene.model_copy(update={"modules": Table(modules), "device": device})


def by_poles(scene: Scene) -> Shaking | None:
    """Returns the unstable motion by every pole, without squares of the transition."""
    VERDICTS.clear()
    with patch.object(NetworkVerdict, "decays", new=False):
        shaking = prediction_of(scene, wherever=True).judge.shaking
    VERDICTS.clear()
    return shaking


def require_one_verdict(scene: Scene) -> tuple[bool, bool]:
    """Returns whether the scene was quickly found stable, and whether it is unstable."""
    soon, shaking = is_soon_stable(scene, LARGE), by_poles(scene)
    assert surely_shaken_by(scene) == shaking
    assert not (soon and shaking is not None)
    return soon, shaking is not None


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("name", NAMES)
def test_what_is_quickly_accepted_shakes_no_hand(name: str) -> None:
    chance = random.Random(name)
    scene = load_scene(name)
    found = [require_one_verdict(varied(scene, chance)) for _ in range(2)]
    # In the plane every place where links touch is judged, which is never soon.
    assert is_soon_stable(scene, LARGE) is (scene.space == 1)
    assert any(soon or shakes for soon, shakes in found)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("kind", ["one hand in regions", *substep_scenes.KINDS])
def test_of_random_scenes_none_is_quickly_accepted_that_shakes(kind: str) -> None:
    draw, found = np.random.default_rng(len(kind)), []
    for seed in range(8 if kind in substep_scenes.KINDS else 5):  # the latter cost ten times as much
        if kind in substep_scenes.KINDS:
            document = substep_scenes._document(draw, kind)
        else:
            document = piecewise_scenes.random_scene(seed)
        for module in document["modules"].values():
            if "stiffness" in module:
                module["stiffness"] *= 4.0 ** draw.integers(0, 4)
        scene = parse_scene(json.dumps(document))
        soon, shakes = require_one_verdict(scene)
        prediction = hapsim.predict(scene, with_margins=False)
        assert not (prediction.stable and shakes)
        assert prediction.stable or prediction.trembles or not soon
        found.append((soon, shakes))
    assert {(True, False), (False, True)} <= set(found)


def test_a_stream_of_changes_is_judged_without_a_prediction(monkeypatch: pytest.MonkeyPatch) -> None:
    def predicted(*_: Any) -> None:
        raise AssertionError("a prediction, which takes long")

    monkeypatch.setattr(changes, "require_not_less_stable", predicted)
    scene = load_scene("four_keys")
    lockstep = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
    with hapsim.start(lockstep, unstable=False) as session:
        for stiffness in (100.0, 150.0, 200.0):
            session.set({"c-spring": {"stiffness": stiffness}, "rest": {"position": 1e-6 * stiffness}})
        session.set({"mock.hand": {"force": 1.0}})
        monkeypatch.undo()
        with pytest.raises(UsageError, match="predicted unstable"):
            session.set({"c-spring": {"stiffness": 1e6}})
        assert session.scene.links["c-spring"].stiffness == 200.0  # type: ignore[attr-defined]


def test_a_damper_that_shakes_a_hand_without_a_spring_is_not_accepted() -> None:
    scene = load_scene("first_touch")
    for damping, is_stable in ((5.0, True), (1e4, False)):
        touch = scene.modules["touch"].model_copy(update={"stiffness": 0.0, "damping": damping})
        braked = scene.model_copy(update={"modules": Table({**scene.modules, "touch": touch})})
        assert Prediction(braked).judge.is_soon_stable(LARGE) is is_stable
        assert (surely_shaken_by(braked) is None) is is_stable


@pytest.mark.parametrize("stiffness", [1e6, 1e8, 1e10, 1e12])
def test_what_grows_beyond_all_numbers_is_refused(stiffness: float) -> None:
    scene = changes.changed(load_scene("plucked_string"), {"pick": {"stiffness": stiffness}})  # 48 substeps
    shaking = surely_shaken_by(scene)
    assert shaking is not None
    assert shaking.growth > 1e50
    assert "grows" in shaking.sentence(LINEAR)


@pytest.mark.parametrize("change", [{"touch": {"damping": 1e308}}, {"mock.hand": {"position": -1e13}}])
def test_what_no_device_has_is_refused(change: Any) -> None:
    scene = load_scene("first_touch")
    lockstep = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
    (part, values), *_ = change.items()
    with hapsim.start(lockstep) as session:
        with pytest.raises(UsageError, match=rf"{part}\.{next(iter(values))}: found .* at most 1e\+12 in size"):
            session.set(change)
        assert session.scene.modules == scene.modules
