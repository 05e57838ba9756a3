"""Expected values of each type of module, the errors for others, and the resulting scene."""

from collections.abc import Callable
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from hapsim.errors import SceneError, UsageError
from hapsim.running.changed_scene import changed
from hapsim.scene import (
    Branches,
    Cell,
    Click,
    Damper,
    Detent,
    Friction,
    Nonlinear,
    Plectrum,
    Proxy,
    Scene,
    Spring,
    parse_scene,
    scene_schema,
)

Faults = Callable[[str], list[str]]

CURVE_M = "expected a list of 2 to 1000 points [m, N]"
BOTH_M = f"{CURVE_M}, or {{press: such a list, release: another, turn: a distance > 0 (m)}}, or a file.csv"
POINT_M = "expected a point [m, N], two numbers"
ORDER = "the points stand in ascending order"

MODULES = {
    "cell": "{type: cell, mass: 0.01, stiffness: 100}",
    "spring": "{type: spring, between: [hand, wall], stiffness: 2000}",
    "damper": "{type: damper, between: [hand, wall], damping: 2}",
    "nonlinear": "{type: nonlinear, between: [hand, wall], force_over_distance: [[-1, -5], [1, 5]]}",
    "branches": "{type: nonlinear, between: [hand, wall], force_over_distance: {press: [[0, 0], [2, 4]], "
    "release: [[0, 0], [1, 1], [2, 3]], turn: 0.1}}",
    "friction": "{type: friction, between: [hand, wall], force: 1, stiffness: 2000}",
    "plectrum": "{type: plectrum, between: [hand, wall], stiffness: 500, release: 0.002}",
    "detent": "{type: detent, between: [hand, wall], pitch: 0.005, depth: 0.3}",
    "proxy": "{type: proxy, mass: 0.01, hand: hand, stiffness: 700}",
    "click": "{type: click, between: [hand, wall], travel: 0.004, peak: 0.6, drop: 0.3, bottom: 5000}",
}


def with_module(good: str, text: str) -> str:
    return f"{good}  it: {text}\n"


def scene_with(good: str, kind: str) -> Scene:
    return parse_scene(with_module(good, MODULES[kind]))


def test_what_is_left_out_of_a_module_has_the_defaults_of_the_format(good: str) -> None:
    ends = ("hand", "wall")
    expected = {
        "cell": Cell(mass=0.01, stiffness=100.0, damping=0.0, rest=0.0, position=None, velocity=0.0),
        "spring": Spring(between=ends, stiffness=2000.0),
        "damper": Damper(between=ends, damping=2.0),
        "nonlinear": Nonlinear(between=ends, force_over_distance=((-1.0, -5.0), (1.0, 5.0)), force_over_velocity=None),
        "branches": Nonlinear(
            between=ends,
            force_over_distance=Branches(
                press=((0.0, 0.0), (1.0, 2.0), (2.0, 4.0)), release=((0.0, 0.0), (1.0, 1.0), (2.0, 3.0)), turn=0.1
            ),
        ),
        "friction": Friction(between=ends, force=1.0, static=None, stiffness=2000.0, damping=0.0),
        "plectrum": Plectrum(between=ends, stiffness=500.0, damping=0.0, release=0.002),
        "detent": Detent(between=ends, pitch=0.005, depth=0.3, damping=0.0, shape="sine", sharpness=None),
        "proxy": Proxy(mass=0.01, hand="hand", stiffness=700.0, damping=0.0, position=0.0, velocity=0.0),
        "click": Click(between=ends, travel=0.004, peak=0.6, drop=0.3, bottom=5000.0, damping=0.0),
    }
    assert {kind: scene_with(good, kind).modules["it"] for kind in MODULES} == expected


def test_a_cell_begins_where_it_rests_unless_the_scene_states_where(good: str) -> None:
    resting = "{type: cell, mass: 0.01, stiffness: 100, rest: 0.02%s}"
    scenes = [parse_scene(with_module(good, resting % more)) for more in ("", ", position: 0.0")]
    assert [scene.material_points["it"].start() for scene in scenes] == [(0.02, 0.0), (0.0, 0.0)]


def test_a_cell_is_a_point_that_a_link_can_hold(good: str) -> None:
    scene = parse_scene(with_module(good, MODULES["cell"]) + "  l: {type: spring, between: [it, wall], stiffness: 1}\n")
    assert scene.links["l"].between == ("it", "wall")
    assert list(scene.masses) == []


@pytest.mark.parametrize("kind", MODULES)
def test_a_scene_with_such_a_module_reads_back_the_same_and_can_be_hashed(good: str, kind: str) -> None:
    scene = scene_with(good, kind)
    assert Scene.model_validate(scene.model_dump()) == scene
    assert Scene.model_validate_json(scene.model_dump_json()) == scene
    assert hash(scene) == hash(scene_with(good, kind))


@pytest.mark.parametrize(
    ("kind", "old", "new", "told"),
    [
        ("cell", ", stiffness: 100", "", "it: 'stiffness' is missing, expected a number >= 0 (N/m)"),
        ("nonlinear", "[[-1, -5], [1, 5]]", "3", f"force_over_distance: found 3, {BOTH_M}"),
        ("nonlinear", "[[-1, -5], [1, 5]]", "[[1, 5]]", f"force_over_distance: found a list of 1, {CURVE_M}"),
        ("nonlinear", "[1, 5]", "[1, 5, 6]", f"force_over_distance[1]: found a list, {POINT_M}"),
        ("nonlinear", "[1, 5]", "[.nan, 5]", "force_over_distance[1][0]: found .nan, expected a finite number (m)"),
        ("nonlinear", "[1, 5]", "[-1, 5]", f"force_over_distance[1][0]: found -1, expected a number > -1 m: {ORDER}"),
        (
            "nonlinear",
            "force_over_distance: [[-1, -5], [1, 5]]",
            "force_over_velocity: [[0.1, 0], [0.0, 1]]",
            f"force_over_velocity[1][0]: found 0.0, expected a number > 0.1 m/s: {ORDER}",
        ),
        ("branches", ", turn: 0.1", ", turn: 0", "turn: found 0, expected a distance > 0 (m)"),
        ("branches", ", turn: 0.1", ", trun: 1", f"force_over_distance: found a mapping, {BOTH_M}"),
        ("branches", "[2, 3]", "[1, 3]", f"release[2][0]: found 1, expected a number > 1 m: {ORDER}"),
        (
            "branches",
            "[1, 1]",
            "[0.5, 1.5]",
            "release[1][1]: found 1.5, expected no more than 1 N while one presses, at 0.5 m",
        ),
        (
            "branches",
            "[2, 4]",
            "[2.5, 2.5]",
            "release[2][1]: found 3, expected no more than 2 N while one presses, at 2 m",
        ),
        (
            "branches",
            "press: [[0, 0]",
            "press: [[0, 0], [0.5, 0.25]",
            "press[1][1]: found 0.25, expected at least 0.5 N while one releases, at 0.5 m",
        ),
        (
            "nonlinear",
            ", force_over_distance: [[-1, -5], [1, 5]]",
            "",
            "it: found neither force_over_distance nor force_over_velocity, expected at least one of them",
        ),
        (
            "friction",
            "force: 1",
            "force: 1, static: 0.5",
            "static: found 0.5 N, less than the force while it slides; expected at least 1 N",
        ),
        ("plectrum", ", release: 0.002", "", "it: 'release' is missing, expected a number > 0 (m)"),
        ("detent", "0.3", "0.3, shape: saw", "shape: found 'saw' (text), expected sine, snap or notch"),
        (
            "detent",
            "0.3",
            "0.3, sharpness: 3",
            "sharpness: found a sharpness, which shape: sine does not have; expected shape: snap or notch, "
            "or no sharpness",
        ),
        ("click", ", bottom: 5000", "", "it: 'bottom' is missing, expected a number > 0 (N/m)"),
    ],
)
def test_what_is_wrong_with_a_module_is_reported(
    faults: Faults, good: str, kind: str, old: str, new: str, told: str
) -> None:
    text = MODULES[kind]
    assert text.count(old) == 1
    (fault,) = faults(with_module(good, text.replace(old, new)))
    assert fault.startswith("8:")
    assert fault.split(": ", 1)[1] == told


def test_a_curve_of_a_thousand_points_is_taken_and_one_of_more_is_not(faults: Faults, good: str) -> None:
    def text(points: int) -> str:
        curve = ", ".join(f"[{i}, 0]" for i in range(points))
        return with_module(good, MODULES["nonlinear"].replace("[[-1, -5], [1, 5]]", f"[{curve}]"))

    link = parse_scene(text(1000)).links["it"]
    assert isinstance(link, Nonlinear)
    assert isinstance(link.force_over_distance, tuple)
    assert len(link.force_over_distance) == 1000
    assert faults(text(1001)) == [f"8:69: force_over_distance: found a list of 1001, {CURVE_M}"]


BUTTON = {
    "press": [[0.0, 0.0], [0.6e-3, 0.55], [1.2e-3, 0.7], [1.6e-3, 0.45], [2.4e-3, 0.6], [3e-3, 2.4]],
    "release": [[0.0, 0.0], [0.6e-3, 0.35], [1.2e-3, 0.45], [1.6e-3, 0.3], [2.4e-3, 0.42], [3e-3, 2.1]],
}


def button(**values: Any) -> Any:
    """The branches of a scene with a button whose branches have these further values, on a device with these."""
    turn = {key: values.pop(key) for key in ("turn", "press", "release") if key in values}
    link = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": BUTTON | turn}
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "button": link}
    scene = {"version": 1, "rate": 1000, "device": {"mass": 0.2, "friction": 9.0} | values, "modules": modules}
    return getattr(parse_scene(yaml.safe_dump(scene)).links["button"], "branches", None)


def test_two_branches_give_a_mean_a_half_difference_and_the_steepest_slope() -> None:
    branches = button(turn=1e-4)
    assert [force for _, force in branches.mean] == pytest.approx([0.0, 0.45, 0.575, 0.375, 0.51, 2.25], rel=1e-12)
    assert [force for _, force in branches.half] == pytest.approx([0.0, 0.1, 0.125, 0.075, 0.09, 0.15], rel=1e-12)
    assert branches.steepest == pytest.approx(6000.0, rel=1e-12)
    assert branches.least_turn(1000.0, 1.0, 9.0) == pytest.approx(1e-4, rel=1e-12)


@pytest.mark.parametrize(
    ("values", "turn"),
    [
        ({"friction": 9.0}, 1e-4),  # its least value
        ({"friction": 9.0, "delay": 0}, 0.3 / 15000.0),  # that is 0.02 mm, and 2 % of 3 mm more
        ({"friction": 4.0}, 2.0 * 0.15),  # one branch is steeper than 2667 N/m: none is safe
        ({"friction": 0.0}, 0.0),
        ({"friction": 9.0, "release": [[0.0, 0.0], [3e-3, 1e-6]]}, 2.4 / 3000.0),
        ({"friction": 0.1, "release": BUTTON["press"]}, 0.0),  # nothing between the branches
    ],
)
def test_a_turn_that_is_left_out_is_two_per_cent_of_the_range_or_the_least_that_is_safe(
    values: dict[str, Any], turn: float
) -> None:
    expected = max(turn, 6e-5) if turn < 0.1 else 6e-5
    assert button(**values).turn == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("friction", [4.6, 5.0, 9.0, 30.0])
@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0])
def test_the_least_turn_is_the_one_whose_steepest_slope_a_device_just_bears(friction: float, delay: float) -> None:
    branches = button(turn=1.0)
    least = branches.least_turn(1000.0, delay, friction)
    assert (0.5 + delay) * 1e-3 * button(turn=least).steepest == pytest.approx(friction, rel=1e-9)
    assert (0.5 + delay) * 1e-3 * button(turn=0.999 * least).steepest > friction


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("nonlinear", "[[-1, -5], [1, 5]]", "[[-1, -5]]"),
        ("nonlinear", "[1, 5]", "[1]"),
        ("nonlinear", "[1, 5]", "[1, x]"),
        ("branches", "[2, 4]", "[2]"),
        ("branches", "0.1", "0"),
        ("branches", "turn", "trun"),
    ],
)
def test_the_schema_takes_curves_and_refuses_what_the_loader_refuses(good: str, kind: str, old: str, new: str) -> None:
    validator = Draft202012Validator(scene_schema())
    text = with_module(good, MODULES[kind])
    assert validator.is_valid(yaml.safe_load(text))
    assert not validator.is_valid(yaml.safe_load(text.replace(old, new)))
    with pytest.raises(SceneError):
        parse_scene(text.replace(old, new))


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("cell", {"stiffness": 1.0, "damping": 2.0, "rest": 3.0}),
        ("spring", {"stiffness": 1.0}),
        ("damper", {"damping": 1.0}),
        ("friction", {"force": 2.0, "static": 3.0, "stiffness": 4.0, "damping": 5.0}),
        ("plectrum", {"stiffness": 1.0, "damping": 2.0, "release": 3.0}),
        ("click", {"travel": 1.0, "peak": 2.0, "drop": 3.0, "bottom": 4.0, "damping": 5.0, "peak_at": 0.4}),
    ],
)
def test_live_values_may_change_while_the_scene_runs(good: str, kind: str, changes: dict[str, float]) -> None:
    module: Any = changed(scene_with(good, kind), {"it": changes}).modules["it"]
    assert set(changes) == set(module.live)
    assert {key: getattr(module, key) for key in changes} == changes


def test_a_change_is_checked_against_the_other_values_of_its_module(good: str) -> None:
    scene = parse_scene(with_module(good, MODULES["friction"].replace("force: 1", "force: 1, static: 2")))
    with pytest.raises(UsageError, match=r"it.static: found 2 N, less than the force .* expected at least 3 N"):
        changed(scene, {"it": {"force": 3.0}})
    assert changed(scene, {"it": {"force": 3.0, "static": 3.0}})
    assert changed(scene_with(good, "friction"), {"it": {"force": 3.0}})


def test_the_sharpness_of_a_detent_may_change_where_it_has_one(good: str) -> None:
    sine = scene_with(good, "detent")
    assert changed(sine, {"it": {"pitch": 0.01, "depth": 0.2, "damping": 0.1}})
    with pytest.raises(UsageError, match=r"it.sharpness: found a sharpness, which shape: sine does not have"):
        changed(sine, {"it": {"sharpness": 3.0}})
    snap = parse_scene(with_module(good, MODULES["detent"].replace("0.3", "0.3, shape: snap")))
    assert changed(sine, {"it": {"shape": "snap", "sharpness": 2.0}})
    with pytest.raises(UsageError, match=r"it.shape: found 'saw', expected 'sine', 'snap' or 'notch'"):
        changed(sine, {"it": {"shape": "saw"}})
    assert getattr(changed(snap, {"it": {"sharpness": 3.0}}).modules["it"], "sharpness", None) == 3.0


def test_what_cannot_change_while_the_scene_runs_is_reported_with_what_can(good: str) -> None:
    with pytest.raises(
        UsageError, match="of a click travel and peak and drop and bottom and damping and peak_at can change"
    ):
        changed(scene_with(good, "click"), {"it": {"stiffness": 1.0}})
    with pytest.raises(UsageError, match="of a nonlinear force_over_distance and force_over_velocity can change"):
        changed(scene_with(good, "nonlinear"), {"it": {"stiffness": 1.0}})


HELD = "{type: detent, between: [hand, wall], %s}"


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("depth: 1", "it: found neither a pitch nor places, expected one of them"),
        ("depth: 1, pitch: 0.01, places: [0, 1]", "it: found a pitch and places, expected one of them"),
        (
            "depth: 1, pitch: 0.01, hold_until: 0.4",
            "hold_until: found 0.4: every passage would give the hand 0.0025 J; expected from 0.5 to below 1.5",
        ),
        ("depth: 1, pitch: 0.01, hold_until: 1.5", "hold_until: found 1.5; expected from 0.5 to below 1.5"),
        ("depth: 1, places: [1, 0]", "places[1]: found 0, expected a number > 1 m: they stand in ascending order"),
        ("depth: 1, places: [0]", "places: found a single place without a stop; expected a second one, or stop: its"),
        ("depth: 1, places: [0, 1], only: [0, 2]", "only: found 2, expected numbers from 0 to 1, those of its places"),
        ("depth: 1, pitch: 0.01, stop: 9", "stop: found a stop without places; expected places too, or none"),
        ("depth: 1, pitch: 0.01, dead_zone: 0.001", "dead_zone: found a dead_zone without hold_until; expected"),
        (
            "depth: 1, pitch: 0.01, hold_until: 0.6, dead_zone: 0.005",
            "dead_zone: found 0.005 m; expected less than half the least way, 0.01 m",
        ),
        (
            "depth: 1, pitch: 0.01, hold_until: 0.6, shape: snap",
            "shape: found snap of a detent that remembers its place; expected no hold_until, or no shape",
        ),
        (
            "depth: 1, places: [0, 0.01], hold_until: 1.2, stop: 90000",
            "stop: found 90000 N/m: the last place takes over within the stop, which gives the hand 0.1739",
        ),
    ],
)
def test_a_detent_that_holds_gives_no_energy_and_has_its_keys(faults: Faults, good: str, keys: str, told: str) -> None:
    (fault,) = faults(with_module(good, HELD % keys))
    assert fault.split(": ", 1)[1].startswith(told)


def test_live_values_of_a_detent_that_holds_change_and_its_places_too(good: str) -> None:
    scene = parse_scene(with_module(good, HELD % "depth: 1, places: [0, 0.01], hold_until: 0.8, stop: 5"))
    assert getattr(changed(scene, {"it": {"hold_until": 1.1, "stop": 9.0}}).modules["it"], "stop", None) == 9.0
    assert getattr(changed(scene, {"it": {"places": [0.0, 0.02]}}).modules["it"], "places", None) == (0.0, 0.02)
    with pytest.raises(UsageError, match="every passage would give the hand"):
        changed(scene, {"it": {"hold_until": 0.3}})
