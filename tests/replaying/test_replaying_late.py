"""A record that begins during a run has the state of its first sample, and is replayed from there to the last bit."""

from __future__ import annotations

import time
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from late_records import record_late, replayed, scenes
from test_replaying_command import SCENE, SOUND, rewrite

from hapsim.running import start
from hapsim.scene import Scene, parse_scene
from tests import thorough

Hapsim = Callable[..., Any]
RUN = SCENE.replace("velocity: 0.1}", "velocity: 0.1}, hand: {stiffness: 20, position: 0.01}, noise: 1.0e-6")
FOREVER = 1e5  # s in virtual time: longer than any test


@pytest.mark.parametrize("seed", range(thorough.points(2, 4)))
def test_random_records(seed: int, tmp_path: Path) -> None:
    name, scene = next(scenes(seed)) if seed % 2 else list(zip(range(2), scenes(seed), strict=False))[1][1]
    record_late(scene, tmp_path / "a.trace", seed, seconds=0.03)
    _, found = replayed(tmp_path / "a.trace")
    assert found.difference is None, (name, found.difference)


def test_in_a_ramp_and_a_crossfade_with_sound(tmp_path: Path) -> None:
    scene = parse_scene(RUN + SOUND.replace("of: velocity, gain: 0.5", "of: position, gain: 20, highpass: 2"))
    late, whole, again = (tmp_path / one for one in ("a.trace", "a.wav", "b.wav"))
    with start(scene, sound_file=whole, keep=False) as session:
        session.set({"touch": {"stiffness": 500.0, "damping": 2.0}}, over=FOREVER)
        session.adopt(other(scene), over=FOREVER)
        session.record(late)
        session.set({"tie": {"stiffness": 100.0}}, over=1.0)
        until_sample(session, 100)
    record, found = replayed(late, again)
    assert record.run.state is not None
    assert len(record.run.state.scenes) == 3, "the first, the older and the present one"
    assert found.difference is None
    assert found.changes == 1
    assert record.run.first_tick > 0
    assert first_sample(record) == record.run.first_tick
    tail = frames_of(again)
    assert any(tail)
    assert frames_of(whole).endswith(tail), "the high-pass goes on"


def test_before_the_first_sample_it_begins_with_the_run(tmp_path: Path) -> None:
    late = tmp_path / "a.trace"
    with start(parse_scene(RUN), on_arming=lambda session: session.record(late)) as session:
        until_sample(session, 100)
    record, found = replayed(late)
    assert (record.run.first_tick, record.run.state, first_sample(record)) == (0, None, 0)
    assert found.difference is None
    assert found.ticks == session.trace.report.ticks


def test_notes_of_what_came_before_are_not_in_it(tmp_path: Path) -> None:
    late = tmp_path / "a.trace"
    with start(parse_scene(RUN)) as session:
        session.mark("before")
        session.set({"touch": {"stiffness": 500.0}})
        until_sample(session, 100)
        session.record(late)
        session.set({"touch": {"stiffness": 600.0}})
        session.mark("after")
        until_sample(session, 100)
    record, found = replayed(late)
    assert [note["marker"] for note in record.notes if "marker" in note] == ["after"]
    assert found.changes == 1
    assert record.scene.modules["touch"].stiffness == 500.0


def test_a_state_that_does_not_fit_is_refused_in_words(hapsim: Hapsim, tmp_path: Path) -> None:
    late = tmp_path / "a.trace"
    with start(parse_scene(RUN)) as session:
        until_sample(session, 100)
        session.record(late)
        until_sample(session, 100)
    softer = tmp_path / "softer.yaml"
    softer.write_text(RUN.replace("2000, damping: 5", "500, damping: 0"), "utf-8")
    whole = late.read_bytes()
    for change, why in (
        (lambda run: run["state"].update(layout="0"), "the state of the scene then is that of another hapsim"),
        (lambda run: run["state"].update(blocks="AAAA"), "the record is damaged"),
        (lambda run: run["state"].update(scenes=[]), "the record is damaged"),
        (lambda run: run.update(state=None), "that of another hapsim"),
    ):
        late.write_bytes(whole)
        rewrite(late, lambda head, change=change: change(head["run"]))
        answer = hapsim("replay", late)
        assert answer.status == 2, answer.out
        assert why in " ".join(answer.err.split())
    late.write_bytes(whole)
    assert "all forces are identical" in hapsim("replay", late).out
    other = hapsim("replay", late, softer, "--json")
    assert other.status == 0, other.err
    assert 0.0 < other.document["force_rms_replayed"][0] < other.document["force_rms_recorded"][0]


def other(scene: Scene) -> Scene:
    """Returns the scene with a second wall."""
    more = {"type": "buffer", "stiffness": 100.0, "damping": 0.5, "between": ["wall", "hand"]}
    document = scene.model_dump(mode="json", exclude_none=True)
    document["modules"]["more"] = more
    return Scene.model_validate(document)


def until_sample(session: Any, count: int) -> None:
    """Waits for this many samples."""
    end = session.state().sample + count
    while session.state().sample < end:
        time.sleep(1e-3)


def frames_of(sound: Path) -> bytes:
    with wave.open(str(sound)) as file:
        return file.readframes(file.getnframes())


def first_sample(record: Any) -> int:
    return int(next(np.copy(rows["sample"][0]) for rows in record.rows()))
