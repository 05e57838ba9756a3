"""The mock's force sensor, with its faults, and what the mock refuses in admittance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import SETUP, frame_to_device
from hapsim.device.mock.assemble_mock import assemble_mock, describe_mock
from hapsim.device.mock.firmware import prepare, take_bytes
from hapsim.running import run
from hapsim.scene import Scene
from tests.admittance_scenes import scene_of, written_out

SLUGGISH = {"simulated_mass": 1e6, "simulated_damping": 0.0}  # stays where it is, whatever pushes


def sensed(sensor: dict[str, Any], hand: dict[str, Any] | None = None) -> np.ndarray[Any, Any]:
    """Returns the force that the sensor shows in 20 samples of a hand that pulls with 2 N."""
    scene = scene_of(device=SLUGGISH, hand=hand, mock={"force_sensor": sensor})
    return run(scene, duration=0.02, unstable=True).sensed["hand_force"][:, 0]


@pytest.mark.parametrize(
    ("sensor", "shown"),
    [
        ({}, -2.0),
        ({"offset": 0.5}, -1.5),
        ({"drift": 100.0}, -2.0 + 0.1 * np.arange(20)),
        ({"limit": 1.5}, -1.5),
        ({"quantum": 0.3}, -2.1),
        ({"fault": "inverted"}, 2.0),
        ({"fault": "inverted", "fault_time": 0.005}, np.where(np.arange(20) < 5, -2.0, 2.0)),
    ],
)
def test_the_sensor_shows_the_force_as_its_faults_let_it(sensor: dict[str, Any], shown: Any) -> None:
    np.testing.assert_allclose(sensed(sensor), np.broadcast_to(shown, 20), atol=1e-6)


def test_a_dead_sensor_keeps_its_count() -> None:
    """The mass moves on with the force that was shown last, and the hand is stretched more and more."""
    scene = scene_of(mock={"force_sensor": {"fault": "dead", "fault_time": 0.01}})
    trace = run(scene, duration=0.05, unstable=True)
    force = trace.sensed["hand_force"][:, 0]
    assert np.unique(force[9:]).size == 1
    assert np.unique(force[:10]).size > 5
    expected = written_out(scene, trace.sample.size)["hand_force"]
    np.testing.assert_allclose(force[:10], expected[:10], atol=1e-5)
    assert abs(force[-1] - expected[-1]) > 0.1


def test_noise_is_the_same_in_each_run_of_a_seed() -> None:
    first, again = (sensed({"noise": 0.1}) for _ in range(2))
    assert np.array_equal(first, again)
    assert 0.05 < np.std(first) < 0.2


@pytest.mark.parametrize(
    ("argument", "fault"),
    [
        (schema.LOCKSTEP | schema.ADMITTANCE, schema.NO_FAULT),
        (schema.PACED_BY_DEVICE | schema.ADMITTANCE | schema.WITH_VELOCITY, schema.NO_FAULT),
        (schema.LOCKSTEP, schema.NO_FAULT),
        (schema.PACED_BY_HOST | schema.ADMITTANCE, schema.WRONG_PACING),
        (schema.LOCKSTEP | schema.WITH_FORCE, schema.WRONG_SENSING),
        (schema.LOCKSTEP | schema.ADMITTANCE | schema.WITH_LINE, schema.WRONG_SENSING),
        (schema.LOCKSTEP | schema.ADMITTANCE | schema.WITH_WORDS, schema.WRONG_SENSING),
    ],
)
def test_it_is_armed_with_what_it_has(argument: int, fault: int) -> None:
    assert _fault_of(scene_of(), argument) == fault


def test_a_mock_in_impedance_takes_no_commands() -> None:
    scene = Scene.model_validate(
        {
            "version": 1,
            "rate": 1000.0,
            "device": {"mass": 0.2, "clock": "lockstep"},
            "modules": {"hand": {"type": "device", "channel": 0}},
        }
    )
    assert describe_mock(scene).servo is None
    assert _fault_of(scene, schema.LOCKSTEP | schema.ADMITTANCE) == schema.WRONG_SENSING


def _fault_of(scene: Scene, argument: int) -> int:
    """Returns the fault in the STATUS that answers ARM."""
    mock = assemble_mock(scene)
    prepare(mock)
    arm = frame_to_device(
        SETUP, schema.ARM, 100, argument, [np.array(schema.SCHEMA_HASH).astype(np.uint32).view(np.int32)]
    )
    take_bytes(mock, np.frombuffer(arm, np.uint8).copy(), len(arm), 0)
    status = next(iter(frames_in(new_decoder(SETUP, to_device=False), mock.outbox[: mock.board.out].tobytes())))
    assert status.type == schema.STATUS
    return int(status.counts[0]) >> 8
