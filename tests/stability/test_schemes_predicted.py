"""What `hapsim check` says of a hand on a simulated object, by every scheme and hold, straddled by a thousandth.

Predicted: by what the link that the hand holds may grow. Observed: the compiled tick, against a hand that is moved
exactly, swings on or dies.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.compiling import entry
from hapsim.cordis.offline import start
from hapsim.cordis.program import compile_scene
from hapsim.cordis.schemes import SCHEMES
from hapsim.cordis.tick import tick
from hapsim.prediction import is_surely_unstable, predict, surely_shaken_by, warnings_about
from hapsim.scene import Scene, parse_scene

RATE = 1000.0
T = 1.0 / RATE
HAND_MASS, HAND_FRICTION, HAND_STIFFNESS = 0.2, 1.0, 400.0
SAMPLES = 420_000  # the slowest motion grows, or dies, by some millionths of itself a sample
BLOCKS = 60
DELAYS = (0.0, 0.37, 1.0)
STIFFNESS = 100.0  # N/m of the link as it is written


def link(first: str, second: str, stiffness: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping, **more}


MASS = {"o": {"type": "mass", "mass": 0.05}, "spring": link("o", "wall", 900.0, 1.2)}
STRING = {"s": {"type": "string", "masses": 6, "mass": 0.02, "stiffness": 3000.0, "damping": 0.5, "friction": 0.2}}
NETWORK = {
    "o": {"type": "mass", "mass": 0.05},
    "p": {"type": "mass", "mass": 0.03},
    "c": {"type": "cell", "mass": 0.04, "stiffness": 700.0, "damping": 0.6},
    "a": link("o", "p", 1500.0, 0.7),
    "b": link("p", "c", 800.0, 0.5, damper="centred"),
    "d": link("o", "c", 300.0, 0.4, damper="filtered", cutoff=150.0),
    "e": {"type": "spring", "between": ["p", "wall"], "stiffness": 400.0},
    "f": {"type": "damper", "between": ["p", "wall"], "damping": 0.3},
    "g": {"type": "friction", "between": ["o", "wall"], "force": 1e9, "stiffness": 500.0, "damping": 0.2},
    "h": link("hand", "p", 50.0, 0.1, damper="centred"),
}
OBJECTS: dict[str, tuple[dict[str, Any], str]] = {"mass": (MASS, "o"), "string": (STRING, "s.2"), "net": (NETWORK, "o")}


def scene_of(scheme: str, name: str, hold: str, delay: float, stiffness: float) -> Scene:
    modules, held = OBJECTS[name]
    around = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    device = {"mass": HAND_MASS, "friction": HAND_FRICTION, "stiffness": HAND_STIFFNESS, "delay": delay, "hold": hold}
    touch = {"touch": link("hand", held, stiffness, 1.5)}
    document = {"version": 1, "rate": RATE, "scheme": scheme, "device": device, "modules": around | modules | touch}
    return parse_scene(json.dumps(document))


def hand(hold: str, delay: float) -> np.ndarray:
    """(2, 4): x and v of the hand at the next sample, of x, v, the force before and the force at the sample."""
    rate = np.array(
        [[0.0, 1.0, 0.0], [-HAND_STIFFNESS / HAND_MASS, -HAND_FRICTION / HAND_MASS, 1.0 / HAND_MASS], [0.0, 0.0, 0.0]]
    )
    first, second = expm(rate * delay * T), expm(rate * (1.0 - delay) * T)
    motion = second[:2, :2] @ first[:2, :2]
    if hold == "zoh":
        return np.column_stack([motion, second[:2, :2] @ first[:2, 2], second[:2, 2]])
    kick = second[:2, :2] @ [0.0, T / HAND_MASS]
    if delay < 1.0:
        return np.column_stack([motion, np.zeros(2), kick])
    return np.column_stack([motion, motion @ [0.0, T / HAND_MASS], np.zeros(2)])


@entry
def run(program, io_buffer, hand, state, samples):
    """The tick against a hand: state is x, v and the force before. How far from 0 the hand comes at the most.
    `io_buffer`: (3, 1), position, velocity and force of the one channel."""
    furthest = 0.0
    for _ in range(samples):
        io_buffer[0, 0] = state[0]
        furthest = max(furthest, abs(state[0]))
        tick(program, io_buffer[0], io_buffer[1], io_buffer[2])
        x, v, f = state[0], state[1], io_buffer[2, 0]
        state[0] = hand[0, 0] * x + hand[0, 1] * v + hand[0, 2] * state[2] + hand[0, 3] * f
        state[1] = hand[1, 0] * x + hand[1, 1] * v + hand[1, 2] * state[2] + hand[1, 3] * f
        state[2] = f
    return furthest


def grows(scene: Scene, hold: str, delay: float) -> bool:
    """Whether a swing of some nm becomes a hundred times as large, or larger at the end than in the middle."""
    program = compile_scene(scene)
    io_buffer, state = np.zeros((3, 1)), np.array([0.0, 1e-6, 0.0])
    start(program, state[:1])
    furthest: list[float] = []
    for _ in range(BLOCKS):
        furthest.append(run(program.record, io_buffer, hand(hold, delay), state, SAMPLES // BLOCKS))
        if not furthest[-1] < min(1.0, 100.0 * furthest[0]):
            return True  # before friction slides
    third = BLOCKS // 3
    return max(furthest[-third:]) > max(furthest[third : 2 * third])


@pytest.mark.parametrize("hold", ["zoh", "impulse"])
@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_hand_on_an_object_is_stable_up_to_what_is_predicted(scheme: str, name: str, hold: str) -> None:
    wrong = []
    for delay in DELAYS:
        written = predict(scene_of(scheme, name, hold, delay, STIFFNESS))
        assert written.stable
        assert written.by_its_scheme
        (factor,) = (margin.stiffness_factor for margin in written.margins if margin.name == "touch")
        for beyond in (0.999, 1.001):
            scene = scene_of(scheme, name, hold, delay, beyond * factor * STIFFNESS)
            predicted = predict(scene, with_margins=False)
            unstable = [
                grows(scene, hold, delay),
                not predicted.stable,
                is_surely_unstable(predicted),
                surely_shaken_by(scene) is not None,
                any("predicted unstable" in one for one in warnings_about(scene, predicted)),
            ]
            if unstable != [beyond > 1.0] * 5:
                wrong.append((delay, beyond, unstable))
    assert wrong == []
