"""While one scene takes over from another, the hand feels the mean of their forces, and an ordinary scene does, too."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import Program, compile_scene, positions_of
from hapsim.prediction import predict
from hapsim.prediction.mixture import PARTS, braked, mixture, shaken_while_taking_over
from hapsim.prediction.predict import prediction_of
from hapsim.running.compile_ahead import scenes_with_every_module
from hapsim.scene import DevicePoint, Scene, load_scene, parse_scene
from hapsim.scene.shipped import shipped_scenes
from hapsim.theory import Configuration

RATE = 1000.0
MOVED = 1e-9  # of the largest force


def fallback_of(scene: Scene) -> Scene:
    """A scene with a mass on the same hands, under another name."""
    place = [0.3, 0.2] if scene.space == 2 else 0.3
    hand = next(one for one in scene.modules.values() if isinstance(one, DevicePoint))
    modules = {
        "palm": hand.model_dump(exclude_none=True),
        "wall": {"type": "ground"},
        "bob": {"type": "mass", "mass": 0.5, "position": place},
        "rod": {"type": "viscoelastic", "between": ["palm", "bob"], "stiffness": 3.0, "damping": 0.2},
        "stop": {"type": "buffer", "between": ["palm", "wall"], "stiffness": 5.0, "distance": 0.5},
    }
    document = {"version": 1, "rate": scene.rate, "space": scene.space, "scheme": scene.scheme, "modules": modules}
    return parse_scene(json.dumps(document | {"device": {"mass": 1.0}}))


def played(scene: Scene, position: np.ndarray) -> tuple[np.ndarray, Program]:
    program, force, still = compile_scene(scene), np.zeros_like(position), np.zeros(position.shape[1])
    start(program, position[0])
    for n, measured in enumerate(position):
        tick(program, measured, still, force[n])
    return force, program


@pytest.mark.parametrize("at", [0, -1], ids=["line", "plane"])
@pytest.mark.parametrize("weight", [0.125, 0.7])
def test_every_module_has_its_share_and_every_mass_moves_as_before(at: int, weight: float) -> None:
    """On a hand that is moved: by the mixture, and by both scenes one after the other."""
    scene = [*scenes_with_every_module("double")][at]
    chance, ticks = np.random.default_rng(3), 300
    steps = chance.normal(0.0, 0.02, (ticks, scene.channels))
    position = 0.4 + np.cumsum(steps, axis=0) * np.exp(-np.arange(ticks) / 200.0)[:, None]
    fallback = fallback_of(scene)
    alone, program = played(scene, position)
    other, below = played(fallback, position)
    mixed, together = played(mixture(scene, fallback, weight), position)
    expected = (1.0 - weight) * alone + weight * other
    assert min(np.abs(alone).max(), np.abs(other).max()) > 0.1
    assert np.abs(mixed - expected).max() < MOVED * np.abs(expected).max()
    for one, prefix in ((program, ""), (below, "fallback_")):
        at, there = positions_of(one)[0], positions_of(together)[0]
        for name, number in one.numbers.items():
            if prefix + name in together.numbers:
                assert there[together.numbers[prefix + name]] == pytest.approx(at[number], rel=1e-9, abs=1e-12)


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("name", ["wall", "knob_24", "bell", "four_keys", "two_hands", "disc"])
def test_a_shipped_scene_can_be_left_for_dampers(name: str) -> None:
    scene = load_scene(name)
    fallback = braked(scene)
    assert shaken_while_taking_over(scene, fallback) is None
    if scene.space == 1:
        assert all(felt.passive is not False for felt in predict(fallback).felt)


def test_every_shipped_scene_has_dampers_that_its_friction_makes_passive() -> None:
    for name in shipped_scenes():
        if (scene := load_scene(name)).ports:  # which take no lease
            continue
        frictions = scene.device.frictions(scene.channels)
        for one in braked(scene).modules.values():
            damping = getattr(one, "damping", 0.0)
            assert 0.0 <= damping <= max(frictions) * (1.0 + 1e-12)


def hand(stiffness: float, damping: float, **more: Any) -> Scene:
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground"},
        "touch": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": stiffness, "damping": damping},
    }
    device = {"mass": 0.2, "friction": 0.5, "delay": 1}
    return parse_scene(json.dumps({"version": 1, "rate": RATE, "device": device, "modules": modules | more}))


def test_the_motion_of_a_mean_is_that_of_mean_values() -> None:
    scene, fallback, case = hand(1500.0, 4.0), hand(200.0, 30.0), Configuration(0.2, RATE, friction=0.5, delay=1.0)
    for weight in (0.25, 0.5, 0.9):
        K, B = 1500.0 + weight * (200.0 - 1500.0), 4.0 + weight * (30.0 - 4.0)
        found = prediction_of(mixture(scene, fallback, weight)).felt[0]
        assert (found.k, found.b) == pytest.approx(case.equivalent(K, B), rel=1e-9)


@pytest.mark.parametrize(
    ("scene", "fallback", "weight"),
    [
        (hand(8000.0, 2.0), hand(500.0, 5.0), 0.0),
        (hand(500.0, 5.0), hand(8000.0, 2.0), None),
        (hand(500.0, 5.0), hand(200.0, 9.0), -1.0),
    ],
)
def test_what_shakes_a_hand_is_found_with_the_weight(scene: Scene, fallback: Scene, weight: float | None) -> None:
    found = shaken_while_taking_over(scene, fallback)
    if weight == -1.0:
        assert found is None
        return
    assert found is not None
    if weight is not None:
        assert found.weight == weight
    else:
        before = prediction_of(mixture(scene, fallback, found.weight - 1.0 / PARTS)).judge
        assert before.shaking is None
        assert found.weight > 0.0


def test_no_random_pair_of_stable_hands_is_unstable_between() -> None:
    """So few parts are judged because of that."""
    chance, judged = np.random.default_rng(1), 0
    for _ in range(12):
        delay, mass = float(chance.choice([0.0, 1.0, 1.5, 2.0])), 10.0 ** chance.uniform(-2, 1)
        case = Configuration(mass, RATE, friction=float(chance.choice([0.0, 0.5])), delay=delay)
        K = case.stiffness_unit * 10.0 ** chance.uniform(-4, 0, 300)
        B = 1.5 * case.damping_unit * 10.0 ** chance.uniform(-3, 0, 300)
        stable = case.spectral_radius(K, B) < 1.0
        (K, B), half = (K[stable], B[stable]), int(stable.sum()) // 2
        weight = np.linspace(0.0, 1.0, 65)[:, None]
        between = [one[:half] + weight * (one[half : 2 * half] - one[:half]) for one in (K, B)]
        assert np.all(case.spectral_radius(*between) < 1.0)
        judged += half
    assert judged > 200
