"""Outputs follow the scene: an output is 1 in exactly the samples in which its contact is closed, and has the number of
its detent's place. Closed and places are worked out once more from the recorded positions."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.errors import SceneError
from hapsim.recording.trace import Trace
from hapsim.running import run, start
from hapsim.scene import Scene, parse_scene

Array = NDArray[np.float64]
SHIFT = 3


def scene_of(
    link: dict[str, Any],
    output: dict[str, Any],
    hand: dict[str, Any],
    channels: int = 1,
    mock: dict[str, Any] | None = None,
    more: dict[str, Any] | None = None,
    **keys: Any,
) -> Scene:
    """A hand (in the plane with two channels) on nothing but this link to a ground at 0, which `output` follows."""
    device = {"mass": 0.1, "friction": 0.2, "clock": "lockstep", "delay": 1, "force_limit": 100.0}
    plane = {"channels": [0, 1]} if channels == 2 else {"channel": 0}
    document = {
        "version": 1,
        "rate": 1000,
        **({"space": 2} if channels == 2 else {}),
        **keys,
        "device": device,
        "mock": {"initial": hand, **(mock or {})},
        "outputs": {"out": output},
        "modules": {
            "hand": {"type": "device", **plane},
            "wall": {"type": "ground"},
            "link": {"between": ["hand", "wall"], **link},
            **(more or {}),
        },
    }
    return parse_scene(json.dumps(document))


def values_of(trace: Trace) -> NDArray[np.int64]:
    return trace.outputs.astype(np.int64) >> SHIFT


def held_plectrum(x: Array) -> Array:
    return np.cumprod(np.abs(x) <= 0.004).astype(bool)


CONTACTS: dict[str, tuple[dict[str, Any], Callable[[Array], Any], dict[str, float]]] = {
    "buffer": (
        {"type": "buffer", "stiffness": 500.0, "distance": 0.01},
        lambda x: x < 0.01,
        {"position": 0.02, "velocity": -0.3},
    ),
    "click": (
        {"type": "click", "travel": 0.004, "peak": 1.0, "drop": 0.5, "bottom": 2000.0},
        lambda x: x < 0.0,
        {"position": 0.003, "velocity": -0.4},
    ),
    "plectrum": (
        {"type": "plectrum", "stiffness": 100.0, "release": 0.004},
        held_plectrum,
        {"position": 0.001, "velocity": 0.3},
    ),
    "curve with a flat middle": (
        {"type": "nonlinear", "force_over_distance": [[-0.01, -5.0], [-0.002, 0.0], [0.003, 0.0], [0.01, 6.0]]},
        lambda x: (x < -0.002) | (x > 0.003),
        {"position": 0.0, "velocity": 0.3},
    ),
    "notches": (
        {"type": "detent", "pitch": 0.004, "depth": 0.3, "shape": "notch", "sharpness": 2.0},
        lambda x: np.abs(x - 0.004 * np.round(x / 0.004)) < 0.001,
        {"position": 0.0015, "velocity": 0.3},
    ),
}


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", CONTACTS)
def test_a_contact_is_closed_where_it_has_a_force(name: str, precision: str) -> None:
    link, closed, hand = CONTACTS[name]
    trace = run(scene_of(link, {"bit": SHIFT, "when": "link"}, hand, precision=precision), duration=0.2)
    values, x = values_of(trace), trace.position[:, 0]
    assert 0 < values.sum() < values.size
    assert values.tolist() == closed(x).astype(int).tolist()
    assert values.tolist() == (trace.asked_force[:, 0] != 0.0).astype(int).tolist()


PLACES: dict[str, tuple[dict[str, Any], Callable[[Array], Any]]] = {
    "sine": ({"pitch": 0.004}, lambda x: np.floor(x / 0.004 + 0.5)),
    "snap": ({"pitch": 0.004, "shape": "snap"}, lambda x: np.floor(x / 0.004 + 0.5)),
    "notch": ({"pitch": 0.004, "shape": "notch"}, lambda x: np.floor(x / 0.004 + 0.5)),
    "held": ({"pitch": 0.004, "hold_until": 0.75}, lambda x: held(x, lambda k: 0.004 * k, 0.75 * 0.004)),
    "places": ({"places": [-0.004, 0.0, 0.004]}, lambda x: np.clip(np.floor(x / 0.004 + 0.5), -1, 1) + 1),
}


def held(x: Array, rest: Callable[[int], float], share: float) -> Array:
    """Numbers of places that hold until `share` m from their rest."""
    found, k = [], round(float(x[0]) / 0.004)
    for at in x:
        while at - rest(k) > share:
            k += 1
        while at - rest(k) < -share:
            k -= 1
        found.append(k)
    return np.array(found, np.float64)


@pytest.mark.parametrize("name", PLACES)
def test_an_output_has_the_number_of_the_place(name: str) -> None:
    detent, place = PLACES[name]
    link = {"type": "detent", "depth": 0.05} | detent
    scene = scene_of(link, {"bits": [SHIFT, SHIFT + 3], "of": "link"}, {"position": -0.009, "velocity": 0.2})
    trace = run(scene, duration=0.2)
    numbers = place(trace.position[:, 0]).astype(int)
    assert len({*numbers}) >= 3
    assert values_of(trace).tolist() == (numbers % 16).tolist()


def outside_disc(x: Array, y: Array) -> Any:
    return np.hypot(x, y) < 0.01


IN_THE_PLANE: dict[str, tuple[dict[str, Any], Callable[[Array, Array], Any], dict[str, Any]]] = {
    "disc": (
        {"type": "shape", "form": {"disc": 0.01}, "stiffness": 800.0},
        outside_disc,
        {"position": [0.013, 0.002], "velocity": [-0.3, 0.0]},
    ),
    "box from inside": (
        {"type": "shape", "form": {"box": [0.02, 0.03]}, "side": "inside", "stiffness": 800.0},
        lambda x, y: (np.abs(x) > 0.01) | (np.abs(y) > 0.015),
        {"position": [0.0, 0.0], "velocity": [0.3, 0.1]},
    ),
    "guide": (
        {"type": "guide", "through": [[-0.1, 0.0], [0.1, 0.0]], "path": "straight", "width": 0.004, "stiffness": 500.0},
        lambda _x, y: np.abs(y) > 0.002,
        {"position": [0.0, 0.0], "velocity": [0.05, 0.2]},
    ),
    "guide that lets go": (
        {"type": "guide", "through": [[-0.1, 0.0], [0.1, 0.0]], "reach": 0.004, "stiffness": 50.0},
        lambda _x, y: np.abs(y) <= 0.004,
        {"position": [0.0, 0.001], "velocity": [0.0, 0.3]},
    ),
    "buffer": (
        {"type": "buffer", "distance": 0.01, "stiffness": 500.0},
        outside_disc,
        {"position": [0.013, 0.002], "velocity": [-0.3, 0.0]},
    ),
    "plectrum": (
        {"type": "plectrum", "stiffness": 50.0, "release": 0.004},
        lambda x, y: held_plectrum(np.hypot(x, y)),
        {"position": [0.001, 0.0], "velocity": [0.2, 0.2]},
    ),
}


@pytest.mark.parametrize("name", IN_THE_PLANE)
def test_a_contact_in_the_plane_is_closed_where_it_has_a_force(name: str) -> None:
    link, closed, hand = IN_THE_PLANE[name]
    trace = run(scene_of(link, {"bit": SHIFT, "when": "link"}, hand, channels=2), duration=0.2)
    values, (x, y) = values_of(trace), trace.position.T
    assert 0 < values.sum() < values.size
    assert values.tolist() == closed(x, y).astype(int).tolist()
    assert values.tolist() == (trace.asked_force != 0.0).any(axis=1).astype(int).tolist()


def test_outputs_follow_a_scene_that_is_adopted() -> None:
    held: dict[str, Any] = {"mock": {"hand": {"stiffness": 5000.0, "damping": 20.0, "position": 0.0}}}
    link = {"type": "buffer", "stiffness": 500.0, "distance": 0.01}
    scene = scene_of(link, {"bit": SHIFT, "when": "link"}, {}, **held)
    more = {"far": {"type": "ground", "position": 1.0}}
    moved = scene_of(link | {"distance": -0.01}, {"bit": SHIFT, "when": "link"}, {}, more=more, **held)
    with start(scene) as session:
        for _ in range(2):
            ticks = int(session._loop.state.ticks) + 100
            while int(session._loop.state.ticks) < ticks and not session.wait(1e-4):
                pass
            session.adopt(moved, over=0.01)
    values = values_of(session.trace)
    assert values[0] == 1
    assert values[-1] == 0
    assert np.count_nonzero(np.diff(values)) == 1


def test_an_output_that_nothing_can_set_is_refused_with_what_it_may_follow() -> None:
    spring = {"type": "spring", "stiffness": 100.0}
    guide = {"type": "guide", "through": [[-0.1, 0.0], [0.1, 0.0]], "stiffness": 500.0}
    refused = [
        (spring, {"bit": 0, "when": "link"}, 1, "when: found link, a spring; expected a link that closes"),
        (guide, {"bit": 0, "when": "link"}, 2, "when: found link, a guide; expected a link that closes"),
        (spring, {"bits": [0, 3], "of": "link"}, 1, "of: found link, a spring; expected a detent"),
        (spring, {"bit": 0, "when": "wall"}, 1, "when: found wall, a ground; expected a link that closes"),
    ]
    for link, output, channels, sentence in refused:
        with pytest.raises(SceneError, match=sentence):
            scene_of(link, output, {}, channels)
