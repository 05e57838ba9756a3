"""identify_servo: the servo, the delay and the handle's mass of a device in admittance, from commanded chirps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hapsim.errors import UsageError
from hapsim.measuring.identify_device import identify_device
from hapsim.measuring.identify_servo import identify_servo, servo_response, straight_response
from hapsim.scene.rewrite import rewrite_device
from tests import one_hand
from tests.admittance_scenes import DEVICE, HAND, scene_of

OFF: dict[str, Any] = {"stiffness": 0.0, "mass": 0.05}
SECONDS = 4.0


def device(servo: Any, delay: float, **mock: Any) -> Any:
    """A scene whose mock has this servo and delay, which the scene does not know."""
    own = {"servo": {"bandwidth": 30.0, "damping": 1.0}, "simulated_damping": 20.0, "travel": [-0.1, 0.1]}
    its = {"initial": {"position": 0.01}, "delay": delay} | ({"servo": servo} if servo else {}) | mock
    return scene_of(device=own if servo else own | {"servo": None}, hand=OFF, mock=its)


@pytest.mark.parametrize(
    ("bandwidth", "damping", "delay"), [(50.0, 0.8, 1.0), (20.0, 1.0, 2.0), (120.0, 0.5, 0.4), (10.0, 2.0, 0.0)]
)
def test_servo_and_delay_are_found_whatever_the_scene_declares(bandwidth: float, damping: float, delay: float) -> None:
    found = identify_servo(device({"bandwidth": bandwidth, "damping": damping}, delay), duration=SECONDS)
    assert found.bandwidth
    assert found.damping
    assert found.bandwidth.value == pytest.approx(bandwidth, rel=1e-3)
    assert found.damping.value == pytest.approx(damping, rel=1e-3)
    assert found.delay.value == pytest.approx(delay, abs=1e-2)
    assert found.handle_mass.value == pytest.approx(0.05, rel=0.02)
    assert found.peak_m < 0.005


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("delay", [1.0, 2.4])
def test_a_device_that_follows_in_straight_lines_is_known_as_one(delay: float) -> None:
    found = identify_servo(device(None, delay), duration=SECONDS)
    assert found.bandwidth is None
    assert found.damping is None
    assert found.delay.value == pytest.approx(delay, abs=1e-4)


def test_uncertainties_hold_with_counts_and_a_noisy_position() -> None:
    off = []
    for seed in range(6):
        scene = device({"bandwidth": 50.0, "damping": 0.8}, 1.0, quantum=1e-5, noise=5e-6, seed=seed)
        found = identify_servo(scene, duration=SECONDS)
        assert found.bandwidth
        assert found.damping
        off += [(found.bandwidth.value - 50.0) / found.bandwidth.uncertainty]
        off += [(found.damping.value - 0.8) / found.damping.uncertainty]
        off += [(found.delay.value - 1.0) / found.delay.uncertainty]
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 2.0


def test_an_inverted_force_sensor_shows_a_negative_mass() -> None:
    found = identify_servo(device(None, 1.0, force_sensor={"fault": "inverted"}), duration=SECONDS)
    assert found.handle_mass.value == pytest.approx(-0.05, rel=0.02)


def test_the_mock_is_let_go_of() -> None:
    held = device(None, 1.0).changed({"mock.hand.stiffness": 2000.0, "mock.hand.damping": 1.0})
    found = identify_servo(held, duration=SECONDS)
    assert found.handle_mass.value == pytest.approx(0.05, rel=0.02)


def test_a_strongly_damped_mass_settles_before_it_is_recorded() -> None:
    found = identify_servo(device(None, 1.0).changed({"device.simulated_damping": 5.0}), duration=SECONDS)
    assert found.error < 1e-6


def test_the_response_is_that_of_a_servo_stepped_through_by_hand() -> None:
    """A step of the command: 1 - (1 + w t) exp(-w t), from the delay on."""
    samples, rate, w, delay = 4096, 1000.0, 2.0 * np.pi * 40.0, 1.3
    z = np.exp(2j * np.pi * np.fft.rfftfreq(samples))
    command = np.r_[np.ones(samples // 2), np.zeros(samples // 2)]
    moved = np.fft.irfft(np.fft.rfft(command) * servo_response(z, 1.0 / rate, 40.0, 1.0, delay))
    time = np.maximum(np.arange(samples // 2) - delay, 0.0) / rate
    np.testing.assert_allclose(moved[: samples // 2], 1.0 - (1.0 + w * time) * np.exp(-w * time), atol=1e-9)
    straight = np.fft.irfft(np.fft.rfft(command) * straight_response(z, delay))
    np.testing.assert_allclose(straight[:5], [0.0, 0.0, 0.7, 1.0, 1.0], atol=1e-9)


def test_a_record_too_short_a_mass_and_an_impedance_are_refused_in_words() -> None:
    with pytest.raises(UsageError, match=r"duration: found 2 s, expected at least 4 s"):
        identify_servo(device(None, 1.0), duration=2.0)
    with pytest.raises(UsageError, match="found admittance, expected impedance: pushes find no mass behind a servo"):
        identify_device(device(None, 1.0))
    with pytest.raises(UsageError, match="found impedance, expected admittance"):
        identify_servo(one_hand.scene_of({"touch": one_hand.touch(2000, 5)}))


def test_what_is_found_is_written_into_the_scene_for_its_channel_alone(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    two = HAND | {"other": {"type": "device", "channel": 1}}
    text = yaml.safe_dump({"version": 1, "rate": 1000.0, "device": DEVICE, "modules": two})
    path.write_text(text)
    written = rewrite_device(str(path), {"servo.bandwidth": "45.1", "delay": "1.01"}, 1)
    assert written == {"servo.bandwidth": "[45.1, 45.1]", "delay": "1.01"}  # no other is known
    path.write_text(text.replace("  mode:", "  servo: {bandwidth: [30 Hz, 60 Hz], damping: 0.7}\n  mode:"))
    rewrite_device(str(path), {"servo.bandwidth": "45.1", "servo.damping": "0.9"}, 1)
    assert "servo: {bandwidth: [30 Hz, 45.1 Hz], damping: [0.7, 0.9]}" in path.read_text()
