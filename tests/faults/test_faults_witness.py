"""Forces that reached the device, the steps between them, and the end of the last one."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from wire_session import ARMED, described, force, injector_of, position, positions_through

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, armed_format, frame_to_device, frame_to_host
from hapsim.bringup.faults import Injector

DISARM = frame_to_device(ARMED, schema.DISARM, 0, 0, [0])


def armed(*faults: str, pacing: int = schema.PACED_BY_DEVICE) -> Injector:
    injector = injector_of(*faults)
    injector.take(described(), False, 0.0)
    arm = frame_to_device(SETUP, schema.ARM, 200, pacing, [schema.SCHEMA_HASH - (schema.SCHEMA_HASH >> 31 << 32)])
    injector.take(arm, True, 0.0)
    injector.take(frame_to_host(SETUP, schema.STATUS, 0, [schema.ARMED]), False, 0.0)
    return injector


def test_forces_and_their_steps_are_printed_in_newtons_before_and_since_the_first_fault() -> None:
    injector = armed("kind: silence, after_samples: 4")
    for number, counts in enumerate((1000, 3000, -500, 200, 250)):  # mN
        injector.take(position(number), False, number * 0.001)
        injector.take(force(number, counts), True, number * 0.001)
    witness = injector.witness
    assert (witness.all.count, witness.all.largest, witness.all.largest_change) == (5, 3.0, 3.5)
    since = witness.since_fault
    assert (since.count, since.largest) == (1, 0.25)
    assert since.largest_change == pytest.approx(0.05)


def test_position_commands_are_no_forces() -> None:
    injector, wire = (
        armed("kind: drop, after_samples: 99", pacing=schema.ADMITTANCE),
        armed_format(1, schema.ADMITTANCE),
    )
    injector.take(frame_to_host(wire, schema.POSITION, 0, [5, 6]), False, 0.0)
    injector.take(frame_to_device(wire, schema.FORCE, 0, 20, [0, 123456]), True, 0.0)
    assert (injector.witness.all.count, injector.witness.all.largest) == (1, 0.0)


def test_a_step_is_counted_from_what_the_device_holds() -> None:
    """Zero at arming, and once the force before has no more time to live; a force that is too old changes nothing."""
    injector = armed("kind: drop, after_samples: 99")
    witness = injector.witness
    injector.take(position(0), False, 0.0)
    injector.take(force(0, 3000, lives=5), True, 0.0)
    assert witness.all.largest_change == 3.0
    for number in range(1, 7):
        injector.take(position(number), False, number * 0.001)
    injector.take(force(0, -9000, lives=5), True, 0.006)
    assert (witness.all.count, witness.all.largest, witness.all.largest_change) == (2, 3.0, 3.0)
    injector.take(force(6, -1000, lives=5), True, 0.006)
    assert witness.all.largest_change == 4.0
    for number in range(7, 14):
        injector.take(position(number), False, number * 0.001)
    injector.take(force(13, 3500, lives=5), True, 0.013)
    assert witness.all.largest_change == 4.0


def test_of_several_forces_within_a_sample_the_last_is_put_out() -> None:
    """Each is set against what the device holds meanwhile; where the host paces, each makes a sample."""
    for pacing, step in ((schema.PACED_BY_DEVICE, 5.0), (schema.PACED_BY_HOST, 10.0)):
        injector = armed("kind: drop, after_samples: 99", pacing=pacing)
        for number in range(3):
            injector.take(position(number), False, number * 0.001)
        for counts in (1000, 5000, -5000, 4000):
            injector.take(force(2, counts), True, 0.002)
        assert injector.witness.all.largest_change == step


def test_a_device_that_is_armed_already_ignores_another_arm() -> None:
    injector = armed("kind: drop, after_samples: 99")
    injector.take(position(0), False, 0.0)
    injector.take(force(0, 3000), True, 0.0)
    arm = frame_to_device(SETUP, schema.ARM, 200, 0, [schema.SCHEMA_HASH - (schema.SCHEMA_HASH >> 31 << 32)])
    injector.take(arm, True, 0.0)
    injector.take(position(1), False, 0.001)
    injector.take(force(1, -3000), True, 0.001)
    assert injector.witness.all.largest_change == 6.0


@pytest.mark.parametrize(("after_s", "step"), [(0.0059, 6.0), (0.0061, 3.0)])
def test_where_the_host_paces_time_decides_whether_the_force_is_over(after_s: float, step: float) -> None:
    injector = armed("kind: drop, after_samples: 99", pacing=schema.PACED_BY_HOST)
    injector.take(position(0), False, 0.0)
    injector.take(force(0, 3000, lives=5), True, 0.0)
    injector.take(position(1), False, 0.0)
    injector.take(force(1, -3000, lives=5), True, after_s)
    assert injector.witness.all.largest_change == step


def test_what_the_faults_keep_back_did_not_reach_the_device_and_without_a_scale_a_force_is_no_number() -> None:
    injector = armed("kind: drop, direction: to_device")
    injector.take(force(0, 5000), True, 0.0)
    assert injector.witness.all.count == 0
    assert injector.witness.release() is None
    injector = injector_of("kind: drop, after_samples: 9")
    injector.take(force(0, 5), True, 0.0)
    assert math.isnan(injector.witness.all.largest)


def test_the_last_force_ends_with_the_disarm() -> None:
    injector = armed("kind: leap, counts: 5, after_samples: 3")
    positions_through(injector, 3)
    injector.take(force(2, 5), True, 0.0025)
    injector.take(position(3), False, 0.003)
    injector.take(DISARM, True, 0.0035)
    release = injector.witness.release()
    assert release is not None
    assert (release.by, release.after_last_force_samples, release.confirmed) == ("disarm", 1, False)
    assert release.after_last_force_s == pytest.approx(0.001)
    assert release.after_first_fault_s == pytest.approx(0.0005)


def test_or_with_its_time_to_live_or_with_the_device_that_reports_it_first() -> None:
    injector = armed("kind: drop, direction: from_device")
    injector.take(force(2, 5, lives=20), True, 0.0025)
    release = injector.witness.release()
    assert release is not None
    assert (release.by, release.after_last_force_samples) == ("time to live", None)
    assert release.after_last_force_s == pytest.approx(0.022)
    injector.take(frame_to_host(ARMED, schema.STATUS, 3, [schema.LATCHED | schema.HOST_QUIET << 8]), False, 0.0045)
    release = injector.witness.release()
    assert release is not None
    assert (release.by, release.confirmed) == ("device", True)
    assert release.after_last_force_s == pytest.approx(0.002)


def test_a_device_may_confirm_later_what_was_over_before_and_in_lockstep_no_time_to_live_passes() -> None:
    injector = armed("kind: drop, direction: from_device")
    injector.take(force(2, 5, lives=20), True, 0.0025)
    injector.take(DISARM, True, 0.1)
    injector.take(frame_to_host(SETUP, schema.STATUS, 3, [schema.IDLE]), False, 0.101)
    release = injector.witness.release()
    assert release is not None
    assert (release.by, release.confirmed) == ("time to live", True)
    injector = armed("kind: drop, direction: from_device", pacing=schema.LOCKSTEP)
    injector.take(force(0, 5), True, 0.0)
    release = injector.witness.release()
    assert release is not None
    assert (release.by, release.after_last_force_s) == ("lockstep", 10.0)


def test_what_is_held_up_reaches_the_device_when_it_does_and_is_no_force_once_that_is_not_armed() -> None:
    injector = armed("kind: delay, seconds: 0.4, direction: to_device, after_samples: 1, for_samples: 1")
    for number in range(3):
        injector.take(position(number), False, number * 0.001)
        injector.take(force(number, 5000 * (number > 0)), True, number * 0.001 + 1e-4)
    assert injector.witness.all.largest == 0.0
    injector.advance(0.2)
    injector.take(frame_to_host(ARMED, schema.STATUS, 102, [schema.LATCHED | schema.HOST_QUIET << 8]), False, 0.102)
    injector.advance(1.0)
    assert (injector.witness.all.count, injector.witness.all.largest) == (1, 0.0)
    release = injector.witness.release()
    assert release is not None
    assert (release.by, release.confirmed) == ("time to live", True)
