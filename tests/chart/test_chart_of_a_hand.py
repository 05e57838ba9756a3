"""Table 1: what springs on both sides of the interface swing at, by closed forms, by the theory, and on the mock. And
transparency: the desired impedance beside the rendered one, defined as `hapsim measure --impedance` defines them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.chart.hand import Hand, hands_of_scene
from hapsim.chart.impedance_chart import transparency, transparency_in
from hapsim.chart.table1 import Table1, table1
from hapsim.errors import DeviceError, UsageError
from hapsim.measuring.measure import measure
from hapsim.prediction import predict
from hapsim.prediction.predict_impedance import predict_impedance
from hapsim.scene import load_scene
from hapsim.theory import Configuration

MASS, RATE, STIFFNESS = 0.001, 1000.0, 100.0


def by_closed_forms(mass: float, rate: float, K: float) -> dict[str, float]:
    """Hz, of Table 1 without damping, delay and hold (Florens et al., §3 and Table 2)."""
    T = 1.0 / rate
    w0 = math.acos(1.0 - 0.5 * K * T**2 / mass) / T
    w = {
        "I": w0,
        "II": w0,
        "III": math.sqrt(2.0) * w0,
        "IV": math.acos(1.0 - K * T**2 / mass) / T,
        "V": math.acos(math.cos(w0 * T) - K * T * math.sin(w0 * T) / (2.0 * mass * w0)) / T,
    }
    return {numeral: value / (2.0 * math.pi) for numeral, value in w.items()}


def require_agreement(data: Table1, expected: dict[str, float], within: float) -> None:
    for numeral, frequency in expected.items():
        assert data.couplings[numeral].predicted_hz == pytest.approx(frequency, rel=1e-9)
        assert data.couplings[numeral].measured_hz == pytest.approx(frequency, rel=within)


@pytest.mark.parametrize("K", [0.1, 100.0, 900.0])
def test_the_mock_swings_as_in_the_closed_forms(K: float) -> None:
    hand = Hand("hand", 0, Configuration(MASS, RATE, friction=0.3, delay=1.0), K, 0.2)
    data = table1(hand, as_scene=False)
    require_agreement(data, by_closed_forms(MASS, RATE, K), 1e-6)
    assert data.relative("III") == pytest.approx(math.sqrt(2.0))
    # Two simulated springs are stiffer than two real ones, and one of each lies between them.
    assert data.error("IV") > data.error("V") > 0.0


def test_a_real_spring_alone_is_enough_to_tune_the_simulated_one() -> None:
    real = Configuration(MASS, RATE, stiffness=100.84462625181537)
    data = table1(Hand("hand", 0, real, 0.0, 0.0), as_scene=False)
    assert pytest.approx(STIFFNESS, rel=1e-9) == data.K
    require_agreement(data, by_closed_forms(MASS, RATE, STIFFNESS), 1e-6)


def test_as_the_scene_is_the_simulated_spring_stands_for_the_real_one_that_it_is_felt_as() -> None:
    device = Configuration(mass=0.2, rate=1000.0, friction=1.0)
    data = table1(Hand("hand", 0, device, 2000.0, 5.0), as_scene=True)
    assert (data.k, data.couplings["I"].configuration.friction) == pytest.approx(device.equivalent(2000.0, 5.0))
    assert data.relative("II") == pytest.approx(1.0)
    for coupling in data.couplings.values():
        assert abs(coupling.off_by) < 1e-6
        assert abs(coupling.off_by) < 6.0 * coupling.uncertainty_hz / coupling.measured_hz + 1e-12


@pytest.mark.parametrize("correction", ["poles", "predictor"])
@pytest.mark.parametrize("as_scene", [False, True])
def test_corrected_two_simulated_springs_are_two_real_ones(correction: Any, as_scene: bool) -> None:
    """I and II, and III to V, swing alike, each at the frequency of real springs alone (Florens et al., §3)."""
    device = Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=1.5)
    data = table1(Hand("hand", 0, device, 2000.0, 5.0), as_scene=as_scene, correction=correction)
    once = math.sqrt(2000.0 / 0.2) / (2.0 * math.pi)
    expected = {"I": 1.0, "II": 1.0, "III": math.sqrt(2.0), "IV": math.sqrt(2.0), "V": math.sqrt(2.0)}
    require_agreement(data, {numeral: times * once for numeral, times in expected.items()}, 1e-6)


def test_what_poles_do_not_reach_is_predicted_as_the_nearest_that_is_simulated() -> None:
    device = Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=3.0)
    data = table1(Hand("hand", 0, device, 40000.0, 20.0), as_scene=True, correction="poles")
    assert data.relative("IV") < 1.3
    for coupling in data.couplings.values():
        assert abs(coupling.off_by) < 1e-5


@pytest.mark.parametrize(
    ("stiffness", "damping", "as_scene", "told"),
    [
        (0.0, 5.0, False, "found no spring"),
        (math.nan, math.nan, False, "found no spring"),
        (4.2e5, 5.0, False, "coupling IV of Table 1 would not swing below half the rate"),
        (1e7, 5.0, False, "swing"),
        (2000.0, 0.0, True, "no real damper does that"),
    ],
)
def test_what_cannot_be_coupled_is_reported(stiffness: float, damping: float, as_scene: bool, told: str) -> None:
    hand = Hand("hand", 0, Configuration(mass=0.2, rate=1000.0, friction=1.0), stiffness, damping)
    with pytest.raises(UsageError, match=told):
        table1(hand, as_scene=as_scene)


def test_a_measurement_whose_run_failed_is_reported_and_not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: Any, **options: Any) -> Any:
        return replace(measure(*arguments, **options), failure=DeviceError("the mock went away"))

    monkeypatch.setattr("hapsim.chart.table1.measure", fails)
    with pytest.raises(DeviceError, match="the mock went away"):
        table1(Hand("hand", 0, Configuration(MASS, RATE, friction=0.3, delay=1.0), STIFFNESS, 0.2), as_scene=False)


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


@pytest.mark.parametrize("stiffness", [0.0, 300.0])
def test_the_real_spring_that_is_felt_is_drawn_without_the_device_s_own(stiffness: float) -> None:
    own = replace(DEVICE, stiffness=stiffness)
    hand = Hand("hand", 0, own, 2000.0, 5.0)
    data = transparency(hand)
    k, b = hand.felt()
    jw = 2j * np.pi * data.frequency
    np.testing.assert_allclose(data.felt, (k - stiffness) / jw + b - DEVICE.friction, rtol=1e-12)
    ((low, high),) = data.agreeing_bands_hz()
    assert low == data.frequency[0]
    at = np.array([0.999 * high, 1.001 * high])
    felt = (k - stiffness) / (2j * np.pi * at) + b - DEVICE.friction
    off = np.abs(SCENE_ALONE.impedance(2000.0, 5.0, at) - felt) / np.abs(felt)
    assert off[0] < 0.05 < off[1]


def test_of_a_hand_that_moves_a_mass_the_felt_pair_is_drawn_with_the_rendered(
    scene_file: Callable[..., Path],
) -> None:
    prediction = predict(load_scene(scene_file("coupled")), with_margins=False)
    data = transparency_in(prediction, "hand", 16.0)
    (part,) = prediction.parts
    friction = prediction.scene.device.frictions(1)[0]
    expected = part.felt.k[0, 0] / (2j * np.pi * data.frequency) + part.felt.b[0, 0] - friction
    np.testing.assert_allclose(data.felt, expected, rtol=1e-12)
    assert data.agreeing_bands_hz()[0][0] == data.frequency[0]


def test_the_scene_gives_energy_where_the_real_part_is_negative() -> None:
    data = transparency(Hand("hand", 0, DEVICE, 2000.0, 5.0))
    ((low, high), *_) = data.active_bands_hz()
    at = np.array([0.999 * low, 1.001 * low, 0.999 * high, 1.001 * high])
    assert (SCENE_ALONE.impedance(2000.0, 5.0, at).real < 0.0).tolist() == [False, True, True, False]
    assert transparency(Hand("hand", 0, replace(DEVICE, delay=0.0, hold="impulse"), 100.0, 1.0)).active_bands_hz() == []


def test_without_an_equivalent_there_is_no_eigenfrequency() -> None:
    data = transparency(Hand("hand", 0, Configuration(mass=0.2, rate=1000.0, delay=0.0), 3000.0, 120.0))
    assert math.isnan(data.eigenfrequency)
    assert data.frequency[0] == pytest.approx(0.5)
