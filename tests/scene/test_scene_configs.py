"""The scenes that ship load, and ring as their comments say."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from hapsim import predict, run
from hapsim.scene import Scene, ViscoElastic, load_scene

FOLDER = Path(__file__).parents[2] / "configs"
BOARDS = sorted(f"boards/{path.stem}" for path in (FOLDER / "boards").glob("*.yaml"))
#: A scene in the plane: where its hand presses a straight side, or a disc, in m.
IN_THE_PLANE = {
    "disc": (0.011, 0.0),
    "maze": (-0.0235, 0.0),
    "puck": (-0.051, 0.0),
    "boards/haply_disc": (0.009, 0.0),
}
ON_A_LINE = [name for name in BOARDS if name not in IN_THE_PLANE]
EVERY = sorted(path.stem for path in FOLDER.glob("*.yaml"))
#: With masses, strings or contacts: the tests of the tick hold what they do.
PLAYED = [
    *("bell", "bowed_string", "button", "buzzing_contact", "fader", "four_keys", "guiro", "held_string", "knob_24"),
    *("button_recorded", "plucked_string", "rubbed_string", "struck_membrane", "toggle", "two_hands", "wall"),
    *("admittance", "disc", "maze", "puck", "touched_wall", "two_devices"),
]
NAMES = [name for name in EVERY if name not in PLAYED]
FORETOLD = re.compile(
    r"#     k = (?P<k>[\d.]+) (?:N/m|N·m/rad), b = (?P<b>[\d.]+) (?:N·s/m|N·m·s/rad), "
    r"ringing at (?P<hertz>[\d.]+) Hz with damping ratio (?P<ratio>[\d.]+)\.$",
    re.MULTILINE,
)


def text_of(name: str) -> str:
    return (FOLDER / f"{name}.yaml").read_text()


def with_touch(name: str, **changes: object) -> Scene:
    """A shipped scene of one link with other values of that link."""
    scene = load_scene(FOLDER / f"{name}.yaml")
    ((link_name, link),) = scene.links.items()
    assert isinstance(link, ViscoElastic)
    return scene.model_copy(update={"modules": {**scene.modules, link_name: link.model_copy(update=changes)}})


def test_the_scenes_that_ship_are_all_here() -> None:
    assert sorted(NAMES + PLAYED) == EVERY
    assert NAMES == [
        "first_touch",
        "paper_6_1_no_delay",
        "paper_6_2_one_sample",
        "paper_6_3_real_damping",
        "sensed_acceleration",
        "sensed_velocity",
        "sprung_device",
        "zero_order_hold",
    ]


@pytest.mark.parametrize("name", [*EVERY, *BOARDS])
def test_a_scene_that_ships_opens_with_what_to_feel_and_what_to_expect(name: str) -> None:
    text = text_of(name)
    opening = text[: text.index("version: 1")]
    assert all(line.startswith("#") for line in opening.splitlines())
    assert "# What to feel: " in opening
    assert "# What to expect: " in opening
    scene = load_scene(FOLDER / f"{name}.yaml")
    assert all(one.port is None for one in (scene.devices.values() if scene.ports else [scene.device]))


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_that_ships_rings_as_in_its_comment(name: str) -> None:
    predicted = predict(with_touch(name))
    told = FORETOLD.search(text_of(name))
    assert predicted.stable
    assert told
    assert predicted.k == pytest.approx(float(told["k"]), abs=0.005)
    assert predicted.b == pytest.approx(float(told["b"]), abs=0.00005)
    ringing_hz = predicted.felt[0].frequency_hz * math.sqrt(1.0 - predicted.felt[0].damping_ratio ** 2)
    assert ringing_hz == pytest.approx(float(told["hertz"]), abs=0.005)
    assert predicted.felt[0].damping_ratio == pytest.approx(float(told["ratio"]), abs=0.0005)
    assert 0.05 < predicted.felt[0].damping_ratio < 0.8


def test_the_scene_in_admittance_feels_as_in_its_comment() -> None:
    (felt,) = predict(load_scene(FOLDER / "admittance.yaml")).felt_masses
    assert f"m = {felt.m:.6f} kg and b = {felt.b:.5f} N·s/m" in text_of("admittance")
    lighter = load_scene(FOLDER / "admittance.yaml").changed({"device.simulated_damping": 1.0})
    assert not predict(lighter).stable


@pytest.mark.parametrize("name", ON_A_LINE)
def test_the_first_scene_of_a_board_is_far_from_unstable_and_rings_as_in_its_comment(name: str) -> None:
    predicted = predict(load_scene(FOLDER / f"{name}.yaml"))
    told = FORETOLD.search(text_of(name))
    assert min(margin.stiffness_factor for margin in predicted.margins) > 2.0
    assert predicted.wire_time.fits
    assert told
    assert predicted.k == pytest.approx(float(told["k"]), abs=0.005)
    assert predicted.b == pytest.approx(float(told["b"]), abs=0.00005)


@pytest.mark.parametrize(("name", "at"), IN_THE_PLANE.items())
def test_a_scene_in_the_plane_is_stable_and_pressed_it_feels_as_in_its_comment(
    name: str, at: tuple[float, float]
) -> None:
    scene = load_scene(FOLDER / f"{name}.yaml")
    start = predict(scene)
    assert start.stable
    assert min(margin.stiffness_factor for margin in start.margins) > 2.0
    told = re.findall(r"k = ([\d.]+) N/m, b = ([\d.]+) N·s/m", text_of(name))
    felt = predict(scene, at=at).parts[0].along("hand")
    assert told
    for (k, b), one in zip(told, felt, strict=False):
        assert one.k == pytest.approx(float(k), abs=0.005)
        assert one.b == pytest.approx(float(b), abs=0.00005)


def test_what_slides_off_is_as_fast_as_its_comment() -> None:
    disc, haply = load_scene(FOLDER / "disc.yaml"), load_scene(FOLDER / "boards" / "haply_disc.yaml")
    slippery = disc.modules["disc"].model_copy(update={"friction_coefficient": 0.0})
    disc = disc.model_copy(update={"modules": {**disc.modules, "disc": slippery}})
    for scene, name in ((disc, "disc"), (haply, "boards/haply_disc")):
        here = predict(scene, at=IN_THE_PLANE[name])
        (slide,) = here.slides
        _, along = here.parts[0].along("hand")
        text = text_of(name)
        assert f"{along.k:.2f} N/m" in text
        assert f"e-fold in {1e3 * slide.e_fold_s:.3g} ms" in text


@pytest.mark.parametrize(
    ("name", "rest"),
    [("disc", (-0.0097, 0.0361)), ("maze", (-0.006 + 0.00152, 0.022)), ("puck", (-0.03, 0.0))],
)
def test_the_mocks_hand_ends_in_the_plane_where_its_comment_has_it(name: str, rest: tuple[float, float]) -> None:
    scene = load_scene(FOLDER / f"{name}.yaml")
    trace = run(scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})}), duration=3)
    np.testing.assert_allclose(trace.position[-1], rest, atol=2e-4)
    assert 0.5 < np.hypot(*trace.asked_force.T).max() < scene.device.force_limit


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_that_ships_stays_within_its_force_limit_and_the_counts_of_the_wire(name: str) -> None:
    scene = load_scene(FOLDER / f"{name}.yaml")
    trace = run(scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})}), duration=3)
    counts = np.abs(trace.position).max() / scene.mock_device.quantum[0]
    assert 0 < scene.mock_device.initial_velocity[0] <= 0.1
    assert np.abs(trace.asked_force).max() < 0.5 * scene.device.force_limit
    assert 10_000 < counts < 0.5 * 2**31
    # It has come to rest; a count of the velocity weighs as much as some counts of the position.
    counts_of_rest = 5.0 if "acceleration" in scene.sensed else 2.0
    assert abs(trace.position[-1, 0]) <= counts_of_rest * scene.mock_device.quantum[0]


@pytest.mark.parametrize(
    ("name", "damping", "b"),
    [("first_touch", 2.0, -0.0295), ("paper_6_2_one_sample", 0.1, -0.0121), ("zero_order_hold", 0.05, -0.0026)],
)
def test_the_unstable_neighbours_that_the_comments_name_are_unstable(name: str, damping: float, b: float) -> None:
    assert f"b = {b:.4f}" in text_of(name)
    predicted = predict(with_touch(name, damping=damping))
    assert not predicted.stable
    assert predicted.b == pytest.approx(b, abs=0.00005)


def test_the_scene_with_a_sensor_states_what_it_would_be_without() -> None:
    predicted = predict(with_touch("sensed_velocity", damper="backward"))
    assert f"k = {predicted.k:.2f} N/m and b = {predicted.b:.4f} N·s/m" in text_of("sensed_velocity")
    (light,) = (one.with_mass(0.1) for one in predict(load_scene(FOLDER / "sensed_acceleration.yaml")).felt)
    assert f"{light.k:.2f} N/m and {light.b:.5f} N·s/m" in text_of("sensed_acceleration")


@pytest.mark.parametrize("mass", [2e-6, 1.2e-5, 1e-4])
@pytest.mark.parametrize("friction", [0.0, 1.45e-4])
def test_the_first_scene_of_a_smartknob_is_stable_for_any_knob(mass: float, friction: float) -> None:
    """No mass and no friction of one is published."""
    scene = load_scene(FOLDER / "boards" / "smartknob.yaml")
    told = FORETOLD.search(text_of("boards/smartknob"))
    assert told
    predicted = predict(scene)
    assert predicted.k == pytest.approx(float(told["k"]), abs=0.000005)
    assert predicted.b == pytest.approx(float(told["b"]), abs=0.0000005)
    assert predicted.felt[0].damping_ratio == pytest.approx(float(told["ratio"]), abs=0.0005)
    knob = scene.device.model_copy(update={"mass": mass, "friction": friction})
    other = predict(scene.model_copy(update={"device": knob}))
    assert other.stable
    assert min(margin.stiffness_factor for margin in other.margins) > 1.5
