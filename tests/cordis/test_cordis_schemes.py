"""Two ways of working out a scheme agree, and what a scheme cannot work out is refused."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, positions_of
from hapsim.cordis.schemes import exact, force_expansion
from hapsim.cordis.schemes.exact import ExactDense, ExactModes
from hapsim.cordis.schemes.force_expansion import StringForces, WeightedLinks
from hapsim.cordis.schemes.midpoint import Midpoint
from hapsim.errors import UsageError
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from scheme_scenes import RATE, T, by_the_tick, chain, link, network, numbers_in, scene_of, strokes

HELD = ["m0", "s.2", "m1", "t.1"]  # by something from outside, whatever the scheme


def agree(scene: Scene, other: Scene, points: list[str], seed: int, prepare: Callable[[], None]) -> None:
    """Two ways of working out the same scene agree; `prepare`: between them. `test_cordis_every_scheme.py` has one of
    them against NumPy."""
    measured = strokes(scene.channels, seed)
    forces, positions = by_the_tick(scene, measured, points)
    prepare()
    expected_forces, expected_positions = by_the_tick(other, measured, points)
    size = float(np.max(np.abs(expected_positions)))
    assert 1e-3 < size < 1.0
    assert np.max(np.abs(positions - expected_positions)) <= 1e-12 * size
    assert np.max(np.abs(forces - expected_forces)) <= 1e-12 * np.max(np.abs(expected_forces))


@pytest.mark.parametrize("seed", range(3))
def test_motions_that_go_by_themselves_are_the_same_system(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of("exact", network(seed, share=3e-4))
    assert ExactModes in numbers_in(scene)
    agree(scene, scene, HELD, seed, lambda: monkeypatch.setattr(exact, "modes_of", lambda *_: None))
    assert ExactDense in numbers_in(scene)


def test_a_damping_that_joins_the_modes_takes_the_dense_matrix() -> None:
    assert ExactDense in numbers_in(scene_of("exact", network(0)))
    nearly = network(0, share=3e-4)
    nearly["l0"]["damping"] *= 1.001
    assert ExactDense in numbers_in(scene_of("exact", nearly))


def chain_in(order: Sequence[int]) -> dict[str, Any]:
    """A chain whose masses stand in the file in this order."""
    count = len(order)
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground", "position": 0.01}}
    modules |= {f"m{i}": {"type": "mass", "mass": 0.05 + 0.01 * float(i % 3)} for i in order}
    row = ["wall", *(f"m{i}" for i in range(count))]
    modules |= {f"l{a}": link(a, b, 400.0, 0.1) for a, b in pairwise(row)}
    return modules | {"touch": link("hand", f"m{count - 1}", 300.0, 0.3)}


def test_a_chain_in_any_order_is_narrow() -> None:
    order = np.random.default_rng(5).permutation(30).tolist()
    shuffled, sorted_chain = (scene_of("midpoint", chain_in(each)) for each in (order, range(30)))
    for scene, in_row in ((shuffled, 0), (sorted_chain, 1)):
        numbers = compile_scene(scene).parts[-1].numbers
        assert type(numbers) is Midpoint
        assert numbers.factor.columns.shape[1] == 1
        assert numbers.in_row == in_row
    agree(shuffled, sorted_chain, ["m29"], 1, lambda: None)


@pytest.mark.parametrize("scheme", ["semi_implicit", "rk4"])
def test_a_structure_taken_apart_is_the_same_as_in_one_pass(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(scheme, network(1))
    assert StringForces in numbers_in(scene)
    agree(scene, scene, HELD, 1, lambda: monkeypatch.setattr(force_expansion, "STRING", None))
    assert StringForces not in numbers_in(scene)
    assert WeightedLinks in numbers_in(scene)


def test_links_that_remember_are_asked_once_a_sample() -> None:
    """Under the Runge-Kutta scheme their force is held: the first of the four alone, all the way."""
    modules = {"hand": {"type": "device", "channel": 0}, "m": {"type": "mass", "mass": 0.5, "velocity": 0.1}}
    alone = modules | {"touch": link("hand", "m", 0.0, 2.0, damper="centred")}
    scene = scene_of("rk4", alone)
    program = compile_scene(scene)
    start(program, np.zeros(1))
    m = numbers_of(scene)["m"]
    x, older, v = [-2e-4, -1e-4, 0.0], 0.0, 0.1
    for _ in range(200):
        force = np.zeros(1)
        tick(program, np.zeros(1), np.zeros(1), force)
        older = x[-1] - v * T  # what the link felt as the position before
        pull = -2.0 * RATE * 0.5 * (x[-1] - x[0])
        np.testing.assert_allclose(force[0], -pull, rtol=1e-9)
        x = [older, 0.0, x[-1] + T * v + 0.5 * T * T * pull / 0.5]
        v += T * pull / 0.5
        np.testing.assert_allclose(positions_of(program)[0][m], x[-1], rtol=1e-9)


def long_string(masses: int, friction: float) -> dict[str, Any]:
    string = {"type": "string", "masses": masses, "mass": 0.001, "stiffness": 100.0, "friction": friction}
    hand = {"hand": {"type": "device", "channel": 0}, "s": string, "touch": link("hand", "s.0", 1.0)}
    return hand | {"wall": {"type": "ground"}, "stop": link("s.50", "wall", 10.0, 1.0)}


def test_what_is_too_large_for_the_exact_scheme_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "MOST_POINTS", 100)  # of 1000 the modes would be searched for some seconds before
    with pytest.raises(UsageError, match="exact is for 100 masses at most where damping joins the scene's modes"):
        compile_scene(scene_of("exact", long_string(101, 0.0)))
    with pytest.raises(UsageError, match="exact is for 4000 masses at most, and this scene moves 4001"):
        compile_scene(scene_of("exact", long_string(4001, 0.0)))


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_what_no_matrix_can_hold_is_refused(scheme: str) -> None:
    """A scene file may not hold such a number."""
    scene = chain(scheme, np.zeros(2), 1.0, 0.0, 1e-3)
    huge = {name: one.model_copy(update={"stiffness": 1e308}) for name, one in scene.links.items()}
    with pytest.raises(UsageError, match="too large for the scene's scheme"):
        compile_scene(scene.model_copy(update={"modules": {**scene.modules, **huge}}))


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_no_stiffness_makes_an_implicit_scheme_unstable(scheme: str, damping: float) -> None:
    """A million times what CORDIS's scheme stands; without damping the energy stays what it was."""
    stiffness, mass, rows = 4e11, np.array([0.1, 0.2, 0.1]), 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    begin = np.array([0.01, -0.02, 0.01])
    scene = chain(scheme, np.append(begin, np.zeros(3)), stiffness, damping)
    program, masses = compile_scene(scene), [numbers_of(scene)[name] for name in scene.masses]
    start(program, np.zeros(1))
    for _ in range(10_000):
        tick(program, np.zeros(1), np.zeros(1), np.zeros(1))
    x, before = (one[masses] for one in positions_of(program))
    v = (x - before) * RATE
    energy, at_first = stiffness * x @ rows @ x + v @ (mass * v), stiffness * begin @ rows @ begin
    assert energy <= at_first * (1.0 + 1e-9)
    if damping == 0.0:
        assert energy == pytest.approx(at_first, rel=1e-6)


def test_a_channel_without_a_hand_gets_no_force() -> None:
    modules = {
        "hand": {"type": "device", "channel": 2},
        "wall": {"type": "ground"},
        "touch": link("wall", "hand", 100.0),
    }
    forces, _ = by_the_tick(scene_of("cordis", modules), np.full((10, 3), 0.01), [])
    np.testing.assert_allclose(forces, np.tile([0.0, 0.0, -1.0], (10, 1)), rtol=1e-15)


def test_the_first_tick_feels_no_jump() -> None:
    """The hand is somewhere when the run begins: at rest there, not arrived from the origin within one sample."""
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground"},
        "touch": link("hand", "wall", 0, 5),
    }
    forces, _ = by_the_tick(scene_of("cordis", modules), np.array([[0.01], [0.011]]), [])
    np.testing.assert_allclose(forces[:, 0], [0.0, -5.0], rtol=1e-12, atol=1e-12)


# --- single precision ---


def slow_swing(scheme: str, precision: str, ticks: int) -> np.ndarray:
    """A mass that swings at 1/2000 of the rate, sample by sample."""
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules["m"] = {"type": "mass", "mass": 1.0, "position": 0.01}
    stiffness = float((2 * np.pi * RATE / 2000) ** 2)
    scene = scene_of(
        scheme, modules | {"l": link("m", "wall", stiffness), "h": link("hand", "m", 0.0)}, RATE, precision
    )
    return by_the_tick(scene, np.zeros((ticks, 1)), ["m"])[1][:, 0]


def test_a_stored_step_keeps_the_digits_of_a_slow_motion_in_single_precision(figures: Any) -> None:
    errors = {}
    for scheme in ("cordis", "semi_implicit"):
        swing = slow_swing(scheme, "single", 8_000)
        errors[scheme] = float(np.max(np.abs(swing - slow_swing(scheme, "double", 8_000)))) / 0.01
    assert errors["semi_implicit"] < 0.1 * errors["cordis"]
    closer = errors["cordis"] / errors["semi_implicit"]
    figures.note(f"single precision, a 2000th of the rate: semi_implicit is {closer:.0f} times closer than cordis")
