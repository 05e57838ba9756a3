"""The objects of the comparison, beside closed forms and solvers: strings, a hand on one spring, a contact."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hapsim.errors import DeviceError
from hapsim.measuring.measure import measure
from hapsim.prediction.correction import rendered
from hapsim.speed_accuracy.comparison import Running
from hapsim.speed_accuracy.objects import (
    BALL,
    BUFFER_DAMPING,
    BUFFER_STIFFNESS,
    MODES,
    OBJECTS,
    ONE_SAMPLE,
    SHARP,
    Contact,
    OneSpring,
    RingingString,
    contact_felt,
    contact_of,
    stay_of,
)
from hapsim.speed_accuracy.strings import StringOfMasses, frequencies_of, poles

STRING = StringOfMasses.tuned(10, damping_ratio=0.0)
OBJECT = RingingString("string", "a string", STRING)


def matrix(string: StringOfMasses) -> np.ndarray:
    """x'' = -matrix x"""
    bend = 2.0 * np.eye(string.masses) - np.eye(string.masses, k=1) - np.eye(string.masses, k=-1)
    return (string.stiffness * bend + string.bending * bend @ bend) / string.mass


@pytest.mark.parametrize("stride", [1, 3, 20])
def test_the_poles_of_a_known_recurrence_are_found(stride: int) -> None:
    pole = 0.9997 * np.exp(0.05j)
    motion = np.real(pole ** np.arange(400))
    found = sorted(poles(motion, stride), key=lambda z: -z.imag)
    assert found == pytest.approx([pole**stride, np.conj(pole) ** stride], rel=1e-10)


def test_where_nothing_moves_or_all_is_lost_there_are_no_poles() -> None:
    for motion in (np.zeros(100), np.full(100, np.nan), 1e160 * np.ones(100)):
        assert np.isnan(poles(motion, 1)).all()


@pytest.mark.parametrize("sharp", [0.0, SHARP])
def test_a_tuned_string_rings_at_the_pitches_of_its_matrix(sharp: float) -> None:
    string = StringOfMasses.tuned(12, sharp=sharp)
    expected = np.sqrt(np.linalg.eigvalsh(matrix(string))) / (2.0 * math.pi)
    np.testing.assert_allclose([string.frequency(mode) for mode in range(1, 13)], expected, rtol=1e-12)
    plain = StringOfMasses.tuned(12)
    assert string.frequency(5) / plain.frequency(5) == pytest.approx(1.0 + sharp)


def test_cordis_rings_at_the_pitches_of_its_closed_form() -> None:
    for rate in (1000.0, 20_000.0):
        warped = [rate / math.pi * math.asin(math.pi * STRING.frequency(mode) / rate) for mode in MODES]
        errors = [w / STRING.frequency(mode) - 1.0 for mode, w in zip(MODES, warped, strict=True)]
        found = OBJECT.found("cordis", "double", rate)
        assert found.errors["frequency"] == pytest.approx(max(errors, key=abs), rel=1e-5)


def test_the_exact_scheme_has_no_error_and_in_single_precision_a_small_one() -> None:
    assert abs(OBJECT.found("exact", "double", 2000.0).errors["frequency"]) < 1e-12
    assert 1e-12 < abs(OBJECT.found("exact", "single", 2000.0).errors["frequency"]) < 1e-4


def test_an_unstable_string_is_reported_as_such() -> None:
    limit = math.pi * STRING.frequency(STRING.masses)
    assert OBJECT.found("cordis", "double", 0.99 * limit).why_not == "unstable"
    assert not OBJECT.found("cordis", "double", 1.2 * limit).why_not


def test_stable_schemes_are_not_taken_for_unstable_far_above_their_nyquist_frequency() -> None:
    string = StringOfMasses.tuned(10, fundamental=150.0)
    found = RingingString("string", "a string", string).found("exact", "single", 2000.0)
    assert found.why_not == ""


def test_a_damped_mode_keeps_its_frequency() -> None:
    string = StringOfMasses.tuned(10, damping_ratio=0.02)

    def record(shape: np.ndarray, samples: int) -> np.ndarray:
        mode = int(np.argmax([abs(shape @ string.shape(j)) for j in range(1, 11)])) + 1
        omega = 2.0 * math.pi * string.frequency(mode)
        ratio = 0.02 * string.frequency(mode) / string.frequency(1)
        pole = omega * complex(-ratio, math.sqrt(1.0 - ratio**2))
        return np.real(np.exp(pole * np.arange(samples) / 10_000.0))

    found = frequencies_of(record, string, 10_000.0, MODES, explicit=False)
    assert found == pytest.approx([string.frequency(mode) for mode in MODES], rel=1e-9)


def test_the_names_of_the_objects_are_their_own() -> None:
    assert len({one.name for one in OBJECTS}) == len(OBJECTS)


def test_what_a_correction_costs_is_timed_with_it() -> None:
    """The predicted state, and not the position, is what the scene's force answers there."""
    spring = OneSpring()
    running = Running(spring.scene("correction: predictor", "double", 1000.0))
    running.advance(10)
    io = running._loop.io
    assert io.velocity[0] != 0.0
    (rendered_K, rendered_B) = rendered(spring.scene("correction: predictor", "double", 1000.0)).ports[0].rendered
    assert io.asked[0] == pytest.approx(-rendered_K * io.measured[0] - rendered_B * io.velocity[0], rel=1e-9)


def test_what_is_predicted_to_be_unstable_is_left_out() -> None:
    assert OneSpring().found(ONE_SAMPLE, "double", 400.0).why_not == "unstable, as predicted"


def test_a_measurement_whose_run_failed_reports_it_in_place_of_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: Any, **options: Any) -> Any:
        return replace(measure(*arguments, **options), failure=DeviceError("the mock went away"))

    monkeypatch.setattr("hapsim.speed_accuracy.objects.measure", fails)
    found = OneSpring().found(ONE_SAMPLE, "double", 1000.0)
    assert (found.errors, found.why_not) == ({}, "the mock went away")


K, B = BUFFER_STIFFNESS, BUFFER_DAMPING


def by_solver(k: float, b: float) -> tuple[float, float]:
    """(stay in s, restitution): the motion until the contact would pull, and from there on in a straight line."""

    def pulls(_t: float, state: np.ndarray) -> float:
        return float(k * state[0] + b * state[1])

    pulls.terminal, pulls.direction = True, -1.0  # type: ignore[attr-defined]
    found = solve_ivp(
        lambda _t, state: [state[1], -(k * state[0] + b * state[1]) / BALL],
        (0.0, 1.0),
        [1e-12, 1.0],
        method="DOP853",
        events=pulls,
        rtol=1e-12,
        atol=1e-15,
    )
    depth, velocity = found.y_events[0][0]
    return found.t_events[0][0] + depth / -velocity, -velocity


@pytest.mark.parametrize(("k", "b"), [(K, B), (K, 12.0), (300.0, 0.01), (5e4, 40.0)])
def test_the_closed_form_is_what_a_solver_finds(k: float, b: float) -> None:
    stay, restitution = by_solver(k, b)
    assert contact_of(k, b) == pytest.approx((stay, restitution), rel=1e-8)
    assert contact_felt(stay, restitution) == pytest.approx((k, b), rel=1e-6)


def test_the_contact_lasts_five_milliseconds_and_returns_nine_tenths() -> None:
    stay, restitution = contact_of(K, B)
    assert stay - B / K == pytest.approx(5e-3, rel=0.05)
    assert restitution == pytest.approx(0.9, abs=0.01)


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
