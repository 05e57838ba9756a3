"""State that continues in a new scene: points, links' memory, live parameters. Without a loop."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, take_over, tick, update_parameters
from hapsim.cordis.program import Program, compile_scene, numbers_of, parameter_values, positions_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.cordis.succession import take_over_from
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from live_structures import LONE, ON_ONE_LINK, RATE, STRING, Modules, played, scene_of, swing

ONE_OF_EACH: Modules = {
    "viscoelastic": {"stiffness": 400.0, "damping": 0.5},
    "centred": {"type": "viscoelastic", "stiffness": 400.0, "damping": 0.5, "damper": "centred"},
    "filtered": {"type": "viscoelastic", "stiffness": 400.0, "damping": 0.5, "damper": "filtered", "cutoff": 80.0},
    "spring": {"stiffness": 400.0},
    "damper": {"damping": 0.5},
    "buffer": {"stiffness": 400.0, "damping": 0.5, "distance": 0.002},
    "nonlinear": {"force_over_distance": [[-0.01, -2.0], [0.0, 0.0], [0.01, 3.0]]},
    "friction": {"force": 0.2, "static": 0.3, "stiffness": 300.0, "damping": 0.2},
    "detent": {"pitch": 0.004, "depth": 0.5, "damping": 0.1, "shape": "snap"},
    "click": {"travel": 0.004, "peak": 0.5, "drop": 0.3, "bottom": 400.0, "damping": 0.1},
    "plectrum": {"stiffness": 400.0, "damping": 0.1, "release": 0.003},
}
MATTER: Modules = {
    "bob": {"type": "mass", "mass": 0.05, "velocity": 0.3},
    "bell": {"type": "cell", "mass": 0.05, "stiffness": 300.0, "damping": 0.1, "rest": 0.001, "position": 0.003},
    "string": STRING | {"damping": 0.01, "pluck": {"at": 4, "by": 0.002}},
    "rod": STRING | {"bending": 40.0, "ends": ["clamped", "free"]},
    "drum": {"type": "membrane", "rows": 4, "columns": 5, "mass": 0.01, "stiffness": 200.0, "edges": ["free"] * 4},
}
HELD_BY: Modules = {
    f"to_{name}": {"type": "viscoelastic", "between": ["hand", end], "stiffness": 100.0, "damping": 0.05}
    for name, end in (("bob", "bob"), ("bell", "bell"), ("string", "string.3"), ("rod", "rod.5"), ("drum", "drum.0.2"))
}


@pytest.mark.thorough(keep=15)
@pytest.mark.parametrize("name", ONE_OF_EACH)
@pytest.mark.parametrize("at", [1, 37, 66, 113])
def test_a_change_elsewhere_is_not_felt_on_any_link(name: str, at: int) -> None:
    """Forces continue to the last bit, since links keep their memory. At 66 the hand stands still; by 113 all slid or
    released."""
    link = {"type": name, "between": ["hand", "wall"]} | ONE_OF_EACH[name]
    before = scene_of(ON_ONE_LINK | {"link": link}, mock=None)
    after = scene_of(LONE | ON_ONE_LINK | {"link": link}, mock=None)
    force, _ = played(before, swing(200))
    changed, _ = played(before, swing(200), after, at)
    assert np.abs(force).max() > 0.1
    np.testing.assert_array_equal(changed, force)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_change_elsewhere_is_not_felt_on_any_matter(scheme: str) -> None:
    modules = ON_ONE_LINK | MATTER | HELD_BY
    before, after = scene_of(modules, scheme, mock=None), scene_of(LONE | modules, scheme, mock=None)
    force, _ = played(before, swing(200))
    changed, _ = played(before, swing(200), after, 60)
    assert np.abs(force).max() > 0.1
    # What is worked into matrices is rounded otherwise in other matrices, and a step is not stored between programs.
    rounding = {"semi_implicit": 1e-13, "midpoint": 1e-11, "exact": 1e-11}
    np.testing.assert_allclose(changed, force, rtol=0.0, atol=rounding.get(scheme, 0.0))


@pytest.mark.thorough(keep=12)
@pytest.mark.parametrize("wanted", SCHEMES)
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_points_go_on_from_scheme_to_scheme(scheme: str, wanted: str, damping: float) -> None:
    """All are where they were, and were before, to the last bit; and a tick on where either scheme takes them. With a
    damper between two masses the exact scheme is one matrix, without it is modes."""
    more: Modules = {"brake": {"type": "damper", "between": ["bob", "bell"], "damping": damping}}
    modules = ON_ONE_LINK | MATTER | HELD_BY | more
    before, after = scene_of(modules, scheme, mock=None), scene_of(modules, wanted, mock=None)
    positions = swing(62)
    _, older = played(before, positions[:60])
    program = compile_scene(after)
    take_over_from(older, before, program, after)
    take_over(older, program, positions[60])
    points = [number for name, number in numbers_of(before).items() if name not in ON_ONE_LINK]
    np.testing.assert_array_equal(np.array(positions_of(program))[:, points], np.array(positions_of(older))[:, points])
    for one, scene in ((older, before), (program, after)):
        tick(one, positions[60], np.zeros(1), np.zeros(1))
        put_all_points(one, scene, positions[61])
    ahead = [positions_of(one)[0][points] for one in (program, older)]
    np.testing.assert_allclose(*ahead, rtol=0.0, atol=2e-5)


def put_all_points(program: Program, scene: Scene, measured: np.ndarray) -> None:
    """The exact scheme puts only those somewhere that something looks at, until another program takes over."""
    following = compile_scene(scene)
    take_over_from(program, scene, following, scene)
    take_over(program, following, measured)


@pytest.mark.parametrize(("precision", "wanted"), [("single", "double"), ("double", "single")])
def test_points_go_on_in_another_precision(precision: str, wanted: str) -> None:
    modules = ON_ONE_LINK | MATTER | HELD_BY
    before = scene_of(modules, mock=None, precision=precision)
    after = scene_of(modules, mock=None, precision=wanted)
    positions = swing(120)
    force, _ = played(before, positions)
    changed, _ = played(before, positions, after, 60)
    np.testing.assert_allclose(changed, force, rtol=0.0, atol=2e-4)
    np.testing.assert_array_equal(changed[:60], force[:60])


def test_a_ground_that_is_taken_over_on_its_ramp_stands_still_there() -> None:
    link = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 100.0, "damping": 0.5}
    scene = scene_of(ON_ONE_LINK | {"link": link}, mock=None)
    moved = scene_of(ON_ONE_LINK | {"wall": {"type": "ground", "position": 0.011}, "link": link}, mock=None)
    program, still, force = compile_scene(scene), np.zeros(1), np.zeros((60, 1))
    start(program, still)
    program.parameters.post(parameter_values(moved), 100)
    for n in range(60):
        if n == 50:
            older, program = program, compile_scene(scene)
            take_over_from(older, scene, program, scene)
            take_over(older, program, still)
        update_parameters(program)
        tick(program, still, still, force[n])
    place = positions_of(program)[0][numbers_of(scene)["wall"]]
    assert 0.004 < place < 0.007
    np.testing.assert_allclose(force[52:], 100.0 * place, rtol=1e-12)


def test_live_parameters_go_on_from_where_they_are() -> None:
    """A ground on its ramp, and a stiffness: neither jumps where another structure takes over."""
    link = {"type": "spring", "between": ["hand", "wall"], "stiffness": 100.0}
    before = scene_of(ON_ONE_LINK | {"link": link}, mock=None)
    moved = ON_ONE_LINK | {"wall": {"type": "ground", "position": 0.011}}
    after = scene_of(LONE | moved | {"link": link | {"stiffness": 300.0}}, mock=None)
    program, still, rest = compile_scene(before), np.zeros(1), np.zeros(1)
    start(program, rest)
    force = np.zeros((200, 1))
    for n in range(200):
        if n == 50:
            older, program = program, compile_scene(after)
            take_over_from(older, before, program, after)
            take_over(older, program, rest)
            program.parameters.post(parameter_values(after), 100)
        update_parameters(program)
        tick(program, rest, still, force[n])
    assert force[49] == pytest.approx(100.0 * 0.001)
    assert force[-1] == pytest.approx(300.0 * 0.011)
    assert (np.diff(force[:, 0]) >= 0.0).all()
    assert np.diff(force[:, 0]).max() < 0.06  # at most 1.5/100 of either's way at a time


RUBS: dict[str, Any] = {"type": "friction", "force": 5.0, "stiffness": 300.0, "damping": 0.2}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, {"rub": RUBS | {"between": ["hand", "wall"]}}),
        ({"rub": RUBS | {"between": ["hand", "far"]}}, {"rub": RUBS | {"between": ["hand", "wall"]}}),
        (
            {"string": STRING | {"masses": 5}, "rub": RUBS | {"between": ["hand", "string.2"]}},
            {"string": STRING | {"masses": 6}, "rub": RUBS | {"between": ["hand", "string.2"]}},
        ),
    ],
    ids=["new", "linked elsewhere", "to a string of another length"],
)
def test_a_link_that_is_new_remembers_nothing(before: Modules, after: Modules) -> None:
    """A new link's bristle is not bent under a moving hand, so that only its damper is felt."""
    around = ON_ONE_LINK | {"far": {"type": "ground", "position": 0.1}}
    position = swing(60)
    old, new = scene_of(around | before, mock=None), scene_of(around | after, mock=None)
    force, _ = played(old, position, new, at=30)
    step = (position[30] - position[29]) * RATE
    assert abs(step[0]) > 0.1
    np.testing.assert_allclose(force[30], -RUBS["damping"] * step, rtol=1e-9)
