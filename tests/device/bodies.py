"""The body that the mock moves, and its motion by mpmath: what the tests of the mock's motion share.

A difference of rounding is measured against what the terms of a result are made of: |x|, |v| t, |F| t²/m.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, lru_cache

import mpmath as mp
import numpy as np
from hypothesis import strategies as st

from hapsim.compiling.native import address_of
from hapsim.device.mock.motion import BODY, move_gliding, move_of, move_with_spring_or_friction

ROUNDING = 1e-14
NATIVES = (move_gliding, move_with_spring_or_friction)


def body_of(
    mass: float,
    friction: float = 0.0,
    coulomb: float = 0.0,
    position: float = 0.0,
    velocity: float = 0.0,
    stiffness: float = 0.0,
    push: float = 0.0,
) -> np.record:
    fields = (mass, friction, stiffness, coulomb, push, 0.0, position, velocity, 0.0)
    body: np.record = np.array([fields], BODY).view(np.recarray)[0]
    return body


@cache
def natives() -> dict[int, Callable[[int, float, float], None]]:
    """Returns the native functions by address. They are compiled at first use."""
    return {native.address(): native for native in NATIVES}


def move(body: np.record, force: float, h: float, beside: Sequence[np.record] = ()) -> None:
    """Moves it as a device does that has this body, and `beside` it others."""
    natives()[move_of(np.array([*beside, body]))](address_of(body), force, h)


def state_of(body: np.record) -> np.ndarray:
    """Position, velocity, area."""
    return np.array([body["position"], body["velocity"], body["area"]])


def decades(low: int, high: int) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def either_sign(low: int, high: int) -> st.SearchStrategy[float]:
    return st.one_of(st.just(0.0), decades(low, high), decades(low, high).map(lambda value: -value))


masses = decades(-4, 3)
frictions = st.one_of(st.just(0.0), decades(-9, 6))
forces = either_sign(-6, 5)
positions = either_sign(-6, 2)
velocities = either_sign(-6, 3)
times = decades(-9, 4)


anything = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
positive = st.floats(min_value=5e-324, allow_nan=False)


def passage(m: float, b: float, k: float, t: mp.mpf) -> mp.matrix:
    """The matrix by which (position, velocity, area, force) become what they are `t` later."""
    m, b, k, t = map(mp.mpf, (m, b, k, t))
    motion = mp.matrix([[0, t, 0, 0], [-k / m * t, -b / m * t, 0, t / m], [t, 0, 0, 0], [0, 0, 0, 0]])
    halvings = max(0, int(mp.ceil(mp.log(mp.mnorm(motion, 1) + 1, 2))))  # until mpmath can raise it to powers
    step = mp.expm(motion / 2**halvings)
    for _ in range(halvings):
        step = step * step
    return step


def exactly(m: float, b: float, k: float, force: float, x: float, v: float, t: float) -> np.ndarray:
    """Position, velocity, area after `t`."""
    with mp.workdps(80):  # forty, and what the squarings of a stiff matrix lose
        end = passage_of_last(m, b, k, t) * mp.matrix([x, v, 0, force])
        return np.array([float(value) for value in end[:3]])


@lru_cache(maxsize=1)
def passage_of_last(m: float, b: float, k: float, t: float) -> mp.matrix:
    """`passage` to 80 digits, kept for the next motion of the same body."""
    return passage(m, b, k, mp.mpf(t))


def sizes(m: float, b: float, k: float, force: float, x: float, v: float, t: float) -> np.ndarray:
    """The size of what position, velocity and area are made of, and how far rounding k, m and t turns a swing: the
    friction only ever makes it smaller."""
    frequency, late = math.sqrt(k / m), m / b if b > 0 else math.inf
    v_travel = min(t, late, 1 / frequency if k > 0 else math.inf)
    a_travel = min(t * v_travel, 2 * m / k) if k > 0 else t * t / 2 if t < late else t * late
    push = abs(force) / m + k / m * abs(x)
    place = abs(x) + abs(v) * v_travel + push * a_travel
    turned = 1 + frequency * t * math.exp(-b * t / m / 2)
    return turned * np.array([place, abs(v) + push * v_travel, t * place])


stiffnesses = decades(-9, 6)
