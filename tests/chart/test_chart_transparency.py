"""The desired impedance beside the rendered one, defined as `hapsim measure --impedance` defines them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hapsim.chart.hand import Hand, hands_of_scene
from hapsim.chart.impedance import transparency
from hapsim.prediction.impedance import predict_impedance
from hapsim.scene import load_scene
from hapsim.theory import Configuration

DEVICE = Configuration(mass=0.2, rate=1000.0, friction=1.0, stiffness=100.0)
SCENE_ALONE = replace(DEVICE, friction=0.0, stiffness=0.0)


@pytest.mark.parametrize("correction", ["none", "poles"])
def test_it_is_the_impedance_that_is_predicted_for_a_measurement(
    scene_file: Callable[..., Path], correction: str
) -> None:
    scene = load_scene(scene_file("spring", stiffness=100.0, correction=correction))
    (hand,) = hands_of_scene(scene, {})
    data = transparency(hand)
    predicted = predict_impedance(scene, data.frequency)
    np.testing.assert_allclose(data.desired, predicted.desired[:, 0, 0], rtol=1e-9)
    np.testing.assert_allclose(data.rendered, predicted.rendered[:, 0, 0], rtol=1e-9)
    columns = data.columns()
    for name, impedance in (("desired", data.desired), ("rendered", data.rendered)):
        np.testing.assert_allclose(columns[f"{name}_Ns_per_m"], np.abs(impedance), rtol=1e-12)
        turned = np.exp(1j * np.radians(columns[f"{name}_phase_deg"]))
        np.testing.assert_allclose(turned, impedance / np.abs(impedance), atol=1e-9)
        assert np.max(np.abs(np.diff(columns[f"{name}_phase_deg"]))) < 90.0


def test_far_below_the_eigenfrequency_the_desired_spring_is_rendered() -> None:
    data = transparency(Hand("hand", 0, DEVICE, 2000.0, 5.0))
    assert data.frequency[0] == pytest.approx(data.eigenfrequency / 20.0)
    assert abs(data.rendered[0]) == pytest.approx(abs(data.desired[0]), rel=1e-3)


def test_the_scene_gives_energy_where_the_real_part_is_negative() -> None:
    data = transparency(Hand("hand", 0, DEVICE, 2000.0, 5.0))
    ((low, high), *_) = data.gives_energy()
    at = np.array([0.999 * low, 1.001 * low, 0.999 * high, 1.001 * high])
    assert (SCENE_ALONE.impedance(2000.0, 5.0, at).real < 0.0).tolist() == [False, True, True, False]
    assert transparency(Hand("hand", 0, replace(DEVICE, delay=0.0, hold="impulse"), 100.0, 1.0)).gives_energy() == []


def test_without_an_equivalent_there_is_no_eigenfrequency() -> None:
    data = transparency(Hand("hand", 0, Configuration(mass=0.2, rate=1000.0, delay=0.0), 3000.0, 120.0))
    assert math.isnan(data.eigenfrequency)
    assert data.frequency[0] == pytest.approx(0.5)
