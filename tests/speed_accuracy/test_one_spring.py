"""What the hand feels of one spring is off by what the theory predicts, and more rate does not cure a delay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hapsim.errors import DeviceError
from hapsim.measuring.measure import measure
from hapsim.prediction.correction import rendered
from hapsim.speed_accuracy.cost import Running
from hapsim.speed_accuracy.one_spring import (
    DAMPING,
    DELAY_S,
    FRICTION,
    MASS,
    ONE_MILLISECOND,
    ONE_SAMPLE,
    STIFFNESS,
    OneSpring,
)
from hapsim.theory import Configuration


@pytest.mark.parametrize("rate", [1000.0, 20_000.0])
@pytest.mark.parametrize("method", [ONE_SAMPLE, ONE_MILLISECOND])
def test_the_errors_are_those_of_the_theory(method: str, rate: float) -> None:
    delay = 1.0 if method == ONE_SAMPLE else DELAY_S * rate
    k, b = Configuration(MASS, rate, friction=FRICTION, delay=delay).equivalent(STIFFNESS, DAMPING)
    found = OneSpring().found(method, "double", rate).errors
    assert found["k"] == pytest.approx(k / STIFFNESS - 1.0, abs=1e-6)
    assert found["b"] == pytest.approx(b / (DAMPING + FRICTION) - 1.0, abs=1e-6)


@pytest.mark.parametrize(("method", "most"), [("poles", 1e-8), ("predictor", 1e-8), ("adaptive", 1e-3)])
def test_a_correction_is_nearer_by_orders(method: str, most: float) -> None:
    errors = OneSpring().found(f"correction: {method}", "double", 1000.0).errors
    assert 0.0 < abs(errors["k"]) < most
    assert 0.0 < abs(errors["b"]) < most


def test_what_a_correction_costs_is_timed_with_it() -> None:
    """The predicted state, and not the position, is what the scene's force answers there."""
    spring = OneSpring()
    running = Running(spring.scene("correction: predictor", "double", 1000.0))
    running.advance(10)
    io = running._loop.io
    assert io.velocity[0] != 0.0
    (rendered_K, rendered_B) = rendered(spring.scene("correction: predictor", "double", 1000.0)).ports[0].rendered
    assert io.asked[0] == pytest.approx(-rendered_K * io.measured[0] - rendered_B * io.velocity[0], rel=1e-9)


def test_more_rate_does_not_cure_the_delay() -> None:
    spring = OneSpring()
    a_sample, a_millisecond = (
        abs(spring.found(method, "double", 20_000.0).errors["b"]) for method in (ONE_SAMPLE, ONE_MILLISECOND)
    )
    assert a_sample < 0.03
    assert a_millisecond > 0.3


def test_what_is_predicted_to_be_unstable_is_left_out() -> None:
    assert OneSpring().found(ONE_SAMPLE, "double", 400.0).why_not == "unstable, as predicted"


def test_a_measurement_whose_run_failed_says_so_in_place_of_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: Any, **options: Any) -> Any:
        return replace(measure(*arguments, **options), failure=DeviceError("the mock went away"))

    monkeypatch.setattr("hapsim.speed_accuracy.one_spring.measure", fails)
    found = OneSpring().found(ONE_SAMPLE, "double", 1000.0)
    assert (found.errors, found.why_not) == ({}, "the mock went away")
