"""Answers of a device before the loop starts, and the advice in the error messages."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

import numpy as np
import pytest
from loop_rig import alike, frame, scene_of, scripted

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, frame_to_host
from hapsim.device.connection import describe, read_register
from hapsim.device.ports import open_serial_port
from hapsim.errors import DeviceError, GuardError, UsageError
from hapsim.running import run
from hapsim.scene import Detent, Scene
from hapsim.scene.section import Table

REFUSALS = [schema.WRONG_SCHEMA, schema.WRONG_PACING, schema.WRONG_SENSING, schema.WRONG_WATCHDOG, schema.HARDWARE]


def refusal(kind: type[Exception], scene: Scene | None = None, **differences: Any) -> str:
    """The sentence with which the run is refused; the device was never left armed."""
    with scripted(scene=scene, **differences) as (there, device):
        with pytest.raises(kind) as caught:
            run(there, duration=0.01)
        assert not device.armed
        assert not device.forces
    assert str(caught.value).startswith(there.device.port)
    return str(caught.value)


def test_a_description_arrives_as_the_device_sends_it() -> None:
    with scripted(name="a device", force_limit=(3.5,)) as (scene, device):
        connection = open_serial_port(scene.device.port, scene.device.baud)
        try:
            assert describe(connection) == device.description
            assert read_register(connection, schema.REG_SCHEMA) == schema.SCHEMA_HASH
        finally:
            connection.close()


SCALES = ("position_scale", "force_scale", "force_limit")
PACINGS = {"lockstep": 0b011, "host": 0b101, "device": 0b110}


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("kind", "told", "differences"),
    [
        *(
            (DeviceError, told, {"registers": {register: value}})
            for register, value, told in (
                (schema.REG_VERSION, 2, "uses version 2 of the protocol, this hapsim version 1: install a newer"),
                (schema.REG_VERSION, 0, "install a newer firmware"),
                (
                    schema.REG_SCHEMA,
                    0xDEADBEEF,
                    f"schema is deadbeef, this hapsim's is {schema.SCHEMA_HASH:08x}: build the firmware",
                ),
                *((schema.REG_CHANNELS, n, f"declares {n} channels, expected 1 to 16") for n in (0, 17, 2**32 - 1)),
            )
        ),
        (UsageError, "the device has 1 channel(s), the scene uses 3", {"scene": scene_of(3)}),
        (
            UsageError,
            "samples at 2000 Hz, the scene says 1000 Hz: write rate: 2000 into the scene",
            {"rate_hz": 2000.0},
        ),
        *((DeviceError, "not a number above 0", {"rate_hz": rate}) for rate in (np.nan, np.inf, 0.0, -1000.0)),
        *(
            (DeviceError, "not a number above 0", {what: (value,)})
            for what in SCALES
            for value in (np.nan, np.inf, -np.inf, 0.0, -1e-6)
        ),
        *(
            (
                UsageError,
                f"cannot be run with clock: {clock}; try another clock",
                {"scene": scene_of(device={"clock": clock}), "pacings": pacings},
            )
            for clock, pacings in PACINGS.items()
        ),
        *((DeviceError, f"the device does not arm: {schema.FAULTS[one]}", {"refuses": one}) for one in REFUSALS),
        *((DeviceError, f"does not arm: fault {one}, which", {"refuses": one}) for one in (77, 255)),
        (DeviceError, "described itself, but it did not answer ARM within 0.08 s", {"ignores_arm": True}),
        (DeviceError, "state 2 and fault 1", {"answers_arm_with": schema.LATCHED | schema.HOST_QUIET << 8}),
        (DeviceError, "allows no watchdog (its register 6 reads 0)", {"max_watchdog_samples": 0}),
    ],
)
def test_what_cannot_be_run_is_refused_before_it_is_armed_with_what_to_do(
    kind: type[Exception], told: str, differences: dict[str, Any]
) -> None:
    sentence = refusal(kind, **differences)
    assert told in sentence
    assert "powered" not in sentence


def test_more_channels_than_the_scene_uses_get_no_force() -> None:
    script = [frame(n, 100, 200, 300) for n in range(5)]
    with scripted(script, **alike(3)) as (scene, device):
        trace = run(scene, duration=0.005)
    assert trace.position_counts.tolist() == [[100, 200, 300]] * 5
    assert [heard.counts for heard in device.forces] == [(-100, 0, 0)] * 5


@pytest.mark.parametrize(("motion", "unit"), [("linear", "m"), ("rotary", "rad")])
def test_detents_that_the_devices_encoder_does_not_resolve_are_refused(motion: str, unit: str) -> None:
    scene = scene_of()
    hand, wall = next(iter(scene.device_points)), next(iter(scene.grounds))
    modules = Table(dict(scene.modules) | {"rests": Detent(between=(hand, wall), pitch=3e-6, depth=0.1)})
    device = scene.device.model_copy(update={"motion": motion})
    there = scene.model_copy(update={"modules": modules, "device": device})
    told = f"found 3e-06 {unit}: 3 counts of the encoder (declared by the device: 1e-06 {unit}); expected 4 or more"
    assert f"rests.pitch: {told}" in refusal(UsageError, scene=there)


@pytest.mark.parametrize("value", [sys.float_info.min, 5e-324, sys.float_info.max])
@pytest.mark.parametrize("what", SCALES)
def test_extreme_scales_leave_the_force_within_the_limit(what: str, value: float) -> None:
    with scripted([frame(n, 1000) for n in range(5)], **{what: (value,)}) as (scene, device):
        with contextlib.suppress(GuardError):
            run(scene, duration=0.005)
        assert not device.armed
    limit = min(device.description.force_limit[0], scene.device.force_limit)
    sent = [heard.counts[0] * device.description.force_scale[0] for heard in device.forces]
    assert np.all(np.abs(sent) <= limit * (1 + 1e-12))


def test_a_watchdog_shorter_than_ours_is_accepted() -> None:
    with scripted([frame(n, 0) for n in range(3)], max_watchdog_samples=3) as (scene, _):
        assert run(scene, duration=0.003).report.ticks == 3


@pytest.mark.usefixtures("impatient")
def test_where_nothing_answers_the_user_is_asked_the_right_questions() -> None:
    with scripted() as (scene, device):
        device.deaf = True
        with pytest.raises(DeviceError, match=r"no answer within 0\.04 s\. Is this the device's port, is the device"):
            run(scene, duration=0.01)


@pytest.mark.parametrize(
    "garbage",
    [b"U-Boot 2024.01 (Jan 01 2024)\r\n", b"\x00" * 500, bytes(range(256)) * 20, b"\xff" * 9000],
    ids=["boot log", "zeros", "every byte", "more than the inbox holds"],
)
def test_garbage_that_waits_on_the_port_is_read_over(garbage: bytes) -> None:
    """It comes after every answer: what waits when the port opens is thrown away by the opening."""
    with scripted([frame(n, 0) for n in range(3)], before=garbage) as (scene, device):
        device.after_each = garbage[:300]
        assert run(scene, duration=0.003).sample.tolist() == [0, 1, 2]


@pytest.mark.usefixtures("impatient")
def test_a_port_that_only_babbles_is_no_device() -> None:
    with scripted() as (scene, device):
        device.deaf, device.after_each = True, b"$GPGGA,123519,4807.038,N\r\n\x00"
        with pytest.raises(DeviceError, match="no answer"):
            run(scene, duration=0.01)


def test_answers_to_other_questions_are_passed_over() -> None:
    stray = frame_to_host(SETUP, schema.DESCRIPTION, schema.REG_HELD, [12345])
    with scripted([frame(n, 0) for n in range(3)]) as (scene, device):
        device.before_each = stray
        assert run(scene, duration=0.003, transport="auto").report.ending == "done"


def test_a_device_that_hangs_up_while_it_is_asked_is_gone() -> None:
    with scripted([None]) as (scene, _), pytest.raises(DeviceError, match=r"went away|is gone|still there"):
        run(scene, duration=0.01)
