"""Sensed velocities and accelerations are in a record, in its replay, in its export, and in a device made of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from test_replaying_command import SCENE, recorded, rewrite, rows_of
from test_replaying_device import served

import hapsim
from hapsim.recording.trace import load_trace
from hapsim.replaying.replay import Record, Replay

Hapsim = Callable[..., Any]

ACCELERATION = SCENE.replace("limit: 10", "limit: 10, sensors: [acceleration]")
BOTH = SCENE.replace("limit: 10", "limit: 10, sensors: [velocity, acceleration]")

CORRECTED = BOTH.replace("limit: 10", "limit: 10, correction: sensed")


@pytest.mark.parametrize("scene", [ACCELERATION, BOTH, CORRECTED], ids=["acceleration", "both", "correction"])
def test_a_record_has_the_acceleration_of_the_motion_and_a_replay_too(scene: str, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", scene)
    trace = load_trace(path)
    assert trace.sensed.keys() == ({"acceleration"} if scene == ACCELERATION else {"velocity", "acceleration"})
    # The force that answers sample n - 1 acts from sample n on; the device's friction is 1 N·s/m, its mass 0.2 kg.
    velocity = np.gradient(trace.position[:, 0]) * trace.rate
    expected = (trace.force[:-1, 0] - 1.0 * velocity[1:]) / 0.2
    assert np.allclose(trace.sensed["acceleration"][1:, 0], expected, atol=0.01 * np.ptp(expected))
    assert np.ptp(expected) > 1.0
    assert [len(one) for one in trace.since(100).sensed.values()] == [200] * len(trace.sensed)
    for before, after in Replay(Record(path)).pieces():
        for name in set(before.dtype.names or ()) - {"time_ns"}:
            assert np.array_equal(before[name], after[name]), name


def test_an_export_has_sensed_accelerations_with_their_unit(hapsim: Hapsim, tmp_path: Path) -> None:
    turning = BOTH.replace("limit: 10", "limit: 10, motion: rotary")
    path = recorded(tmp_path / "a.trace", turning)
    assert hapsim("export", path, tmp_path / "a.h5").status == 0
    with h5py.File(tmp_path / "a.h5") as file:
        for name, unit in (("velocity", "rad/s"), ("acceleration", "rad/s²")):
            column = file[f"sensed_{name}"]
            assert column.attrs["units"] == unit
            assert np.array_equal(column, load_trace(path).sensed[name])
    path = recorded(tmp_path / "b.trace", SCENE)
    assert hapsim("export", path, tmp_path / "b.h5").status == 0
    with h5py.File(tmp_path / "b.h5") as file:
        assert not [name for name in file if name.startswith("sensed_")]


@pytest.mark.parametrize("wanted", [ACCELERATION, BOTH, SCENE], ids=["acceleration", "both", "neither"])
def test_a_device_made_of_a_record_sends_what_a_host_requests(wanted: str, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", BOTH)
    with served(path, wanted) as (device, on_port):
        assert device.description.sensed == ("velocity", "acceleration")
        hapsim.run(on_port, duration=0.3, record=tmp_path / "b.trace")
    before, after = rows_of(path), rows_of(tmp_path / "b.trace")
    for name in set(after.dtype.names or ()) - {"time_ns", "force_counts", "flags"}:
        assert np.array_equal(before[name], after[name]), name


def test_a_record_without_accelerations_replays_no_scene_that_needs_them(hapsim: Hapsim, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", SCENE)
    assert "acceleration_counts" not in rows_of(path).dtype.names
    rewrite(path, lambda head: head["run"]["scene"]["device"].update(sensors=["acceleration"]))
    answer = hapsim("replay", path)
    assert answer.status == 2
    assert "acceleration in device.sensors, expected none: the record has no sensed accelerations" in answer.err


def test_a_record_of_an_older_hapsim_is_read_as_before(hapsim: Hapsim, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", SCENE.replace("damping: 5}", "damping: 5, damper: sensed}"))
    rewrite(path, lambda head: (head.pop("acceleration"), head.update(version=2)))
    assert load_trace(path).sensed.keys() == {"velocity"}
    assert "identical, to the last bit" in hapsim("replay", path).out
