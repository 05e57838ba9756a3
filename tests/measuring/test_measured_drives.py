"""Felt values behind a belt or a lagging motor, measured on the mock as they are predicted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.prediction import predict_impedance
from hapsim.prediction.drives import drive_sentences
from hapsim.scene import Scene
from tests.one_hand import scene_of, touch

BELT = {"stiffness": 20000.0, "damping": 0.04 * math.sqrt(2e4 * 0.0375), "motor_mass": 0.05}
DRIVES: list[dict[str, Any]] = [
    *({"transmission": BELT | {"sensor": side}} for side in ("motor", "handle")),
    {"motor_lag": 1e-3},
    {"motor_lag": 3e-4, "hold": "ramp"},
]


def scene_with(device: dict[str, Any]) -> Scene:
    return scene_of({"spring": touch(2000.0, 5.0)}, device=device, mock={"initial": {"position": 1e-3}})


@pytest.mark.parametrize("device", DRIVES)
def test_k_and_b_are_measured_as_predicted(device: dict[str, Any]) -> None:
    scene = scene_with(device)
    (part,) = hapsim.predict(scene).parts
    measured = hapsim.measure(scene)
    assert measured.k == pytest.approx(float(part.felt.k[0, 0]), rel=1e-6)
    assert measured.b == pytest.approx(float(part.felt.b[0, 0]), rel=1e-6)


@pytest.mark.parametrize("device", DRIVES[:3])
def test_the_impedance_is_measured_as_predicted_where_the_position_is_read(device: dict[str, Any]) -> None:
    scene = scene_with(device)
    measured = hapsim.measure_impedance(scene, duration=7.0)
    predicted = predict_impedance(scene, measured.frequency, as_read=True)
    for name in ("device", "rendered", "closed_loop"):
        circles = getattr(measured, name)
        assert (np.abs(circles.value - getattr(predicted, name)) <= circles.uncertainty).all()
        assert (np.median(circles.uncertainty / np.abs(circles.value))) < 0.01
    at_handle = predict_impedance(scene, measured.frequency)
    assert (np.abs(measured.device.value - at_handle.device) > measured.device.uncertainty).any()


@pytest.mark.parametrize(("lag", "within"), [(4e-4, 2e-3), (1e-3, 1e-2)])
def test_a_predictor_takes_a_lag_as_a_longer_delay(lag: float, within: float) -> None:
    scene = scene_with({"motor_lag": lag, "correction": "predictor"})
    predicted, measured = hapsim.predict(scene), hapsim.measure(scene)
    assert (predicted.k, predicted.b) == pytest.approx((2000.0, 6.0), rel=1e-9)
    assert (measured.k, measured.b) == pytest.approx((2000.0, 6.0), rel=within)
    (said,) = drive_sentences(predicted)
    assert said.endswith("samples); correction predictor takes it as a longer delay")


def test_declared_backlash_is_named_as_the_reason_of_a_softer_spring(hapsim: Any, tmp_path: Path) -> None:
    path = tmp_path / "play.yaml"
    belt = "{stiffness: 14 N/mm, damping: 2 N·s/m, motor_mass: 50 g, backlash: 0.1 mm}"
    text = (
        "version: 1\nrate: 2000\ndevice:\n  clock: lockstep\n  mass: 150 g\n  friction: 0.8 N·s/m\n"
        f"  transmission: {belt}\nmodules:\n  hand: {{type: device, channel: 0}}\n  rail: {{type: ground}}\n"
        "  s: {type: viscoelastic, between: [hand, rail], stiffness: 0.8 N/mm, damping: 2 N·s/m}\n"
    )
    path.write_text(text, encoding="utf-8")
    words = " ".join(hapsim("measure", path).out.split())
    assert "The declared backlash of 0.1 mm parts motor and handle at each turn" in words
    path.write_text(text.replace(", backlash: 0.1 mm", ""), encoding="utf-8")
    assert "declared backlash" not in hapsim("measure", path).out
