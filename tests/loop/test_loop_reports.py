"""The report file of a run that a guard or its device ended: what was on the wire, and what the loop made of it."""

from __future__ import annotations

import os
import random
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop_rig import frame, scene_of, scripted, served

from firmware_protocol import schema
from firmware_protocol.capture import Capture, Decoded
from firmware_protocol.compiled import new_record
from firmware_protocol.decoder import Frame
from hapsim.errors import DeviceError, RunError
from hapsim.loop.buffers import AT_ONCE, KEPT, LAST_BYTES, last_bytes, next_place
from hapsim.recording import report_file
from hapsim.recording.report_file import FRAMES, last_frames, read_report
from hapsim.recording.trace import load_trace
from hapsim.running import Session, run, start
from hapsim.scene import Scene, load_scene


def leaving(ticks: int, channels: int = 1, **parts: Any) -> Scene:
    """A scene whose hand leaves the range of its counts after so many ticks, drawn by a force that changes with each:
    the device stops the run. Nothing slows it down."""
    quantum = 0.1 * ticks * 1e-3 / 2.0**31
    device = {"friction": 0.0, "mass": 1000.0} | parts
    return scene_of(
        channels, stiffness=1.0, damping=0.0, device=device, mock={"quantum": quantum, "initial": {"velocity": 0.1}}
    )


def stopped(scene: Scene, reports: Path, **options: Any) -> RunError:
    with pytest.raises(RunError) as caught:
        run(scene, duration=100.0, reports=reports, **options)
    return caught.value


def the_one_in(directory: Path) -> Path:
    (path,) = directory.iterdir()
    return path


def frames_of(data: bytes, from_host: bool) -> list[Frame]:
    """All of it is frames."""
    found = list(Capture((from_host,)).feed(data))
    assert all(isinstance(one, Decoded) for one in found)
    return [one.frame for one in found if isinstance(one, Decoded)]


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize(("ticks", "channels"), [(40, 2), (1600, 1)])
def test_the_last_frames_are_those_of_the_last_ticks(tmp_path: Path, ticks: int, channels: int, portable: bool) -> None:
    """A report of few ticks includes the arming; in one of many, the buffers have wrapped around."""
    failure = stopped(leaving(ticks, channels), tmp_path, transport="terminal", portable=portable)
    trace = failure.trace
    assert (trace.report.ending, trace.report.released) == ("device stopped", True)
    assert trace.report.ticks > ticks // 2
    wire = read_report(the_one_in(tmp_path)).wire
    from_device, to_device = frames_of(wire.from_device, False), frames_of(wire.to_device, True)
    assert (len(from_device) == len(to_device) == FRAMES) == (ticks == 1600)
    positions = [frame for frame in from_device if frame.type == schema.POSITION]
    forces = [frame for frame in to_device if frame.type == schema.FORCE]
    assert len(forces) == min(trace.report.ticks, len(forces)) > 20
    assert [frame.counts for frame in positions] == list(map(tuple, trace.position_counts[-len(positions) :].tolist()))
    assert [frame.counts for frame in forces] == list(map(tuple, trace.force_counts[-len(forces) :].tolist()))
    assert len(set(trace.force_counts[-len(forces) :, 0].tolist())) > len(forces) // 2
    assert to_device[-1].type == schema.DESCRIBE
    assert schema.DISARM in [frame.type for frame in to_device[-5:]]
    assert [frame.type for frame in to_device].count(schema.ARM) == (ticks == 40)
    assert schema.STATUS in [frame.type for frame in from_device[-5:]]


def test_garbage_is_kept_as_it_was(tmp_path: Path) -> None:
    garbage = bytes(range(1, 200)) * 3
    with scripted([frame(0, 0), garbage + b"\0" + frame(1, 1), None]) as (scene, _):
        failure = stopped(scene, tmp_path)
    assert isinstance(failure, DeviceError)
    assert read_report(the_one_in(tmp_path)).wire.from_device.endswith(frame(0, 0) + garbage + b"\0" + frame(1, 1))


def test_the_sentence_names_the_file_which_has_the_rest(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    scene = leaving(1600)
    failure = stopped(scene, tmp_path)
    path = the_one_in(tmp_path)
    assert str(path) in str(failure)
    assert re.fullmatch(r"\d{8}T\d{6}Z_mock-in-memory_device-stopped\.zip", path.name)
    about = read_report(path).about
    assert about["sentence"] in str(failure)
    assert about["exit_status"] == failure.exit_status == 3
    trace, last = failure.trace, load_trace(path)
    assert last.sample.tolist() == trace.sample[-1000:].tolist()
    np.testing.assert_array_equal(last.force, trace.force[-1000:])
    assert (last.report, last.statistics) == (trace.report, trace.statistics)
    with zipfile.ZipFile(path) as file:
        (tmp_path / "scene.yaml").write_bytes(file.read("scene.yaml"))
    assert load_scene(tmp_path / "scene.yaml").model_dump() == scene.model_dump()
    told = hapsim("frames", path)
    assert told.status == 0
    assert "from the device:" in told.out
    assert about["sentence"] in told.out
    document = hapsim("frames", path, "--json").document
    positions = [one for one in document["entries"] if one.get("type") == "POSITION"]
    assert positions[-1]["position_m"] == pytest.approx(trace.position[-1].tolist())  # by the scales in the report
    assert document["counters"]["from_device"] == document["counters"]["from_host"] == FRAMES
    assert document["report"]["sentence"] == about["sentence"]
    only = hapsim("frames", path, "--from", "host", "--json").document
    assert {one["from"] for one in only["entries"]} == {"host"}


def test_by_default_only_a_device_on_a_port_leaves_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for transport in ("loopback", "terminal"):
        with pytest.raises(DeviceError) as caught:
            run(leaving(20), duration=5.0, transport=transport)
        assert "hapsim frames" not in str(caught.value)
    assert os.listdir(tmp_path) == []
    with served(leaving(20)) as (scene, _), pytest.raises(DeviceError) as caught:
        run(scene, duration=5.0)
    assert str(the_one_in(tmp_path / "hapsim" / "reports")) in str(caught.value)
    with served(scene_of()) as (scene, _):
        run(scene, duration=0.05)
    assert len(os.listdir(tmp_path / "hapsim" / "reports")) == 1  # one that ends as asked leaves none


def test_the_newest_are_kept_and_no_other_file_is_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_file, "NEWEST", 3)
    (tmp_path / "theirs.zip").write_bytes(b"")
    older = [f"2020010{day}T000000Z_port_device-gone.zip" for day in range(1, 5)]
    for name in older:
        (tmp_path / name).write_bytes(b"")
    stopped(leaving(20), tmp_path)
    names = set(os.listdir(tmp_path))
    assert {"theirs.zip", *older[2:]} < names
    assert len(names) == 4
    stopped(leaving(20), tmp_path)
    stopped(leaving(20), tmp_path)
    assert set(older) & set(os.listdir(tmp_path)) == set()
    assert len(os.listdir(tmp_path)) == 4


@pytest.mark.parametrize("is_defect", [False, True])
def test_a_report_that_cannot_be_written_is_mentioned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_defect: bool
) -> None:
    directory = tmp_path / "file" / "reports"
    if is_defect:
        monkeypatch.setattr(report_file, "to_registers", lambda _: [None])
    else:
        (tmp_path / "file").write_bytes(b"")
    failure = stopped(leaving(20), directory)
    told = "" if is_defect else ".*: Not a directory"
    assert re.search(rf"the device stopped after .* No report of it could be written in {told}", str(failure))
    assert failure.exit_status == 3


def test_without_a_home_what_ended_the_run_is_reported_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A container's user has none, nor has one that is not in the list of users."""

    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    with served(scene_of()) as (scene, _):
        assert run(scene, duration=0.05).report.ending == "done"
    with served(leaving(20)) as (scene, _), pytest.raises(DeviceError) as caught:
        run(scene, duration=5.0)
    assert re.search(r"the device stopped after .* No report of it .*: this user has no home", str(caught.value))


def test_a_scene_that_was_changed_is_reported_as_it_ran(tmp_path: Path) -> None:
    def change(session: Session) -> None:
        session.set({"touch0": {"stiffness": 2.0}}, over=0.0)

    with pytest.raises(DeviceError), start(leaving(20), on_arming=change, reports=tmp_path) as session:
        session.wait(60.0)
    with zipfile.ZipFile(the_one_in(tmp_path)) as file:
        assert b"stiffness: 2.0" in file.read("scene.yaml")


def test_what_is_kept_is_the_end_of_what_came() -> None:
    """Pieces of every size that can come, over and over through the buffer."""
    last, buffer, chance = new_record(LAST_BYTES), np.zeros(KEPT + AT_ONCE, np.uint8), random.Random(1)
    came = b""
    for _ in range(300):
        piece = chance.randbytes(chance.choice([1, 11, 12, 500, AT_ONCE]))
        at = int(next_place(last))
        buffer[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
        last.at = at + len(piece)
        came += piece
        kept = last_bytes(last, buffer)
        assert came.endswith(kept)
        assert len(kept) >= min(KEPT, len(came))


def test_the_last_frames_are_cut_out_between_delimiters() -> None:
    frames = [bytes([1 + i % 250]) * 3 + b"\0" for i in range(FRAMES + 20)]
    assert last_frames(b"".join(frames)) == b"".join(frames[20:])
    assert last_frames(b"".join(frames) + b"tail") == b"".join(frames[20:]) + b"tail"
    assert last_frames(b"".join(frames[:7])) == b"".join(frames[:7])
    assert last_frames(b"x" * KEPT + b"\0ab\0") == b"ab\0"
    assert last_frames(b"") == b""
