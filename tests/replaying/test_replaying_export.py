"""`hapsim export`: each kind of file, opened by the programs that it is for, has the record's values and units."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas
import pytest
import soundfile
import xarray
from mcap.reader import make_reader
from test_replaying_command import SCENE, SOUND, recorded, rewrite

from hapsim.loop.ring import ROWS
from hapsim.recording.stream import MAGIC
from hapsim.recording.times import Marker
from hapsim.recording.trace import Trace, load_trace
from hapsim.replaying.export import Columns, ages
from hapsim.running import Session, start
from hapsim.scene import parse_scene

Hapsim = Callable[..., Any]

TWO = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.002, force_limit: 10, motion: [rotary, linear]}
mock: {initial: {velocity: [0.5, 0.1]}, misses: 0.1, seed: 3}
modules:
  knob: {type: device, channel: 0}
  hand: {type: device, channel: 1}
  wall: {type: ground}
  turn: {type: viscoelastic, between: [knob, wall], stiffness: 2, damping: 0.005}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2, damping: 0.005, damper: sensed}
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record of a rotary and a linear channel, with late forces, a marker and a change."""
    path = tmp_path_factory.mktemp("record") / "two.trace"

    def change(session: Session) -> None:
        session.mark("here")
        session.set({"turn": {"stiffness": 1.5}}, over=0.01)

    with start(parse_scene(TWO), duration=3.0, record=path, on_arming=change) as session:
        session.wait()
    return path


def test_hdf5_is_read_by_h5py_xarray_and_pandas(hapsim: Hapsim, record: Path, tmp_path: Path) -> None:
    assert hapsim("export", record, tmp_path / "a.h5").out.endswith("a.h5: 3000 rows of 2 channels\n")
    trace = load_trace(record)
    with h5py.File(tmp_path / "a.h5") as file:
        assert np.array_equal(file["position"], trace.position)
        assert np.array_equal(file["force"], trace.force)
        assert np.array_equal(file["asked_force"], trace.asked_force)
        assert np.array_equal(file["flags"], trace.flags)
        assert np.array_equal(file["sample"], trace.sample)
        assert np.array_equal(file["arrival"], trace.time_ns)
        assert np.array_equal(file["time"], trace.sample / 1000.0)
        assert {name: file[name].attrs["units"] for name in ("time", "position", "sensed_velocity", "force")} == {
            "time": "s",
            "position": "rad, m",
            "sensed_velocity": "rad/s, m/s",
            "force": "N·m, N",
        }
        assert [scale.keys() for scale in file["force"].dims] == [["time"], ["channel"]]
        assert all(one.attrs["description"] for one in file.values() if isinstance(one, h5py.Dataset))
        texts = {name: one.asstr()[()] for name, one in file["record"].items() if one.dtype.kind == "O"}
        assert parse_scene(texts["scene"]).rate == 1000.0
        assert json.loads(texts["device"])["name"] == "hapsim mock"
        assert json.loads(texts["versions"])["hapsim"]
        assert json.loads(texts["prediction"])["device_points"].keys() == {"knob", "hand"}
        assert list(texts["marker"]) == ["here"]
        assert json.loads(texts["change"][0])["set"] == {"turn": {"stiffness": 1.5}}
        assert 0 <= file["record/change_row"][0] < 3000
    with xarray.open_dataset(tmp_path / "a.h5", engine="h5netcdf") as dataset:
        assert dataset.force.dims == ("time", "channel")
        assert dataset.sizes == {"time": 3000, "channel": 2}
        assert float(dataset.force.sel(time=0.1, channel=1)) == trace.force[100, 1]
        table = dataset.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert table.loc[(0.1, 0), "position"] == trace.position[100, 0]


def torn(trace: Trace) -> Trace:
    """The same without rows 50 to 52."""
    kept = np.r_[0:50, 53:300]
    return replace(trace, **{name: getattr(trace, name)[kept] for name in ROWS})


def test_markers_are_in_every_kind_of_file_at_the_same_row(hapsim: Hapsim, tmp_path: Path) -> None:
    """Also one whose row is missing, one behind the last row, and a text that a table has to quote."""
    whole = load_trace(recorded(tmp_path / "a.trace"))
    texts = {0: "begun", 51: 'lost, "between"\nrows', 53: "beside it", 900: "behind"}
    markers = tuple(Marker(sample, text, "2026-01-01T00:00:00.000+00:00") for sample, text in texts.items())
    trace = replace(torn(whole), markers=markers)
    for name in ("b.trace", "b.npz", "b.csv"):
        trace.save(tmp_path / name)
    for name in ("c.npz", "c.csv", "c.h5", "c.mcap"):
        assert hapsim("export", tmp_path / "b.trace", tmp_path / name).status == 0
    for name in ("b.trace", "b.npz", "c.npz"):
        read = load_trace(tmp_path / name)
        assert (read.markers, read.clock) == (markers, whole.clock)
    with np.load(tmp_path / "c.npz") as file:
        assert np.array_equal(file["time_s"], trace.time_s)
    expected = {0: "begun", 50: 'lost, "between"\nrows; beside it', 296: "behind"}
    for name in ("b.csv", "c.csv"):
        table = pandas.read_csv(tmp_path / name)
        assert table["marker"].dropna().to_dict() == expected
        assert np.allclose(table["time_s"], trace.time_s, rtol=1e-11)
    times = trace.time_s[[0, 50, 50, 296]]
    with h5py.File(tmp_path / "c.h5") as file:
        assert np.array_equal(file["record/marker_time"], times)
        assert list(file["record/marker"].asstr()) == list(texts.values())
        clock = json.loads(file["record/clock"].asstr()[()])
    assert whole.clock is not None
    assert clock == whole.clock._asdict() | {"time_source": "count", "time_0_ns": int(trace.time_ns[0])}
    with (tmp_path / "c.mcap").open("rb") as file:
        messages = list(make_reader(file).iter_messages(["/hapsim/markers"]))
    begun = whole.clock.realtime_offset_ns + int(trace.time_ns[0])
    assert [(json.loads(one.data)["text"], one.log_time - begun) for _, _, one in messages] == [
        (text, round(1e9 * time)) for text, time in zip(texts.values(), times, strict=True)
    ]


def test_age_and_lost_follow_from_the_rows(hapsim: Hapsim, record: Path, tmp_path: Path) -> None:
    hapsim("export", record, tmp_path / "a.h5")
    trace = load_trace(record)
    with h5py.File(tmp_path / "a.h5") as file:
        age = np.array(file["age"])
        assert not np.array(file["lost"]).any()
        moved = np.diff(trace.position, axis=0, prepend=trace.position[:1]) * 1000.0
        assert np.allclose(file["velocity"], moved, rtol=1e-12, atol=1e-12)
        sensed = np.array(file["sensed_velocity"])
        assert np.allclose(sensed[0], [0.5, 0.1], atol=1e-9), "the device's, which has moved before"
        assert np.abs(sensed[1:] - moved[1:]).max() < 0.02
    counted, statistics = np.unique(age, return_counts=True), trace.statistics.age
    assert counted[1].tolist() == statistics.counts[statistics.counts > 0].tolist(), "as the loop counted them"
    assert counted[0][-1] == statistics.maximum >= 3, "no force was late twice"
    assert ages(np.array([1, 1, 0, 1], np.uint8), 4).tolist() == [5, 6, 1, 2], "goes on from the piece before"


def test_mcap_is_read_by_its_own_reader(hapsim: Hapsim, record: Path, tmp_path: Path) -> None:
    hapsim("export", record, tmp_path / "a.mcap")
    trace = load_trace(record)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        messages = [(schema, channel.topic, message) for schema, channel, message in reader.iter_messages()]
        metadata = {one.name: one.metadata for one in reader.iter_metadata()}
    assert parse_scene(metadata["record"]["scene"]).rate == 1000.0
    rows = [json.loads(message.data) for _, topic, message in messages if topic == "/hapsim/samples"]
    assert [row["force_1"] for row in rows] == trace.force[:, 1].tolist()
    assert [row["position_0"] for row in rows] == trace.position[:, 0].tolist()
    assert all(isinstance(value, (int, float)) for value in rows[0].values())
    schema = next(json.loads(schema.data) for schema, topic, _ in messages if topic == "/hapsim/samples")
    assert schema["properties"].keys() == rows[0].keys()
    assert [schema["properties"][f"force_{c}"]["description"][-5:] for c in (0, 1)] == ["(N·m)", "r (N)"]
    times = [message.log_time for _, topic, message in messages if topic == "/hapsim/samples"]
    assert np.abs(np.diff(times) - 1e6).max() < 1000, "ns"
    texts = {topic: json.loads(message.data)["text"] for _, topic, message in messages if topic != "/hapsim/samples"}
    assert texts["/hapsim/markers"] == "here"
    assert "1.5" in texts["/hapsim/changes"]


def test_tables_are_those_of_a_recorded_csv_and_npz(hapsim: Hapsim, record: Path, tmp_path: Path) -> None:
    hapsim("export", record, tmp_path / "a.csv")
    hapsim("export", record, tmp_path / "a.npz")
    trace = load_trace(record)
    assert np.array_equal(load_trace(tmp_path / "a.npz").force_counts, trace.force_counts)
    table = pandas.read_csv(tmp_path / "a.csv")
    assert np.allclose(table["force_N[1]"], trace.force[:, 1], rtol=1e-11)
    assert np.allclose(table["time_s"], trace.sample / trace.rate, rtol=1e-11)


def test_a_wav_has_one_column_at_a_stated_level(hapsim: Hapsim, record: Path, tmp_path: Path) -> None:
    answer = hapsim("export", record, tmp_path / "a.wav", "--column", "force.0", "--json")
    frames, rate = soundfile.read(tmp_path / "a.wav")
    force = load_trace(record).force[:, 0]
    assert (rate, answer.document["full_scale"]) == (1000, np.abs(force).max())
    assert answer.document["full_scale_unit"] == "N·m"
    assert np.abs(frames * answer.document["full_scale"] - force).max() < np.abs(force).max() * 2.0**-22


def test_a_wav_holds_the_value_where_positions_were_lost(hapsim: Hapsim, tmp_path: Path) -> None:
    trace = load_trace(recorded(tmp_path / "a.trace"))
    torn(trace).save(tmp_path / "lost.trace")
    hapsim("export", tmp_path / "lost.trace", tmp_path / "a.wav", "--column", "position.0")
    frames, _ = soundfile.read(tmp_path / "a.wav")
    assert frames.size == 300
    expected = np.concatenate([trace.position[:50, 0], [trace.position[49, 0]] * 3, trace.position[53:, 0]])
    assert np.abs(frames * np.abs(expected).max() - expected).max() < 1e-7
    hapsim("export", tmp_path / "lost.trace", tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert np.flatnonzero(file["lost"]).tolist() == [50]
        assert file["lost"][50] == 3


def test_a_pick_up_sounds_as_in_the_run(hapsim: Hapsim, tmp_path: Path) -> None:
    scene = SCENE + SOUND + "  wood: {from: gut.1, of: position, gain: 2}\n"
    path = recorded(tmp_path / "a.trace", scene, sound_file=tmp_path / "a.wav")
    for channel, name in enumerate(("air", "wood")):
        assert hapsim("export", path, tmp_path / f"{name}.wav", "--column", name).status == 0
        heard, _ = soundfile.read(tmp_path / f"{name}.wav", dtype="int32")
        both, _ = soundfile.read(tmp_path / "a.wav", dtype="int32")
        assert heard.any()
        assert np.array_equal(heard, both[:, channel])


def test_what_is_left_of_a_record_is_exported_with_a_warning(hapsim: Hapsim, tmp_path: Path) -> None:
    whole = recorded(tmp_path / "a.trace").read_bytes()
    part, older, damaged, grows = (tmp_path / f"{name}.trace" for name in ("a.part", "older", "damaged", "grows"))
    part.write_bytes(whole[: whole.rindex(b"TOLD") + 30])
    older.write_bytes(whole)
    rewrite(older, lambda head: (head.pop("run"), head.pop("clock"), head.update(version=1)))
    at = whole.index(b"ROWS")
    damaged.write_bytes(whole[: at + 100] + b"x" + whole[at + 101 :])
    for path, rows, why in (
        (part, 300, "incomplete record of 300 rows: the run goes on, or the file is cut off or damaged"),
        (older, 300, "recorded by an older hapsim, without scene"),
    ):
        answer = hapsim("export", path, tmp_path / f"{path.name}.h5")
        assert answer.status == 0
        assert why in " ".join(answer.err.split())
        with h5py.File(tmp_path / f"{path.name}.h5") as file:
            assert file["force"].shape == (rows, 1)
            assert ("scene" in file["record"]) == (path is part), "a part has a prediction, too"
    assert load_trace(older).clock is None
    assert hapsim("export", older, tmp_path / "older.mcap").status == 0, "at the time at which it was begun"
    assert "without rows" in hapsim("export", damaged, tmp_path / "d.h5").sentence
    damaged.write_bytes(whole)
    rewrite(damaged, lambda head: head["run"].pop("description"))
    assert (
        "the record is damaged: found no description, expected one"
        in hapsim("export", damaged, tmp_path / "d.h5").sentence
    )
    so_far = whole[: whole.rindex(b"NOTE")]
    grows.write_bytes(so_far)
    columns = Columns(grows)
    grows.write_bytes(so_far + whole[whole.index(b"ROWS") :])
    assert len(load_trace(grows).sample) == 600
    assert sum(len(values["time"]) for values in columns.pieces()) == 300, "rows that come meanwhile do not count"


def test_what_cannot_be_exported_is_refused_with_the_reason(
    hapsim: Hapsim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = recorded(tmp_path / "a.trace", SCENE + SOUND)
    cut, empty, there = (tmp_path / name for name in ("cut.trace", "empty.trace", "there.h5"))
    cut.write_bytes(whole.read_bytes()[: len(MAGIC) + 40])
    empty.touch()
    there.write_text("mine", "utf-8")
    for words, why in (
        ((tmp_path / "none.trace", "a.h5"), "found no file"),
        ((cut, "a.h5"), "cut off, or damaged, before its first row"),
        ((empty, "a.h5"), "not a trace that hapsim wrote; expected a .trace"),
        ((whole, "a.txt"), "found the ending '.txt', expected .h5, .csv, .npz, .wav, .mcap or .tsv"),
        ((whole, "no/a.h5"), "there is no directory"),
        ((whole, "there.h5"), "the file exists; --overwrite replaces it"),
        ((whole, "a.wav"), "a .wav needs --column"),
        ((whole, "a.h5", "--column", "force.0"), "a .wav needs --column"),
        ((whole, "a.wav", "--column", "force.1"), "found 'force.1', expected position.0, velocity.0, force.0,"),
        ((whole, "a.wav", "--column", "gut"), "asked_force.0 or air"),
    ):
        record, out, *others = words
        answer = hapsim("export", record, tmp_path / out, *others)
        assert answer.status == 2, words
        assert why in " ".join(answer.sentence.split()), words
    assert there.read_text("utf-8") == "mine"
    assert hapsim("export", whole, there, "--overwrite").status == 0
    assert h5py.is_hdf5(there)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.trace", "cut.trace", "empty.trace", "there.h5"]
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert "pip install 'hapsim[record]'" in hapsim("export", whole, tmp_path / "b.mcap").sentence


LINES = """\
# Two springs.
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2, friction: 1.0}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: spring, between: [hand, wall], stiffness: 2 N/mm}  # stiff
"""


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record of a scene that was changed twice, and its file beside it."""
    path = tmp_path_factory.mktemp("tuned") / "tuned.trace"
    path.with_suffix(".yaml").write_text(LINES, encoding="utf-8")

    with start(path.with_suffix(".yaml"), record=path) as session:
        next(state for state in session.subscribe(1000.0) if state.sample > 0)  # a row comes before the change
        session.set({"touch": {"stiffness": 1500.0}})
        session.adopt(parse_scene(LINES + "  more: {type: damper, between: [hand, wall], damping: 1}\n"))
        adopted = session.state().sample
        next(state for state in session.subscribe(1000.0) if state.sample > adopted + 1000)
    return path


@pytest.mark.parametrize(("change", "stiffness"), [(-1, "2 N/mm"), (0, "1.5 N/mm")])
def test_the_scene_at_a_time_is_its_file_with_the_values_of_then(
    hapsim: Hapsim, tuned: Path, tmp_path: Path, change: int, stiffness: str
) -> None:
    row, _ = Columns(tuned).changes[0]
    at = float(load_trace(tuned).sample[row + change]) / 1000.0
    told = json.loads(hapsim("export", tuned, tmp_path / "a.yaml", "--scene-at", at, "--json").out)
    assert (told["changes"], told["as_written"]) == (change + 1, True)
    assert (tmp_path / "a.yaml").read_text(encoding="utf-8") == LINES.replace("2 N/mm", stiffness)


def test_the_last_scene_has_what_was_added_and_a_record_without_text_all_values(
    hapsim: Hapsim, tuned: Path, tmp_path: Path
) -> None:
    end = float(load_trace(tuned).sample[-1]) / 1000.0
    hapsim("export", tuned, tmp_path / "a.yaml", "--scene-at", end)
    text = (tmp_path / "a.yaml").read_text(encoding="utf-8")
    assert text == LINES + "  more: {type: damper, between: [hand, wall], damping: 1 N·s/m}\n"
    rewrite(copy := Path(shutil.copy(tuned, tmp_path)), lambda head: head["run"].pop("text"))
    assert "without comments" in hapsim("export", copy, tmp_path / "b.yaml", "--scene-at", end).out
    assert parse_scene((tmp_path / "b.yaml").read_text(encoding="utf-8")).modules == parse_scene(text).modules


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("a.yaml", "--scene-at", 1e6), "found 1e+06 s, expected 0 s to "),
        (("a.h5", "--scene-at", 1), "--scene-at writes a .yaml"),
        (("a.yaml",), "a scene needs --scene-at"),
    ],
)
def test_what_cannot_be_exported_as_a_scene_is_refused(
    hapsim: Hapsim, tuned: Path, tmp_path: Path, words: tuple[Any, ...], why: str
) -> None:
    told = hapsim("export", tuned, tmp_path / words[0], *words[1:])
    assert told.status == 2
    assert why in told.err
    assert not [*tmp_path.iterdir()]
