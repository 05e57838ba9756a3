"""A run in admittance: its record has sensed forces and commands, comes out of a replay to the bit, and is exported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from late_records import record_late, replayed
from test_replaying_command import recorded, rows_of
from test_replaying_device import served

import hapsim
from hapsim.loop.ring import COMMAND
from hapsim.recording.trace import load_trace
from hapsim.replaying.replay import Record, Replay, compare, first_difference

Hapsim = Callable[..., Any]

SCENE = """
version: 1
rate: 1000
device: {clock: lockstep, mode: admittance, simulated_mass: 0.2, simulated_damping: 5,
  assumed_hand: {stiffness: 2000}, origin: 0.0002}
mock: {initial: {position: 0.001}, hand: {stiffness: 2000}, force_sensor: {noise: 0.01}}
modules:
  hand: {type: device, channel: 0}
  ball: {type: mass, mass: 0.05}
  tie: {type: viscoelastic, between: [hand, ball], stiffness: 300, damping: 0.5}
"""


def test_a_record_has_forces_and_commands_and_a_replay_too(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", SCENE)
    trace = load_trace(path)
    assert trace.sensed.keys() == {"hand_force"}
    assert trace.command.shape == trace.position.shape == (300, 1)
    np.testing.assert_allclose(trace.command[:-2, 0], trace.position[2:, 0], atol=1e-12, rtol=0)
    held = -2000.0 * (trace.position[:, 0] + 0.0002)
    np.testing.assert_allclose(trace.sensed["hand_force"][:, 0], held, atol=0.06)
    assert np.std(trace.sensed["hand_force"][:, 0] - held) > 0.005
    assert trace.since(100).command.shape == (200, 1)
    assert compare(Record(path), None, None, False).difference is None
    for before, after in Replay(Record(path)).pieces():
        for name in set(before.dtype.names or ()) - {"time_ns"}:
            assert np.array_equal(before[name], after[name]), name


def test_a_record_that_begins_during_the_run_begins_with_the_mass_as_it_is(tmp_path: Path) -> None:
    record_late(hapsim.parse_scene(SCENE), tmp_path / "late.trace", 7, seconds=0.03)
    record, found = replayed(tmp_path / "late.trace")
    assert record.run.first_tick > 0
    assert found.difference is None


def test_another_command_is_a_difference(tmp_path: Path) -> None:
    rows = rows_of(recorded(tmp_path / "a.trace", SCENE))
    other = rows.copy()
    other[COMMAND][7] += 1
    difference = first_difference(rows, other, 0)
    assert difference is not None
    assert (difference.tick, difference.what.split(":")[0]) == (7, COMMAND)


def test_an_export_has_both_with_their_unit(hapsim: Hapsim, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", SCENE)
    assert hapsim("export", path, tmp_path / "a.h5").status == 0
    trace = load_trace(path)
    with h5py.File(tmp_path / "a.h5") as file:
        for name, unit, values in (
            ("sensed_hand_force", "N", trace.sensed["hand_force"]),
            ("command", "m", trace.command),
        ):
            assert file[name].attrs["units"] == unit
            np.testing.assert_allclose(file[name], values, rtol=1e-15)


def test_a_device_made_of_a_record_sends_its_forces(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", SCENE)
    with served(path, SCENE) as (device, on_port):
        assert device.description.parts == ("hand_force", "command")
        hapsim.run(on_port, duration=0.3, record=tmp_path / "b.trace", unstable=True)
    before, after = rows_of(path), rows_of(tmp_path / "b.trace")
    for name in ("position_counts", "hand_force_counts", COMMAND):
        assert np.array_equal(before[name], after[name]), name
