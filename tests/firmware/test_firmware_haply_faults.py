"""A bridge whose board, wire, host or own process fails while it pushes: zero torque wherever it can be reached, and a
sentence. The mock board keeps its last torque for ever, as Haply's does, and logs each one with the machine's clock."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bridged import Bridged, Pushing

from firmware_protocol import schema
from tests import thorough

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bridges stand on pseudo-terminals of Linux")

Start = Callable[..., Bridged]
KILLS = thorough.points(2, 4)  # a thousand take a quarter of an hour
WHEN = 400  # the frame of torques at which the board fails

FAULTS = {
    "drop": "an answer that is none",
    "twice": "an answer that is none",
    "nan": "an answer that is none",
    "eat": "no answer in time",
    "mute": "no answer in time",
    "jump": "jumped from",
    "forget": "the board lost its set-up",
    "unplug": "the port hung up",
}
ENDS = {"jump", "forget", "unplug"}  # the angles, or the board, are gone
LASTS = {"mute"}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_board_or_its_wire_ends_in_zero_torque(fault: str, start_bridged: Start) -> None:
    bridged = start_bridged(f"{fault}={WHEN}")
    host = Pushing(bridged.port)
    host.session.patience_s = 30.0
    assert not host.run(4 * WHEN)
    assert host.session.ended is not None
    assert (host.session.ended.state, host.session.ended.fault) == (schema.LATCHED, schema.HARDWARE)
    pushed = bridged.torques()
    assert any(abs(one) > 1e-3 for _, one, _ in pushed)
    if fault != "unplug":
        bridged.wait_until(bridged.is_released)
    if fault in ENDS:
        assert bridged.bridge.wait(60) == 3
    host.close()
    if fault not in ENDS | LASTS:  # in step again
        again = Pushing(bridged.port)
        assert again.run(20)
        again.close()
    said = bridged.said.read_text("utf-8")
    assert said.count(FAULTS[fault]) == 1, said


def test_a_silent_host_leaves_no_torque(start_bridged: Start) -> None:
    bridged = start_bridged()
    host = Pushing(bridged.port)
    assert host.run(50)
    bridged.wait_until(bridged.is_released)
    host.close()


def test_more_force_than_the_motors_give_is_scaled_and_counted(start_bridged: Start) -> None:
    bridged = start_bridged("mass=10")
    host = Pushing(bridged.port, (400_000_000, -300_000_000))
    assert host.run(50)
    assert host.session.disarm() is not None
    bridged.wait_until(lambda: "forces needed more than the motors' 0.123 N m" in bridged.said.read_text("utf-8"))
    largest = max(max(abs(one), abs(two)) for _, one, two in bridged.torques())
    assert largest == pytest.approx(0.123, rel=1e-6)
    host.close()


def guard_of(bridged: Bridged) -> int:
    return int(Path(f"/proc/{bridged.bridge.pid}/task/{bridged.bridge.pid}/children").read_text().split()[0])


@pytest.mark.parametrize(
    ("number", "status", "words"),
    [
        (signal.SIGTERM, 0, ""),
        (signal.SIGINT, 0, ""),
        (signal.SIGSTOP, -signal.SIGKILL, "the bridge did not tick"),
        (None, 3, "the guard of this bridge ended"),
    ],
)
def test_every_end_of_the_bridge_leaves_no_torque(
    number: int | None, status: int, words: str, start_bridged: Start
) -> None:
    """None: its guard is killed."""
    bridged = start_bridged()
    host = Pushing(bridged.port)
    assert host.run(50)
    os.kill(*(bridged.bridge.pid, number) if number is not None else (guard_of(bridged), signal.SIGKILL))
    assert bridged.bridge.wait(60) == status
    bridged.wait_until(bridged.is_released)
    assert words in bridged.said.read_text("utf-8")
    host.close()


def test_a_bridge_that_is_killed_at_any_moment_leaves_no_torque(start_bridged: Start, figures: Any) -> None:
    rng = np.random.default_rng()
    for _ in range(KILLS):
        bridged = start_bridged()
        host = Pushing(bridged.port)
        assert host.run(int(rng.integers(1, 60)))
        host.push(host.session.samples[-1])
        time.sleep(float(rng.uniform(0.0, 2e-3)))  # of an exchange, which takes a fraction of that
        at = time.monotonic_ns()
        bridged.bridge.kill()
        bridged.wait_until(bridged.is_released)
        torques = bridged.torques()
        last = max(n for n, (_, one, two) in enumerate(torques) if abs(one) + abs(two) > 1e-30)
        figures.most("ms from the end of a bridge to zero torque", max(torques[last + 1][0] - at, 0) * 1e-6)
        bridged.stop()
        host.close()
