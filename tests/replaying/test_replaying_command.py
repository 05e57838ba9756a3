"""`hapsim replay`: what it says of a record, what it computes of another scene, and what it refuses."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.recording.stream import MAGIC, StreamReader
from hapsim.recording.trace import load_trace
from hapsim.running import start
from hapsim.scene import parse_scene

Hapsim = Callable[..., Any]

SCENE = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2, friction: 1.0, force_limit: 10}
mock: {initial: {velocity: 0.1}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}
"""
SOUND = """\
  tie: {type: spring, between: [hand, gut.3], stiffness: 50}
  gut: {type: string, masses: 8, mass: 0.001, stiffness: 100, damping: 0.01}
sound:
  air: {from: gut.3, of: velocity, gain: 0.5}
"""


def recorded(path: Path, scene: str = SCENE, **options: Any) -> Path:
    with start(parse_scene(scene), duration=0.3, record=path, **options) as session:
        session.mark("here")
        session.wait()
    return path


def test_a_record_comes_out_as_it_was(hapsim: Hapsim, tmp_path: Path) -> None:
    record = recorded(tmp_path / "a.trace", SCENE + SOUND, sound_file=tmp_path / "a.wav")
    answer = hapsim("replay", record, "--sound-file", tmp_path / "b.wav", "--picture", tmp_path / "p.svg")
    assert answer.status == 0
    assert "300 samples, 0 changes: all forces are identical, to the last bit" in answer.out
    assert (tmp_path / "a.wav").read_bytes() == (tmp_path / "b.wav").read_bytes()
    assert (tmp_path / "p.svg").read_bytes().startswith(b"<?xml")
    assert hapsim("replay", record, "--sound-file", tmp_path / "b.wav").status == 2, "it replaces nothing unasked"
    document = hapsim("replay", record, "--json").document
    assert (document["identical"], document["first_difference"], document["ticks"]) == (True, None, 300)
    assert document["force_rms_apart"] == [0.0]


def test_another_scene_answers_the_same_hand(hapsim: Hapsim, tmp_path: Path) -> None:
    record = recorded(tmp_path / "a.trace")
    other = tmp_path / "softer.yaml"
    other.write_text(SCENE.replace("2000, damping: 5", "500, damping: 0"), "utf-8")
    answer = hapsim("replay", record, other, "--json", "--data", tmp_path / "d.csv")
    assert answer.status == 0
    trace, rows = load_trace(record), (tmp_path / "d.csv").read_text("utf-8").splitlines()
    assert rows[0] == "time_s,position_m[0],recorded_force_N[0],replayed_force_N[0]"
    *_, position, before, now = map(float, rows[100].split(","))
    assert (position, before) == (trace.position[99, 0], trace.force[99, 0])
    assert now == pytest.approx(-500.0 * position, abs=trace.force_scale[0])


def test_the_first_sample_that_differs_is_named(hapsim: Hapsim, tmp_path: Path) -> None:
    record = recorded(tmp_path / "a.trace")
    rewrite(record, lambda head: head["run"]["scene"]["modules"]["touch"].update(stiffness=2001.0))
    answer = hapsim("replay", record)
    assert answer.status == 2
    assert "sample 1 is the first that differs. asked_force: recorded [" in answer.out.replace("\n    ", " ")
    rewrite(record, lambda head: head["run"]["versions"].update(numba="0.1"))
    assert "It was recorded with numba 0.1, now" in hapsim("replay", record).out.replace("\n    ", " ")


def test_what_cannot_be_replayed_is_refused_with_the_reason(hapsim: Hapsim, tmp_path: Path) -> None:
    whole = recorded(tmp_path / "a.trace")
    recorded(tmp_path / "a.npz")
    older, damaged, cut = (tmp_path / f"{name}.trace" for name in ("older", "damaged", "cut"))
    for copy, change in (
        (older, lambda head: (head.pop("run"), head.update(version=1))),
        (damaged, lambda head: head["run"].pop("description")),
    ):
        copy.write_bytes(whole.read_bytes())
        rewrite(copy, change)
    cut.write_bytes(whole.read_bytes()[: len(MAGIC) + 40])
    slow = tmp_path / "slow.yaml"
    slow.write_text(SCENE.replace("rate: 1000", "rate: 500"), "utf-8")
    for words, why in (
        ((tmp_path / "a.npz",), "not a trace that hapsim wrote; expected a .trace"),
        ((tmp_path / "none.trace",), "found no file"),
        ((older,), "recorded by an older hapsim"),
        ((damaged,), "the record is damaged: found no description, expected one"),
        ((cut,), "cut off, or damaged, before its first row"),
        ((whole, slow), "found rate 500 Hz, expected the record's, 1000 Hz"),
        ((whole, "--sound-file", tmp_path / "s.wav"), "found no pick-up in the scene"),
    ):
        answer = hapsim("replay", *words)
        assert answer.status == 2, words
        assert why in " ".join(answer.err.split()), words


def test_a_record_that_ends_early_is_replayed_up_to_there(hapsim: Hapsim, tmp_path: Path) -> None:
    record = recorded(tmp_path / "a.trace")
    whole = record.read_bytes()
    record.write_bytes(whole[: whole.rindex(b"TOLD") + 30])
    answer = hapsim("replay", record)
    assert "all forces are identical" in answer.out
    assert "the run goes on, or the file is cut off or damaged" in " ".join(answer.err.split())
    assert hapsim("replay", record, "--json").document["complete"] is False
    record.write_bytes(whole)
    assert not hapsim("replay", record).err
    assert hapsim("replay", record, "--json").document["complete"] is True


def test_a_record_has_markers_and_changes(tmp_path: Path) -> None:
    with start(parse_scene(SCENE), record=tmp_path / "a.trace") as session:
        session.mark("before")
        session.set({"touch": {"stiffness": 1000.0}}, over=0.01)
        session.adopt(parse_scene(SCENE + SOUND.partition("sound:")[0]))
        at = session.state().sample
        while session.state().sample < at + 100:  # until the loop has taken it
            pass
    reader = StreamReader(tmp_path / "a.trace")
    rows = sum(len(piece) for piece in reader.rows())
    predicted = reader.notes.pop()
    marker, change, adopted = sorted(reader.notes, key=lambda note: note.get("tick", -1))
    assert marker["marker"] == "before"
    assert change["set"] == {"touch": {"stiffness": 1000.0}}
    assert list(adopted["adopt"]["modules"]) == ["hand", "wall", "touch", "tie", "gut"]
    assert 0 <= change["tick"] <= adopted["tick"] <= rows
    felt = hapsim.predict(parse_scene(SCENE)).felt[0]
    of_hand = predicted["prediction"]["device_points"]["hand"]
    assert (of_hand["k"], of_hand["b"]) == (felt.k, felt.b), "of the scene that the run began with"


def test_a_record_of_a_scene_that_cannot_be_predicted_states_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def predict(*_: object, **__: object) -> None:
        raise ArithmeticError("too large")

    monkeypatch.setattr("hapsim.running.recorded_run.predict", predict)
    reader = StreamReader(recorded(tmp_path / "a.trace"))
    assert sum(len(rows) for rows in reader.rows()) == 300
    assert reader.is_finished
    assert reader.notes[-1] == {"prediction": {"error": "too large"}}


def rows_of(path: Path) -> Any:
    return np.concatenate(list(StreamReader(path).rows()))


def rewrite(record: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Changes the head of a record."""
    data, begin = record.read_bytes(), len(MAGIC)
    kind, count, size, _ = struct.unpack_from("<4sIII", data, begin)
    head = json.loads(data[begin + 16 : begin + 16 + size])
    change(head)
    payload = json.dumps(head).encode()
    check = zlib.crc32(payload, zlib.crc32(kind + struct.pack("<II", count, len(payload))))
    chunk = struct.pack("<4sIII", kind, count, len(payload), check) + payload
    record.write_bytes(data[:begin] + chunk + data[begin + 16 + size :])
