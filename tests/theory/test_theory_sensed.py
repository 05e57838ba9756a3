"""Links that answer the sensed motion ahead of its reading (``correction: sensed``), beside a loop written out here."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from hapsim.holds import HOLDS
from hapsim.theory import Configuration
from hapsim.theory.interface import Ahead
from hapsim.theory.network import poles_of
from hapsim.theory.network.network import Network, damper_named

RATE = 1000.0
FRESH = (1998.377529979, 6.019039149)
OLD = (1997.276643602, 6.115607493)
REST = 6  # forces that the loop below remembers


def hand(mass: float = 0.2, age: int = 0, masses: tuple[float, ...] = (), **more: float | str) -> Configuration:
    device = {"friction": 1.0, "delay": 1.0} | more
    ahead = Ahead(float(device["delay"]), age, masses)
    return Configuration(mass=mass, rate=RATE, damper="sensed", ahead=ahead, **device)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("mass", "age", "masses", "felt"),
    [
        (0.2, 0, (), FRESH),
        (0.2, 1, (), OLD),
        (0.2, 1, (0.2,), FRESH),
        (0.1, 0, (), (1995.109096018, 6.034236610)),
        (0.4, 0, (), (1999.388211641, 6.009976005)),
    ],
)
def test_the_hand_feels_the_reference_figures(
    mass: float, age: int, masses: tuple[float, ...], felt: tuple[float, float]
) -> None:
    found = hand(mass, age, masses)
    assert found.equivalent(2000.0, 5.0) == pytest.approx(felt, rel=2e-10)
    assert found.simulated(*found.equivalent(2000.0, 5.0)) == pytest.approx((2000.0, 5.0), rel=1e-11)


State = NDArray[np.float64]


def sample(
    mass: float, own: tuple[float, float], delay: float, hold: str, answer: Callable[[State, float, float], float]
) -> Callable[[State], State]:
    """One sample of a mass with friction and spring ``own``. State: x, v, the forces f[n-1], f[n-2], ..., and more that
    ``answer`` (state, acceleration after the newest force, and before it) uses."""
    friction, spring = own
    whole = math.floor(delay)
    pieces = [piece for piece in HOLDS[hold].pieces(delay - whole) if piece.duration > 0.0]

    def force(weights: tuple[float, ...], forces: State, late: int) -> float:
        return sum(weight * forces[late + age] for age, weight in enumerate(weights) if late + age >= 0)

    def acceleration(state: State, acting: float) -> float:
        return float((acting - friction * state[1] - spring * state[0]) / mass)

    def step(state: State) -> State:
        past, last = state[2 : 2 + REST], pieces[-1]
        end = tuple(a + last.duration * b for a, b in zip((*last.level, 0.0), (*last.slope, 0.0, 0.0), strict=False))
        before = acceleration(state, force(end, past, whole))
        after = acceleration(state, force(pieces[0].level, past, whole - 1)) if delay > 0.0 else before
        new = np.concatenate([[answer(state, after, before)], past[:-1]])
        moved = state[:2].copy()
        for duration, _, level, slope in pieces:
            rate = np.zeros((4, 4))
            rate[0, 1] = rate[1, 2] = rate[2, 3] = 1.0
            rate[1, :2] = -spring / mass, -friction / mass
            acting = np.array([force(level, new, whole) / mass, force(slope, new, whole) * RATE / mass])
            moved = (expm(rate * duration / RATE) @ np.concatenate([moved, acting]))[:2]
        return np.concatenate([moved, new, [state[0], *state[2 + REST : -1]]])

    return step


def poles(step: Callable[[State], State], size: int) -> NDArray[np.complex128]:
    return slowest_first(np.linalg.eigvals(np.array([step(one) for one in np.eye(size)]).T))


def slowest_first(found: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.array(sorted(found.tolist(), key=lambda pole: (-round(abs(pole), 7), -pole.imag)))


Case = tuple[float, tuple[float, float], float, str, int]


def cases() -> list[Case]:
    """Masses, their frictions and springs, delays, holds and ages of the acceleration."""
    rng = np.random.default_rng(7)
    loops = [
        (delay, hold, age) for hold in ("zoh", "ramp") for delay in (0.0, 0.37, 1.0, 1.6, 2.0, 3.0) for age in (0, 1)
    ]
    return [(rng.uniform(0.05, 1.0), (rng.uniform(0.0, 3.0), rng.uniform(0.0, 300.0)), *loop) for loop in loops]


@pytest.mark.parametrize("case", cases())
def test_the_poles_are_those_of_the_loop_written_out(case: Case) -> None:
    (mass, own, delay, hold, age), declared = case, 0.3
    K, B = 0.1 * mass * RATE**2, 0.15 * mass * RATE
    ahead = (delay + {"zoh": 0.5, "ramp": 1.0}[hold]) / RATE
    changes = delay >= 1.0 and delay == int(delay) and hold == "zoh"

    def answer(state: State, after: float, before: float) -> float:
        a = before if age else after
        if age and changes:
            a += (state[2 + int(delay) - 1] - state[2 + int(delay)]) / declared
        return float(-K * (state[0] + ahead * state[1] + 0.5 * ahead**2 * a) - B * (state[1] + ahead * a))

    expected = poles(sample(mass, own, delay, hold, answer), 2 + REST + 1)
    device = {"friction": own[0], "stiffness": own[1], "delay": delay, "hold": hold}
    found = hand(mass, age, (declared,) if age else (), **device).poles(K, B)
    assert slowest_first(found)[:2] == pytest.approx(expected[:2], rel=1e-9)
    network = Network(
        RATE, np.array([mass]), np.array([own[0]]), delay, hold, "ideal", np.zeros(0), np.array([[0, -1]]),
        np.array([K]), np.array([B]), np.array([own[1]]), (damper_named("sensed", None, RATE),),
        ahead=Ahead(delay, age, (declared,) if age else ()),
    )  # fmt: skip
    assert np.sort(np.abs(poles_of(network)))[::-1][:3] == pytest.approx(np.abs(expected[:3]), rel=1e-8, abs=1e-9)
