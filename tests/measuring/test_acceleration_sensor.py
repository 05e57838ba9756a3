"""`hapsim identify` compares a device's sensed acceleration with that of its motion."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identification import FORCE, TRAVEL, Device
from test_device_identification import Body, OnWire

import hapsim
from firmware_protocol.description import from_registers, to_registers
from hapsim.device.mock import assemble_mock
from hapsim.measuring.device_sensor import AccelerationSensor, sensor_warnings
from hapsim.running.requirements import with_sensors
from hapsim.running.run import run_to_end
from hapsim.units import Units

ONE = Device(rate=1000.0, mass=0.2, friction=1.0, stiffness=0.0, delay=1.0, coulomb=0.0)
LINEAR = Units.of(["linear"])


def identified(
    device: Device, wrong: float = 1.0, run: Callable[..., Any] = run_to_end, **mock: Any
) -> hapsim.DeviceIdentification:
    scene = device.scene(wrong)
    assert scene.mock is not None
    scene = scene.model_copy(update={"mock": scene.mock.model_copy(update=mock)})
    return hapsim.identify_device(scene, force=FORCE, travel=TRAVEL, duration=2.0, run=run)


def sensor_of(found: hapsim.DeviceIdentification) -> AccelerationSensor:
    assert found.acceleration_sensor is not None
    return found.acceleration_sensor


def changed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., hapsim.Trace]:
    """Returns a run of a board that sends another acceleration than the mock."""

    def run(scene: hapsim.Scene, **options: Any) -> hapsim.Trace:
        trace = run_to_end(scene, **options)
        return replace(trace, sensed={"acceleration": change(trace.sensed["acceleration"])})

    return run


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("age", "noise", "quantum"), [(0, 0.05, 1e-6), (1, 0.5, 1e-6), (1, 0.05, 1e-5), (0, 0.5, 1e-5)]
)
def test_a_right_sensor_is_found_right_with_its_noise_and_age(age: int, noise: float, quantum: float) -> None:
    """The mass is declared twice as large as it is; the device has dry friction and a spring."""
    device = replace(ONE, coulomb=0.2, stiffness=100.0, quantum=quantum)
    sensor = sensor_of(identified(device, 2.0, acceleration_noise=noise, acceleration_age=age, seed=age))
    assert abs(sensor.scale.value - 1.0) < 4.0 * sensor.scale.uncertainty < 0.01
    assert abs(sensor.offset.value) < 4.0 * sensor.offset.uncertainty < 0.3 * noise
    assert sensor.noise == pytest.approx(noise, rel=0.25)  # of 100 samples
    assert sensor.residual == pytest.approx(noise, rel=0.1)
    assert sensor.age == age
    assert sensor_warnings(sensor, 0, age, LINEAR) == []
    (warning,) = sensor_warnings(sensor, 0, 1 - age, LINEAR)
    assert f"found device.acceleration_age: {1 - age}, expected {age}" in warning


@pytest.mark.thorough
def test_the_uncertainties_are_those_of_the_noise() -> None:
    found = [sensor_of(identified(ONE, acceleration_noise=0.2, seed=seed)) for seed in range(8)]
    for name, truth in (("scale", 1.0), ("offset", 0.0)):
        estimates = [getattr(one, name) for one in found]
        off = [(one.value - truth) / one.uncertainty for one in estimates]
        assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.75, name  # of 8 draws, within three standard deviations


def test_a_wrong_scale_register_is_named_with_the_right_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    assemble = assemble_mock.assemble_mock

    def wrong(scene: hapsim.Scene) -> Any:
        mock = assemble(scene)
        description = from_registers(mock.registers)
        scale = tuple(0.25 * one for one in description.acceleration_scale)
        mock.registers[:] = to_registers(replace(description, acceleration_scale=scale))
        return mock

    monkeypatch.setattr(assemble_mock, "assemble_mock", wrong)
    sensor = sensor_of(identified(ONE, acceleration_noise=0.05))
    assert sensor.scale.value == pytest.approx(0.25, rel=1e-3)
    (warning,) = sensor_warnings(sensor, 2, 0, LINEAR)
    assert "is 0.25 times that of the motion: its scale is wrong" in warning
    assert "(register 192) by 4" in warning, "of channel 2"


def test_a_wrong_sign_and_an_offset_are_named() -> None:
    turned = sensor_of(identified(ONE, run=changed(lambda values: -values)))
    (warning,) = sensor_warnings(turned, 0, 0, LINEAR)
    assert "is -1 times that of the motion: its sign is wrong" in warning
    leaning = sensor_of(identified(ONE, run=changed(lambda values: values + 0.5), acceleration_noise=0.05))
    assert abs(leaning.offset.value - 0.5) < 4.0 * leaning.offset.uncertainty
    (warning,) = sensor_warnings(leaning, 0, 0, LINEAR)
    assert re.search(r"has an offset of 0\.(49|50)\d* m/s², 0\.05\d* of what it sensed", warning)


def test_a_sensor_of_low_bandwidth_lags() -> None:
    sensor = sensor_of(identified(ONE, acceleration_bandwidth=200.0, acceleration_noise=0.05))
    assert sensor.noise == pytest.approx(0.05, rel=0.25)
    assert sensor.residual > 0.5
    assert any("it lags, as a sensor of a low bandwidth does" in one for one in sensor_warnings(sensor, 0, 0, LINEAR))


def test_the_age_is_unknown_where_no_force_begins_at_a_sample() -> None:
    sensor = sensor_of(identified(replace(ONE, delay=1.4), acceleration_noise=0.05))
    assert sensor.age is None
    assert abs(sensor.scale.value - 1.0) < 4.0 * sensor.scale.uncertainty
    assert sensor_warnings(sensor, 0, 1, LINEAR) == []


def test_the_acceleration_of_a_handle_in_a_hand_is_the_handles() -> None:
    """A second mass pulls at it. The body's own equation gives its acceleration just before each sample."""

    class Logged(Body):
        def __init__(self) -> None:
            super().__init__((1.0, 2000.0, 10.0))
            self.accelerations = [0.0]

        def move(self, force: float, seconds: float) -> None:
            super().move(force, seconds)
            if seconds > 0.0:
                self.accelerations.append(float(self._matrix[1] @ self._state))

    def run(scene: hapsim.Scene, **options: Any) -> hapsim.Trace:
        body = Logged()
        trace = run_to_end(scene, between=lambda _: OnWire(body), **options)
        return replace(trace, sensed={"acceleration": np.array(body.accelerations)[trace.sample][:, None]})

    found = hapsim.identify_device(ONE.scene(), duration=2.0, run=run)
    assert found.hand is not None
    sensor = sensor_of(found)
    assert sensor.age == 1
    assert sensor.scale.value == pytest.approx(1.0, abs=1e-3)
    assert sensor.residual < 1e-3 * sensor.rms


def test_without_a_sensor_or_where_longer_frames_would_be_late_there_is_none() -> None:
    def run(scene: hapsim.Scene, also_sense: tuple[str, ...], **options: Any) -> hapsim.Trace:
        assert also_sense == ("acceleration",)
        return run_to_end(scene, **options)

    assert identified(ONE, run=run).acceleration_sensor is None
    for baud, sensors in ((2_000_000, ("acceleration",)), (250_000, ())):
        scene = ONE.scene()
        device = scene.device.model_copy(update={"port": "/dev/ttyS0", "baud": baud, "clock": "device"})
        scene = scene.model_copy(update={"device": device})
        assert with_sensors(scene, ("acceleration",), assemble_mock.describe_mock(scene)).device.sensors == sensors
