"""Runs in virtual time over a wire with faults: the message to the user, and the bytes that reached the device."""

from __future__ import annotations

import contextlib
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from wire_session import injector_of, touched_scene

from hapsim.bringup.faults import Injector
from hapsim.bringup.faults.in_memory import in_memory
from hapsim.errors import DeviceError, GuardError, HapsimError
from hapsim.loop.endings import HUNG_UP, TIMED_OUT
from hapsim.recording.trace import Trace
from hapsim.running import Session, run, start
from hapsim.scene import Scene

TICKS, LIMIT = 200, 10.0
RELEASED = "the force is zero: the device confirmed that it released it"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return touched_scene(force_limit=LIMIT)


def through(scene: Scene, *faults: str) -> tuple[Trace, Injector]:
    injector = injector_of(*faults)
    return run(scene, duration=TICKS / scene.rate, between=in_memory(injector, scene.period)), injector


@pytest.fixture(scope="module")
def undisturbed(scene: Scene) -> Trace:
    return run(scene, duration=TICKS / scene.rate)


@pytest.mark.parametrize(
    "fault",
    [
        "kind: silence, after_samples: 1000000",
        "kind: duplicate, direction: from_device, probability: 0.3",
        "kind: garbage, bytes: 300, every_samples: 7, direction: both",
        "kind: delay, seconds: 0.0035, probability: 0.3",
        "kind: reorder, probability: 0.3, after_samples: 1, for_samples: 190",  # not ARM, nor the last force
    ],
)
def test_what_a_lockstep_run_can_bear_changes_no_force(scene: Scene, undisturbed: Trace, fault: str) -> None:
    trace, injector = through(scene, fault)
    assert trace.report.ending == "done"
    assert trace.report.released
    for name in ("sample", "position_counts", "force_counts"):
        np.testing.assert_array_equal(getattr(trace, name), getattr(undisturbed, name))
    ((_, count),) = injector.counts
    assert count > 0 or "1000000" in fault
    largest = np.abs(trace.force).max()
    assert injector.witness.all.largest == pytest.approx(largest, rel=1e-9)
    assert injector.witness.all.count == TICKS


# The fault, the error, and its message. No force may reach the device after the fault.
NOT_ARMED = "which is not a number above 0. Not armed; set the register in its firmware"
UNPLUGGED = (
    r"the device went away after 50 ticks \(unplugged.* did not confirm that it released .* 10 s after the last force"
)
ENDS = {
    "kind: leap, metres: 0.1, after_samples: 50": (
        GuardError,
        rf"the position of channel 0 leapt at tick 51: 0\.1 m away .* its force was not sent.*; {RELEASED}",
    ),
    "kind: unplug, after_samples: 50": (DeviceError, UNPLUGGED),
    "kind: version": (DeviceError, "the device uses version 2 of the protocol, this hapsim version 1"),
    "kind: nonsense, register: rate, what: nan": (
        DeviceError,
        rf"declares a rate of nan Hz \(register 4\), {NOT_ARMED}",
    ),
    "kind: nonsense, register: force_limit, what: negative": (
        DeviceError,
        rf"a force limit of channel 0 of -1 N \(register 36\), {NOT_ARMED}",
    ),
    "kind: nonsense, register: channels, what: huge": (DeviceError, "the device declares 2147483647 channels"),
    "kind: reboot, after_samples: 50": (DeviceError, rf"the device was silent for 200 ms after 50 ticks; {RELEASED}"),
}


def soon_impatient(session: Session) -> None:
    session._loop.control.silence_ns = 200_000_000  # in place of 5 s


@pytest.mark.parametrize("fault", ENDS)
def test_what_it_cannot_bear_ends_it_with_a_true_sentence_and_no_further_force(scene: Scene, fault: str) -> None:
    error, sentence = ENDS[fault]
    injector = injector_of(fault)
    with pytest.raises(HapsimError) as caught:
        run(scene, duration=1.0, between=in_memory(injector, scene.period), on_start=soon_impatient)
    assert isinstance(caught.value, error)
    assert re.search(sentence, str(caught.value)), caught.value
    witness = injector.witness
    assert witness.since_fault.count == 0
    assert witness.all.largest <= LIMIT
    release = witness.release()
    if "after_samples" in fault:
        assert release is not None
        assert release.by == ("lockstep" if "unplug" in fault else "device" if "reboot" in fault else "disarm")


class Silent:
    """A device that hears everything and says nothing."""

    def __init__(self) -> None:
        self.received: list[bytes] = []

    def receive(self, buffer: Any, timeout_ns: int) -> int:
        del buffer, timeout_ns
        return TIMED_OUT

    def send(self, frame: bytes) -> int:
        self.received.append(frame)
        return 0


def test_time_passes_while_the_host_waits_and_the_plug_is_pulled_meanwhile() -> None:
    device, buffer = Silent(), np.zeros(100, np.uint8)
    carrier = in_memory(injector_of("kind: unplug, at: 0.003"), 0.001)(device)
    assert carrier.receive(buffer, 10**7) == TIMED_OUT  # nothing passed yet: no time of the script's either
    assert carrier.send(b"\1\0") == 0
    assert device.received == [b"\1\0"]
    assert carrier.receive(buffer, 2 * 10**6) == TIMED_OUT
    assert carrier.receive(buffer, 2 * 10**6) == HUNG_UP
    assert carrier.send(b"\2\0") == HUNG_UP
    assert device.received == [b"\1\0"]


def test_what_is_held_up_comes_when_it_is_due_in_pieces_where_there_is_little_room() -> None:
    carrier = in_memory(injector_of("kind: garbage, bytes: 5, from: 0.002"), 0.001)(Silent())
    carrier.send(b"\0")
    room = np.zeros(3, np.uint8)
    assert carrier.receive(room, 10**6) == TIMED_OUT
    assert [carrier.receive(room, 10**7) for _ in range(3)] == [3, 2, TIMED_OUT]


def test_a_sign_that_is_wrong_stays_below_the_force_limit(scene: Scene) -> None:
    for direction in ("from_device", "to_device"):
        trace, injector = through(scene, f"kind: invert, direction: {direction}, after_samples: 50")
        assert injector.witness.since_fault.largest <= LIMIT
        assert trace.report.limited_ticks > 0


def test_the_velocity_behind_lost_positions_is_that_of_the_time_between() -> None:
    scene = touched_scene(force_limit=LIMIT)
    scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "device"})})
    for seed in range(20):
        injector = injector_of("kind: drop, direction: from_device, probability: 0.5, after_samples: 20", seed=seed)
        # A busy machine may have the device stop: what was measured until then is as good.
        between = in_memory(injector, scene.period)
        with contextlib.suppress(DeviceError), start(scene, duration=0.05, between=between) as session:
            session.wait()
            velocity = session.state().velocity
        trace = session.trace
        apart = trace.sample[-1] - trace.sample[-2]
        moved = (trace.position[-1] - trace.position[-2]) * scene.rate
        if apart > 1 and moved.any():
            break
    assert apart > 1
    np.testing.assert_allclose(velocity, moved / apart)
