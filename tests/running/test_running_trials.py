"""Trials of an experiment: values, modules that begin anew and a code, from one sample on; in records and tables."""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import hapsim
from hapsim import load_trace, start
from hapsim.errors import UsageError
from hapsim.recording.stream import MAGIC
from hapsim.replaying.notes import kind_of
from hapsim.running import Event
from hapsim.scene import Scene, load_scene
from tests.one_hand import scene_of
from tests.trial_runs import SAMPLES, columns_of, scene, wait_beyond

Hapsim = Callable[..., Any]

TRIALS = 60


@dataclass
class Run:
    path: Path
    asked: list[hapsim.running.Event]
    trials: hapsim.Trials
    events: list[Event]
    trace: hapsim.Trace


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Sixty trials, each of which sends its number as a code; the mass that drifts begins anew in every third."""
    folder, events, asked = tmp_path_factory.mktemp("trials"), list[Event](), list[Event]()
    table = folder / "conditions.csv"
    rows = [f"{150 + 10 * i},{'drifter' if i % 3 == 0 else ''},{i + 1}" for i in range(12)]
    table.write_text("\n".join(["touch.stiffness,restart,code", *rows]))
    trials = hapsim.Trials(table, seed=3, repetitions=TRIALS // 12, scene=scene())
    path = folder / "run.trace"
    with hapsim.start(scene(), record=path, on_event=events.append) as session:
        stream = session.stream()
        for trial in trials:
            asked.append(session.trial(*trial))
            wait_beyond(stream, asked[-1].sample + SAMPLES)
            session.mark(f"answer {trial.number}")
    return Run(path, asked, trials, events, session.trace)


def table_of(run: Run, call: Hapsim, name: str) -> pandas.DataFrame:
    out = run.path.with_name(f"sub-01_{name}.tsv")
    assert call("export", run.path, out, "--overwrite").out.startswith(f"{out}: {name} of {run.trace.sample.size} rows")
    return pandas.read_csv(out, sep="\t", na_values="n/a")


def test_each_trial_has_its_code_from_its_first_sample_on(run: Run) -> None:
    sample, outputs = columns_of(run.path, "sample", "outputs")
    begins = np.searchsorted(sample, [one.sample for one in run.asked])
    assert ((outputs[begins] >> 8) & 255).tolist() == [one.code for one in run.trials]
    before = [0, *(one.code for one in run.trials)][:-1]
    assert ((outputs[begins - 1] >> 8) & 255).tolist() == before
    changes = np.flatnonzero(np.diff(outputs)) + 1
    assert set(changes) <= set(begins)


def test_every_row_has_the_number_of_its_trial(run: Run, tmp_path: Path) -> None:
    expected = np.zeros(run.trace.sample.size, int)
    for one in run.asked:
        expected[run.trace.sample >= one.sample] = one.values["trial"]
    run.trace.save(tmp_path / "run.npz")
    run.trace.save(tmp_path / "run.trace")
    for trace in (run.trace, *map(hapsim.load_trace, (run.path, tmp_path / "run.npz", tmp_path / "run.trace"))):
        assert np.array_equal(trace.trial, expected)
    assert expected[-1] == TRIALS
    assert np.array_equal(run.trace.since(100).trial, expected[100:])


def test_a_trial_settles_when_its_ramp_and_its_crossfade_are_over(run: Run) -> None:
    phases = [(one.values["trial"], one.values["phase"], one.sample) for one in run.events if one.kind == "trial"]
    begun = {number: sample for number, phase, sample in phases if phase == "begun"}
    settled = {number: sample for number, phase, sample in phases if phase == "settled"}
    assert settled == {number: sample + SAMPLES - 1 for number, sample in begun.items()}
    assert [*begun] == [*range(1, TRIALS + 1)]


def test_pandas_reads_the_trials(run: Run, hapsim: Hapsim) -> None:
    table = table_of(run, hapsim, "trials")
    assert table["trial"].tolist() == [*range(1, TRIALS + 1)]
    assert table["sample"].tolist() == [one.sample for one in run.asked]
    assert table["outputs.code"].tolist() == [one.code for one in run.trials]
    assert table["touch.stiffness"].tolist() == [one.set["touch.stiffness"] for one in run.trials]
    assert table["restart"].fillna("").tolist() == [" ".join(one.restart) for one in run.trials]
    assert (table["settled"] - table["sample"] == SAMPLES - 1).all()
    assert table["onset"].to_numpy() == pytest.approx((table["sample"] - run.trace.sample[0]) * 1e-3, abs=1e-9)
    assert (table["onset"] + table["duration"])[:-1].to_numpy() == pytest.approx(table["onset"][1:].to_numpy())


def test_pandas_reads_the_events_in_their_order(run: Run, hapsim: Hapsim) -> None:
    table = table_of(run, hapsim, "events")
    assert [*table.columns] == ["onset", "duration", "trial_type", "value", "sample", "code"]
    assert table["onset"].is_monotonic_increasing
    marked = table[table["trial_type"] == "marker"]
    assert marked["value"].tolist() == [f"answer {number}" for number in range(1, TRIALS + 1)]
    begun = table[table["trial_type"] == "trial"]
    assert begun["code"].tolist() == [one.code for one in run.trials]
    assert (table["trial_type"] == "settled").sum() == TRIALS


def test_a_replay_has_the_same_forces_to_the_last_bit(run: Run, hapsim: Hapsim) -> None:
    assert "60 changes: all forces are identical" in hapsim("replay", run.path).out


def test_the_scene_at_a_time_has_the_values_of_its_trial(run: Run, tmp_path: Path, hapsim: Hapsim) -> None:
    out, fifth = tmp_path / "then.yaml", run.asked[4]
    assert hapsim("export", run.path, out, "--scene-at", (fifth.sample + 1) * 1e-3).status == 0
    touched: Any = load_scene(out).modules["touch"]
    assert touched.stiffness == run.trials[4].set["touch.stiffness"]


def test_a_module_that_restarts_moves_as_it_did_at_the_beginning_of_the_run() -> None:
    """A spring shows where a mass is that drifts, too heavy for the spring to move it."""
    modules = {
        "drifter": {"type": "mass", "mass": 1e9, "position": 0.02, "velocity": 0.1},
        "rod": {"type": "viscoelastic", "between": ["hand", "drifter"], "stiffness": 1.0},
    }
    with hapsim.start(scene_of(modules, mock={"hand": {"stiffness": 2000.0, "damping": 20.0}})) as session:
        stream = session.stream()
        wait_beyond(stream, 100)
        kept = session.trial(1, over=0.0).sample
        wait_beyond(stream, kept + 100)
        anew = session.trial(2, restart=["drifter"], over=0.0).sample
        wait_beyond(stream, anew + 100)
    trace = session.trace
    drifter = (trace.position + trace.asked_force)[:, 0]
    drifted = drifter[0] + 1e-4 * np.arange(anew + 100)
    first, second = (int(np.searchsorted(trace.sample, one)) for one in (kept, anew))
    assert drifter[:second] == pytest.approx(drifted[:second], abs=5e-5)
    assert drifter[second : second + 100] == pytest.approx(drifted[:100], abs=5e-5)
    assert 0 < first < second


def test_the_force_has_no_jump_when_a_pressed_mass_begins_anew() -> None:
    """A hand presses a mass 20 mm out of its place; back there, its contact pushes with another force."""
    modules = {
        "ball": {"type": "mass", "mass": 0.05, "position": 0.0},
        "base": {"type": "viscoelastic", "between": ["ball", "wall"], "stiffness": 100.0, "damping": 2.0},
        "rod": {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 100.0, "damping": 1.0},
    }
    held = {"hand": {"stiffness": 2000.0, "damping": 20.0, "position": 0.04}}
    steps = {}
    for over in (0.02, 0.0):
        with hapsim.start(scene_of(modules, mock=held)) as session:
            stream = session.stream()
            wait_beyond(stream, 2000)
            first = session.trial(1, restart=["ball"], over=over).sample
            wait_beyond(stream, first + 100)
        trace = session.trace.since(int(np.searchsorted(session.trace.sample, first - 1)))
        steps[over] = np.abs(np.diff(trace.force[:60, 0])).max()
        swing = np.ptp(trace.force[:60, 0])
    assert swing > 1.0
    assert steps[0.02] < 1.5 / 20 * 2.0 + 0.05 < 1.0 < steps[0.0]


def wrong_trials(scene: Scene, parameters: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields arguments of trials that nobody can mean, each with what its message names."""
    for name, one in parameters.items():
        part, _, key = name.rpartition(".")
        for typo in (f"{part}.{key}x", f"{part}x.{key}", name.replace(".", "_"), f"{name}.{key}"):
            yield typo.rpartition(".")[0] or typo, {"set": {typo: one.value}}
        if one.kind == "number":
            beyond = [
                *([one.least - 1.0] if one.least is not None else []),
                *([one.most + 1.0] if one.most is not None else []),
            ]
            for value in (*beyond, math.nan, math.inf, "3 apples", [1.0, 2.0], None):
                yield key, {"set": {name: value}}
            yield key, {"set": {name: one.value, f"{part}.{key}": math.nan}}
    for name in scene.modules:
        yield f"{name}x", {"restart": [f"{name}x"]}
    for number in (0, -1, 1.5, True, "1", None, 2**31):
        yield "number", {"number": number}
    for over in (-0.1, math.nan, math.inf, "1 s"):
        yield "over", {"over": over}
    for code in (-1, 256, 1.5, "17", {"cod": 1}, {"led": 2}, {"code": None}):
        yield "code" if not isinstance(code, dict) else next(iter(code)), {"code": code}
    yield "set", {"set": 5}


@pytest.mark.parametrize("name", ["first_touch", "knob_24", "held_string", "four_keys"])
def test_what_cannot_be_a_trial_changes_nothing_and_names_why(name: str) -> None:
    shipped = load_scene(f"configs/{name}.yaml")
    document = shipped.ranged_document
    document["device"] |= {"clock": "lockstep"}
    document["outputs"] = {"code": {"bits": [8, 15]}, "led": {"bit": 3}}
    tried = Scene.model_validate(document)
    events: list[Event] = []
    with hapsim.start(tried, transport="mock", unstable=True, on_event=events.append) as session:
        before, wrong = session.scene, list(wrong_trials(tried, session.parameters))
        for where, arguments in wrong:
            with pytest.raises(UsageError) as error:
                session.trial(**{"number": 1, **arguments})
            assert where in str(error.value), (arguments, str(error.value))
        assert session.scene is before
        assert int(session._loop.record.posted.number) == 0
    assert session.trace.trials == ()
    assert not [one for one in events if one.kind in ("trial", "changed")]
    assert len(wrong) >= 50  # in each of four scenes


def test_a_trial_is_refused_while_another_one_begins() -> None:
    with hapsim.start(scene()) as session:
        session.trial(1, {"touch.stiffness": 210.0}, over=1e6)
        with pytest.raises(UsageError, match="trial 2: trial 1 still begins"):
            session.trial(2, {"touch.stiffness": 220.0})
        assert session.scene.modules["touch"].stiffness == 210.0  # type: ignore[union-attr]
        session.set({"touch.stiffness": 230.0}, over=0.0)  # ends that ramp
        wait_beyond(session.stream(), session.state().sample + 2)
        session.trial(3)
    assert [number for _, number in session.trace.trials] == [1, 3]


class TestTrials:
    def read(self, tmp_path: Path, text: str, **options: Any) -> hapsim.Trials:
        table = tmp_path / "conditions.csv"
        table.write_text(text, "utf-8")
        return hapsim.Trials(table, **{"seed": 1, **options})

    TABLE = "touch.stiffness;code\n100;1\n200;2\n300;3\n"

    @pytest.mark.parametrize("order", ["random", "blocked", "as listed"])
    def test_each_condition_comes_as_often_and_in_the_same_order_for_the_same_seed(
        self, tmp_path: Path, order: Any
    ) -> None:
        trials = self.read(tmp_path, self.TABLE, repetitions=20, order=order)
        codes = [one.code for one in trials]
        assert [one.number for one in trials] == [*range(1, 61)]
        assert {codes.count(code) for code in (1, 2, 3)} == {20}
        assert codes == [one.code for one in self.read(tmp_path, self.TABLE, repetitions=20, order=order)]
        blocks = [sorted(codes[i : i + 3]) for i in range(0, 60, 3)]
        assert (blocks == [[1, 2, 3]] * 20) == (order != "random")
        assert (codes == [1, 2, 3] * 20) == (order == "as listed")
        other = self.read(tmp_path, self.TABLE, repetitions=20, order=order, seed=2)
        assert (codes == [one.code for one in other]) == (order == "as listed")

    def test_the_order_of_a_seed_never_changes(self, tmp_path: Path) -> None:
        codes = [one.code for one in self.read(tmp_path, self.TABLE, repetitions=2, seed=7)]
        assert codes == [1, 2, 1, 3, 2, 3]

    @pytest.mark.parametrize(
        ("text", "found"),
        [
            ("", "found no conditions"),
            ("touch.stiffness\n", "found no conditions"),
            ("touch.stiffness,colour\n1,red", "line 1: found the column 'colour'"),
            ("touch.stiffness,touch.stiffness\n1,2", "line 1: found the column 'touch.stiffness'"),
            ("touch.stiffness,code\n1", "line 2: cells: found 1, expected 2"),
            ("touch.stiffness,code\n1,2\n1,x", "line 3: code: found 'x'"),
            ("touch.stifness\n1", "line 2: touch: found 'stifness'"),
            ("touhc.stiffness\n1", "line 2: found 'touhc'.*did you mean 'touch'"),
            ("touch.stiffness\n1\n\n-5", "line 4: touch.stiffness: found -5.0"),
            ("touch.stiffness,restart\n1,drifetr", "line 2: restart: found 'drifetr'.*did you mean 'drifter'"),
            ("touch.stiffness,code\n1,256", "line 2: outputs.code: found 256, expected a whole number from 0 to 255"),
        ],
    )
    def test_a_table_that_does_not_fit_is_refused_with_its_line(self, tmp_path: Path, text: str, found: str) -> None:
        with pytest.raises(UsageError, match=found):
            self.read(tmp_path, text, scene=scene())

    @pytest.mark.parametrize(
        ("options", "found"),
        [
            ({"seed": None}, "seed: found None"), ({"seed": -1}, "seed: found -1"), ({"seed": 1.5}, "seed: found 1.5"),
            ({"order": "shuffled"}, "order: found 'shuffled'"), ({"repetitions": 0}, "repetitions: found 0"),
        ],
    )  # fmt: skip
    def test_wrong_options_are_refused(self, tmp_path: Path, options: dict[str, Any], found: str) -> None:
        with pytest.raises(UsageError, match=found):
            self.read(tmp_path, self.TABLE, **options)

    def test_a_table_that_is_not_there_or_is_no_text_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "picture.csv").write_bytes(b"\xff\xd8\xff")
        for name in ("none.csv", "picture.csv"):
            with pytest.raises(UsageError, match=name):
                hapsim.Trials(tmp_path / name, seed=1)

    def test_a_table_in_memory_is_refused(self) -> None:
        with pytest.raises(UsageError, match=r"table: found a DataFrame, expected the path .*to_csv"):
            hapsim.Trials(pandas.DataFrame({"code": [1]}), seed=1)  # type: ignore[arg-type]


def without_samples(record: Path) -> None:
    """Rewrites a record as earlier versions wrote it: changes have a tick and no sample."""
    data, at = record.read_bytes(), len(MAGIC)
    written = [data[:at]]
    while at < len(data):
        kind, count, size, _ = struct.unpack_from("<4sIII", data, at)
        payload = data[at + 16 : at + 16 + size]
        if kind == b"NOTE" and "tick" in (note := json.loads(payload)):
            payload = json.dumps({key: value for key, value in note.items() if key != "sample"}).encode()
        head = struct.pack("<4sII", kind, count, len(payload))
        written += [head, struct.pack("<I", zlib.crc32(payload, zlib.crc32(head))), payload]
        at += 16 + size
    record.write_bytes(b"".join(written))


def test_records_of_earlier_versions_have_no_trials(tmp_path: Path, hapsim: Hapsim) -> None:
    record, tables = tmp_path / "run.trace", list[str]()
    with start(scene(), record=record) as session:
        stream = session.stream()
        for stiffness in (210.0, 220.0):
            wait_beyond(stream, session.state().sample + 50)
            session.set({"touch.stiffness": stiffness})
            session.mark("set")
        wait_beyond(stream, session.state().sample + 50)
    for change in (lambda _: None, without_samples):
        change(record)
        assert "2 changes: all forces are identical" in hapsim("replay", record).out
        for table in ("events.tsv", "trials.tsv"):
            assert hapsim("export", record, tmp_path / table, "--overwrite").status == 0
        tables.append((tmp_path / "events.tsv").read_text())
        assert (tmp_path / "trials.tsv").read_text() == "onset\tduration\ttrial\tsample\tsettled\trestart\n"
        assert load_trace(record).trial.max() == 0
    assert tables[0] == tables[1]
    assert [line.split("\t")[2] for line in tables[0].splitlines()[1:]].count("set") == 2


def test_a_trial_is_no_set() -> None:
    assert kind_of({"tick": 1, "set": {}, "trial": 3}) == "trial"


def test_a_note_of_a_later_version_is_refused() -> None:
    with pytest.raises(UsageError, match="it takes a newer hapsim"):
        kind_of({"tick": 3, "teleport": 1})


def test_a_table_of_another_name_is_refused(run: Run, hapsim: Hapsim) -> None:
    refused = hapsim("export", run.path, run.path.with_name("answers.tsv"))
    assert (refused.status, "ends with events.tsv or trials.tsv" in refused.sentence) == (2, True)
