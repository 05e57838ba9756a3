"""The contact in continuous time, by its closed form and by a solver; and what hapsim makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hapsim.speed_accuracy.contact import DAMPING, MASS, STIFFNESS, Contact, contact_felt, contact_of, stay_of


def by_solver(k: float, b: float) -> tuple[float, float]:
    """(stay in s, restitution): the motion until the contact would pull, and from there on in a straight line."""

    def pulls(_t: float, state: np.ndarray) -> float:
        return float(k * state[0] + b * state[1])

    pulls.terminal, pulls.direction = True, -1.0  # type: ignore[attr-defined]
    found = solve_ivp(
        lambda _t, state: [state[1], -(k * state[0] + b * state[1]) / MASS],
        (0.0, 1.0),
        [1e-12, 1.0],
        method="DOP853",
        events=pulls,
        rtol=1e-12,
        atol=1e-15,
    )
    depth, velocity = found.y_events[0][0]
    return found.t_events[0][0] + depth / -velocity, -velocity


@pytest.mark.parametrize(("k", "b"), [(STIFFNESS, DAMPING), (STIFFNESS, 12.0), (300.0, 0.01), (5e4, 40.0)])
def test_the_closed_form_is_what_a_solver_finds(k: float, b: float) -> None:
    stay, restitution = by_solver(k, b)
    assert contact_of(k, b) == pytest.approx((stay, restitution), rel=1e-8)
    assert contact_felt(stay, restitution) == pytest.approx((k, b), rel=1e-6)


def test_the_contact_lasts_five_milliseconds_and_returns_nine_tenths() -> None:
    stay, restitution = contact_of(STIFFNESS, DAMPING)
    assert stay - DAMPING / STIFFNESS == pytest.approx(5e-3, rel=0.05)
    assert restitution == pytest.approx(0.9, abs=0.01)


def test_what_throws_back_faster_than_it_came_is_felt_as_a_negative_damping() -> None:
    stay, restitution = contact_of(STIFFNESS, -DAMPING)
    assert restitution > 1.0
    assert contact_felt(stay, restitution) == pytest.approx((STIFFNESS, -DAMPING), rel=1e-9)


def test_no_spring_and_damper_returns_nearly_nothing() -> None:
    assert np.isnan(contact_felt(5e-3, 0.01)).all()


def test_the_error_falls_with_the_rate() -> None:
    slow, fast = (Contact().found("cordis", "double", rate).errors for rate in (5000.0, 50_000.0))
    assert fast["k"] < 0.2 * slow["k"] < 0.01
    assert fast["b"] < 0.2 * slow["b"] < 0.02


def test_the_stay_is_between_the_lines_of_flight_and_of_who_does_not_leave_there_is_none() -> None:
    came, left = [2.5, 1.5, 0.5], [1.0, 1.5]  # m a sample: 1 in, 1/2 out; at the surface at 2.5, and a sample before 9
    assert stay_of([*came, *[-1.0] * 6, *left], 1000.0) == pytest.approx(((7.0 - 2.5) / 1000.0, 0.5))
    assert np.isnan(stay_of([*came, *[-1.0] * 8], 1000.0)).all()
    assert np.isnan(stay_of([*came, np.nan, *left], 1000.0)).all()
