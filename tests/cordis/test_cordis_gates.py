"""Links with `when`: they act while their input is on, do nothing while it is off, and fade between the two."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.cordis.offline import start, take_over, tick, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values, positions_of
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
from hapsim.cordis.succession import take_over_from
from hapsim.errors import UsageError
from hapsim.scene import Scene
from hapsim.scene.modules import Link

from . import plane_scenes
from .module_scenes import SCENES, Hands, scene_of, walk

Array = NDArray[np.float64]
ON, OFF = 1, 0
SAMPLES = 400
PLANE: dict[str, dict[str, Any]] = {
    "spring": {"type": "viscoelastic", "stiffness": 300.0, "damping": 1.0, "length": 0.03},
    "shape": plane_scenes.shape({"disc": 0.02}, damping=1.0, friction_coefficient=0.4),
    "guide": {"type": "guide", "stiffness": 300.0, "damping": 2.0, "through": [[-0.03, 0.0], [0.0, 0.01], [0.03, 0.0]]},
    "click": {"type": "click", "travel": 0.02, "peak": 1.0, "drop": 0.6, "bottom": 400.0, "length": 0.03},
    "friction": {"type": "friction", "stiffness": 300.0, "force": 0.6},
}


def gated(scene: Scene, **inputs: Any) -> Scene:
    """The scene, all its links acting while `touch` is on."""
    modules = {
        name: one.model_copy(update={"when": "touch"}) if isinstance(one, Link) else one
        for name, one in scene.modules.items()
    }
    document = scene.document | {"inputs": {"touch": {"bit": 0}} | inputs}
    document["modules"] = {name: one.model_dump(exclude_none=True) for name, one in modules.items()}
    return Scene.model_validate(document)


def wall(**more: Any) -> Scene:
    """A wall on the left of a hand, and values of the scene."""
    modules: dict[str, Any] = {
        "hand": {"type": "device", "channel": 0},
        "post": {"type": "ground"},
        "wall": {"type": "buffer", "between": ["hand", "post"], "stiffness": 1000.0, "damping": 2.0},
    }
    return gated(
        Scene.model_validate({"version": 1, "rate": 1000.0, "device": {"mass": 0.2}, "modules": modules} | more)
    )


def put(program: Program, word: int) -> None:
    program.parameters.inputs[0] = word


def run(program: Program, path: Array, word: int | None = None) -> Array:
    """The forces along a path, (samples, channels) N. `word`: the inputs, from the start on."""
    if word is not None:
        put(program, word)
    found = np.zeros_like(path)
    start(program, path[0])
    for here, force in zip(path, found, strict=True):
        update_parameters(program)
        tick(program, here, np.zeros_like(here), force)
    return found


def held(program: Program, place: float, samples: int) -> Array:
    """The forces on a hand that goes on at a place, N."""
    found = np.zeros((samples, 1))
    for force in found:
        update_parameters(program)
        tick(program, np.array([place]), np.zeros(1), force)
    return found[:, 0]


@pytest.mark.parametrize("hands", SCENES, ids=lambda hands: hands[0])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_every_link_is_itself_while_its_input_is_on_and_nothing_while_it_is_off(precision: str, hands: Hands) -> None:
    scene = scene_of(precision, hands)
    rng = np.random.default_rng(7)
    path = np.array([walk(rng, precision)[:SAMPLES] for _ in hands]).T.copy()
    expected = run(compile_scene(scene), path)
    assert expected.any(axis=0).all()
    assert np.array_equal(run(compile_scene(gated(scene)), path, ON), expected)
    assert not run(compile_scene(gated(scene)), path, OFF).any()


@pytest.mark.parametrize("name", PLANE)
def test_every_link_of_the_plane_is_itself_or_nothing(name: str) -> None:
    scene = plane_scenes.scene_of({"it": PLANE[name]})
    path = plane_scenes.line([0.028, 0.004], [-0.02, -0.008], SAMPLES)
    expected = run(compile_scene(scene), path)
    assert expected.any()
    assert np.array_equal(run(compile_scene(gated(scene)), path, ON), expected)
    assert not run(compile_scene(gated(scene)), path, OFF).any()


def test_a_curve_with_two_branches_has_a_gate() -> None:
    curve = {"press": [[-0.02, 1.0], [0.02, 3.0]], "release": [[-0.02, 0.5], [0.02, 2.0]], "turn": 0.002}
    document = wall().document | {"inputs": {}}
    document["modules"]["wall"] = {"type": "nonlinear", "between": ["hand", "post"], "force_over_distance": curve}
    scene = Scene.model_validate(document)
    path = 0.01 * np.sin(np.linspace(0.0, 9.0, SAMPLES))[:, None]
    expected = run(compile_scene(scene), path)
    assert expected.all()
    assert np.array_equal(run(compile_scene(gated(scene)), path, ON), expected)
    assert not run(compile_scene(gated(scene)), path, OFF).any()


def test_a_link_at_a_proxy_has_a_gate() -> None:
    cup = {"type": "proxy", "hand": "hand", "mass": 0.01, "stiffness": 500.0, "damping": 1.0}
    bottom = {"type": "buffer", "between": ["cup", "post"], "stiffness": 1000.0}
    document = wall().document
    document["modules"] |= {"cup": cup, "wall": bottom}
    path = np.linspace(0.0, -0.01, SAMPLES)[:, None]
    alone = Scene.model_validate(document)
    without = alone.model_copy(update={"modules": {k: v for k, v in alone.modules.items() if k != "wall"}})
    scene = gated(alone)
    expected = [run(compile_scene(one), path) for one in (alone, Scene.model_validate(without.document))]
    assert not np.array_equal(*expected)
    assert np.array_equal(run(compile_scene(scene), path, ON), expected[0])
    assert np.array_equal(run(compile_scene(scene), path, OFF), expected[1])


@pytest.mark.parametrize("more", [{}, {"precision": "single"}, {"substeps": 4}, {"scheme": "rk4"}], ids=str)
def test_a_wall_fades_in_over_5_ms_and_out_again(more: dict[str, Any]) -> None:
    program = compile_scene(wall(**more))
    put(program, OFF)
    start(program, np.array([-0.002]))
    samples = 5 * int(more.get("substeps", 1))
    s = np.arange(1, samples + 1) / samples
    weight = s * s * (3.0 - 2.0 * s)
    for word, expected in ((OFF, 0.0 * s), (ON, weight), (ON, 1.0 + 0.0 * s), (OFF, 1.0 - weight)):
        put(program, word)
        assert held(program, -0.002, samples) == pytest.approx(2.0 * expected, abs=1e-6)


def test_an_input_that_changes_back_turns_the_fade_round() -> None:
    program = compile_scene(wall())
    put(program, OFF)
    start(program, np.array([-0.002]))
    put(program, ON)
    up = held(program, -0.002, 3)
    put(program, OFF)
    assert held(program, -0.002, 3) == pytest.approx([*up[1::-1], 0.0], abs=1e-15)


def test_an_inverted_input_is_on_while_its_bit_is_0() -> None:
    scene = wall().model_copy(update={"inputs": wall().inputs})
    scene = gated(Scene.model_validate(scene.document), touch={"bit": 3, "inverted": True})
    pressed = np.full((3, 1), -0.002)
    assert run(compile_scene(scene), pressed, 0b1000)[-1, 0] == 0.0
    assert run(compile_scene(scene), pressed, 0b0000)[-1, 0] == pytest.approx(2.0)


def test_a_ramp_goes_on_under_its_gate() -> None:
    scene = wall()
    stiff = scene.changed({"wall": {"stiffness": 3000.0}})
    program, alone = compile_scene(scene), compile_scene(scene.with_inputs(frozenset({"touch"})))
    put(program, OFF)
    for one in (program, alone):
        start(one, np.array([-0.002]))
        one.parameters.post(parameter_values(stiff), 10)
    shut = held(program, -0.002, 3)
    put(program, ON)
    s = np.concatenate([np.arange(1, 6) / 5, np.ones(5)])
    assert not shut.any()
    expected = held(alone, -0.002, 13)[3:]
    assert held(program, -0.002, 10) == pytest.approx(s * s * (3.0 - 2.0 * s) * expected)


def accounted(scene: Scene, level: float) -> tuple[Program, Any]:
    """The program, pressed 5 mm deep while the input is off, and its TANK."""
    program, tank = compile_scene(scene), new_record(TANK)
    kept = Tank(tank, capacity_j=1.0, refill_j=0.0)
    program.stored = StoredEnergy(program, scene, kept, 1e3)
    tank.level = level
    put(program, OFF)
    start(program, np.array([-0.005]))
    return program, tank


def stored_of(program: Program) -> float:
    here, before = positions_of(program)
    return float(evaluate(program.record.parameters.stored, here.ctypes.data, before.ctypes.data, 0))


def test_touching_while_5_mm_deep_takes_the_energy_of_the_wall_from_the_tank() -> None:
    program, tank = accounted(wall(), 0.5)
    assert stored_of(program) == 0.0
    put(program, ON)
    held(program, -0.005, 5)
    assert stored_of(program) == pytest.approx(500.0 * 0.005**2)
    assert float(tank.spent) == pytest.approx(stored_of(program))
    assert float(tank.level) == pytest.approx(0.5 - stored_of(program))
    put(program, OFF)
    held(program, -0.005, 5)
    assert float(tank.level) == pytest.approx(0.5)


def test_a_tank_that_holds_less_shortens_the_fade() -> None:
    program, tank = accounted(wall(), 0.005)  # of 12.5 mJ
    put(program, ON)
    force = held(program, -0.005, 50)
    assert force[-1] == pytest.approx(0.4 * 5.0, rel=1e-3)
    assert stored_of(program) == pytest.approx(0.005, rel=1e-3)
    assert float(tank.spent) == pytest.approx(0.005, rel=1e-3)
    assert (np.diff(force) >= 0.0).all()
    tank.level = 0.1
    assert held(program, -0.005, 5)[-1] == pytest.approx(5.0)


def test_the_next_program_takes_over_the_weight_of_a_fade() -> None:
    scene = wall()
    more = scene.document
    more["modules"]["rub"] = {"type": "damper", "between": ["hand", "post"], "damping": 0.1}
    later = Scene.model_validate(more)
    older, program = compile_scene(scene), compile_scene(later)
    put(older, OFF)
    start(older, np.array([-0.002]))
    put(older, ON)
    put(program, ON)
    before = held(older, -0.002, 2)
    take_over_from(older, scene, program, later)
    take_over(older, program, np.array([-0.002]))
    program.parameters.post(parameter_values(later), 1)
    after = held(program, -0.002, 3)
    s = np.arange(1, 6) / 5
    assert [*before, *after] == pytest.approx(2.0 * s * s * (3.0 - 2.0 * s))


def test_a_link_within_a_matrix_has_no_gate() -> None:
    document = wall(scheme="exact").document
    document["modules"] |= {
        "ball": {"type": "mass", "mass": 0.1},
        "tied": {"type": "spring", "between": ["ball", "post"], "stiffness": 10.0, "when": "touch"},
    }
    with pytest.raises(
        UsageError, match=r"^tied.when: found scheme: exact, .* expected scheme: cordis, semi_implicit or rk4"
    ):
        compile_scene(Scene.model_validate(document))
