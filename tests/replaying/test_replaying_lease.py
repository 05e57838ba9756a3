"""Leases that begin, run out, are renewed and end are in a record, which is replayed to the last bit."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from late_records import replayed
from test_replaying_command import SCENE

from hapsim.running import start
from hapsim.running.session_view import Event
from hapsim.scene import parse_scene
from tests.word_scenes import WORDS

RUN = parse_scene(
    SCENE.replace("velocity: 0.1}", "velocity: 0.1}, hand: {stiffness: 20, position: 0.01}, noise: 1.0e-6")
)
SOFTER = parse_scene(SCENE.replace("2000, damping: 5", "300, damping: 3"))
FOREVER_S = 3600.0


def wait_until(is_so: Any) -> None:
    end = time.monotonic() + 20.0
    while not is_so():
        assert time.monotonic() < end
        time.sleep(1e-4)


def test_a_whole_run_with_leases(tmp_path: Path) -> None:
    events: list[Event] = []
    record = tmp_path / "a.trace"
    with start(RUN, record=record, on_event=events.append) as session:
        lease = session._live.lease
        session.lease(0.05)
        wait_until(lambda: lease.weight == 1.0)
        session.renew()
        session.lease(0.01)
        wait_until(lambda: lease.is_out)
        session.lease(None)
        session.lease(0.02, SOFTER)
        wait_until(lambda: lease.weight == 1.0)
    found, comparison = replayed(record)
    assert comparison.difference is None
    asked = [note["lease"] for note in found.notes if "lease" in note]
    assert asked == [0.05, 0.05, 0.01, None, 0.02]
    ended = [note["lease_ran_out"] for note in found.notes if "lease_ran_out" in note]
    assert [event.sample for event in events if event.kind == "lease" and event.values["out"]] == ended
    assert len(ended) >= 3
    ticks = [note["tick"] for note in found.notes if "lease" in note]
    assert ended[0] == ticks[0] + 50, "by the numbers of the positions, from the request's on"


def test_a_mock_in_real_time(tmp_path: Path) -> None:
    record = tmp_path / "a.trace"  # its scene is in lockstep, but its leases count nanoseconds
    with start(RUN, record=record, transport="paced") as session:
        session.lease(0.02)
        wait_until(lambda: session._live.lease.weight == 1.0)
        session.renew()
    found, comparison = replayed(record)
    assert comparison.difference is None
    samples = np.concatenate(list(found.rows()))
    asked, ended = (next(note for note in found.notes if key in note) for key in ("lease", "lease_ran_out"))
    begun, out = (samples["time_ns"][samples["sample"] == note["sample"]][0] for note in (asked, ended))
    assert out - begun >= 20_000_000


def test_a_record_that_begins_in_a_lease_of_a_scene_with_inputs(tmp_path: Path) -> None:
    """The mock and the motor name inputs."""
    with start(parse_scene(WORDS.replace("{clock", "{when: touch, clock"))) as session:
        session.lease(FOREVER_S)
        session.record(tmp_path / "a.trace")
    found, comparison = replayed(tmp_path / "a.trace")
    assert found.run.state is not None
    assert comparison.difference is None


def test_a_record_that_begins_while_the_fallback_takes_over(tmp_path: Path) -> None:
    for fallback, seconds in ((None, 0.02), (SOFTER, 0.02), (SOFTER, FOREVER_S)):
        record = tmp_path / f"{seconds}{fallback is None}.trace"
        with start(RUN) as session:
            lease = session._live.lease
            session.lease(seconds, fallback)
            if seconds < FOREVER_S:
                wait_until(lambda lease=lease: lease.is_out)
            session.record(record)
            session.lease(0.05)
            wait_until(lambda lease=lease: lease.is_out)
            wait_until(lambda lease=lease: lease.weight == 1.0)
            session.renew()
        found, comparison = replayed(record)
        assert found.run.state is not None
        assert found.run.state.lease is not None
        assert comparison.difference is None
        assert comparison.ticks > 50
