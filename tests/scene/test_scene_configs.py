"""The scenes that ship load, and ring as their comments say: by the poles of hand and spring together."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.scene import Scene, ViscoElastic, load_scene

FOLDER = Path(__file__).parents[2] / "configs"
EVERY = sorted(path.stem for path in FOLDER.glob("*.yaml"))
#: With masses, strings or contacts: the tests of the tick hold what they do.
PLAYED = ["buzzing_contact", "four_keys", "held_string", "plucked_string", "rubbed_string", "two_hands", "wall"]
NAMES = [name for name in EVERY if name not in PLAYED]
CONFIGS = [FOLDER / f"{name}.yaml" for name in NAMES]
FORETOLD = re.compile(
    r"#     k = (?P<k>[\d.]+) N/m, b = (?P<b>[\d.]+) N·s/m, "
    r"ringing at (?P<hertz>[\d.]+) Hz with damping ratio (?P<ratio>[\d.]+)\.$",
    re.MULTILINE,
)


def touch_of(scene: Scene) -> ViscoElastic:
    """The only link."""
    (link,) = scene.links.values()
    assert isinstance(link, ViscoElastic)
    return link


def closed_loop(scene: Scene) -> np.ndarray:
    """From sample to sample: position, velocity, position one sample before, and the forces under way."""
    mock, period = scene.mock_device, scene.period
    stiffness, damping = touch_of(scene).stiffness, touch_of(scene).damping
    (mass,), (friction,) = mock.mass, mock.friction
    late = int(mock.delay)
    (own,) = mock.stiffness
    # Position, velocity and a held force, over one sample.
    moves = expm(period * np.array([[0.0, 1.0, 0.0], [-own / mass, -friction / mass, 1.0 / mass], [0.0, 0.0, 0.0]]))
    moves, push = moves[:2, :2], moves[:2, 2]
    if mock.hold == "impulse":
        push = moves @ np.array([0.0, period / mass])
    matrix = np.zeros((3 + late, 3 + late))
    matrix[:2, :2], matrix[2, 0] = moves, 1.0
    force = np.zeros(3 + late)
    force[0], force[2] = -stiffness - damping / period, damping / period
    if touch_of(scene).damper == "sensed":
        force[:3] = -stiffness, -damping, 0.0
    if late:
        matrix[:2, 3] += push
        matrix[3:-1, 4:] = np.eye(late - 1)
        matrix[-1] += force
    else:
        matrix[:2] += np.outer(push, force)
    return matrix


def test_the_scenes_that_ship_are_all_here() -> None:
    assert sorted(NAMES + PLAYED) == EVERY
    assert NAMES == [
        "first_touch",
        "paper_6_1_no_delay",
        "paper_6_2_one_sample",
        "paper_6_3_real_damping",
        "sensed_velocity",
        "sprung_device",
        "zero_order_hold",
    ]


@pytest.mark.parametrize("path", [FOLDER / f"{name}.yaml" for name in EVERY], ids=EVERY)
def test_a_scene_that_ships_opens_with_what_to_feel_and_what_to_expect(path: Path) -> None:
    text = path.read_text()
    opening = text[: text.index("version: 1")]
    assert all(line.startswith("#") for line in opening.splitlines())
    assert "# What to feel: " in opening
    assert "# What to expect: " in opening
    assert load_scene(path).device.port is None


@pytest.mark.parametrize("path", CONFIGS, ids=NAMES)
def test_a_scene_that_ships_rings_as_its_comment_says(path: Path) -> None:
    scene = load_scene(path)
    poles = np.linalg.eigvals(closed_loop(scene)).astype(complex)
    pair = poles[np.argsort(-abs(poles))][:2]
    assert abs(pair[0]) < 1
    assert abs(pair[0] - pair[1].conj()) < 1e-9
    slow = np.log(pair[0]) / scene.period
    (mass,) = scene.mock_device.mass
    told = FORETOLD.search(path.read_text())
    assert told
    assert mass * abs(slow) ** 2 == pytest.approx(float(told["k"]), abs=0.005)
    assert -2 * mass * slow.real == pytest.approx(float(told["b"]), abs=0.00005)
    assert abs(slow.imag) / (2 * np.pi) == pytest.approx(float(told["hertz"]), abs=0.005)
    assert -slow.real / abs(slow) == pytest.approx(float(told["ratio"]), abs=0.0005)
    assert 0.05 < -slow.real / abs(slow) < 0.8


@pytest.mark.parametrize("path", CONFIGS, ids=NAMES)
def test_a_scene_that_ships_stays_within_its_force_limit_and_the_counts_of_the_wire(path: Path) -> None:
    scene = load_scene(path)
    touch = touch_of(scene)
    matrix = closed_loop(scene)
    state = np.zeros(len(matrix))
    state[1] = scene.mock_device.initial_velocity[0]
    assert 0 < state[1] <= 0.1
    force, position = [], []
    for _ in range(3000):
        speed = state[1] if touch.damper == "sensed" else (state[0] - state[2]) / scene.period
        force.append(touch.stiffness * state[0] + touch.damping * speed)
        position.append(state[0])
        state = matrix @ state
    assert max(map(abs, force)) < 0.5 * scene.device.force_limit
    assert max(map(abs, position)) / scene.mock_device.quantum < 0.5 * 2**31
    assert max(map(abs, position)) / scene.mock_device.quantum > 10_000
    assert abs(state[0]) < 1e-6 * max(map(abs, position))


@pytest.mark.parametrize(
    ("name", "damping", "b"),
    [
        ("first_touch", 2.0, -0.0295),
        ("paper_6_2_one_sample", 0.1, -0.0121),
        ("zero_order_hold", 0.05, -0.0026),
    ],
)
def test_the_unstable_neighbours_that_the_comments_name_are_unstable(name: str, damping: float, b: float) -> None:
    path = CONFIGS[NAMES.index(name)]
    assert f"b = {b:.4f}" in path.read_text()
    scene = load_scene(path)
    (link_name,) = scene.links
    link = scene.links[link_name].model_copy(update={"damping": damping})
    neighbour = scene.model_copy(update={"modules": {**scene.modules, link_name: link}})
    slow = np.log(max(np.linalg.eigvals(closed_loop(neighbour)).astype(complex), key=abs)) / scene.period
    assert -2 * scene.mock_device.mass[0] * slow.real == pytest.approx(b, abs=0.00005)


def test_the_scene_with_a_sensor_says_what_it_would_be_without() -> None:
    path = CONFIGS[NAMES.index("sensed_velocity")]
    scene = load_scene(path)
    touch = touch_of(scene).model_copy(update={"damper": "backward"})
    without = scene.model_copy(update={"modules": {**scene.modules, "touch": touch}})
    slow = np.log(max(np.linalg.eigvals(closed_loop(without)).astype(complex), key=abs)) / scene.period
    (mass,) = scene.mock_device.mass
    assert f"k = {mass * abs(slow) ** 2:.2f} N/m and b = {-2 * mass * slow.real:.4f} N·s/m" in path.read_text()
