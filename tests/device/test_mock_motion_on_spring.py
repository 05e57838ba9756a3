"""The mock's mass on a spring.

The reference is the exponential of the matrix of m x'' + b x' + k x = F, for which no regime is special.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from bodies import (
    ROUNDING,
    body_of,
    decades,
    exactly_on_spring,
    forces,
    frictions,
    masses,
    move,
    positions,
    sizes,
    spring_sizes,
    state_of,
    stiffnesses,
    velocities,
)

RATIOS = [0.0, 1e-9, 0.3, 1 - 1e-9, 1 - 1e-15, 1.0, 1 + 1e-15, 1 + 1e-9, 1.06, 1.07, 1.5, 50.0, 1e5]
PHASES = [1e-9, 1e-4, 1e-2, 0.6, 1.0, 1.999999, 2.000001, 2.5, 30.0, 1000.0]


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("phase", PHASES)
def test_on_a_spring_all_is_exact_for_every_damping_ratio_and_interval(ratio: float, phase: float) -> None:
    m, t = 0.1, 1e-3
    k = m * (phase / t) ** 2
    b = 2 * ratio * math.sqrt(k * m)
    for force, x, v in ((-1.7, 0.03, 0.4), (0.0, 0.02, 0.0), (0.0, 0.0, -0.3), (2.5, 0.0, 0.0)):
        body = body_of(m, b, position=x, velocity=v, stiffness=k)
        move(body, force, t)
        difference = np.abs(state_of(body) - exactly_on_spring(m, b, k, force, x, v, t))
        assert (difference <= ROUNDING * spring_sizes(m, b, k, force, x, v, t)).all()


@pytest.mark.parametrize("t", [1e-12, 1e-6, 1e-3, 0.3])
@pytest.mark.parametrize("k", [1e-18, 1e-6, 0.3, 7.0])
@pytest.mark.parametrize("b", [0.0, 1e-12, 1e-3, 0.3, 2.0, 100.0, 1e4])
def test_from_rest_no_digit_of_position_and_area_is_lost_however_small_they_are(b: float, k: float, t: float) -> None:
    body = body_of(1.0, b, stiffness=k)
    move(body, 3.0, t)
    np.testing.assert_allclose(state_of(body), exactly_on_spring(1.0, b, k, 3.0, 0.0, 0.0, t), rtol=ROUNDING)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.floats(0.0, 12.0), st.floats(0.01, 9.0))
@example(0.01, 0.0101)  # where a formula by exponentials would have lost four digits
@example(0.2, 0.01)
@example(4.0, 4.0)  # where the series ends
@example(4.0, math.nextafter(4.0, 5.0))
@example(math.nextafter(4.0, 5.0), 4.0)
@example(math.nextafter(4.0, 5.0), 0.01)
@example(4.8, 5.12)  # where two decays are no longer taken as close
def test_from_rest_no_digit_is_lost_where_one_formula_takes_over_from_another(b: float, k: float) -> None:
    body = body_of(1.0, b, stiffness=k)
    move(body, 1.0, 1.0)
    np.testing.assert_allclose(state_of(body), exactly_on_spring(1.0, b, k, 1.0, 0.0, 0.0, 1.0), rtol=ROUNDING)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(masses, frictions, stiffnesses, forces, positions, velocities, decades(-9, 1))
def test_on_a_spring_all_is_exact_whatever_the_body(
    m: float, b: float, k: float, force: float, x: float, v: float, t: float
) -> None:
    body = body_of(m, b, position=x, velocity=v, stiffness=k)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly_on_spring(m, b, k, force, x, v, t))
    assert (difference <= ROUNDING * spring_sizes(m, b, k, force, x, v, t)).all()


@settings(max_examples=150, deadline=None, derandomize=True)
@given(masses, frictions, st.one_of(st.just(0.0), decades(-3, 2)), forces, positions, velocities, decades(-9, 2))
def test_a_spring_that_goes_to_zero_leaves_the_free_mass(
    m: float, b: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    free = body_of(m, b, coulomb, x, v)
    move(free, force, t)
    size = sizes(m, b, abs(force) + coulomb, x, v, t)
    assume(coulomb == 0.0 or abs(abs(force) - coulomb) > 1e-3 * coulomb)
    for softness in (1e-16, 1e-100):
        soft = body_of(m, b, coulomb, x, v, softness * m / t**2)
        move(soft, force, t)
        what_the_spring_does = 1.01 * softness * size[0] * np.array([1.0, 1.0 / t, t])
        assert (np.abs(state_of(soft) - state_of(free)) <= 10 * ROUNDING * size + what_the_spring_does).all()


@pytest.mark.parametrize("b", [0.0, 0.1, 8.0, 8e3])
@pytest.mark.parametrize("coulomb", [0.0, 0.5])
def test_a_mass_that_rests_where_the_spring_holds_the_force_stays_there_to_the_last_bit(
    b: float, coulomb: float
) -> None:
    body = body_of(0.25, b, coulomb, 0.75, stiffness=64.0)
    for _ in range(10):
        move(body, 48.0, 0.125)
    assert state_of(body).tolist() == [0.75, 0.0, 0.9375]
