"""Scenes with two coordinates in the kernel, beside formulas that are written here once more."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.program import compile_scene, positions_of
from hapsim.scene.chain import Chain

from .plane_scenes import RATE, Floats, forces, line, moved, noisy, scene_of, shape, turned

T = 1.0 / RATE
SQUARE = [[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]]

TENSIONS: dict[str, tuple[dict[str, Any], Any]] = {
    "spring": ({"type": "spring", "stiffness": 300.0, "length": 0.03}, lambda d, _: 300.0 * (d - 0.03)),
    "loose_spring": ({"type": "spring", "stiffness": 300.0}, lambda d, _: 300.0 * d),
    "damper": ({"type": "damper", "damping": 2.0}, lambda _, v: 2.0 * v),
    "viscoelastic": (
        {"type": "viscoelastic", "stiffness": 300.0, "damping": 2.0, "length": 0.03},
        lambda d, v: 300.0 * (d - 0.03) + 2.0 * v,
    ),
    "buffer": (
        {"type": "buffer", "stiffness": 300.0, "damping": 2.0, "distance": 0.04},
        lambda d, v: min(300.0 * (d - 0.04) + 2.0 * v, 0.0) if d < 0.04 else 0.0,
    ),
    "nonlinear": (
        {"type": "nonlinear", "force_over_distance": [[0.01, -3.0], [0.03, 0.0], [0.06, 5.0]]},
        lambda d, _: float(np.interp(d, [0.01, 0.03, 0.06], [-3.0, 0.0, 5.0])),
    ),
    "plectrum": (
        {"type": "plectrum", "stiffness": 300.0, "damping": 2.0, "release": 0.5},
        lambda d, v: 300.0 * d + 2.0 * v,
    ),
}


def wandering(seed: int, steps: int = 200, near: float = 0.006) -> Floats:
    """A path about the post that keeps its distance from it."""
    random = np.random.default_rng(seed)
    angle = np.cumsum(random.normal(0.0, 0.02, steps)) + random.uniform(-math.pi, math.pi)
    away = near + np.abs(random.uniform(0.0, 0.05) + np.cumsum(random.normal(0.0, 5e-4, steps)))
    return np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", TENSIONS)
def test_a_link_pulls_along_the_line_between_its_ends(name: str, precision: str) -> None:
    link, tension = TENSIONS[name]
    for seed in range(5):
        path = wandering(seed)
        found = forces({"it": link}, path, precision=precision)
        before = np.vstack([path[:1], path[:-1]])
        for r, last, force in zip(path, before, found, strict=True):
            d = math.hypot(*r)
            n = r / d
            expected = -tension(d, n @ (r - last) * RATE) * n
            assert force == pytest.approx(expected, abs=1e-11 if precision == "double" else 1e-2)


def test_both_ends_are_pulled_and_neither_needs_neighbouring_channels() -> None:
    modules = {
        "hand": {"type": "device", "channels": [3, 0]},
        "other": {"type": "device", "channels": [1, 4]},
        "it": {"type": "viscoelastic", "between": ["hand", "other"], "stiffness": 300.0, "damping": 2.0},
    }
    random = np.random.default_rng(1)
    path = np.cumsum(random.normal(0.0, 1e-3, (50, 5)), axis=0) + np.array([0.01, 0.0, 0.0, 0.02, 0.03])
    found = forces(modules, path)
    r = path[:, [3, 0]] - path[:, [1, 4]]
    g = np.vstack([np.zeros((1, 2)), np.diff(r, axis=0)])
    n = r / np.linalg.norm(r, axis=1)[:, None]
    expected = -300.0 * r - 2.0 * RATE * np.sum(n * g, axis=1)[:, None] * n
    assert found[:, [3, 0]] == pytest.approx(expected, abs=1e-11)
    assert found[:, [1, 4]] == pytest.approx(-expected, abs=1e-11)
    assert not found[:, 2].any()


# Where two points meet.


@pytest.mark.parametrize("link", ["spring", "viscoelastic", "buffer"])
def test_a_hand_that_is_pressed_through_a_point_is_pushed_back_to_its_side(link: str) -> None:
    """All the way through and 5 mm further, with noise, and out again: the force never turns over, nor jumps."""
    there = line([0.03, 0.0], [-0.005, 0.0], 350)
    path = noisy(np.vstack([there, np.repeat(there[-1:], 2000, axis=0), there[::-1]]))
    found = forces({"it": TENSIONS[link][0]}, path)
    inside = path[:, 0] < 0.025
    assert (found[inside, 0] > 0.0).all()
    assert np.abs(found[:, 1]).max() < 0.05 * found[:, 0].max()
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    assert steps[1:].max() < 1.0  # N: K times the step of 0.1 mm, and the damper's noise


@pytest.mark.parametrize("name", ["spring", "loose_spring", "viscoelastic", "buffer", "nonlinear"])
def test_across_the_point_where_ends_meet_the_force_changes_by_no_more_than_it_may_turn(name: str) -> None:
    """A direction turns by the way over a tenth of the length and 0.1 mm, so the force by its size times that."""
    link, _ = TENSIONS[name]
    scene = {"it": {key: value for key, value in link.items() if key != "damping"}}
    near = 1e-4 + 0.1 * link.get("length", link.get("distance", 0.0))
    for seed in range(20):
        random = np.random.default_rng(seed)
        path = np.cumsum(random.normal(0.0, 2e-5, (4000, 2)), axis=0)
        path -= path[random.integers(4000)]  # some sample is the very point
        found = forces(scene, path)
        way = np.linalg.norm(np.diff(path, axis=0), axis=1) + 1e-8
        turn = np.minimum(way / near, 1.0)
        size = np.linalg.norm(found, axis=1)
        assert np.isfinite(found).all()
        allowed = 300.0 * way + size[1:] * 1.001 * turn + np.linalg.norm(found, axis=1)[:-1] * 0.001 + 1e-9
        assert (np.linalg.norm(np.diff(found, axis=0), axis=1) < allowed * 1.5).all()


def test_a_spring_without_a_length_is_linear_through_the_point() -> None:
    path = np.cumsum(np.random.default_rng(3).normal(0.0, 3e-5, (1000, 2)), axis=0)
    assert forces({"it": {"type": "spring", "stiffness": 300.0}}, path) == pytest.approx(-300.0 * path, abs=1e-12)


# A frame that is turned.


def test_a_frame_that_is_turned_changes_nothing() -> None:
    for seed in range(6):
        random = np.random.default_rng(seed)
        angle = random.uniform(-math.pi, math.pi)
        path = np.cumsum(random.normal(0.0, 4e-4, (600, 2)), axis=0) + random.normal(0.0, 0.01, 2)
        whole = {}
        for turn in (0.0, angle):
            corners = turned([*SQUARE, [-0.03, 0.0]], turn).tolist()
            places = turned([[-0.03, 0.02], [0.0, 0.03], [0.03, 0.02]], turn).tolist()
            modules = {name: link for name, (link, _) in TENSIONS.items()} | {
                "block": shape({"polygon": corners}, damping=2.0, friction_coefficient=0.3, round=0.001),
                "wall": shape({"capsule": places[:2], "radius": 0.001}, friction_coefficient=0.3),
                "lane": {"type": "guide", "through": places, "stiffness": 800.0, "damping": 1.0, "reach": 0.02},
                "rub": {"type": "friction", "force": 0.5, "static": 0.8, "stiffness": 500.0, "damping": 0.1},
                "ball": {"type": "mass", "mass": 0.05, "position": turned([0.02, 0.01], turn).tolist()},
                "rope": {"type": "spring", "between": ["ball", "hand"], "stiffness": 90.0, "length": 0.02},
            }
            whole[turn] = forces(modules, turned(path, turn))
        size = np.abs(whole[0.0]).max()
        # Some pass 0.1 mm from the post, where rounding turns a direction most.
        assert turned(whole[0.0], angle) == pytest.approx(whole[angle], rel=0.0, abs=5e-12 * size)


# Shapes.


def surface(chain: Chain, r: Floats) -> tuple[float, Floats]:
    nearest = chain.nearest(*r)
    return nearest.distance, np.array(nearest.normal)


FORMS: dict[str, dict[str, Any]] = {
    "disc": {"form": {"disc": 0.02}},
    "ring": {"form": {"disc": 0.02}, "side": "inside"},
    "half plane": {"form": {"half_plane": [1.0, 2.0]}},
    "capsule": {"form": {"capsule": [[-0.02, -0.01], [0.02, 0.01]], "radius": 0.005}},
    "box": {"form": {"box": [0.04, 0.02]}, "round": 0.003},
    "room": {"form": {"box": [0.04, 0.02]}, "side": "inside"},
    "polygon": {
        "form": {"polygon": [[-0.02, -0.02], [0.02, -0.02], [0.0, 0.0], [0.02, 0.02], [-0.02, 0.02]]},
        "round": 0.003,
    },
}


@pytest.mark.parametrize("name", FORMS)
def test_a_shape_pushes_along_the_normal_of_its_nearest_place(name: str) -> None:
    link = {"type": "shape", "stiffness": 2000.0, "damping": 5.0, **FORMS[name]}
    scene = scene_of({"it": link})
    chain = scene.plane_links["it"].chain()  # type: ignore[attr-defined]
    program, touched = compile_scene(scene), 0
    random = np.random.default_rng(4)
    for _ in range(100):
        begin = random.uniform(-0.03, 0.03, 2)
        while not 0.0 < surface(chain, begin)[0] < 1e-3:
            begin = random.uniform(-0.03, 0.03, 2)
        towards = begin - (surface(chain, begin)[0] + random.uniform(0.0, 1e-3)) * surface(chain, begin)[1]
        path = line(begin, towards + random.normal(0.0, 3e-4, 2), 20)
        found = moved(program, path)
        for r, last, force in zip(path, np.vstack([path[:1], path[:-1]]), found, strict=True):
            d, n = surface(chain, r)
            tension = min(2000.0 * d + 5.0 * RATE * (n @ (r - last)), 0.0) if d < 0.0 else 0.0
            corner, t = chain.pieces[chain.nearest(*r).piece], np.array([-n[1], n[0]])
            is_damped = d < 0.0 and corner.bend < 0 and corner.extent < math.pi
            share = -d / (corner.radius - d) if is_damped else 0.0
            assert force == pytest.approx(-tension * n - 5.0 * RATE * share * (t @ (r - last)) * t, abs=1e-9)
            touched += d < 0.0
    assert touched > 400


def jacobian(modules: dict[str, Any], way_in: Floats, step: float = 1e-7) -> Floats:
    """Minus the change of the settled force for a step from the end of a path, N/m."""

    def settled(by: Floats) -> Floats:
        return forces(modules, np.vstack([way_in, way_in[-1] + by, way_in[-1] + by]))[-1]

    return np.array([settled(-by) - settled(by) for by in step * np.eye(2)]).T / (2.0 * step)


@pytest.mark.parametrize("name", ["disc", "ring", "half plane"])
def test_friction_that_sticks_is_the_bristle_projected_on_the_tangent(name: str) -> None:
    K, kt, p = 2000.0, 1000.0, 1e-3
    link = shape(**FORMS[name], stiffness=K, friction_coefficient=0.5, bristle_stiffness=kt)
    n = np.array([1.0, 2.0]) / math.sqrt(5.0)
    t = np.array([-n[1], n[0]])
    outwards, radius = {"disc": (1.0, 0.02), "ring": (-1.0, 0.02), "half plane": (1.0, 0.0)}[name]
    place = outwards * n * radius - p * n
    # In along the normal, then a little along the surface, so that the bristle is bent.
    way_in = np.vstack([line(place + 2e-3 * n, place, 20), line(place, place + 2e-4 * t, 10)])
    chain = scene_of({"it": link}).plane_links["it"].chain()  # type: ignore[attr-defined]
    (d, normal), curvature = surface(chain, way_in[-1]), chain.nearest(*way_in[-1]).curvature
    tangent = np.array([-normal[1], normal[0]])
    bent = -forces({"it": link}, way_in)[-1] @ tangent
    assert 0.1 < bent < 0.5 * K * p
    nn, tt, nt = np.outer(normal, normal), np.outer(tangent, tangent), np.outer(normal, tangent)
    expected = K * nn + (kt + K * d * curvature) * tt - bent * curvature * nt
    found = jacobian({"it": link}, way_in)
    assert found == pytest.approx(expected, abs=1e-3)  # 1e-6 of the stiffness


@pytest.mark.parametrize("name", ["disc", "half plane"])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_friction_that_slides_is_the_cone(name: str, way: float) -> None:
    K, mu, p = 2000.0, 0.3, 1e-3
    link = shape(FORMS[name]["form"], friction_coefficient=mu, static_coefficient=0.4, bristle_stiffness=1000.0)
    n = np.array([1.0, 2.0]) / math.sqrt(5.0)
    radius = 0.02 if name == "disc" else 0.0
    angle = np.linspace(0.0, way * 0.1, 300)
    if name == "disc":
        path = (radius - p) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        path = np.vstack([line(path[0] * 1.1, path[0], 20), path])
    else:
        path = -p * n + np.outer(0.1 * radius + 0.02 * angle / 0.1, [-n[1], n[0]])
        path = np.vstack([line(path[0] + 2e-3 * n, path[0], 20), path])
    found = forces({"it": link}, path)
    chain = scene_of({"it": link}).plane_links["it"].chain()  # type: ignore[attr-defined]
    d, normal = surface(chain, path[-1])
    tangent = np.array([-normal[1], normal[0]])
    assert found[-1] == pytest.approx(-K * d * normal + way * mu * K * d * tangent, abs=1e-9)
    # Before it slides the friction rises to the static cone, and never beyond it.
    normals = np.array([surface(chain, r)[1] for r in path])
    along = np.abs(normals[:, 0] * found[:, 1] - normals[:, 1] * found[:, 0])
    press = np.array([max(-K * surface(chain, r)[0], 0.0) for r in path])
    assert (along <= 0.4 * press + 1e-9).all()
    assert along.max() > 0.36 * K * p
    # It keeps sliding where the hand stands, and sticks at the smallest step back.
    stopped = moved(compile_scene(scene_of({"it": link})), np.vstack([path, path[-1:], path[-1:], path[-2:-1]]))
    assert stopped[-2] == pytest.approx(found[-1], abs=1e-9)
    back = math.dist(path[-1], path[-2])
    assert abs(stopped[-1] @ tangent) == pytest.approx(mu * K * p - 1000.0 * back, abs=1e-2 * mu * K * p)


def test_a_bristle_does_not_creep_under_noise_and_goes_when_the_contact_ends() -> None:
    link = shape({"half_plane": [0.0, 1.0]}, friction_coefficient=0.5)
    there = np.vstack([line([0.0, 1e-3], [0.0, -1e-3], 20), line([0.0, -1e-3], [2e-4, -1e-3], 20)])
    path = noisy(np.vstack([there, np.repeat(there[-1:], 5000, axis=0)]))
    program = compile_scene(scene_of({"it": link}))
    found = moved(program, path)
    assert found[-1, 0] == pytest.approx(-1000.0 * 2e-4, abs=0.02)
    off = np.array([[2e-4, 1e-5], [2e-4, -1e-3]])
    assert moved(program, off, begin=False)[-1, 0] == 0.0


# Walls.


@pytest.mark.parametrize("deep", [0.0005, 0.0015, 0.005])
def test_no_thin_wall_is_crossed(deep: float) -> None:
    """A capsule of 1 mm radius, pressed at 1.9 mm in a sample, with noise of 1 um, at its side and at its end."""
    wall = {"it": shape({"capsule": [[-0.02, 0.0], [0.02, 0.0]], "radius": 0.001})}
    for outside, towards in np.array([[[0.003, 0.002], [0.0, -1.0]], [[0.022, 0.0], [-1.0, 0.0]]]):
        for speed in (1e-4, 1e-3, 1.9e-3):
            far = 0.001 + deep
            steps = max(1, round(far / speed))
            path = line(outside, outside + far * towards, steps)
            path = noisy(np.vstack([path, np.repeat(path[-1:], 3000, axis=0), path[::-1]]))
            found = forces(wall, path)
            back = found @ -towards
            held = found[steps + 1 : steps + 3000]
            assert back.min() > -1e-9
            assert held @ -towards == pytest.approx(2000.0 * deep, abs=0.1)
            assert np.abs(held @ towards[::-1]).max() < 0.2
            assert found[-1] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    ("rounding", "deep"), [(0.002, 0.0002), (0.002, 0.0018), (0.002, 0.005), (0.0, 0.001), (0.0, 0.005)]
)
def test_the_force_along_a_polygon_has_no_jump(rounding: float, deep: float) -> None:
    """Along the lower side of a square at this depth. Less deep than its rounded corners are, on around all others;
    deeper, straight on and out at the right."""
    inner = 0.02 - deep
    places = [np.array([0.0, -0.021]), np.array([0.0, -inner])]
    if deep < rounding:
        corners = [(inner, -inner), (inner, inner), (-inner, inner), (-inner, 0.0)]
        expected = [-2000.0 * deep, 0.0]  # of the left side
    else:
        corners, expected = [(0.03, -inner)], [0.0, 0.0]
    path = np.vstack([line(a, b, 8000) for a, b in pairwise([*places, *map(np.array, corners)])])
    found = forces({"it": shape({"polygon": SQUARE}, round=rounding)}, path)
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    way = np.linalg.norm(np.diff(path, axis=0), axis=1)
    turn = (way + 1e-8) / (1e-4 + 0.1 * rounding)  # at most: the normal's, rad
    assert (steps <= 2000.0 * (way + math.sqrt(2.0) * deep * turn)).all()
    assert found[8000] == pytest.approx([0.0, -2000.0 * deep], abs=1e-6)  # of the lower side
    assert found[-1] == pytest.approx(expected, abs=1e-6)


def put_in(link: dict[str, Any], places: list[Floats], steps: int) -> float:
    """The work of a hand on this way, J."""
    path = np.vstack([line(a, b, steps) for a, b in pairwise(places)])
    found = forces({"it": link}, path)
    return -float(np.sum(0.5 * (found[1:] + found[:-1]) * np.diff(path, axis=0)))


def test_no_closed_path_inside_a_shape_is_given_energy() -> None:
    """A hand puts into a shape, on a random way in, about and out, at least what it gets back."""
    for seed in range(60):
        random = np.random.default_rng(seed)
        form, rounding = [({"disc": 0.001}, {}), ({"polygon": SQUARE}, {"round": 0.002}),
                          ({"capsule": [[-0.01, 0.0], [0.01, 0.0]], "radius": 0.001}, {})][seed % 3]  # fmt: skip
        begin = np.array([0.0, 0.03])
        places = [begin, *random.uniform(-0.004, 0.004, (12, 2)), begin]
        if seed % 3 == 1:
            places[1:-1] = [place + np.array([0.02, 0.018]) for place in places[1:-1]]
        assert put_in(shape(form, **rounding), places, 4000) > -2e-3 * 2000.0 * 0.005**2, seed


def test_no_path_about_the_middle_of_a_disc_is_given_energy() -> None:
    """A hand that is pressed to the middle of a disc and wanders about there, as deep as a direction is remembered."""
    for seed in range(40):
        random = np.random.default_rng(seed)
        begin = np.array([0.0, 0.021])
        places = [begin, *random.uniform(-0.0015, 0.0015, (40, 2)), begin]
        assert put_in(shape({"disc": 0.02}), places, 2000) > -1e-3 * 1000.0 * 0.02**2, seed


def test_a_hand_that_leaves_one_side_into_another_is_pushed_by_that() -> None:
    """Across a gap of 1 mm in one sample, from inside one wall of a U to inside the other."""
    u = (1e-3 * np.array([[0, 0], [21, 0], [21, 20], [11, 20], [11, 5], [10, 5], [10, 20], [0, 20]])).tolist()
    path = [[0.0105, 0.015], [0.0098, 0.015], [0.0113, 0.015], [0.0113, 0.015]]
    assert forces({"it": shape({"polygon": u})}, path) == pytest.approx(
        np.array([[0.0, 0.0], [0.4, 0.0], [-0.6, 0.0], [-0.6, 0.0]])
    )


def test_a_contact_begins_with_a_bristle_that_is_not_bent() -> None:
    link = shape({"half_plane": [0.0, 1.0]}, friction_coefficient=1.0)
    found = forces({"it": link}, [[0.0, 1e-3], [1e-3, -1e-3], [1.1e-3, -1e-3]])
    assert found == pytest.approx(np.array([[0.0, 0.0], [0.0, 2.0], [-0.1, 2.0]]))


# Plectrum, friction, guide.


def test_a_plectrum_releases_and_grips_again_where_its_ends_nearly_meet() -> None:
    link = {"type": "plectrum", "stiffness": 300.0, "release": 0.01}
    path = 1e-3 * np.array([[0, 9], [6, 7], [0, 10.1], [0, 9], [1.1, 0], [0, -0.9], [0, -9]])
    found = forces({"it": link}, path)
    grips = np.array([True, True, False, False, False, True, True])
    assert found == pytest.approx(np.where(grips[:, None], -300.0 * path, 0.0))


def test_friction_is_a_bristle_that_bends_any_way() -> None:
    link = {"type": "friction", "force": 0.5, "static": 0.8, "stiffness": 500.0, "damping": 0.1}
    slid = stuck = 0
    for seed in range(10):
        random = np.random.default_rng(seed)
        drift = np.cumsum(random.normal(0.0, 2e-5, (600, 2)), axis=0) * 0.1
        path = np.cumsum(drift + random.normal(0, 3e-5, (600, 2)), axis=0)
        found = forces({"it": link}, path)
        anchor, slides, last = path[0], False, path[0]
        for r, force in zip(path, found, strict=True):
            g, z = r - last, r - anchor
            if (last - anchor) @ g < 0.0:
                slides = False
            slides = slides or 500.0 * math.hypot(*z) > 0.8
            if slides:
                pull = 0.5 * z / math.hypot(*z)
                anchor = r - pull / 500.0
            else:
                pull = 500.0 * z + 0.1 * RATE * g
            assert force == pytest.approx(-pull, abs=1e-10)
            slid, stuck, last = slid + slides, stuck + (not slides), r
    assert min(slid, stuck) > 500


@pytest.mark.parametrize("closed", [False, True])
def test_a_guide_pulls_to_its_path_within_its_reach(closed: bool) -> None:
    places = [[-0.03, 0.0], [0.0, 0.02], [0.03, 0.0], [0.0, -0.03]]
    link = {"type": "guide", "through": places, "closed": closed, "stiffness": 800.0, "damping": 2.0}
    link |= {"width": 0.002, "reach": 0.005}
    chain = scene_of({"it": link}).plane_links["it"].chain()  # type: ignore[attr-defined]
    states = {"within": 0, "pulled": 0, "released": 0}
    for seed in range(20):
        random = np.random.default_rng(seed)
        path = np.cumsum(random.normal(0.0, 4e-4, (300, 2)), axis=0) + random.uniform(-0.03, 0.03, 2)
        found = forces({"it": link}, path)
        for r, last, force in zip(path, np.vstack([path[:1], path[:-1]]), found, strict=True):
            d, n = surface(chain, r)
            off = abs(d) - 0.001
            state = "within" if off <= 0.0 else "released" if abs(d) > 0.005 else "pulled"
            tension = math.copysign(800.0 * off, d) + 2.0 * RATE * n @ (r - last) if state == "pulled" else 0.0
            nearest = chain.nearest(*r)
            bend, t = chain.pieces[nearest.piece], np.array([-n[1], n[0]])
            held = state == "pulled" and bend.bend * d > 0.0  # outside a bend, or beyond an end
            along = 2.0 * RATE * off / (bend.radius + abs(d)) * (t @ (r - last)) if held else 0.0
            assert force == pytest.approx(-tension * n - along * t, abs=1e-9)
            states[state] += 1
    assert min(states.values()) > 100


# Masses.


def test_no_passive_scene_gains_energy() -> None:
    """Masses on springs, between walls, with friction and no hand: what they have at the start only falls."""
    for seed in range(20):
        random = np.random.default_rng(seed)
        modules: dict[str, Any] = {"far": {"type": "ground", "position": [1.0, 1.0]}}
        for i in range(3):
            angle = 2.0 * math.pi * (i + random.uniform(0.0, 0.3)) / 3.0
            position = (0.012 * np.array([math.cos(angle), math.sin(angle)])).tolist()
            velocity = random.normal(0.0, 0.3, 2).tolist()
            modules[f"m{i}"] = {"type": "mass", "mass": 0.1, "position": position, "velocity": velocity}
            more = {"damping": 0.3, "friction_coefficient": 0.2, "bristle_damping": 0.05}
            room = shape({"box": [0.08, 0.06]}, 300.0, side="inside", **more)
            modules[f"room{i}"] = room | {"between": [f"m{i}", "post"]}
            modules[f"post{i}"] = shape({"disc": 0.004}, 300.0, damping=0.3) | {"between": [f"m{i}", "post"]}
        for i, j in ((0, 1), (1, 2), (2, 0)):
            ends = {"between": [f"m{i}", f"m{j}"]}
            modules[f"k{i}"] = {"type": "viscoelastic", "stiffness": 30.0, "damping": 0.1, "length": 0.015, **ends}
            modules[f"b{i}"] = {"type": "buffer", "stiffness": 200.0, "damping": 0.2, "distance": 0.008, **ends}
        modules["away"] = {"type": "spring", "stiffness": 1.0, "between": ["hand", "far"]}
        program = compile_scene(scene_of(modules))
        places = [[program.numbers[f"m{i}.{axis}"] for axis in "xy"] for i in range(3)]
        still, kinetic = np.zeros((10, 2)), []
        for n in range(600):
            moved(program, still, begin=n == 0)
            here, before = positions_of(program)
            v = (here[places] - before[places]) * RATE
            kinetic.append(0.05 * float(np.sum(v * v)))
        assert max(kinetic[400:]) < 0.1 * kinetic[0]
        assert max(kinetic) < 3.0 * kinetic[0] + 0.02
