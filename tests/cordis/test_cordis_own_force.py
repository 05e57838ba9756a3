"""A material point that pulls itself, of a type that hapsim does not ship: under every scheme it is a mass on a link
that does the same, in the kernel and in the theory."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from hapsim.compiling.native import value_of
from hapsim.cordis import program as programs
from hapsim.cordis.build_context import BatchType, all_of
from hapsim.cordis.dispatch import Batch, action
from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import PART_TYPES, compile_scene
from hapsim.cordis.schemes import SCHEMES
from hapsim.laws import Law, line
from hapsim.prediction import predict
from hapsim.scene import Mass, Scene
from hapsim.scene.modules import MODULE_TYPES

RATE = 1000.0
K, B = 900.0, 0.7


class Sprung(Mass):
    """Pulls itself to 0."""

    pulls_itself: ClassVar[bool] = True

    def law(self) -> Law:
        return line(K, B, assumption="is taken as it is")


class SprungPoints(NamedTuple):
    start: np.uint64
    end: np.uint64
    values: np.ndarray  # K, B/T


@action
def pull(points, state):
    points, state = value_of(points), value_of(state)
    for i in range(points.start, points.end):
        way = state.position[i] - state.previous[i]
        state.force[i] -= points.values[0] * state.position[i] + points.values[1] * way


def _build(points: Any, _columns: Any, context: Any) -> Batch:
    first = context.number[next(iter(points))]
    numbers = SprungPoints(np.uint64(first), np.uint64(first + len(points)), np.array([K, B * RATE]))
    return Batch(numbers, add_forces=pull)


@pytest.fixture(autouse=True)
def _a_type_more(monkeypatch: pytest.MonkeyPatch) -> None:
    sprung = BatchType(all_of(Sprung), _build)
    monkeypatch.setitem(MODULE_TYPES, "sprung", Sprung)
    monkeypatch.setattr(programs, "PART_TYPES", (*PART_TYPES, sprung))


def scene_of(scheme: str, sprung: bool) -> Scene:
    point = {"mass": 0.02, "position": 0.003, "velocity": -0.2}
    modules: dict[str, Any] = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground"},
        "m": {"type": "mass", "mass": 0.05},
        "held": {"type": "cell", "mass": 0.01, "stiffness": 50.0, "damping": 0.1},
        "p": Sprung(**point) if sprung else {"type": "mass", **point},
        "touch": {"type": "viscoelastic", "between": ("hand", "m"), "stiffness": 400.0, "damping": 0.3},
        "tie": {"type": "viscoelastic", "between": ("m", "p"), "stiffness": 300.0, "damping": 0.2},
        "hung": {"type": "spring", "between": ("p", "held"), "stiffness": 80.0},
    }
    if not sprung:  # a link that no matrix holds
        curves = {"force_over_distance": [[-9.0, -9.0 * K], [9.0, 9.0 * K]]}
        curves |= {"force_over_velocity": [[-9e3, -9e3 * B], [9e3, 9e3 * B]]}
        modules["own"] = {"type": "nonlinear", "between": ("p", "wall"), **curves}
    device = {"mass": 0.2, "friction": 1.0}
    document = {"version": 1, "rate": RATE, "scheme": scheme, "device": device, "modules": modules}
    return Scene.model_validate(document)


def forces_of(scene: Scene, hand: np.ndarray) -> np.ndarray:
    program, force = compile_scene(scene), np.zeros((len(hand), 1))
    start(program, hand[:1])
    for n in range(len(hand)):
        tick(program, hand[n : n + 1], np.zeros(1), force[n])
    return force[:, 0]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_it_moves_as_a_mass_on_a_link_does(scheme: str) -> None:
    hand = 0.01 * np.sin(np.cumsum(np.random.default_rng(3).normal(size=500)) / 9.0)
    expected = forces_of(scene_of(scheme, sprung=False), hand)
    assert np.abs(expected[-100:]).max() > 0.1
    np.testing.assert_allclose(forces_of(scene_of(scheme, sprung=True), hand), expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_it_is_predicted_as_a_mass_on_a_link(scheme: str) -> None:
    found, expected = (predict(scene_of(scheme, sprung), with_margins=False) for sprung in (True, False))
    np.testing.assert_allclose(found.poles, expected.poles, rtol=0.0, atol=1e-12)
    assert "p is taken as it is" in found.assumptions


def test_one_without_a_declaration_is_not_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(Sprung, "law")
    with pytest.raises(NotImplementedError):
        predict(scene_of("cordis", sprung=True))
