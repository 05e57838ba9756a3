"""Velocities and accelerations that the device senses: asked for where the scene needs them, and what the loop makes of
them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import pytest
from loop_rig import alike, frame, scene_of, scripted, served

from firmware_protocol import schema
from firmware_protocol.schema import MOTION_BITS, WITH_ACCELERATION, WITH_VELOCITY
from hapsim.device.connection import arm, describe, disarm
from hapsim.device.open_connection import open_connection
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.compiled_loop import run_loop
from hapsim.loop.endings import DONE
from hapsim.running import run
from hapsim.running.assemble_loop import LoopMemory, assemble_loop
from hapsim.running.session_options import RunOptions
from hapsim.scene import DamperScheme, Scene
from hapsim.scene.issue import one_of
from tests import one_hand

SCALE = 1e-3  # (m/s) per count of the scripted device
BOTH, ALONE = {"sensors": ["velocity", "acceleration"]}, {"sensors": ["acceleration"]}
SENSES = {"acceleration_scale": (1e-2,), "sensors": schema.SENSES_ACCELERATION}


def looped(scene: Scene, ticks: int) -> LoopMemory:
    """The loop after this number of ticks."""
    with open_connection(scene) as connection:
        description = describe(connection)
        loop = assemble_loop(scene, connection, description, RunOptions(duration=ticks / scene.rate))
        parts = schema.parts_of(scene.sensed)
        assert arm(connection, description, schema.LOCKSTEP, 100, parts) == loop.wire
        assert run_loop(loop.record) == DONE
        assert connection.decoder.crc_errors + connection.decoder.form_errors == 0
        disarm(connection, loop.wire)
    return loop


def after(scene: Scene, script: Sequence[bytes], **fields: Any) -> tuple[Any, list[int]]:
    """The loop's io buffer after a script, each item of which is a position that is answered; and how it armed."""
    fields = alike(scene.channels) | {"velocity_scale": (SCALE, 2.0 * SCALE)[: scene.channels]} | fields
    with scripted(script, scene=scene, **fields) as (there, device):
        io = looped(there, len(script)).record.io
    return io, [heard.argument for heard in device.arms]


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"damper": "sensed"}, WITH_VELOCITY),
        ({"device": BOTH}, MOTION_BITS),
        ({"device": ALONE}, WITH_ACCELERATION),
        ({"damper": "backward"}, 0),
        ({"damper": "centred"}, 0),
    ],
)
def test_what_the_scene_needs_is_asked_for_and_comes_in_si_units(keys: dict[str, Any], parts: int) -> None:
    scene = scene_of(2, **keys)
    sent: list[dict[str, Any]] = [
        {"velocity": (7 * n, -(2**31) + n)} if parts & WITH_VELOCITY else {} for n in range(4)
    ]
    sent = [one | ({"acceleration": (9 * n, -4)} if parts & WITH_ACCELERATION else {}) for n, one in enumerate(sent)]
    script = [frame(n, 10 * n, -20 * n, **one) for n, one in enumerate(sent)]
    io, arms = after(scene, script, acceleration_scale=(0.01, 0.02), sensors=schema.SENSES_ACCELERATION)
    assert arms == [schema.LOCKSTEP | parts]
    assert bool(scene.sensed_links) == ("sensed" in keys.values())
    velocity = (21 * SCALE, (-(2**31) + 3) * 2 * SCALE) if parts & WITH_VELOCITY else (0.0, 0.0)
    acceleration = (0.27, -0.08) if parts & WITH_ACCELERATION else (0.0, 0.0)
    np.testing.assert_allclose(io.measured[:2], [30e-6, -60e-6], rtol=1e-15)
    np.testing.assert_allclose(io.velocity[:3], [*velocity, 0.0], rtol=1e-15)
    np.testing.assert_allclose(io.acceleration[:2], acceleration, rtol=1e-15)


def refusal(scene: Scene, kind: type[Exception], **fields: Any) -> str:
    """The sentence with which a device is refused, which is not armed, behind its port."""
    with scripted(scene=scene, **alike(scene.channels) | fields) as (there, device):
        with pytest.raises(kind) as caught:
            run(there, duration=0.01)
        assert not device.arms
    return str(caught.value).removeprefix(f"{there.device.port}: ")


def test_a_device_that_senses_no_velocity_is_refused_with_the_links_that_ask_and_what_to_do() -> None:
    dampers = one_of(name for name in get_args(DamperScheme) if name != "sensed")
    for channels, who in ((1, "touch0 asks"), (2, "touch0, touch1 ask")):
        assert refusal(scene_of(channels, damper="sensed"), UsageError) == (
            f"the device does not sense velocity, but {who} for it with damper: sensed; write damper: {dampers} there, "
            "or use a firmware that reports velocity"
        )
    one = one_hand.scene_of({"rub": one_hand.touch(1.0, damper="sensed"), "touch": one_hand.touch(1.0)})
    assert "velocity, but rub asks for it" in refusal(one, UsageError)
    said = "does not sense velocity (its registers 38), expected"
    assert said in refusal(scene_of(device=BOTH), UsageError, **SENSES)


@pytest.mark.parametrize("fields", [{}, {"acceleration_scale": (1e-2,)}, {"sensors": 1}, {"sensors": 6}])
def test_a_device_that_senses_no_acceleration_is_refused(fields: dict[str, object]) -> None:
    assert refusal(scene_of(device=ALONE), UsageError, **fields) == (
        "found a device that does not sense acceleration (its registers 15, bit 0, and 160), expected one that does: "
        "device.sensors names it; leave acceleration out there, or use a firmware that reports it"
    )


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf"), -1e-6])
def test_an_absurd_scale_is_the_devices_fault_where_it_is_needed(value: float) -> None:
    told = "scale that is not a number above 0"
    assert f"velocity {told}" in refusal(scene_of(damper="sensed"), DeviceError, velocity_scale=(value,))
    fields = SENSES | {"acceleration_scale": (value,)}
    assert f"acceleration {told}" in refusal(scene_of(device=ALONE), DeviceError, **fields)
    with scripted([frame(n, 0) for n in range(3)], velocity_scale=(value,)) as (there, _):
        assert run(there, duration=0.003).report.ticks == 3


def test_a_sensed_damper_brakes_by_the_velocity_on_the_wire_and_not_by_the_way_gone() -> None:
    x, v = np.array([0, 300, 200, 200]), np.array([50, -40, 0, 700])
    script = [frame(n, x[n], velocity=(v[n],)) for n in range(4)]
    with scripted(script, scene=scene_of(damper="sensed"), velocity_scale=(SCALE,)) as (there, _):
        trace = run(there, duration=0.004)
    np.testing.assert_allclose(trace.asked_force[:, 0], -1000.0 * x * 1e-6 - 2.0 * v * SCALE, rtol=1e-12)


def test_a_mass_is_led_past_lost_velocities_as_if_they_had_run_along_a_straight_line() -> None:
    tie = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 500, "damping": 1, "damper": "sensed"}
    scene = one_hand.scene_of({"ball": {"type": "mass", "mass": 0.01}, "tie": tie})
    x, v = np.arange(9) * 40, np.array([0, 100, 100, 0, -100, -200, -300, 300, 50])
    traces = []
    for numbers in (range(9), [0, 1, 2, 6, 7, 8]):
        script = [frame(n, x[n], velocity=(v[n],)) for n in numbers]
        with scripted(script, scene=scene, velocity_scale=(SCALE,)) as (there, _):
            traces.append(run(there, duration=len(script) / 1000))
    whole, bridged = traces
    assert bridged.report.lost_frames == 3
    np.testing.assert_allclose(bridged.asked_force, whole.asked_force[bridged.sample], rtol=1e-12)


def test_without_sensed_velocities_the_scene_is_given_zeros() -> None:
    io, _ = after(scene_of(), [frame(0, 0), frame(1, 500), frame(4, 900)], **SENSES)
    for one in (io.velocity, io.velocity_bridge, io.acceleration):
        assert not one.any()


@pytest.mark.parametrize("sampling", ["ideal", "average"])
def test_the_mock_s_velocity_reaches_the_loop(sampling: str) -> None:
    scene = scene_of(
        2, stiffness=0.0, damping=0.0, damper="sensed", device={"sampling": sampling, "friction": 4.0, "mass": 0.2}
    )
    velocity = looped(scene, 21).record.io.velocity[:2]
    instant = 0.1 * np.exp(-20 * 0.020)
    mean = 0.1 * np.exp(-20 * 0.019) * -np.expm1(-20 * 0.001) / (20 * 0.001)
    np.testing.assert_allclose(velocity, instant if sampling == "ideal" else mean, atol=0.51e-6)


def test_the_mock_s_acceleration_reaches_the_loop() -> None:
    device = {**BOTH, "friction": 4.0, "mass": 0.2, "stiffness": 30.0, "acceleration_age": 1}
    io = looped(scene_of(2, stiffness=0.0, damping=0.0, device=device), 21).record.io
    expected = -(4.0 * io.velocity[:2] + 30.0 * io.measured[:2]) / 0.2
    np.testing.assert_allclose(io.acceleration[:2], expected, atol=2e-5)  # of velocities in steps of 1e-6 m/s
    assert abs(expected).min() > 1.0


def test_a_host_that_died_while_velocities_were_sent_does_not_lock_the_next_one_out() -> None:
    with served(scene_of(2, damper="sensed")) as (scene, mock):
        with open_connection(scene) as connection:
            arm(connection, describe(connection), schema.LOCKSTEP, 100, schema.MOTION_BITS)
        assert mock.board.state == schema.ARMED
        assert run(scene, duration=0.05).report.ticks == 50
        assert mock.board.state == schema.IDLE
