"""The scenes that ship with strings and contacts do what their comments say, on a hand that is worked out here."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, positions_of
from hapsim.prediction import predict
from hapsim.running import run
from hapsim.scene import Scene, load_scene

FOLDER = Path(__file__).parents[2] / "configs"


@dataclass
class Played:
    """Samples by channels: m and N; and where the points that were asked for have been, in m."""

    hand: np.ndarray
    force: np.ndarray
    points: dict[str, np.ndarray]


def shipped(name: str) -> tuple[Scene, str]:
    """A scene and what its comment says, in one line."""
    text = (FOLDER / f"{name}.yaml").read_text()
    comment = " ".join(line.lstrip("# ") for line in text.splitlines() if line.startswith("#"))
    return load_scene(FOLDER / f"{name}.yaml"), comment


def play(scene: Scene, seconds: float, *points: str) -> Played:
    """The scene against real masses that are moved exactly, each force held from the sample after its own."""
    mock, number, program = scene.mock_device, numbers_of(scene), compile_scene(scene)
    channels, samples = scene.channels, int(seconds * scene.rate)
    state = np.array([mock.initial_position, mock.initial_velocity, np.zeros(channels)])
    steps = [
        expm(scene.period * np.array([[0.0, 1.0, 0.0], [0.0, -friction / mass, 1.0 / mass], [0.0, 0.0, 0.0]]))
        for mass, friction in zip(mock.mass, mock.friction, strict=True)
    ]
    played = Played(
        np.zeros((samples, channels)), np.zeros((samples, channels)), {name: np.zeros(samples) for name in points}
    )
    start(program, state[0])
    for n in range(samples):
        played.hand[n] = state[0]
        for name, where in played.points.items():
            where[n] = positions_of(program)[0][number[name]]
        tick(program, state[0], np.zeros(channels), played.force[n])
        state = np.array([step @ state[:, c] for c, step in enumerate(steps)]).T
        state[2] = played.force[n]
    return played


def pitch(motion: np.ndarray, rate: float) -> float:
    """Hz, of the strongest part."""
    length = 1 << 18
    spectrum = np.abs(np.fft.rfft((motion - motion.mean()) * np.hanning(motion.size), length))
    return float(np.argmax(spectrum) * rate / length)


def with_damping(scene: Scene, name: str, damping: float) -> Scene:
    link = scene.modules[name].model_copy(update={"damping": damping})
    return scene.model_copy(update={"modules": {**scene.modules, name: link}})


def test_the_wall_throws_the_hand_back_once_and_never_holds_it() -> None:
    scene, comment = shipped("wall")
    played = play(scene, 1.0)
    touched = np.flatnonzero(played.force)
    assert np.all(played.force >= 0.0)
    assert np.ptp(touched) < 100  # samples: one bounce
    assert played.hand[-1] > 0.002
    assert "bounces once and comes to rest above" in comment
    careless = play(with_damping(scene, "stop", 1.0), 0.2)
    assert "Try damping 1" in comment
    way = np.diff(careless.hand[:, 0])
    assert np.max(way) > 1.01 * -way[np.flatnonzero(careless.force)[0] - 1]


def test_the_rubbed_string_sticks_and_breaks_away_again_and_again() -> None:
    scene, comment = shipped("rubbed_string")
    played = play(scene, 1.0)
    size = np.abs(played.force[:, 0])
    breaks = np.flatnonzero((size[:-1] > 0.25) & (size[1:] <= 0.151))
    assert breaks.size > 20
    assert np.abs(played.force).max() == pytest.approx(0.4, abs=0.02)
    assert "breaks away at 0.4 N and slides at 0.15 N" in comment
    assert 0.0 < np.diff(played.hand[:, 0])[-1] * scene.rate < 0.15  # m/s: slower than the 0.2 that it began with


def test_the_string_is_higher_while_it_buzzes() -> None:
    scene, comment = shipped("buzzing_contact")
    played = play(scene, 1.0, "string.12", "string.18")
    quarter = len(played.force) // 4
    at_bridge = played.points["string.18"] < -0.0005
    assert at_bridge[:quarter].any()
    first, later = (pitch(played.points["string.12"][part], scene.rate) for part in (np.s_[:quarter], np.s_[-quarter:]))
    assert first > later + 0.3
    assert "its pitch is higher while it buzzes than after" in comment


def test_the_four_keys_come_back_and_click_on_their_way() -> None:
    scene, comment = shipped("four_keys")
    played = play(scene, 1.0)
    assert np.abs(played.hand[-1]).max() < 1e-4
    assert not played.force[:, 2:].any()
    press = -np.linspace(0.0, 0.012, 2000)
    force = np.zeros((press.size, 4))
    program = compile_scene(scene)
    start(program, np.zeros(4))
    for n, x in enumerate(press):
        tick(program, np.full(4, x), np.zeros(4), force[n])
    slow = 1.0  # N: the damper's part is smaller than what is looked for

    def at(depth: float) -> float:
        return float(force[np.searchsorted(-press, depth), 0])

    assert at(0.003) - at(0.0036) > slow - 0.15
    assert "1 N more up to 3 mm, and none from 3.5 mm on" in comment
    assert at(0.0118) > at(0.0098) + 3.0  # the bottom


def on_the_mock(name: str) -> np.ndarray:
    """Positions of a shipped scene's mock for 1.5 s of virtual time, m or rad."""
    scene, _ = shipped(name)
    lockstep = scene.device.model_copy(update={"clock": "lockstep"})
    trace = run(scene.model_copy(update={"device": lockstep}), duration=1.5)
    assert np.abs(trace.asked_force).max() < 0.9 * scene.device.force_limit
    return np.asarray(trace.position[:, 0])


@pytest.mark.parametrize("name", ["button", "fader", "knob_24", "toggle"])
def test_knobs_and_buttons_feel_in_their_regions_as_predicted(name: str) -> None:
    """Every region holds the hand stably, lets it go or is a snap; and the comment has no k and b but theirs."""
    scene, comment = shipped(name)
    ((_, regions),) = predict(scene).regions.items()
    assert all(region.is_stable for region in regions)
    assert {"held", "snap"} <= {region.kind for region in regions}
    told = re.findall(r"k = ([\d.]+) N\S+, b = ([\d.]+) N", comment)
    assert told
    for k, b in told:
        within = [0.5000001 * 10.0 ** -len(number.partition(".")[2]) for number in (k, b)]
        assert any(
            abs(float(k) - region.felt.k) <= within[0] and abs(float(b) - region.felt.b) <= within[1]
            for region in regions
            if region.kind == "held"
        ), (k, b)


def test_the_finger_of_the_mock_rests_on_the_bottom_of_the_button() -> None:
    position, (scene, comment) = on_the_mock("button"), shipped("button")
    assert position[-1] == pytest.approx(-0.004 - (1.0 - 0.65) / 1500.0, abs=1e-6)
    assert "rest 0.23 mm into the bottom" in comment
    button = scene.modules["button"].model_copy(update={"drop": 0.8})
    held = program_force(scene.model_copy(update={"modules": {**scene.modules, "button": button}}), -0.003)
    assert "stays down until you pull it up with 0.2 N" in comment
    assert held == pytest.approx(-0.2)


def program_force(scene: Scene, position: float) -> float:
    """N, on a hand at rest."""
    program, force = compile_scene(scene), np.zeros(1)
    start(program, np.array([position]))
    tick(program, np.array([position]), np.zeros(1), force)
    return float(force[0])


def test_the_fader_slides_into_its_notch_and_takes_its_force_to_leave() -> None:
    assert abs(on_the_mock("fader")[-1]) < 1e-5
    scene, comment = shipped("fader")
    forces = [program_force(scene, position) for position in (0.00125, -0.00125, 0.0026, 0.0399)]
    assert forces == pytest.approx([-1.0, 1.0, 0.0, 0.0])
    assert "5 mm wide, and takes 1 N to leave it" in comment


def test_the_knob_is_spun_into_its_fourth_detent() -> None:
    turned = np.degrees(on_the_mock("knob_24"))
    assert turned[-1] == pytest.approx(4 * 15.0, abs=1e-3)
    assert "passes three detents and comes to rest in the fourth" in shipped("knob_24")[1]


def test_the_toggle_is_knocked_over_or_comes_back() -> None:
    assert on_the_mock("toggle")[-1] == pytest.approx(0.005, abs=2e-6)
    scene, comment = shipped("toggle")
    assert "with 0.6 m/s, comes to rest on the right" in comment
    assert "With a velocity of 0.4 m/s it comes back" in comment
    assert scene.mock is not None
    slower = scene.mock.model_copy(update={"initial": scene.mock.initial.model_copy(update={"velocity": 0.4})})
    back = play(scene.model_copy(update={"mock": slower}), 1.0)
    assert back.hand[-1, 0] == pytest.approx(-0.005, abs=2e-6)
    assert max(abs(program_force(scene, x)) for x in np.linspace(-0.005, 0.005, 101)) == pytest.approx(2.0)
