"""The outlines of a scene in the plane: lines along surfaces and paths, relative to the points that carry them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hapsim.scene import parse_scene
from hapsim.scene.outlines import Outline, outlines_of

HEAD = """\
version: 1
rate: 1000
space: 2
device: {mass: 0.2, %s}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground, position: [0.03, 0.0]}
  it: {between: [hand, post], stiffness: 100, %s}
"""


def outlines(link: str, device: str = "friction: 1") -> list[Outline]:
    return [*outlines_of(parse_scene(HEAD % (device, link)))]


def area(places: tuple[tuple[float, float], ...]) -> float:
    x, y = np.array(places).T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


@pytest.mark.parametrize(
    ("form", "size"),
    [
        ("disc: 0.02", math.pi * 4e-4),
        ("box: [0.04, 0.02]", 8e-4),
        ("capsule: [[0, 0], [0.03, 0.04]], radius: 0.01", math.pi * 1e-4 + 1e-3),
        ("polygon: [[0, 0], [0, 0.02], [0.02, 0]]", 2e-4),  # clockwise in the file
    ],
)
def test_a_shape_has_its_material_on_one_side(form: str, size: float) -> None:
    (outside,) = outlines(f"type: shape, form: {{{form}}}")
    (inside,) = outlines(f"type: shape, side: inside, form: {{{form}}}")
    assert (outside.name, outside.kind, outside.of, outside.about) == ("it", "outside", "hand", "post")
    assert inside.kind == "inside"
    assert outside.places[0] == outside.places[-1]
    assert area(outside.places) == pytest.approx(size, rel=3e-3)
    assert area(inside.places) == pytest.approx(-size, rel=3e-3)


def test_a_half_plane_is_closed_far_within_its_material() -> None:
    (one,) = outlines("type: shape, form: {half_plane: [1, 1]}")
    away = np.array(one.places) @ [math.sqrt(0.5), math.sqrt(0.5)]
    assert sorted(np.round(away, 6)) == [-20.0, -20.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("path", ["smooth", "straight"])
def test_an_open_path_leads_from_its_first_place_to_its_last(path: str) -> None:
    through = "[[0, 0], [0.02, 0.01], [0.05, 0.0]]"
    (one,) = outlines(f"type: guide, path: {path}, through: {through}")
    assert one.kind == "guide"
    np.testing.assert_allclose([one.places[0], one.places[-1]], [[0.0, 0.0], [0.05, 0.0]], atol=1e-12)
    assert np.hypot(*np.diff(one.places, axis=0).T).sum() < 0.06
    (closed,) = outlines(f"type: guide, path: {path}, through: {through}, closed: true")
    np.testing.assert_allclose(closed.places[-1], closed.places[0], atol=1e-12)


@pytest.mark.parametrize(
    ("travel", "bounds"),
    [
        ("[[-0.05, 0.04], [-0.03, 0.02]]", [-0.05, 0.04, -0.03, 0.02]),
        ("[-0.05, 0.04]", [-0.05, 0.04, -0.05, 0.04]),
        ("{disc: 0.05, center: [0.01, 0.02]}", [-0.04, 0.06, -0.03, 0.07]),
        ("{polygon: [[-0.01, 0], [0.03, 0], [0, 0.02]]}", [-0.01, 0.03, 0.0, 0.02]),
    ],
)
def test_the_travel_is_a_line_about_position_0(travel: str, bounds: list[float]) -> None:
    shape, one = outlines("type: shape, form: {disc: 0.02}", f"travel: {travel}")
    assert (one.kind, one.about, shape.kind) == ("travel", "", "outside")
    x, y = np.array(one.places).T
    assert [x.min(), x.max(), y.min(), y.max()] == pytest.approx(bounds, abs=6.3e-5)  # arcs in steps of 0.1 rad
    assert one.places[0] == one.places[-1]


def test_a_scene_of_one_coordinate_has_none() -> None:
    text = (
        "version: 1\nrate: 1000\ndevice: {mass: 0.2, travel: [-0.1, 0.1]}\nmodules: {hand: {type: device, channel: 0}}"
    )
    assert [*outlines_of(parse_scene(text))] == []


WALL = "type: shape, between: [hand, post], stiffness: 100"
PLACES = {"left": "[0, 0], [0, 0.03]", "right": "[0.03, 0], [0.03, 0.03]", "low": "[0, 0], [0.03, 0]"} | {
    "high": "[0, 0.03], [0.03, 0.03]"
}
WALLS = "".join(f"  {name}: {{{WALL}, form: {{capsule: [{at}], radius: 0.001}}}}\n" for name, at in PLACES.items())


def test_walls_with_the_same_ends_are_drawn_as_one_with_the_outer_line_first() -> None:
    scene = HEAD.replace("  it: {between: [hand, post], stiffness: 100, %s}\n", WALLS) % "friction: 1"
    around, hole = outlines_of(parse_scene(scene))
    assert (around.kind, hole.kind) == ("outside", "inside")
    assert {*around.name.split(", ")} == {*hole.name.split(", ")} == {"left", "right", "low", "high"}
    assert area(around.places) == pytest.approx(0.03**2 + 4 * 0.03 * 0.001 + math.pi * 1e-6, rel=1e-3)
    assert area(hole.places) == pytest.approx(-(0.028**2))


@pytest.mark.parametrize(("slope", "angle"), [("[1, 1]", 225.0), ("[1, 0]", 270.0), ("[1, -0.1]", 275.7106)])
def test_two_half_planes_are_one_line_that_is_closed_far_within_their_material(slope: str, angle: float) -> None:
    more = f"  floor: {{{WALL}, form: {{half_plane: [0, 1]}}}}\n"
    scene = (HEAD + more) % ("friction: 1", f"type: shape, form: {{half_plane: {slope}}}")
    (one,) = outlines_of(parse_scene(scene))
    assert one.kind == "outside"
    near = [place for place in one.places if math.hypot(*place) < 10.0]
    assert np.hypot(*np.array(near).T).max() < 1e-9  # the corner alone
    assert area(one.places) == pytest.approx(4.0 * 20.0**2 * math.sin(math.radians(angle) / 8.0))
