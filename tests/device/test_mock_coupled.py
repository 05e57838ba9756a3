"""Bodies of the mock whose mass is a matrix, against the exponential of the matrix of M x'' + b0 x' + k0 x = F + P."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from firmware_protocol import schema
from hapsim.device.mock.firmware import advance_coupled
from hapsim.errors import SceneError, UsageError
from hapsim.scene import parse_scene
from hapsim.scene.rewrite import device_rewritten

New = Callable[..., Any]
MASS = [[0.2, 0.05], [0.05, 0.3]]
ROUNDING = 1e-14


def rates_of(mass: np.ndarray, friction: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """The derivative of (area, position, velocity, force, slope), each of every channel."""
    n = len(mass)
    rates, inverse = np.zeros((5 * n, 5 * n)), np.linalg.inv(mass)
    area, x, v, force, slope = (slice(i * n, (i + 1) * n) for i in range(5))
    rates[area, x] = rates[x, v] = rates[force, slope] = np.eye(n)
    rates[v, x], rates[v, v], rates[v, force] = -inverse * stiffness, -inverse * friction, inverse
    return rates


def exactly(rates: np.ndarray, start: np.ndarray, h: float) -> np.ndarray:
    """The state after `h` seconds, to the last digit of a double."""
    with mp.workdps(40):
        halvings = max(0, math.ceil(math.log2(np.abs(rates).sum(axis=1).max() * h + 1.0)))
        passage = mp.expm(mp.matrix(rates.tolist()) * (mp.mpf(h) / 2**halvings))
        for _ in range(halvings):
            passage = passage * passage
        return np.array([float(one) for one in passage * mp.matrix(start.tolist())])


CASES = [
    (n, stiff, damped, h)
    for n in (2, 3)
    for stiff, damped in ((0, 0), (0, 5), (400, 0.5), (3e4, 80))
    for h in (1e-6, 1e-3, 0.05)
]


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize(("n", "stiff", "damped", "h"), CASES)
def test_position_velocity_and_area_are_exact_under_a_ramp(
    new_host: New, n: int, stiff: float, damped: float, h: float
) -> None:
    """A hand with its own stiffness, damping and push on each channel; the force begins elsewhere and ramps."""
    random = np.random.default_rng([n, round(stiff), round(1e6 * h)])
    root = np.tril(random.uniform(0.1, 0.5, (n, n)))
    mass, each = root @ root.T + 0.05 * np.eye(n), random.uniform(0.5, 1.5, (3, n))
    mass = (mass + mass.T) / 2.0
    hand = {"stiffness": (stiff * each[0]).tolist(), "damping": (damped * each[1]).tolist(), "force": each[2].tolist()}
    device = {"mass": mass.tolist(), "hold": "ramp", "delay": 0, "force_limit": 50.0}
    host = new_host(n, 1.0 / h, device=device, mock={"hand": hand})
    host.bodies["position"], host.bodies["velocity"] = random.uniform(-0.02, 0.02, (2, n))
    before, now = random.uniform(-5.0, 5.0, (2, n))
    host.mock.commands[:2, :n] = before, now
    host.mock.board.n = 1
    x, v, rates = (
        *(host.bodies[name].copy() for name in ("position", "velocity")),
        rates_of(mass, *(each[1::-1] * [[damped], [stiff]])),
    )
    expected = exactly(rates, np.concatenate([np.zeros(n), x, v, before + each[2], (now - before) / h]), h)
    advance_coupled(int(host.mock.address), h, h)
    push = np.abs(rates[2 * n : 3 * n]) @ np.abs(np.concatenate([0 * x, x, v, before + each[2], 0 * x]))
    for i, (name, size) in enumerate(
        {"area": h * np.abs(x), "position": np.abs(x), "velocity": np.abs(v) + h * push}.items()
    ):
        off = np.abs(host.bodies[name] - expected[i * n : (i + 1) * n])
        assert off.max() <= ROUNDING * (size + np.abs(expected[i * n : (i + 1) * n])).max()


@pytest.mark.parametrize(("hold", "delay"), [("zoh", 1.0), ("zoh", 1.4), ("ramp", 0.3), ("impulse", 1.25)])
def test_holds_and_delays_are_those_of_bodies_by_themselves(new_host: New, hold: str, delay: float) -> None:
    """In the directions in which nothing couples it, the device moves as one with these masses on its channels."""
    own, turn = np.linalg.eigh(np.array(MASS))
    device = {"hold": hold, "delay": delay, "friction": 2.0}
    coupled = new_host(2, device=device | {"mass": MASS})
    alone = new_host(2, device=device | {"mass": own.tolist()})
    for host in (coupled, alone):
        host.arm()
    for n in range(30):
        force = np.random.default_rng(n).integers(-(2**28), 2**28, 2)
        coupled.force(n, force)
        alone.force(n, np.rint(turn.T @ force).astype(int))
    moved = turn.T @ coupled.bodies["position"]
    assert np.abs(moved).min() > 1e-5
    assert moved == pytest.approx(alone.bodies["position"], abs=1e-12)  # the forces are in counts
    assert turn.T @ coupled.bodies["velocity"] == pytest.approx(alone.bodies["velocity"], abs=1e-8)


def test_a_force_that_expires_leaves_the_rest_of_a_sample_to_the_hand(new_host: New) -> None:
    hand = {"stiffness": 300.0, "force": [0.5, -1.0]}
    host = new_host(2, device={"mass": MASS, "delay": 0.5}, mock={"hand": hand})
    host.arm(schema.PACED_BY_HOST)
    force, later = np.array([2**29, -(2**28)]), np.array([-(2**27), 2**29])
    host.send(host.force_frame(0, force, time_to_live=0), now=1_000_000)
    host.force(1, later, now=6_000_000)  # a sample of 1 ms under the forces, and 4 ms without them
    rates, state = rates_of(np.array(MASS), np.zeros(2), np.full(2, 300.0)), np.zeros(10)
    for h, acting in ((0.5e-3, 0 * force), (1e-3, force), (0.5e-3, later), (4e-3, 0 * force)):
        state[6:8] = hand["force"] + acting * float(host.mock.force_scale[0])
        state = expm(rates * h) @ state
    assert host.bodies["position"] == pytest.approx(state[2:4], rel=1e-12)


def test_a_diagonal_matrix_is_a_list_of_masses(new_host: New) -> None:
    matrix, listed = (new_host(2, device={"mass": mass}) for mass in (block_diag(0.2, 0.3).tolist(), [0.2, 0.3]))
    assert matrix.mock.called.advance == listed.mock.called.advance
    assert np.array_equal(matrix.bodies, listed.bodies)


def test_a_hand_too_stiff_for_the_series_is_refused(new_host: New) -> None:
    with pytest.raises(UsageError, match=r"move a mass that is a matrix in 1/2\.\d+e\+03 of a sample period"):
        new_host(2, device={"mass": MASS}, mock={"hand": {"stiffness": 1e12}})


GOOD = """version: 1
rate: 1000
space: 2
device: {mass: [[200 g, 50 g], [0.05, 0.3]]}
modules: {hand: {type: device, channels: [0, 1]}}
"""


def test_a_matrix_has_units_and_stays_as_it_is_written() -> None:
    scene = parse_scene(GOOD)
    assert (
        scene.device.mass == ((0.2, 0.05), (0.05, 0.3)) == scene.device.mass_matrix(2) == scene.mock_device.mass_matrix
    )
    assert scene.device.masses(2) == (0.2, 0.3)
    assert scene.units(0.2, "kg") == "200 g"
    with pytest.raises(UsageError, match=r"nothing was written: device\.mass is a matrix"):
        device_rewritten(GOOD, {"mass": "0.25"}, 0)
    assert parse_scene(device_rewritten(GOOD, {"friction": "2.0"}, 0)).device.friction == (2.0, 0.0)
    assert parse_scene(GOOD.replace("50 g", "0").replace("0.05", "0")).device.mass_matrix(2) is None


def test_one_coordinate_has_no_matrix() -> None:
    line = GOOD.replace("space: 2\n", "").replace("channels: [0, 1]", "channel: 1")
    with pytest.raises(SceneError, match=r"mass: found a matrix in a scene with one coordinate, .*; or write space: 2"):
        parse_scene(line)
    with pytest.raises(SceneError, match="mass: found a matrix in a scene with one coordinate"):
        parse_scene(line.replace("}", "", 1).replace("mass:", "mass: 1}\nmock: {mass:", 1).replace("]]", "]]}"))


@pytest.mark.parametrize(
    ("device", "found"),
    [
        ("mass: [[0.2, 0.05], [0.04, 0.3]]", "mass[1][0]: found 0.04, expected 0.05, the same as in row 1, column 2"),
        ("mass: [[0.2, 0.3], [0.3, 0.3]]", "found a matrix that gives some motion a kinetic energy of 0 or less"),
        ("mass: [[0.2, 0.05], [0.05]]", "mass[1]: found 1, expected 2 numbers, as many as the matrix has rows"),
        ("mass: [[0.2, {from: 0, to: 1}], [0, 0.3]]", "expected a number (kg) in a row of a matrix"),
        ("mass: [[0.2, 1 N], [0, 0.3]]", "mass[0][1]: found 1 N, expected a mass (kg)"),
        ("mass: [[0.2]]", "mass: found 1 row, expected 2: one for each channel"),
        ("mass: [[0.2, 0.05], [0.05, 0.3]], stiffness: [0, 9]", "stiffness: found a spring in a device whose mass is"),
        ("mass: [[0.2, 0.05], [0.05, 0.3]], correction: poles", "found poles in a scene with space: 2, expected none"),
        ("mass: [[0.2, 0.05], [0.05, 0.3]]}\nmock: {coulomb: 0.1", "coulomb: found dry friction with a mass that is a"),
        ("mass: 1}\nmock: {mass: [[1, 0.1], [0.1, 1]], grips: [[1, 2]]", "grips: found grips with a mass that is a"),
    ],
)
def test_what_a_matrix_cannot_be_or_go_with_is_an_error_in_words(device: str, found: str) -> None:
    with pytest.raises(SceneError) as error:
        parse_scene(GOOD.replace("mass: [[200 g, 50 g], [0.05, 0.3]]", device))
    assert str(error.value).count("\n") == 0
    assert found in str(error.value)
