"""k of devices that are not quite as declared: right within what is stated, or with a word that says why not."""

from __future__ import annotations

import numpy as np
import pytest
from records import trace_of
from rich.console import Console

import hapsim
from hapsim.cli.measure_command import show_measurement
from hapsim.measuring.measure_trace import measure_trace
from tests.one_hand import scene_of, touch
from tests.rough_devices import TOO_FAR, measured, rough_device


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("seed", range(6))
def test_no_k_is_far_off_without_a_word(seed: int) -> None:
    said = measured(rough_device(seed))
    named = [word for word in said.words if word != "limits"]
    assert not said.apart > TOO_FAR or named
    assert not said.wrong


def scene_with(quantum: float, coulomb: float = 0.0, damper: str = "backward", damping: float = 11.6) -> hapsim.Scene:
    mock = {"initial": {"velocity": 0.1}, "quantum": quantum, "coulomb": coulomb}
    return scene_of({"touch": touch(2000, damping, damper=damper)}, device={"delay": 0.0}, mock=mock)


@pytest.mark.parametrize("quantum", [1e-9, 1e-6])
@pytest.mark.parametrize("damping", [24.0, 32.0, 40.0, 48.0])
def test_a_sensed_velocity_s_rounding_is_no_second_mode(damping: float, quantum: float) -> None:
    scene = scene_with(quantum, damper="sensed", damping=damping)
    predicted, found = hapsim.predict(scene, with_margins=False), hapsim.measure(scene)
    assert abs(found.k - predicted.k) < 4.0 * found.k_uncertainty < 0.04 * predicted.k
    assert abs(found.b - predicted.b) < 4.0 * found.b_uncertainty < 0.04 * predicted.b


@pytest.mark.parametrize("coulomb", [0.005, 0.02, 0.1, 0.5])
def test_dry_friction_is_measured_and_k_and_b_are_those_without_it(coulomb: float) -> None:
    scene = scene_with(1e-9, coulomb)
    prediction, found = hapsim.predict(scene, with_margins=False), hapsim.measure(scene)
    assert found.dry_friction_n == pytest.approx(coulomb, rel=1e-3)
    assert abs(found.k - prediction.k) < 4.0 * found.k_uncertainty < 1e-4 * prediction.k
    assert abs(found.b - prediction.b) < 4.0 * found.b_uncertainty < 1e-3 * prediction.b
    out = Console(width=10_000)
    with out.capture() as said:
        show_measurement(out, scene, prediction, found)
    assert f"The device has dry friction of {coulomb:g} N, as its motion shows" in said.get()
    assert "swings along" not in said.get()


@pytest.mark.parametrize("quantum", [1e-9, 5e-6])
def test_a_device_without_dry_friction_is_reported_to_have_none(quantum: float) -> None:
    assert hapsim.measure(scene_with(quantum)).dry_friction_n == 0.0


def test_what_has_nearly_all_of_the_energy_is_the_hand_whatever_rings_longer_next_to_it() -> None:
    n, mass = np.arange(2048), 0.2
    hand = 1e-3 * np.exp(-0.02 * n) * np.cos(0.15 * n)
    beside = 2e-5 * np.exp(-0.004 * n) * np.cos(0.4 * n)  # 0.2 % of the energy
    found = measure_trace(trace_of(hand + beside, -500.0 * (hand + beside)), mass)
    assert found.k == pytest.approx(mass * 1e6 * (0.02**2 + 0.15**2), rel=1e-2)
    assert found.b == pytest.approx(2.0 * mass * 1e3 * 0.02, rel=1e-2)
    assert found.second_mode is not None
    assert abs(np.angle(found.second_mode.pole)) == pytest.approx(0.4, rel=1e-2)
    assert found.second_mode.share < 0.05
