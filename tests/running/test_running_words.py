"""Digital words of a running scene: inputs that change, outputs that programs set, in records and their replay."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.errors import UsageError
from hapsim.recording.trace import Trace
from hapsim.replaying.export import Columns, export
from hapsim.replaying.replay import Record, compare
from hapsim.running.changed_scene import first_fixed_difference
from hapsim.running.requirements import require_compatible
from hapsim.scene import Scene, parse_scene
from tests.word_scenes import WORDS, without_words

GRIP = 1 << 31


def ran(scene: Scene, act: Callable[[hapsim.Session], Any], path: Path, ticks: int = 2000) -> hapsim.Session:
    """Runs a scene with a record; `act` is called when it is armed."""
    with hapsim.start(scene, duration=ticks * scene.period, record=path, on_arming=act) as session:
        session.wait()
    return session


@pytest.fixture(scope="module")
def scene() -> Scene:
    return parse_scene(WORDS)


@pytest.fixture(scope="module")
def recorded(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record whose outputs are set before its first tick and once during the run."""
    path = tmp_path_factory.mktemp("words") / "words.trace"
    ran(scene, lambda session: session.set({"outputs.led": 1, "wall.stiffness": 200.0}), path)
    return path


@pytest.fixture(scope="module")
def trace(recorded: Path) -> Trace:
    return hapsim.load_trace(recorded)


def test_inputs_of_the_mock_change_at_their_samples(trace: Trace) -> None:
    is_touched = (trace.sample >= 500) & (trace.sample < 1200)
    assert np.array_equal(trace.inputs, GRIP | is_touched.astype(np.uint32))


def test_outputs_that_programs_set_go_out_with_every_force(trace: Trace) -> None:
    assert set(trace.outputs.tolist()) == {8}
    assert not trace.asked_force.any()  # the wall is open


def test_a_set_changes_parameters_and_outputs_in_one_tick(scene: Scene, tmp_path: Path) -> None:
    seen: list[dict[str, float]] = []

    def set_all(session: hapsim.Session) -> None:
        session.set({"outputs": {"code": 0xA5, "led": 1}, "wall": {"stiffness": 150.0}})
        session.set({"outputs.code": 7})  # the other outputs stay
        seen.append({name: one.value for name, one in session.parameters.items() if name.startswith("outputs.")})

    ran(scene, set_all, tmp_path / "a.trace", 20)
    assert seen == [{"outputs.code": 7.0, "outputs.led": 1.0}]
    assert set(hapsim.load_trace(tmp_path / "a.trace").outputs.tolist()) == {0x708}


def test_an_input_of_the_mock_can_be_switched(scene: Scene, tmp_path: Path) -> None:
    seen: list[float] = []

    def switch(session: hapsim.Session) -> None:
        session.set({"mock.inputs": {"touch": 1, "grip": 1}})
        session.set({"mock.inputs.grip": 1})  # it is on already
        seen.extend(session.parameters[f"mock.inputs.{name}"].value for name in ("touch", "grip"))

    ran(scene, switch, tmp_path / "a.trace", 600)
    trace = hapsim.load_trace(tmp_path / "a.trace")
    assert seen == [1.0, 1.0]
    assert np.array_equal(trace.inputs, (trace.sample < 500).astype(np.uint32))  # its time turns it over again
    notes = [note for note in Record(tmp_path / "a.trace").notes if "set" in note]
    assert notes == []  # the record has the words


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"outputs.code": 256}, "outputs.code: found 256, expected a whole number from 0 to 255"),
        ({"outputs.code": -1}, "outputs.code: found -1, expected a whole number from 0 to 255"),
        ({"outputs.code": 1.5}, "outputs.code: found 1.5, expected a whole number from 0 to 255"),
        ({"outputs.led": True}, "outputs.led: found True, expected a whole number from 0 to 1"),
        ({"outputs.led": "on"}, "outputs.led: found 'on', expected a whole number from 0 to 1"),
        ({"outputs.cod": 1}, "outputs: found 'cod', expected one of code, led, hit; did you mean 'code'?"),
        ({"outputs.hit": 1}, "outputs.hit: it follows wall; expected an output that programs set"),
        ({"mock.inputs.touch": 2}, "mock.inputs.touch: found 2, expected a whole number from 0 to 1"),
        ({"mock.inputs.tuch": 1}, "mock.inputs: found 'tuch', expected one of touch, grip; did you mean 'touch'?"),
    ],
)
def test_what_a_word_cannot_have_changes_nothing(
    scene: Scene, tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    told: list[str] = []

    def set_wrong(session: hapsim.Session) -> None:
        with pytest.raises(UsageError) as caught:
            session.set({"wall.stiffness": 50.0, "outputs.code": 3} | changes)
        told.append(str(caught.value))
        told.append(str(session.parameters["wall.stiffness"].value))

    ran(scene, set_wrong, tmp_path / "a.trace", 2)
    assert told == [why, "100.0"]
    assert set(hapsim.load_trace(tmp_path / "a.trace").outputs.tolist()) == {0}


def test_a_stream_has_a_column_for_each_input_and_output(scene: Scene, tmp_path: Path) -> None:
    streams: list[Any] = []

    def follow(session: hapsim.Session) -> None:
        session.set({"outputs.code": 5})
        streams.append(session.stream())

    session = ran(scene, follow, tmp_path / "a.trace", 700)
    words = np.concatenate([one.words for one in streams[0]])
    names = [*scene.word_values(0, 0)]
    assert names == ["inputs.touch", "inputs.grip", "outputs.code", "outputs.led", "outputs.hit"]
    assert words.shape == (700, 5)
    assert np.array_equal(words[:, 0], np.arange(700) >= 500)
    assert set(words[:, 2].tolist()) == {5}
    assert session.sensed == ()


def test_files_keep_the_words(trace: Trace, tmp_path: Path) -> None:
    for name in ("a.npz", "a.trace"):
        trace.save(tmp_path / name)
        again = hapsim.load_trace(tmp_path / name)
        assert np.array_equal(again.inputs, trace.inputs)
        assert np.array_equal(again.outputs, trace.outputs)
    assert np.array_equal(trace.since(600).inputs, trace.inputs[600:])


def test_without_words_a_trace_has_none(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "a.trace"
    session = ran(without_words(scene), lambda _: None, path, 3)
    for trace in (session.trace, hapsim.load_trace(path)):
        assert trace.inputs.size == trace.outputs.size == 0
    assert session.state().progress.words == {}


@pytest.mark.parametrize("ending", [".csv", ".h5"])
def test_an_export_has_the_words_and_their_names(recorded: Path, trace: Trace, tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"out{ending}"
    if ending == ".h5":
        h5py = pytest.importorskip("h5py")
    export(Columns(recorded), out, None, lambda _: None)
    if ending == ".csv":
        with out.open() as file:
            found = {
                name: [int(float(one)) for one in column]
                for name, *column in zip(*csv.reader(file), strict=True)
                if "put" in name
            }
    else:
        with h5py.File(out) as file:
            found = {name: file[name][:].tolist() for name in file if "put" in name}
    expected = {
        "inputs": trace.inputs,
        "outputs": trace.outputs,
        "inputs.touch": trace.inputs & 1,
        "inputs.grip": 0 * trace.inputs,
    }
    expected |= {"outputs.code": 0 * trace.inputs, "outputs.led": 1 + 0 * trace.inputs, "outputs.hit": 0 * trace.inputs}
    assert found == {name: values.tolist() for name, values in expected.items()}


def test_a_replay_gives_the_same_words(recorded: Path) -> None:
    found = compare(Record(recorded), None, None, with_curves=False)
    assert (found.difference, found.changes, found.ticks) == (None, 1, 2000)


def test_a_replay_notices_an_output_that_differs(recorded: Path) -> None:
    record = Record(recorded)
    rows = record.rows

    def with_another_output() -> Any:
        for piece in rows():
            copy = piece.copy()
            copy["outputs"][copy["sample"] == 1234] ^= 1 << 20
            yield copy

    record.rows = with_another_output  # type: ignore[method-assign]
    difference = compare(record, None, None, with_curves=False).difference
    assert difference is not None
    assert (difference.sample, difference.what) == (1234, "outputs: recorded 1048584, replayed 8")


def test_a_scene_with_inputs_needs_a_record_with_words(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "a.trace"
    ran(without_words(scene), lambda _: None, path, 3)
    with pytest.raises(UsageError, match="found inputs, expected none: the record has no digital words"):
        compare(Record(path), scene, None, with_curves=False)


def test_a_device_without_a_digital_word_is_refused(scene: Scene) -> None:
    require_compatible(scene, "port", describe_mock(scene))
    with pytest.raises(UsageError) as caught:
        require_compatible(scene, "port", describe_mock(without_words(scene)))
    assert str(caught.value) == (
        "port: the scene has inputs and outputs, but the device has no digital word (its register 15, bit 2); remove "
        "inputs and outputs, or use a firmware that has one"
    )


@pytest.mark.parametrize(
    ("old", "new", "fixed"),
    [
        ("led: {bit: 3}", "led: {bit: 4}", "outputs"),
        ("touch: {bit: 0}", "touch: {bit: 1}", "inputs"),
        ("[0.5", "[0.6", "mock.inputs"),
    ],
)
def test_bits_stay_while_a_scene_runs(scene: Scene, old: str, new: str, fixed: str) -> None:
    assert first_fixed_difference(scene, parse_scene(WORDS)) == ""
    assert first_fixed_difference(scene, parse_scene(WORDS.replace(old, new))) == fixed


def test_words_are_no_unsaved_values(tmp_path: Path) -> None:
    file = tmp_path / "words.yaml"
    file.write_text(WORDS)
    saved: list[str] = []

    def save(session: hapsim.Session) -> None:
        session.set({"outputs.code": 3, "mock.inputs.touch": 1})
        session.save()
        saved.append(file.read_text())
        session.set({"wall.stiffness": 150.0})
        session.save()
        saved.append(file.read_text())

    ran(hapsim.load_scene(file), save, tmp_path / "a.trace", 2)
    assert saved == [WORDS, WORDS.replace("stiffness: 100", "stiffness: 150")]


def test_the_shipped_wall_acts_while_it_is_touched() -> None:
    scene = hapsim.load_scene("configs/touched_wall.yaml").changed({"device.clock": "lockstep"})
    trace = hapsim.run(scene, duration=2.0)
    before, touched, after = (1e3 * trace.position[round(at * scene.rate), 0] for at in (0.49, 1.49, 1.99))
    assert (before, after) == pytest.approx((-4.0, -4.0), abs=0.01)
    assert touched == pytest.approx(-4.0 * 300 / 1800, abs=0.01)
    assert np.array_equal(trace.inputs, (trace.sample >= 500) & (trace.sample < 1500))
