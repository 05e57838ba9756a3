"""A hold is an entry of HOLDS and nothing else: predicted, run, measured, identified, corrected and drawn."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import hapsim
from hapsim.holds import HOLDS
from hapsim.prediction.impedance import predict_impedance
from hapsim.scene import Scene, parse_scene

sys.path.insert(0, str(Path(__file__).parents[1]))
from unshipped_holds import UNSHIPPED

TEXT = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2, friction: 1, delay: 1.3}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}
"""
EVERY = [*HOLDS, "sawtooth", "two blows"]


@pytest.fixture(params=EVERY)
def held(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Scene:
    if request.param in UNSHIPPED:
        monkeypatch.setitem(HOLDS, request.param, UNSHIPPED[request.param])
    return with_device(parse_scene(TEXT, "here"), hold=request.param)


def with_device(scene: Scene, **values: object) -> Scene:
    return scene.model_copy(update={"device": scene.device.model_copy(update=values)})


@pytest.mark.parametrize("correction", ["none", "poles", "predictor"])
def test_a_hold_is_predicted_and_measured_alike_whatever_corrects_it(held: Scene, correction: str) -> None:
    scene = with_device(held, correction=correction)
    predicted, found = hapsim.predict(scene, with_margins=False).felt[0], hapsim.measure(scene)
    assert (found.k, found.b) == pytest.approx((predicted.k, predicted.b), rel=3e-7)
    if correction != "none":
        assert (found.k, found.b) == pytest.approx((2000.0, 6.0), rel=3e-7)


def test_the_ramp_feels_as_linear_interpolation_does() -> None:
    """Computed apart from hapsim, by the recurrence of a force that moves linearly to the new one."""
    scene = with_device(parse_scene(TEXT, "here"), hold="ramp", delay=1.0)
    found = hapsim.predict(scene, with_margins=False).felt[0]
    assert (found.k, found.b) == pytest.approx((2086.89017115, 1.94232467956), rel=1e-11)


def test_the_device_is_identified(held: Scene) -> None:
    found = hapsim.identify_device(with_device(held, mass=0.25, friction=0.8), duration=2.0)
    assert found.misfit == ""
    for estimate, true in ((found.mass, 0.25), (found.friction, 0.8), (found.delay, 1.3)):
        assert abs(estimate.value - true) < max(4.0 * estimate.uncertainty, 1e-6)


def test_the_impedance_is_measured_as_it_is_predicted(held: Scene) -> None:
    found = hapsim.measure_impedance(held)
    predicted = predict_impedance(held, found.frequency)
    for kind in ("device", "rendered", "closed_loop"):
        circles = getattr(found, kind)
        assert np.all(np.abs(circles.value - getattr(predicted, kind)) <= circles.uncertainty)
