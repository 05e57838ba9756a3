"""Accelerations that the device senses, on the wire and in the loop, beside or without velocities."""

from __future__ import annotations

import numpy as np
import pytest
from loop_rig import frame, scene_of, scripted
from test_loop_velocity import SCALE, looped

from firmware_protocol import schema
from firmware_protocol.schema import MOTION_BITS, WITH_ACCELERATION
from hapsim.errors import DeviceError, UsageError
from hapsim.running import run

BOTH = {"sensors": ["velocity", "acceleration"]}
ALONE = {"sensors": ["acceleration"]}
SENSES = {"acceleration_scale": (1e-2,), "sensors": schema.SENSES_ACCELERATION}


@pytest.mark.parametrize(("device", "parts"), [(BOTH, MOTION_BITS), (ALONE, WITH_ACCELERATION)])
def test_the_loop_reads_them_in_metres_per_second_squared(device: dict[str, list[str]], parts: int) -> None:
    velocity = (4, -5) if parts & schema.WITH_VELOCITY else ()
    script = [frame(n, 10 * n, -20 * n, velocity=velocity, acceleration=(7 * n, -(2**31) + n)) for n in range(4)]
    fields = {name: (value,) * 2 for name, value in (("position_scale", 1e-6), ("force_scale", 1e-3))}
    fields |= {"force_limit": (9.0, 9.0), "velocity_scale": (SCALE, SCALE), "acceleration_scale": (0.01, 0.02)}
    with scripted(script, scene=scene_of(2, device=device), **fields, sensors=1) as (scene, served):
        io = looped(scene, len(script)).record.io
    assert [heard.argument for heard in served.arms] == [schema.LOCKSTEP | parts]
    np.testing.assert_allclose(io.acceleration[:2], [21 * 0.01, (-(2**31) + 3) * 0.02], rtol=1e-15)
    np.testing.assert_allclose(io.velocity[:2], np.multiply(velocity or (0, 0), SCALE), rtol=1e-15)
    np.testing.assert_allclose(io.measured[:2], [30e-6, -60e-6], rtol=1e-15)
    assert (io.accelerations, io.velocities) == (1, bool(velocity))


def test_without_the_sensor_in_the_scene_none_are_requested() -> None:
    with scripted([frame(n, 5) for n in range(3)], scene=scene_of(), **SENSES) as (scene, served):
        io = looped(scene, 3).record.io
    assert [heard.argument for heard in served.arms] == [schema.LOCKSTEP]
    assert not io.accelerations
    assert not io.acceleration.any()


def test_the_mock_s_acceleration_reaches_the_loop() -> None:
    device = {**BOTH, "friction": 4.0, "mass": 0.2, "stiffness": 30.0, "acceleration_age": 1}
    io = looped(scene_of(2, stiffness=0.0, damping=0.0, device=device), 21).record.io
    expected = -(4.0 * io.velocity[:2] + 30.0 * io.measured[:2]) / 0.2
    np.testing.assert_allclose(io.acceleration[:2], expected, atol=2e-5)  # of velocities in steps of 1e-6 m/s
    assert abs(expected).min() > 1.0


@pytest.mark.parametrize("fields", [{}, {"acceleration_scale": (1e-2,)}, {"sensors": 1}, {"sensors": 6}])
def test_a_device_that_senses_none_is_refused_before_it_is_armed(fields: dict[str, object]) -> None:
    with scripted(scene=scene_of(device=ALONE), **fields) as (scene, served):
        with pytest.raises(UsageError) as refused:
            run(scene, duration=0.01)
        assert not served.arms
    assert str(refused.value) == (
        f"{scene.device.port}: found a device that does not sense acceleration (its registers 15, bit 0, and 160), "
        "expected one that does: device.sensors names it; leave acceleration out there, or use a firmware that reports "
        "it"
    )


def test_a_device_that_senses_no_velocity_is_refused_where_the_sensors_name_it() -> None:
    said = r"does not sense velocity \(its registers 38\), expected"
    with scripted(scene=scene_of(device=BOTH), **SENSES) as (scene, _), pytest.raises(UsageError, match=said):
        run(scene, duration=0.01)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e-6])
def test_an_absurd_scale_is_the_device_s_fault(value: float) -> None:
    with scripted(scene=scene_of(device=ALONE), **SENSES | {"acceleration_scale": (value,)}) as (scene, served):
        with pytest.raises(DeviceError, match="acceleration scale that is not a number above 0"):
            run(scene, duration=0.01)
        assert not served.arms
