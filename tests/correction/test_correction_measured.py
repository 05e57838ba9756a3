"""The mock in virtual time shows the desired k and b. The identification knows neither K and B nor the desired
values."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hapsim import measure, measure_impedance, predict, run
from hapsim.loop.ring import LATE_FORCE
from hapsim.prediction import predict_impedance
from hapsim.prediction.correction import rendered
from hapsim.scene import Nonlinear, Scene
from hapsim.theory.correction import PredictedLoop
from tests.one_hand import scene_of, touch

MASS = 0.2


def hand_on(*links: Any, mock: dict[str, Any] | None = None, **device: Any) -> Scene:
    """A hand with a flick on links to one wall."""
    start = {"initial": {"velocity": 0.1}, "quantum": 1e-10} | (mock or {})
    return scene_of({f"link{i}": link for i, link in enumerate(links)}, device=device, mock=start)


def test_a_predictor_may_be_given_velocities() -> None:
    felt = measure(hand_on(touch(20000.0, 40.0, damper="sensed"), correction="predictor", delay=2.0))
    assert (felt.k, felt.b) == (pytest.approx(20000.0, rel=1e-5), pytest.approx(41.0, rel=1e-4))


@pytest.mark.parametrize("factor", [0.7, 0.9, 1.1, 2.0])
def test_another_mass_than_the_declared_one_feels_what_is_predicted_for_it(factor: float) -> None:
    scene = hand_on(touch(6000.0, 20.0), correction="predictor", mock={"mass": factor * MASS})
    (port,) = rendered(scene).ports
    true = replace(port.declared, mass=factor * MASS)
    k, b = PredictedLoop(true, rendered(scene).predictor_of(port)).equivalent(*port.rendered)
    felt = measure(scene)
    assert felt.k * factor == pytest.approx(float(k), rel=1e-5)  # it reads k and b with the declared mass
    assert felt.b * factor == pytest.approx(float(b), rel=1e-5)


@pytest.mark.thorough
def test_a_span_of_masses_is_no_worse_at_its_ends_than_without() -> None:
    for correction in ("poles", "predictor"):
        scene = hand_on(touch(3000.0, 12.0), mass={"from": 0.1, "to": 0.4}, correction=correction)
        (wanted,) = predict(scene, with_margins=False).desired
        plain = predict(hand_on(touch(3000.0, 12.0), mass=0.1), with_margins=False)
        assert wanted.error < abs(plain.b - 13.0) / 13.0
        for mass in (0.1, 0.4):
            felt = measure(
                hand_on(touch(3000.0, 12.0), mass={"from": 0.1, "to": 0.4}, correction=correction, mock={"mass": mass})
            )
            factor = mass / scene.device.masses(1)[0]  # it reads k and b with the middle of the span
            off = max(abs(felt.k * factor - 3000.0) / 3000.0, abs(felt.b * factor - 13.0) / 13.0)
            assert off <= wanted.error * 1.01 + 1e-6


@pytest.mark.parametrize(("hold", "misses"), [("zoh", 0.0), ("zoh", 0.05), ("impulse", 0.05)])
def test_the_force_answers_where_the_mass_will_be_whatever_is_late_on_the_way(hold: str, misses: float) -> None:
    """A link that a correction leaves as it is: its force at a sample is that of the position two samples later, which
    the trace tells. Forces that missed their deadline are not counted, because the device says so."""
    table = ((-1.0, -2000.0), (1.0, 2000.0))
    spring = Nonlinear(between=("hand", "wall"), force_over_distance=table)
    scene = hand_on(spring, correction="predictor", hold=hold, delay=2.0, friction=4.0, mock={"misses": misses})
    trace = run(scene, duration=0.3)
    assert (trace.report.deadline_misses > 5) == (misses > 0.0)
    known = np.full(len(trace.sample), True)
    known[:2] = False  # two samples tell the state
    for late in np.flatnonzero(trace.flags & LATE_FORCE):
        known[max(late - 4, 0) : late] = False  # a deadline miss is unknown when the force is computed
    expected = -2000.0 * trace.position[2:, 0]
    asked, known = trace.asked_force[:-2, 0], known[:-2]
    assert known.sum() > 100
    np.testing.assert_allclose(asked[known], expected[known], rtol=0.0, atol=1e-6 * np.abs(asked).max())


@pytest.mark.parametrize("correction", ["poles", "predictor"])
def test_the_impedance_that_is_rendered_is_the_predicted_one_at_every_frequency(correction: str) -> None:
    """The excitation plays the hand, of which a predictor knows nothing."""
    scene = hand_on(touch(5000.0, 15.0), correction=correction)
    found = measure_impedance(scene)
    expected = predict_impedance(scene, found.frequency)
    off = np.abs(found.rendered.value - expected.rendered) / np.abs(expected.rendered)
    assert off.max() < 1e-4
    assert (
        np.abs(expected.rendered / expected.desired - 1.0).max() > 0.1
    )  # the motion is corrected, not every frequency
