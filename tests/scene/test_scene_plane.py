"""Scenes with two coordinates: their points, their links, and errors of what does not fit."""

import math

import pytest

from hapsim.errors import SceneError
from hapsim.scene import Scene
from hapsim.scene.load import load_scene, parse_scene, scene_schema
from hapsim.scene.modules import MODULE_TYPES

PLANE = """
version: 1
rate: 1000
space: 2
device: {mass: 0.2, friction: 1.0}
modules:
  hand:  {type: device, channels: [0, 1]}
  post:  {type: ground, position: [0.03, 0.0]}
  disc:  {type: shape, between: [hand, post], form: {disc: 0.02}, stiffness: 2000, damping: 5}
  lane:  {type: guide, between: [hand, post], through: [[0, 0], [0.02, 0.01], [0.05, 0.01]], stiffness: 800,
          reach: 0.005}
  ball:  {type: mass, mass: 0.05, position: [0.02, 0.04], velocity: [0.0, 1.0]}
  hit:   {type: buffer, between: [hand, ball], distance: 0.01, stiffness: 1500}
  rope:  {type: spring, between: [ball, post], length: 0.05, stiffness: 500}
"""


def fault(*changes: tuple[str, str]) -> str:
    text = PLANE
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    with pytest.raises(SceneError) as error:
        parse_scene(text)
    return str(error.value)


def test_shapes_with_the_same_ends_that_leave_no_place_free_are_refused() -> None:
    ring = "  ring:  {type: shape, between: [hand, post], form: {disc: %s}, side: inside, stiffness: 2000}\n  lane:"
    told = fault(("  lane:", ring % "0.015"))
    assert "form: found a form that, together with disc, leaves no place free; expected room for hand" in told
    for room in (ring % "0.025", (ring % "0.015").replace("[hand, post]", "[ball, post]")):
        assert "ring" in parse_scene(PLANE.replace("  lane:", room)).modules


def test_points_of_the_plane_are_two_coordinates_each() -> None:
    scene = parse_scene(PLANE)
    assert {name: one.channel for name, one in scene.device_points.items()} == {"hand.x": 0, "hand.y": 1}
    assert {name: one.position for name, one in scene.grounds.items()} == {"post.x": 0.03, "post.y": 0.0}
    assert {name: one.start() for name, one in scene.masses.items()} == {"ball.x": (0.02, 0.0), "ball.y": (0.04, 1.0)}
    assert all(one.mass == 0.05 for one in scene.material_points.values())
    assert scene.channels == 2
    assert scene.channel_groups == ((0, 1),)


def test_links_of_the_plane_stand_apart_from_those_of_a_line() -> None:
    scene = parse_scene(PLANE)
    assert list(scene.plane_links) == ["disc", "lane", "hit", "rope"]
    assert not scene.links
    assert not load_scene("first_touch").plane_links
    assert float(scene.plane_links["rope"].law().tension(0.07)) == pytest.approx(500 * 0.02)


def test_law_of_a_guide_pulls_beyond_its_width_and_lets_go_beyond_its_reach() -> None:
    scene = parse_scene(PLANE.replace("reach: 0.005", "reach: 0.005, width: 0.002"))
    law = scene.plane_links["lane"].law()
    found = [float(law.tension(d)) for d in (-0.006, -0.004, -0.0005, 0.0, 0.0009, 0.004, 0.006)]
    assert found == pytest.approx([0.0, -800 * 0.003, 0.0, 0.0, 0.0, 800 * 0.003, 0.0])


def test_a_scene_of_the_plane_is_the_same_after_a_dump() -> None:
    scene = parse_scene(PLANE)
    assert Scene.model_validate(scene.model_dump()) == scene


def test_units_are_taken_in_forms_and_places() -> None:
    text = PLANE.replace("{disc: 0.02}", "{disc: 20 mm}").replace("[0.03, 0.0]", "[3 cm, 0]")
    assert parse_scene(text).modules == parse_scene(PLANE).modules


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("channels: [0, 1]", "channel: 0", "found channel, expected channels: two of the device"),
        ("channels: [0, 1]", "channels: [0, 0]", "found 0 twice; expected two channels"),
        ("channels: [0, 1]", "channels: [0, 1, 2]", "expected a list of 2 whole numbers from 0 to 15"),
        ("position: [0.03, 0.0]", "position: 0.03", "found 0.03 m alone, expected [x, y]"),
        ("position: [0.02, 0.04]", "position: [0.02, 0.04, 1]", "expected two numbers [x, y] (m)"),
        ("{disc: 0.02}", "{disc: 0.02, box: [1, 1]}", "found disc and box, expected one of disc, half_plane"),
        ("{disc: 0.02}", "{}", "found none, expected one of disc"),
        ("{disc: 0.02}", "{radius: 0.01, disc: 0.02}", "found a radius without a capsule"),
        ("{disc: 0.02}", "{capsule: [[0, 0], [1, 0]]}", "found a capsule without a radius"),
        ("{disc: 0.02}", "{capsule: [[0, 0], [0, 0]], radius: 0.1}", "expected another place than the one before"),
        ("{disc: 0.02}", "{half_plane: [0, 0]}", "which points nowhere"),
        ("{disc: 0.02}", "{box: [0.1, -0.1]}", "found a side below 1e-12"),
        ("{disc: 0.02}", "{polygon: [[0, 0], [1, 1], [1, 0], [0, 1]]}", "found side 1 crossing side 3"),
        ("{disc: 0.02}", "{polygon: [[0, 0], [1, 0], [0, 1], [0, 0]]}", "it closes by itself"),
        ("{disc: 0.02}", "{polygon: [[0, 0], [2, 0], [1, 0]]}", "found a turn straight back"),
        ("{disc: 0.02}", "{box: [0.01, 0.02]}, round: 0.006", "expected at most 0.005 m"),
        ("{disc: 0.02}", "{disk: 0.02}", "did you mean 'disc'?"),
        ("[0.02, 0.01], [0.05", "[0.02, 0.01], [0.02, 0.01], [0.05", "expected another place than the one before"),
        ("reach: 0.005", "reach: 0.005, width: 0.02", "found 0.005 m, within half of its width"),
        ("reach: 0.005", "round: 0.005", "a smooth path, which has no corners"),
        ("[0.05, 0.01]], ", "[0.01, 0.005]], path: straight, ", "found a turn straight back at place 2"),
        ("type: spring", "type: detent", "found detent in a scene with space: 2"),
        ("friction: 1.0", "friction: 1.0, correction: poles", "found poles in a scene with space: 2, expected none"),
        ("friction: 1.0", "friction: 1.0, motion: rotary", "expected linear: x and y are lengths"),
        ("space: 2", "space: 2\nscheme: rk4", "found rk4 in a scene with space: 2, expected cordis"),
        ("space: 2", "space: 3", "expected a whole number from 1 to 2"),
        ("{type: spring", "{type: viscoelastic, damper: centred", "found centred in a scene with space: 2"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_plane_is_an_error(old: str, new: str, told: str) -> None:
    assert told in fault((old, new))


def test_what_needs_the_plane_is_an_error_on_a_line() -> None:
    told = fault(("space: 2\n", ""))
    assert "found channels in a scene with one coordinate, expected channel; or write space: 2" in told
    assert "found two coordinates, expected a number (m); or write space: 2" in told
    assert "found shape in a scene with one coordinate; write space: 2" in told
    assert "found a length in a scene with one coordinate" in told
    assert "Traceback" not in told


def test_places_with_decimals_are_not_taken_for_numbers_with_a_comma() -> None:
    told = fault(("{disc: 0.02}", "{capsule: [[0.01,0.5],[0.01,0.5]], radius: 0.002}"))
    assert told.endswith("found a list, expected another place than the one before")


def test_schema_describes_forms_and_paths() -> None:
    described = str(scene_schema())
    assert all(word in described for word in ("half_plane", "Corners of a polygon", "Channels of x and y", "closed"))
    assert {"shape", "guide"} <= MODULE_TYPES.keys()


def test_default_friction_is_softer_along_a_surface_than_across_it() -> None:
    shape = parse_scene(PLANE).modules["disc"]
    assert shape.bristle == (1000.0, 5.0)  # type: ignore[attr-defined]
    assert math.isfinite(shape.chain().nearest(0.0, 0.0).curvature) is False  # type: ignore[attr-defined]
