"""Views of a scene on the page, and the force over the position of a hand. Nothing runs here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.live.messages import Predict, text_of
from hapsim.live.predicted import predicted
from hapsim.live.views import views_of
from hapsim.running.live_parameters import parameters_of
from hapsim.scene import Scene, load_scene, parse_scene

VIEWS = {
    "knob_24": "force dial plane",
    "button": "force plane",
    "button_recorded": "force plane",
    "toggle": "force plane",
    "fader": "force plane",
    "wall": "force plane",
    "four_keys": "force plane picture",
    "first_touch": "plane picture",
    "sprung_device": "plane picture",
    "two_hands": "picture",
    "held_string": "picture",
    "maze": "picture",
}
HEAD = "version: 1\nrate: 2000\ndevice: {mass: 0.08, friction: 0.6, force_limit: 5DEVICE}\nmodules:\n"
HEAD += "  hand: {type: device, channel: 0}\n  frame: {type: ground, position: 0.001}\n"
BUTTON = """\
  rest: {type: viscoelastic, between: [hand, frame], stiffness: 200, damping: 1}
  dome: {type: nonlinear, between: [frame, hand], force_over_distance: [[0, 0], [0.002, 2.6], [0.0025, 1.5]]}
  stop: {type: buffer, between: [hand, frame], stiffness: 2500, damping: 40, distance: -0.005}
"""
HELD = """\
  knob: {type: detent, between: [hand, frame], depth: 0.9, hold_until: 0.7, dead_zone: 0.5 mm, damping: 1, PLACES}
"""


def scene_of(modules: str, device: str = "") -> Scene:
    return parse_scene(HEAD.replace("DEVICE", device) + modules)


def answer(scene: Scene, *at: float, **asked: Any) -> dict[str, Any]:
    values = Predict(type="predict", at=list(at), curve=True, **asked)
    found = predicted(scene, parameters_of(scene, has_mock=False), values)
    assert text_of(found)
    return found


def curve(scene: Scene, *at: float, **asked: Any) -> Any:
    return answer(scene, *at, **asked)["curve"]


def columns(curve: Any, *names: str) -> list[np.ndarray]:
    """Arrays over all regions; a region whose force has no two ways is its own `up` and `down`."""
    return [np.concatenate([one.get(name, one["f"]) for one in curve["regions"]]) for name in names]


@pytest.mark.parametrize("name", VIEWS)
def test_every_kind_of_scene_has_its_views_and_the_mock_can_be_dragged_in_one(name: str) -> None:
    scene = load_scene(f"configs/{name}.yaml")
    assert views_of(scene, has_mock=True) == VIEWS[name].split()
    alone = views_of(scene, has_mock=False)
    assert alone == [one for one in VIEWS[name].split() if one != "picture" or "plane" not in alone or "keys" in name]


@pytest.mark.parametrize("own", [0.0, 40.0])
def test_the_force_is_that_of_the_links_with_snaps_places_and_stops(own: float) -> None:
    found = curve(scene_of(BUTTON, f", stiffness: {own}"), 0.0)
    x, force = columns(found, "x", "f")
    d = x - 0.001
    dome = np.interp(-d, [0.0, 0.002, 0.0025], [0.0, 2.6, 1.5])
    expected = own * x + 200.0 * d - dome + 2500.0 * np.minimum(d + 0.005, 0.0)
    np.testing.assert_allclose(force, expected, atol=1e-5)
    assert np.all(np.diff(x) >= -1e-9)
    assert found["own_stiffness"] == own
    assert [one["kind"] for one in found["regions"]] == ["held", "held", "snap", "held", "held"]
    assert all(one["stable"] and (one["error"] > 0.0) is (one["kind"] == "held") for one in found["regions"])
    # From the peak at -1 mm to -1.5 mm the force falls by 1.1 N less what the springs take.
    fall = 1.1 - (200.0 + own) * 0.0005
    ((at, energy),) = found["snaps"]
    assert at == pytest.approx(-0.00125)
    assert energy == pytest.approx(0.5 * fall * 0.0005, rel=1e-6)
    ((low, high),) = found["places"]
    assert (low, high) == (pytest.approx(1.5 / (1500.0 + own), rel=1e-5),) * 2
    assert found["stops"] == [(-0.004, 1)]
    assert found["view"][0] < -0.004 < 0.001 < found["view"][1]


def test_it_is_asked_for_with_values_that_are_not_applied_and_of_the_chosen_hand() -> None:
    keys = load_scene("configs/four_keys.yaml")
    before = curve(keys, 0, 0, 0, 0, hand=2)
    assert before["hand"] == "e"
    softer = curve(keys, 0, 0, 0, 0, hand=2, values={"e-spring.stiffness": 75.0})
    (x, force), (other, less) = columns(before, "x", "f"), columns(softer, "x", "f")
    at = np.linspace(-0.009, 0.009, 50)
    np.testing.assert_allclose(np.interp(at, x, force) - np.interp(at, other, less), 75.0 * at, atol=1e-5)
    with pytest.raises(UsageError, match="hand: found 4, expected 0 to 3"):
        curve(keys, hand=4)


def test_a_straight_spring_and_a_hand_that_moves_masses_have_none() -> None:
    assert curve(load_scene("configs/first_touch.yaml"), 0.0) is None
    assert "curve" not in answer(load_scene("configs/two_hands.yaml"), 0.0, 0.0)
    assert "curve" not in answer(load_scene("configs/disc.yaml"), 0.0, 0.0)


@pytest.mark.parametrize("turns", [-400, -1, 0, 1, 100_000])
def test_a_knob_without_an_end_is_drawn_and_felt_alike_in_every_turn(turns: int) -> None:
    scene, pitch = load_scene("configs/knob_24.yaml"), math.radians(15.0)
    x = turns * math.tau + 0.3 * pitch
    found = answer(scene, x)
    drawn, region = found["curve"], found["hands"][0]["region"]
    assert region["low_m"] <= x <= region["high_m"]
    assert region["high_m"] - region["low_m"] == pytest.approx(0.5 * pitch, abs=1e-9 * abs(x) + 1e-12)
    assert region["kind"] == "snap"
    assert drawn["period"] == pytest.approx(pitch)
    places, force = columns(drawn, "x", "f")
    assert np.ptp(places) == pytest.approx(pitch, rel=1e-6)
    np.testing.assert_allclose(force, 0.03 * np.sin(math.tau * places / pitch), atol=1e-6)
    ((place, _),) = drawn["places"]
    assert math.remainder(place, pitch) == pytest.approx(0.0, abs=1e-9)
    assert drawn["snaps"][0][1] == pytest.approx(0.03 * pitch / 2.0, rel=1e-3)
    assert sum(drawn["view"]) / 2.0 == pytest.approx(x)
    assert drawn["follows"]


def test_a_wall_ends_a_knob_whose_picture_stays_while_the_hand_moves_within_a_detent() -> None:
    scene = load_scene("configs/toggle.yaml")
    views = {tuple(curve(scene, x)["view"]) for x in (-0.0049, -0.002, 0.0, 0.002, 0.0049)}
    assert len(views) == 1
    first = curve(scene, 0.0)
    assert [round(low, 6) for low, _ in first["places"]] == [-0.005, 0.005]
    assert first["stops"] == [(-0.006, 1), (0.006, -1)]


@pytest.mark.parametrize("number", [0, 1, 128, 255])
def test_of_many_places_those_about_the_hand_are_sent(number: int) -> None:
    places = ", ".join(f"{one} mm" for one in range(256))
    scene = scene_of(HELD.replace("PLACES", f"stop: 3000, places: [{places}]").replace("0.5 mm", "0.1 mm"))
    found = curve(scene, 0.001 + 1e-3 * number)
    low, high = found["regions"][0]["low"], found["regions"][-1]["high"]
    assert low <= 0.001 + 1e-3 * number <= high
    assert high - low < 0.02
    assert len(text_of(found)) < 20_000
    assert found["stops"] == [(0.001 - 0.0001, 1), (0.001 + 0.255 + 0.0001, -1)]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_detent_that_holds_has_two_ways_and_its_places_have_numbers(sign: int) -> None:
    modules = HELD.replace("PLACES", "pitch: 10 mm")
    if sign < 0:
        modules = modules.replace("[hand, frame]", "[frame, hand]")
    found = curve(scene_of(modules), 0.0)
    x, up, down = columns(found, "x", "up", "down")
    d, stiffness = x - 0.001, 0.9 / (0.7 * 0.01 - 0.0005)

    def held(d: np.ndarray, until: float) -> np.ndarray:
        way = d - 0.01 * np.floor(d / 0.01 + 1.0 - until)
        return stiffness * (np.maximum(way - 0.0005, 0.0) + np.minimum(way + 0.0005, 0.0))

    for until in (0.3, 0.7):  # the force jumps there, in a line as upright as it is
        assert np.sum(np.abs(np.remainder(d / 0.01, 1.0) - until) < 1e-6) >= 2
    clear = np.min([np.abs(np.remainder(d / 0.01, 1.0) - share) for share in (0.3, 0.7)], axis=0) > 1e-6
    np.testing.assert_allclose(up[clear], held(d, 0.7)[clear], atol=1e-5)
    np.testing.assert_allclose(down[clear], held(d, 0.3)[clear], atol=1e-5)
    (place,) = found["places"]
    assert place == pytest.approx([0.0005, 0.0015], abs=1e-6)
    assert found["held"]["knob"] == {"at": [0.001], "pitch": pytest.approx(sign * 0.01)}


def test_both_branches_of_a_curve_and_both_ways_of_friction_are_drawn() -> None:
    x, up, down = columns(curve(load_scene("configs/button_recorded.yaml"), 0.0), "x", "up", "down")
    at = [0.0, 0.6e-3, 1.2e-3, 1.6e-3, 2.4e-3, 3e-3]
    np.testing.assert_allclose(up, np.interp(x, at, [0.0, 0.55, 0.7, 0.45, 0.6, 2.4]), atol=1e-5)
    np.testing.assert_allclose(down, np.interp(x, at, [0.0, 0.35, 0.45, 0.3, 0.42, 2.1]), atol=1e-5)
    rubbed = curve(
        scene_of(BUTTON + "  rub: {type: friction, between: [hand, frame], force: 0.1, stiffness: 500}\n"), 0.0
    )
    x, force, up, down = columns(rubbed, "x", "f", "up", "down")
    np.testing.assert_allclose([up - force, force - down], 0.1, atol=1e-5)
