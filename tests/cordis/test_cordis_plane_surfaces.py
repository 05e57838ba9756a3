"""Shapes with the same two ends as one surface: what it remembers, corners of unlike walls, and live changes."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import take_over
from hapsim.cordis.program import compile_scene
from hapsim.cordis.succession import take_over_from
from hapsim.prediction.plane_geometry import Plane

from .plane_scenes import RATE, Floats, line, moved, scene_of, shape
from .test_cordis_plane import jacobian
from .test_cordis_plane_live import account, energy

FRICTION = {"friction_coefficient": 0.4, "static_coefficient": 0.5, "bristle_damping": 0.3}


def bar(left: float, right: float, **more: Any) -> dict[str, Any]:
    corners = [[left, -0.005], [right, -0.005], [right, 0.005], [left, 0.005]]
    return shape({"polygon": corners}, 400.0, damping=0.5, **more)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("overlap", [0.0, 1e-9, 0.002, 0.02])
def test_two_bars_in_line_are_felt_as_one(overlap: float, precision: str) -> None:
    """Along all of it with friction, pressed at other depths, back and out: force, bristle and stored energy."""
    corners = [[-0.025, 0.004], [0.01, 0.004], [-0.012, 0.003], [0.006, -0.004], [0.0001, 0.002], [0.01, 0.007]]
    path = np.vstack([line(a, b, 900) for a, b in pairwise(corners)])
    path += np.random.default_rng(1).normal(0.0, 2e-6, path.shape)
    both = {"a": bar(-0.02, 0.5 * overlap, **FRICTION), "b": bar(-0.5 * overlap, 0.02, **FRICTION)}
    found, stored = [], []
    for modules in (both, {"a": bar(-0.02, 0.02, **FRICTION)}):
        scene = scene_of(modules, precision=precision)
        program = compile_scene(scene)
        found.append(moved(program, path))
        moved(program, path[3000:3002], begin=False)
        stored.append(energy(program, account(program, scene)[0]))
    scale = 1e-9 if precision == "double" else 3e-3
    np.testing.assert_allclose(found[0], found[1], atol=max(scale, 400.0 * 0.6 * 1e-9))
    assert np.abs(found[0][:, 0]).max() > 0.3  # N, of friction
    assert stored[0] == pytest.approx(stored[1], rel=1e-2 * scale, abs=1e-3 * scale)


def unlike(degrees: float, **more: Any) -> tuple[dict[str, Any], Floats, Floats]:
    """Two half planes with a hollow corner at the post that turns by so much, and the normals of both."""
    angle = math.radians(degrees)
    normals = np.array([(0.0, 1.0), (math.sin(angle), math.cos(angle))])
    one = shape({"half_plane": normals[0].tolist()}, 1500.0, damping=6.0, **more)
    other = shape({"half_plane": normals[1].tolist()}, 500.0, damping=1.0, friction_coefficient=0.1)
    return {"one": one, "other": other}, normals, np.linalg.inv(normals.T)


@pytest.mark.parametrize("degrees", [20.0, 90.0, 135.0])
@pytest.mark.parametrize("order", [1, -1])
def test_in_a_corner_of_unlike_walls_each_holds_its_own_part(degrees: float, order: int) -> None:
    """Way out = a n + b m: they push K a n and K b m; the second damps along its normal, the first across it."""
    modules, normals, parts = unlike(degrees)
    modules = dict([*modules.items()][::order])
    random, program = np.random.default_rng(int(degrees)), compile_scene(scene_of(modules))
    K, B, damped = np.array([1500.0, 500.0]), np.array([6.0, 1.0]), 0
    for _ in range(50):
        deep = random.uniform(2e-4, 2e-3, 2)
        place, free = -deep @ normals, np.array([0.01, 0.01]) @ normals
        steps = random.normal(0.0, 3e-6, (4, 2))
        found = moved(program, np.vstack([line(free, place, 400), place + steps]))[-4:]
        for r, last, force in zip(place + steps, np.vstack([[place], place + steps[:-1]]), found, strict=True):
            a, g = parts @ -r, r - last
            n = normals[1]  # of the wall that comes second on the way with the free side on the right
            t = np.array([n[1], -n[0]])
            damping = B[1] * RATE * (n @ g) * n + B[0] * RATE * (t @ g) * t
            assert force == pytest.approx((K * a) @ normals - damping, abs=1e-9)
            damped += abs(damping).max() > 1e-3
    assert damped > 50


@pytest.mark.parametrize("friction", [0.0, 2.0, 0.02])
@pytest.mark.parametrize("degrees", [60.0, 90.0])
def test_a_prediction_has_the_stiffness_of_a_corner_of_unlike_walls(degrees: float, friction: float) -> None:
    """Without friction, with friction that sticks, and with friction that slides: differences of the settled force."""
    modules, normals, _ = unlike(degrees, bristle_stiffness=300.0)
    modules["one"]["friction_coefficient"] = modules["other"]["friction_coefficient"] = friction
    for deep in ([1e-3, 4e-4], [3e-4, 1.5e-3]):
        place = -np.array(deep) @ normals
        out = -place / np.hypot(*place)
        aside = np.array([-out[1], out[0]])
        way_in = line(place + 0.004 * out, place, 80)
        if friction == 0.02:
            way_in = np.vstack([line(place + 0.004 * out - 2e-4 * aside, place - 2e-4 * aside, 80),
                                line(place - 2e-4 * aside, place, 60), place])  # fmt: skip
        links = [one for one in Plane(scene_of(modules)).at({"hand": tuple(way_in[-1].tolist())}) if one.acts]
        assert {one.name for one in links} == {"one", "other"}
        static = -sum(one.tension * np.array(one.normal) for one in links)
        if friction == 0.02:
            first = next(one for one in links if one.rubs)
            rows = [row for one in links for row in one.rows(1)]
            assert first.corner is not None
            there = moved(compile_scene(scene_of(modules)), way_in)[-1]
            t = np.array([-first.corner.normal[1], first.corner.normal[0]])
            assert (there - static) @ t == pytest.approx(-0.02 * abs(static @ np.array(first.corner.normal)), rel=1e-6)
            e = 1e-7
            columns = []
            for step in (np.array([e, 0.0]), np.array([0.0, e])):
                both = []
                for sign in (1.0, -1.0):
                    # It comes from farther back along the tangent, so that it slides the same way there.
                    end = way_in[-1] + sign * step
                    path = np.vstack([way_in[:-2], line(end - 1e-5 * t, end, 10), end])
                    both.append(moved(compile_scene(scene_of(modules)), path)[-1])
                columns.append((both[1] - both[0]) / (2.0 * e))
            found = np.array(columns).T
        else:
            rows, found = [row for one in links for row in one.rows()], jacobian(modules, way_in)
        expected = sum(row.stiffness * np.outer(row.pull, row.stretch) for row in rows)
        assert found == pytest.approx(expected, abs=0.5)


def test_the_energy_in_a_corner_of_unlike_walls_is_half_of_force_times_way() -> None:
    for degrees in (40.0, 90.0):
        modules, normals, _ = unlike(degrees)
        scene = scene_of(modules)
        program = compile_scene(scene)
        stored, _ = account(program, scene)
        place = -np.array([1e-3, 7e-4]) @ normals
        force = moved(program, np.vstack([line(-10.0 * place, place, 400), place, place]))[-1]
        assert energy(program, stored) == pytest.approx(0.5 * force @ -place, rel=1e-9)
        back = place + np.array([0.01, 0.0])  # out of the corner, along the first wall
        moved(program, line(place, back, 50), begin=False)
        force = moved(program, np.array([back, back]), begin=False)[-1]
        deep = -back @ normals[0]
        assert energy(program, stored) == pytest.approx(0.5 * 1500.0 * deep * deep, rel=1e-9)


WALL = shape({"capsule": [[-0.02, 0.0], [0.02, 0.0]], "radius": 0.001}, friction_coefficient=0.6)
FOOT = shape({"capsule": [[0.003, 0.0], [0.003, 0.02]], "radius": 0.001}, friction_coefficient=0.6)
FAR = shape({"disc": 0.004}, side="outside") | {"form": {"capsule": [[-0.02, -0.03], [0.02, -0.03]], "radius": 0.004}}
ROOM = shape({"box": [0.1, 0.1]}, side="inside")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({"wall": WALL}, {"far": FAR, "wall": WALL}),
        ({"wall": WALL}, {"foot": FOOT, "wall": WALL, "room": ROOM}),
        ({"foot": FOOT, "room": ROOM, "wall": WALL}, {"wall": WALL}),
        ({"far": FAR, "wall": WALL}, {"wall": WALL, "far": FAR}),
        ({"wall": WALL}, {"also": WALL, "wall": WALL}),
    ],
)
@pytest.mark.parametrize(("x", "y"), [(0.0, -0.004), (-0.0204, 0.0002)])
def test_a_hand_stays_on_its_side_of_a_wall_when_others_come_and_go(
    before: Any, after: Any, x: float, y: float
) -> None:
    """Pressed 3 mm beyond a thin wall, or about its round end, with a bent bristle: the force goes on."""
    older_scene, later = scene_of(before), scene_of(after)
    older, program, alone = (compile_scene(one) for one in (older_scene, later, older_scene))
    path = np.vstack([line([x, 0.01], [x, y], 300), line([x, y], [x + 2e-5, y], 20)])
    for one in (older, alone):
        moved(one, path)
    take_over_from(older, older_scene, program, later)
    take_over(older, program, path[-1])
    here, there = (moved(one, path[-1:], begin=False)[0] for one in (program, alone))
    assert here == pytest.approx(there, abs=1e-7)
    assert math.hypot(*there) > 0.8
    there, here = (moved(one, line(path[-1], path[0], 300), begin=False) for one in (alone, program))
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_a_contact_in_a_corner_goes_on_and_one_with_a_wall_that_goes_is_over() -> None:
    modules, normals, _ = unlike(90.0)
    place = -np.array([1e-3, 2e-3]) @ normals
    path = np.vstack([line(-5.0 * place, place, 300), place, place])
    far = shape({"capsule": [[0.02, 0.02], [0.03, 0.03]], "radius": 0.001})
    left = {name: one for name, one in modules.items() if name == "one"}
    for later in (modules | {"far": far}, left):
        older_scene, scene = scene_of(modules), scene_of(later)
        older, program = compile_scene(older_scene), compile_scene(scene)
        moved(older, path)
        take_over_from(older, older_scene, program, scene)
        take_over(older, program, path[-1])
        force = moved(program, path[-2:], begin=False)[-1]
        expected = [0.0, 1500.0 * -place[1]] if later is left else moved(older, path[-2:], begin=False)[-1]
        assert force == pytest.approx(np.array(expected), abs=1e-9)


def slab(left: float, low: float, right: float, high: float) -> dict[str, Any]:
    return shape({"polygon": [[left, low], [right, low], [right, high], [left, high]]}, 1000.0)


def test_a_hand_that_leaves_a_wall_within_the_next_has_gone_into_that_from_where_it_was() -> None:
    """Pressed through one slab, 1.5 mm deep into another of 2 mm behind it, and along past the first one's end: from
    there on the second pushes, to the side from which the hand came."""
    modules = {"near": slab(-0.02, -0.001, 0.0, 0.001), "far": slab(-0.02, -0.006, 0.02, -0.004)}
    path = np.vstack([line([-0.001, 0.002], [-0.001, -0.0055], 2000), line([-0.001, -0.0055], [0.002, -0.0055], 2000)])
    found = moved(compile_scene(scene_of(modules)), path)
    assert found[2000] == pytest.approx([0.0, 6.5], abs=1e-9)
    assert found[-1] == pytest.approx([0.0, 1.5], abs=1e-9)


@pytest.mark.parametrize("gap", [0.0001, 0.0005, 0.004])
def test_no_wall_is_crossed_by_a_hand_that_moves_less_than_its_thickness_in_a_sample(gap: float) -> None:
    """From between two slabs of 2 mm, however narrow the gap is and whichever is nearer, by 1.9 mm at once."""
    modules = {"low": slab(-0.02, -0.002, 0.02, 0.0), "high": slab(-0.02, gap, 0.02, gap + 0.002)}
    program = compile_scene(scene_of(modules))
    for share in (0.01, 0.4, 0.6, 0.99):
        for way in (1.0, -1.0):
            begin = share * gap
            edge = gap if way > 0.0 else 0.0
            places = [[0.0, begin], [0.0, begin], [0.001, edge + way * 0.0015], [0.002, edge + way * 0.0017]]
            found = moved(program, np.array(places))
            assert not found[:2].any()
            np.testing.assert_allclose(found[2:], [[0.0, -way * 1.5], [0.0, -way * 1.7]], atol=1e-9)
