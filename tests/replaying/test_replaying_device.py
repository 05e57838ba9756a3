"""`hapsim replay --device`: a record is served as a device that sends what the recorded one sent."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_replaying_command import SCENE, recorded, rewrite, rows_of

import hapsim
from hapsim.device.mock.stand_ins import RecordedDevice
from hapsim.device.mock.terminal import serving
from hapsim.errors import DeviceError, RunError
from hapsim.loop.ring import BRIDGED
from hapsim.recording.stream import StreamReader
from hapsim.recording.trace import Trace, load_trace
from hapsim.replaying.replay import device_of
from hapsim.running import start
from hapsim.scene import Scene, parse_scene

Hapsim = Callable[..., Any]

SENSED = SCENE.replace("damping: 5}", "damping: 5, damper: sensed}").replace("limit: 10", "limit: 10, origin: 0.001")
WITH_INPUTS = SENSED.replace("modules:", "inputs: {touch: {bit: 0}, open: {bit: 31, inverted: true}}\nmodules:")
WITH_INPUTS = WITH_INPUTS.replace("mock: {", "mock: {inputs: {touch: [0.1, 0.2]}, ")


@contextmanager
def served(path: Path, scene: str, clock: str = "lockstep") -> Iterator[tuple[RecordedDevice, Scene]]:
    """The record's device, and a scene on its port."""
    device = device_of(path)
    with serving(device.assemble()) as port:
        yield device, parse_scene(scene.replace("clock: lockstep", f"clock: {clock}, port: {port}"))


@pytest.mark.parametrize("scene", [SCENE, SENSED, WITH_INPUTS], ids=["positions", "velocities", "inputs"])
def test_a_run_against_a_record_has_its_positions_and_forces(scene: str, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace", scene)
    with served(path, scene) as (device, on_port):
        hapsim.run(on_port, duration=0.3, record=tmp_path / "b.trace")
        assert device.forces >= 299
    before, after = rows_of(path), rows_of(tmp_path / "b.trace")
    for name in set(before.dtype.names or ()) - {"time_ns", "force_counts", "flags"}:
        assert np.array_equal(before[name], after[name]), name


@pytest.mark.parametrize("clock", ["device", "host"])
def test_in_real_time_every_position_is_the_one_of_its_sample(clock: str, tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace")
    before = load_trace(path).position_counts
    with served(path, SCENE, clock) as (device, on_port):
        trace = _run_beyond(50, on_port)
        assert device.forces > 0
    assert np.array_equal(trace.position_counts, before[trace.sample])


def test_behind_the_last_position_the_device_is_idle_and_begins_anew(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace")
    with served(path, SCENE) as (_, on_port):
        for _ in range(2):
            with pytest.raises(DeviceError, match="the device stopped after 300 ticks") as caught:
                hapsim.run(on_port, duration=1.0)
            trace = caught.value.trace
            assert trace is not None
            assert trace.report.released
            assert np.array_equal(trace.position_counts, load_trace(path).position_counts)


def test_a_position_that_was_lost_is_not_sent(tmp_path: Path) -> None:
    trace = load_trace(recorded(tmp_path / "a.trace"))
    device = device_of(tmp_path / "a.trace")
    kept = np.r_[0:20, 23:300]
    lossy = RecordedDevice(
        device.description, trace.sample[kept], trace.position_counts[kept].astype(np.int32), period_s=1e-3
    )
    with serving(lossy.assemble()) as port:
        heard = _run_beyond(22, parse_scene(SCENE.replace("clock: lockstep", f"clock: device, port: {port}")))
    assert not {20, 21, 22} & {*heard.sample.tolist()}
    assert heard.flags[heard.sample > 22][0] & BRIDGED
    assert np.array_equal(heard.position_counts, trace.position_counts[heard.sample])


def test_a_record_from_the_middle_of_a_run_begins_at_sample_0(tmp_path: Path) -> None:
    with start(parse_scene(SCENE)) as session:
        while session.state().sample < 50:
            pass
        session.record(tmp_path / "late.trace")
        at = session.state().sample
        while session.state().sample < at + 100:
            pass
    late = load_trace(tmp_path / "late.trace")
    with served(tmp_path / "late.trace", SCENE) as (_, on_port):
        trace = hapsim.run(on_port, duration=0.01)
    assert late.sample[0] > 0
    assert np.array_equal(trace.position_counts, late.position_counts[:10])


def test_a_device_that_paced_itself_keeps_its_own_rate(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.trace")
    trace = load_trace(path)
    slow = replace(trace, time_ns=trace.sample * 1_250_000, report=replace(trace.report, timed_by_device=True))
    slow.save(tmp_path / "b.trace")
    head = StreamReader(path).head.run
    rewrite(tmp_path / "b.trace", lambda document: document.update(run=head))
    assert device_of(tmp_path / "b.trace").period_s == pytest.approx(1.25e-3)
    assert device_of(path).period_s == 1e-3


def test_the_command_prints_its_port_and_counts_forces(
    hapsim: Hapsim, start_hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    path, scene = recorded(tmp_path / "a.trace"), tmp_path / "s.yaml"
    scene.write_text(SCENE, "utf-8")
    process = start_hapsim("replay", path, "--device", "--link", tmp_path / "device")
    give_up = time.monotonic() + 60.0
    while not process.out.endswith("\n"):
        assert time.monotonic() < give_up, process.err
        time.sleep(0.01)
    assert process.out == f"{tmp_path / 'device'}\n"
    assert hapsim("run", scene, "--port", tmp_path / "device", "--duration", 0.1).status == 0
    os.kill(process.pid, signal.SIGTERM)
    assert process.wait() == 0
    assert "100 forces taken since it was last armed" in process.err
    assert f"serving the record {path} as a device at {tmp_path / 'device'}" in process.err
    assert "serving the mock" not in process.err


def test_what_cannot_be_served_is_refused_with_the_reason(hapsim: Hapsim, tmp_path: Path) -> None:
    path, older = recorded(tmp_path / "a.trace"), tmp_path / "older.trace"
    older.write_bytes(path.read_bytes())
    rewrite(older, lambda head: (head.pop("run"), head.update(version=1)))
    for words, why in (
        ((older, "--device"), "recorded by an older hapsim, without its device"),
        ((path, "first_touch", "--device"), "--device can be combined with --link and --json only"),
        ((path, "--link", tmp_path / "l"), "--link needs --device"),
    ):
        answer = hapsim("replay", *words)
        assert answer.status == 2, words
        assert why in " ".join(answer.sentence.split()), words


def _run_beyond(sample: int, scene: Scene) -> Trace:
    """The trace of a run; a busy machine may end one before this sample."""
    for _ in range(20):
        with suppress(RunError), start(scene, duration=0.2) as session:
            session.wait()
        if session.trace.sample.size and session.trace.sample[-1] > sample:
            return session.trace
    raise AssertionError(f"20 runs, none of them beyond sample {sample}")
