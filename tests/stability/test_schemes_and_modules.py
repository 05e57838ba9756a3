"""The limit of a hand on a simulated object, for every scheme and every kind of module, straddled by a thousandth.

Predicted: the closed loop as one matrix, of the hand moved exactly by matrix exponentials and the object moved by the
scheme's own matrix (`scheme_formulas.py`). Observed: the compiled tick, against the same hand, swings on or dies.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.optimize import brentq

from hapsim.compiling import entry
from hapsim.cordis.offline import start
from hapsim.cordis.program import compile_scene
from hapsim.cordis.tick import tick
from hapsim.scene import Scene, parse_scene
from hapsim.theory.schemes import SCHEMES

sys.path.insert(0, str(Path(__file__).parents[1]))
from scheme_formulas import step_matrix

RATE = 1000.0
T = 1.0 / RATE
HAND_MASS, HAND_FRICTION, HAND_STIFFNESS = 0.2, 1.0, 400.0
LINK_DAMPING = 1.5
DELAYS = (0.0, 1.0, 0.37)
SAMPLES = 420_000  # the slowest motion grows, or dies, by some millionths of itself a sample
BLOCKS = 60
DISTANCE = 0.05  # m: how far a buffer presses its ends apart, so that they never part


class Object(NamedTuple):
    """What is simulated: its module, the point that the link holds, and M, K, B of all its masses."""

    module: dict[str, Any]
    held: str
    place: int
    mass: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


def spread(masses: int, links: list[tuple[int, int, float]]) -> np.ndarray:
    """A matrix of stiffness or damping; -1 is what stays."""
    matrix = np.zeros((masses, masses))
    for a, b, value in links:
        for i, j, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
            if i >= 0 and j >= 0:
                matrix[i, j] += sign * value
    return matrix


def cell() -> Object:
    module = {"type": "cell", "mass": 0.05, "stiffness": 900.0, "damping": 1.2}
    return Object(module, "o", 0, np.array([0.05]), np.array([[900.0]]), np.array([[1.2]]))


def string(bending: float = 0.0) -> Object:
    module = {"type": "string", "masses": 4, "mass": 0.02, "stiffness": 3000.0, "damping": 0.5, "friction": 0.2}
    row = [(-1, 0), (0, 1), (1, 2), (2, 3), (3, -1)]
    stiffness = spread(4, [(a, b, 3000.0) for a, b in row])
    if bending:
        module["bending"] = bending
        curvature = np.diag(np.full(4, -2.0)) + np.diag(np.ones(3), 1) + np.diag(np.ones(3), -1)
        stiffness = stiffness + bending * curvature.T @ curvature
    damping = spread(4, [(a, b, 0.5) for a, b in row]) + 0.2 * np.eye(4)
    return Object(module, "o.1", 1, np.full(4, 0.02), stiffness, damping)


def membrane() -> Object:
    module = {"type": "membrane", "rows": 2, "columns": 2, "mass": 0.03, "stiffness": 1500.0, "damping": 0.4}
    inner = [(0, 1), (2, 3), (0, 2), (1, 3)]
    edges = [(i, -1) for i in range(4) for _ in range(2)]
    both = [spread(4, [(a, b, value) for a, b in inner + edges]) for value in (1500.0, 0.4)]
    return Object(module, "o.1.0", 2, np.full(4, 0.03), *both)


OBJECTS: dict[str, Callable[[], Object]] = {
    "cell": cell,
    "string": string,
    "stiff string": lambda: string(bending=400.0),
    "membrane": membrane,
}


#: The link between hand and object, for its stiffness in N/m; all but some with the damping of all.
LINKS: dict[str, Callable[[float], dict[str, Any]]] = {
    "viscoelastic": lambda k: {"type": "viscoelastic", "stiffness": k, "damping": LINK_DAMPING},
    "spring": lambda k: {"type": "spring", "stiffness": k},
    "buffer": lambda k: {"type": "buffer", "stiffness": k, "damping": LINK_DAMPING, "distance": DISTANCE},
    "nonlinear": lambda k: {
        "type": "nonlinear",
        "force_over_distance": [[-1.0, -k], [1.0, k]],
        "force_over_velocity": [[-10.0, -10.0 * LINK_DAMPING], [10.0, 10.0 * LINK_DAMPING]],
    },
    "friction": lambda k: {"type": "friction", "force": 1e9, "stiffness": k, "damping": LINK_DAMPING},
    "plectrum": lambda k: {"type": "plectrum", "stiffness": k, "damping": LINK_DAMPING, "release": 10.0},
}


class Hand(NamedTuple):
    """The real mass over one sample: (2, 2), and what the force before and the force at the sample do, (2,) each."""

    motion: np.ndarray
    before: np.ndarray
    now: np.ndarray


def hand(delay: float) -> Hand:
    """`delay`: 0 to 1 sample."""
    rate = np.array(
        [[0.0, 1.0, 0.0], [-HAND_STIFFNESS / HAND_MASS, -HAND_FRICTION / HAND_MASS, 1.0 / HAND_MASS], [0.0, 0.0, 0.0]]
    )
    first, second = expm(rate * delay * T), expm(rate * (1.0 - delay) * T)
    return Hand(second[:2, :2] @ first[:2, :2], second[:2, :2] @ first[:2, 2], second[:2, 2])


def closed_loop(scheme: str, one: Object, stiffness: float, damping: float, delay: float) -> np.ndarray:
    """The matrix of one sample: hand x and v, hand x before, the force before, then the object's x and v."""
    n, real = one.mass.size, hand(delay)
    size = 4 + 2 * n
    felt = np.zeros(size)  # the tension, from the state
    felt[0], felt[2] = stiffness + damping / T, -damping / T
    felt[4 + one.place], felt[4 + n + one.place] = -stiffness, -damping
    matrix = np.zeros((size, size))
    matrix[:2, :2] = real.motion
    matrix[:2, 3] = real.before
    matrix[:2] -= np.outer(real.now, felt)
    matrix[2, 0] = 1.0
    matrix[3] = -felt
    pulled = np.zeros(n)
    pulled[one.place] = 1.0
    if scheme in STAGES:
        matrix[4:] = _by_instants(STAGES[scheme], one, pulled, stiffness, damping)
        return matrix
    step = step_matrix(scheme, one.mass, one.stiffness, one.damping, T)
    # A force that is held moves where the object would rest, and nothing else.
    rest = np.concatenate([np.linalg.solve(one.stiffness, pulled), np.zeros(n)])
    matrix[4:, 4:] += step
    matrix[4:] += np.outer(rest - step @ rest, felt)
    return matrix


def _rk4(z: np.ndarray) -> np.ndarray:
    one = np.eye(len(z))
    return one + z @ (one + z @ (one + z @ (one + z / 4) / 3) / 2)


#: What schemes that ask links at several instants make of T times the rates of change.
STAGES = {"rk4": _rk4}


def _by_instants(
    stages: Callable[[np.ndarray], np.ndarray], one: Object, pulled: np.ndarray, stiffness: float, damping: float
) -> np.ndarray:
    """Its rows: the link is asked at every instant, with a hand that goes on as it went."""
    n = one.mass.size
    link = np.outer(pulled, pulled) / one.mass[:, None]
    held_mass = one.mass[:, None]
    rate = np.zeros((2 * n + 2, 2 * n + 2))
    rate[:n, n : 2 * n] = np.eye(n)
    rate[n : 2 * n, :n] = -one.stiffness / held_mass - stiffness * link
    rate[n : 2 * n, n : 2 * n] = -one.damping / held_mass - damping * link
    rate[n : 2 * n, 2 * n] = stiffness * pulled / one.mass
    rate[n : 2 * n, 2 * n + 1] = damping * pulled / one.mass
    rate[2 * n, 2 * n + 1] = 1.0
    step = stages(rate * T)
    rows = np.zeros((2 * n, 4 + 2 * n))
    rows[:, 4:] = step[: 2 * n, : 2 * n]
    rows[:, 0] = step[: 2 * n, 2 * n] + step[: 2 * n, 2 * n + 1] / T
    rows[:, 2] = -step[: 2 * n, 2 * n + 1] / T
    return rows


def limit(scheme: str, one: Object, damping: float, delay: float) -> float:
    """The least stiffness of the link, N/m, at which a motion neither dies nor grows."""

    def beyond(log_stiffness: float) -> float:
        matrix = closed_loop(scheme, one, float(np.exp(log_stiffness)), damping, delay)
        return float(np.abs(np.linalg.eigvals(matrix)).max()) - 1.0

    grid = np.log(np.geomspace(1.0, 1e7, 400))
    values = [beyond(x) for x in grid]
    first = next(i for i, value in enumerate(values) if value > 0.0)
    assert first > 0, "unstable already without a link"
    return float(np.exp(brentq(beyond, grid[first - 1], grid[first], xtol=1e-14)))


def scene(scheme: str, one: Object, link: dict[str, Any], rest: np.ndarray) -> Scene:
    """The hand's link to the object, which begins where it rests: of a cell that may be anywhere."""
    begin = {"position": rest[0]} if one.module["type"] == "cell" else {}
    document = {
        "version": 1,
        "rate": RATE,
        "scheme": scheme,
        "device": {"mass": HAND_MASS},
        "modules": {
            "hand": {"type": "device", "channel": 0},
            "o": {**one.module, **begin},
            "touch": {"between": ["hand", one.held], **link},
        },
    }
    return parse_scene(json.dumps(document))


@entry
def run(program, io_buffer, hand, state, samples, rest):
    """The tick against a hand: state is x, v and the force before. How far from `rest` the hand comes at the most.
    `io_buffer`: (3, 1), position, velocity and force of the one channel."""
    furthest = 0.0
    for _ in range(samples):
        io_buffer[0, 0] = state[0]
        furthest = max(furthest, abs(state[0] - rest))
        tick(program, io_buffer[0], io_buffer[1], io_buffer[2])
        x, v, f = state[0], state[1], io_buffer[2, 0]
        state[0] = hand[0, 0] * x + hand[0, 1] * v + hand[0, 2] * state[2] + hand[0, 3] * f
        state[1] = hand[1, 0] * x + hand[1, 1] * v + hand[1, 2] * state[2] + hand[1, 3] * f
        state[2] = f
    return furthest


def grows(scheme: str, one: Object, link: str, stiffness: float, delay: float) -> bool:
    """Whether a small swing about where everything rests becomes a hundred times as large, or is larger at the end than
    in the middle of the run."""
    press, real = DISTANCE if link == "buffer" else 0.0, hand(delay)
    # Where the link presses by stiffness times `press`: hand and object at rest.
    whole = block_diag(np.array([[HAND_STIFFNESS]]), one.stiffness)
    arm = np.zeros(1 + one.mass.size)
    arm[0], arm[1 + one.place] = 1.0, -1.0
    rest = np.linalg.solve(whole + stiffness * np.outer(arm, arm), stiffness * press * arm)
    program = compile_scene(scene(scheme, one, LINKS[link](stiffness), rest[1:]))
    io_buffer = np.zeros((3, 1))
    force = -stiffness * (rest[0] - rest[1 + one.place] - press)
    state = np.array([rest[0], 1e-6, force])
    start(program, state[:1])
    matrix = np.column_stack([real.motion, real.before, real.now])
    furthest: list[float] = []
    for _ in range(BLOCKS):
        furthest.append(run(program.record, io_buffer, matrix, state, SAMPLES // BLOCKS, rest[0]))
        if not furthest[-1] < 100.0 * furthest[0]:
            return True  # before it leaves what is linear
    third = BLOCKS // 3
    return max(furthest[-third:]) > max(furthest[third : 2 * third])


def straddled(scheme: str, one: Object, link: str) -> list[tuple[float, float]]:
    """Where the run does not do as it is predicted: delay and factor."""
    damping = 0.0 if link == "spring" else LINK_DAMPING
    wrong = []
    for delay in DELAYS:
        critical = limit(scheme, one, damping, delay)
        for factor in (0.999, 1.001):
            stiffness = factor * critical
            if grows(scheme, one, link, stiffness, delay) != (factor > 1.0):
                wrong.append((delay, factor))
    return wrong


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", OBJECTS)
def test_every_object_by_every_scheme_is_stable_up_to_its_limit(name: str, scheme: str) -> None:
    assert straddled(scheme, OBJECTS[name](), "viscoelastic") == []


@pytest.mark.parametrize("scheme", ["cordis", "exact"])
@pytest.mark.parametrize("link", [name for name in LINKS if name != "viscoelastic"])
def test_every_link_is_stable_up_to_its_limit(link: str, scheme: str) -> None:
    assert straddled(scheme, cell(), link) == []
