"""The mock's mass in continuous time, against the solution written out in mpmath."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hapsim.device.mock.motion import strike

sys.path.insert(0, str(Path(__file__).parent))
from bodies import (
    ROUNDING,
    body_of,
    decades,
    exactly,
    forces,
    frictions,
    masses,
    move,
    positions,
    sizes,
    state_of,
    stiffnesses,
    times,
    velocities,
)


@pytest.mark.parametrize("friction", [0.0, 1e-9, 1e-3, 0.0999, 0.1, 0.1001, 1.0, 30.0, 1e4, 1e9])
@pytest.mark.parametrize("t", [1e-9, 1e-4, 1e-3, 0.99, 1.0, 1.01, 50.0])
def test_position_velocity_and_area_are_exact_for_every_friction_and_interval(friction: float, t: float) -> None:
    m, force, x, v = 0.1, -1.7, 0.03, 0.4
    body = body_of(m, friction, position=x, velocity=v)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly(m, friction, force, x, v, t))
    assert (difference <= ROUNDING * sizes(m, friction, force, x, v, t)).all()


@settings(max_examples=200, deadline=None, derandomize=True)
@given(masses, frictions, forces, positions, velocities, times)
@example(1.0, 1.0, 1.0, 0.0, 0.0, 1.0)  # where the series ends
@example(1.0, math.nextafter(1.0, 2.0), 1.0, 0.0, 0.0, 1.0)
@example(1e-4, 1e6, -1e5, 0.0, 1e3, 1e4)
def test_position_velocity_and_area_are_exact_whatever_the_body(
    m: float, b: float, force: float, x: float, v: float, t: float
) -> None:
    body = body_of(m, b, position=x, velocity=v)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly(m, b, force, x, v, t))
    assert (difference <= ROUNDING * sizes(m, b, force, x, v, t)).all()


@pytest.mark.parametrize(("coulomb", "stiffness"), [(0.0, 0.0), (0.5, 0.0), (0.0, 300.0), (0.5, 300.0)])
def test_the_push_of_a_hand_comes_to_the_force(coulomb: float, stiffness: float) -> None:
    held, free = (body_of(0.2, 1.0, coulomb, 0.01, 0.3, stiffness, push) for push in (2.5, 0.0))
    move(held, -1.25, 0.004)
    move(free, 1.25, 0.004)
    assert state_of(held).tolist() == state_of(free).tolist()


def test_an_impulse_changes_the_momentum_and_nothing_else() -> None:
    body = body_of(0.25, 3.0, 0.5, position=0.1, velocity=-2.0)
    strike(body, 0.75)
    assert state_of(body).tolist() == [0.1, 1.0, 0.0]


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    masses,
    frictions,
    st.one_of(st.just(0.0), decades(-3, 2)),
    st.one_of(st.just(0.0), stiffnesses),
    forces,
    positions,
    velocities,
    decades(-9, 1),
)
def test_what_moves_beside_it_makes_no_difference_to_a_body(
    m: float, b: float, coulomb: float, k: float, force: float, x: float, v: float, t: float
) -> None:
    others = [
        body_of(1.0),
        body_of(1.0, coulomb=1.0),
        body_of(1.0, stiffness=1.0),
        body_of(1.0, 1.0, 1.0, stiffness=1.0),
    ]
    alone = body_of(m, b, coulomb, x, v, k)
    move(alone, force, t)
    for beside in ([other] for other in others):
        body = body_of(m, b, coulomb, x, v, k)
        move(body, force, t, beside)
        assert state_of(body).tolist() == state_of(alone).tolist()
