"""A correction is an entry of CORRECTIONS and its name among a scene's choices: nothing else knows its name."""

from __future__ import annotations

from dataclasses import replace

import pytest

import hapsim
from hapsim.prediction import warnings_about
from hapsim.prediction.correction import CORRECTIONS, CorrectionKind
from hapsim.scene import Scene, Span
from tests.one_hand import scene_of, touch


@pytest.fixture
def corrected(monkeypatch: pytest.MonkeyPatch) -> Scene:
    """A scene with a correction that hapsim does not have: as `poles`, with a centred damper at the device."""
    centred = CorrectionKind(
        name="centred poles",
        with_damper="centred",
        predicts=False,
        adapts=False,
        seen_by_theory=lambda declared: replace(declared, damper="centred", cutoff=None),
        closed=lambda true, _declared, _observer: replace(true, damper="centred", cutoff=None),
    )
    monkeypatch.setitem(CORRECTIONS, centred.name, centred)
    scene = scene_of({"touch": touch(2000.0, 5.0)}, device={"delay": 0.5})
    return scene.model_copy(update={"device": scene.device.model_copy(update={"correction": centred.name})})


def test_the_hand_feels_what_is_desired_as_predicted_and_as_measured(corrected: Scene) -> None:
    (felt,), found = hapsim.predict(corrected).felt, hapsim.measure(corrected)
    assert felt.configuration.damper == "centred"
    assert (felt.k, felt.b) == pytest.approx((2000.0, 6.0), rel=1e-9)
    assert (found.k, found.b) == pytest.approx((2000.0, 6.0), rel=1e-6)


def test_what_is_desired_and_how_well_the_device_has_to_be_known_is_stated(corrected: Scene) -> None:
    prediction = hapsim.predict(corrected)
    (desired,) = prediction.desired
    assert (desired.k, desired.b, desired.reached) == (2000.0, 6.0, True)
    assert prediction.parts[0].tolerances()[0].mass[0] < 0.2 < prediction.parts[0].tolerances()[0].mass[1]
    assert not [one for one in warnings_about(corrected, prediction) if "correction" in one]


def test_over_a_span_of_masses_the_worst_error_is_minimised(corrected: Scene) -> None:
    span = Span(least=0.1, most=0.4)
    scene = corrected.model_copy(update={"device": corrected.device.model_copy(update={"mass": span})})
    (desired,) = hapsim.predict(scene).desired
    uncorrected = scene.model_copy(update={"device": scene.device.model_copy(update={"correction": "poles"})})
    assert 0.0 < desired.error < 1.0
    assert hapsim.predict(uncorrected).desired[0].error > 0.0
