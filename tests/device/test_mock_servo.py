"""The mock's servo while its host is silent: it goes on, brakes, and rests within the way that PROTOCOL.md states."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder, use_format
from firmware_protocol.frames import SETUP, armed_format, frame_to_device
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.firmware import check_watchdog, prepare, take_bytes, take_sample
from hapsim.device.mock.stand_ins import LiveHand
from tests.admittance_scenes import scene_of

STEP, LIVES, WATCHDOG = 400_000, 20, 100  # counts of 1e-9 m in a sample: 0.4 m/s; samples
WIRE = armed_format(1, schema.ADMITTANCE)
COUNT = 1e-9


class Served:
    """A mock, armed, whose samples a test takes by itself."""

    def __init__(self, **keys: Any) -> None:
        self.mock = assemble_mock(scene_of(mock={"initial": {"position": 0.0}}, hand={"stiffness": 0.0}, **keys))
        prepare(self.mock)
        self._decoder = new_decoder(SETUP, to_device=False)
        check = int(np.array(schema.SCHEMA_HASH).astype(np.uint32).view(np.int32))
        self.send(frame_to_device(SETUP, schema.ARM, WATCHDOG, schema.PACED_BY_DEVICE | schema.ADMITTANCE, [check]))
        (status,) = self.frames(1)
        assert status.type == schema.STATUS
        use_format(self._decoder, WIRE)

    def send(self, data: bytes) -> None:
        take_bytes(self.mock, np.frombuffer(data, np.uint8).copy(), len(data), 0)

    def frames(self, most: int = 1000) -> list[Any]:
        """Returns the frames that it has sent since the last call, at most `most`."""
        found, size = [], int(self.mock.board.out)
        for at, byte in enumerate(self.mock.outbox[:size].tobytes()):
            found += frames_in(self._decoder, bytes([byte]))
            if len(found) == most:
                size = at + 1
                break
        self.mock.outbox[: self.mock.board.out - size] = self.mock.outbox[size : self.mock.board.out].copy()
        self.mock.board.out -= size
        return found

    def command(self, number: int, counts: int) -> None:
        self.send(frame_to_device(WIRE, schema.FORCE, number, LIVES, [0, counts]))

    def sample(self) -> int:
        """Ends a sample; returns the position in counts."""
        take_sample(self.mock, 0)
        return int(self.frames()[-1].counts[0])


def moved(served: Served, samples: int, silent: int) -> np.ndarray[Any, Any]:
    """Returns the positions (m) of a device that a host leads at 0.4 m/s and then leaves alone."""
    places = []
    for n in range(samples):
        served.command(n, STEP * (n + 1))
        places.append(served.sample())
    places += [served.sample() for _ in range(silent)]
    return np.array(places) * COUNT


def test_in_straight_lines_it_goes_on_while_the_last_command_lives_and_then_brakes() -> None:
    """At 0.4 m/s and 40 m/s² it rests after 10 ms and 2 mm."""
    served = Served(device={"acceleration_limit": 40.0, "speed_limit": 0.5})
    places = moved(served, 30, 60)
    steps = np.diff(places)[10:]
    alive = 30 + LIVES + 1 - 11  # of the steps: to the last sample whose command is alive, and the delay of one
    np.testing.assert_allclose(steps[: alive - 1], STEP * COUNT, rtol=1e-9)
    np.testing.assert_allclose(np.diff(steps[alive - 1 : alive + 9]), -40e-6, rtol=1e-6)
    np.testing.assert_array_equal(steps[alive + 11 :], 0.0)


@pytest.mark.parametrize("servo", [None, {"bandwidth": 60.0}], ids=["straight", "servo"])
def test_its_way_to_rest_is_within_the_bound(servo: dict[str, float] | None) -> None:
    """v²/2a + v (t + 1) T after its last command, with the time to live as t, and a servo's own delay besides."""
    device: dict[str, Any] = {"acceleration_limit": 20.0, "speed_limit": 0.5}
    served = Served(device=device | ({} if servo is None else {"servo": servo}))
    places = moved(served, 200, 120)
    way = places[-1] - STEP * 200 * COUNT
    bound = 0.4**2 / (2.0 * 20.0) + 0.4 * (LIVES + 1) * 1e-3
    assert bound - 2.0 * 0.4e-3 < way <= bound
    assert np.ptp(places[-5:]) < 1e-6


def test_it_latches_when_the_watchdog_expires_and_moves_no_more() -> None:
    served = Served()
    moved(served, 5, WATCHDOG - 1)
    check_watchdog(served.mock, 0)
    assert served.mock.board.state == schema.ARMED
    served.sample()
    served.sample()
    check_watchdog(served.mock, 0)
    assert (served.mock.board.state, served.mock.board.fault) == (schema.LATCHED, schema.HOST_QUIET)


def test_a_command_beyond_the_speed_limit_is_shortened_and_counted() -> None:
    served = Served(device={"speed_limit": 0.5, "delay": 0.0})
    served.command(0, 2_000_000)
    assert served.sample() == 500_001
    assert served.mock.registers[schema.REG_LIMITED] == 1
    served.command(1, 1_000_000)
    assert served.sample() == 1_000_000
    assert served.mock.registers[schema.REG_LIMITED] == 1


def test_a_late_command_acts_and_an_expired_one_does_not() -> None:
    served = Served(device={"delay": 0.0})
    for _ in range(LIVES + 1):
        served.sample()
    served.command(1, 300)
    assert served.sample() == 300
    served.command(1, 900)
    assert served.sample() == 300, "the one before has expired, too: it rests"
    assert served.mock.registers[schema.REG_EXPIRED] == 1


def test_a_hand_that_is_moved_meanwhile_is_sensed() -> None:
    served = Served()
    hand = LiveHand(served.mock, scene_of(hand={"stiffness": 0.0}))
    hand.retarget(scene_of(hand={"stiffness": 0.0, "force": 1.5}), 4)
    shown = []
    take = ctypes.CFUNCTYPE(None, ctypes.c_uint64, ctypes.c_int64)(int(served.mock.called.take_sample))
    for _ in range(8):
        take(int(served.mock.address), 0)
        shown.append(served.frames()[-1].counts[1] * served.mock.force_sensors[0].quantum)
    assert 0.0 < shown[0] < shown[2] < 1.5
    assert shown[-1] == pytest.approx(1.5, rel=1e-6)
