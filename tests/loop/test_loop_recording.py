"""A record that is written while a scene runs: whole where the run came to its end, readable where it did not."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from loop_rig import require_same, scene_of

import hapsim
from hapsim.errors import RecordError, UsageError
from hapsim.recording import background_file, recorder, stream
from hapsim.recording.trace import load_trace
from hapsim.running import run


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "MOST_ROWS", 7)


@pytest.mark.parametrize("ending", ["trace", "npz"])
@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.usefixtures("small_chunks")
def test_what_is_written_is_what_happened(tmp_path: Path, ending: str, channels: int) -> None:
    path = tmp_path / f"t.{ending}"
    trace = run(scene_of(channels), duration=0.05, record=path)
    assert trace.sample.size == 50
    back = load_trace(path)
    require_same(back, trace, None, "time_ns")
    assert (back.report, back.statistics) == (trace.report, trace.statistics)
    assert back.report.ending == "done"
    assert back.report.released is True
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.usefixtures("small_chunks")
def test_a_csv_is_the_one_that_a_trace_in_memory_writes(tmp_path: Path) -> None:
    trace = run(scene_of(2), duration=0.05, record=tmp_path / "t.csv")
    trace.save(tmp_path / "whole.csv")
    assert (tmp_path / "t.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_what_is_written_needs_nothing_in_memory(tmp_path: Path) -> None:
    """More rows than the ring has: each was freed once it was handed over."""
    trace = run(scene_of(), duration=150.0, keep=False, record=tmp_path / "t.trace")
    assert trace.sample.size == 0
    assert load_trace(tmp_path / "t.trace").sample.tolist() == list(range(150_000))


@pytest.mark.usefixtures("small_chunks")
def test_a_trace_in_memory_can_be_saved_as_a_stream(tmp_path: Path) -> None:
    trace = run(scene_of(2), duration=0.05)
    trace.save(tmp_path / "t.trace")
    back = load_trace(tmp_path / "t.trace")
    require_same(back, trace, None, "time_ns")
    assert (back.report, back.statistics) == (trace.report, trace.statistics)


@pytest.mark.usefixtures("small_chunks")
def test_of_a_torn_file_every_whole_chunk_is_read_and_where_it_stops_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "t.trace"
    trace = run(scene_of(2), duration=0.05, record=path)
    whole = path.read_bytes()
    first_row = whole.index(b"ROWS")
    seen = set()
    for length in range(first_row, len(whole), 11):
        path.write_bytes(whole[:length])
        back = load_trace(path)
        ticks = back.sample.size
        require_same(back, trace, ticks, "time_ns")
        assert back.report.ending == f"not finished: the record stops after {ticks} ticks"
        assert back.report.ticks == ticks
        assert back.report.released is None
        seen.add(ticks)
    assert seen == {0, 7, 14, 21, 28, 35, 42, 49, 50}
    for length in range(0, first_row, 50):
        path.write_bytes(whole[:length])
        with pytest.raises(UsageError, match=r"not a trace|before its first row"):
            load_trace(path)


@pytest.mark.usefixtures("small_chunks")
def test_a_damaged_chunk_ends_what_is_read(tmp_path: Path) -> None:
    path = tmp_path / "t.trace"
    trace = run(scene_of(), duration=0.05, record=path)
    whole = path.read_bytes()
    third = whole.index(b"ROWS", whole.index(b"ROWS", whole.index(b"ROWS") + 4) + 4)
    for at in range(third, third + 200, 3):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        back = load_trace(path)
        require_same(back, trace, 14, "time_ns")
        assert back.report.ending == "not finished: the record stops after 14 ticks"
        assert (back.report.ticks, back.report.knows_ticks) == (14, False)
    path.write_bytes(whole + bytes(40))
    assert load_trace(path).report.ending == "not finished: the record stops after 50 ticks"


def test_a_later_version_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "VERSION", 7)
    run(scene_of(), duration=0.01, record=tmp_path / "t.trace")
    monkeypatch.undo()
    with pytest.raises(UsageError, match=r"found version 7 .* expected 6: it takes a newer hapsim"):
        load_trace(tmp_path / "t.trace")


def test_the_record_of_a_run_that_died_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "t.npz.part").write_text("of a run that died", "utf-8")
    run(scene_of(), duration=0.01, record=tmp_path / "t.npz")
    assert (tmp_path / "t.npz.part").read_text("utf-8") == "of a run that died"
    assert sorted(os.listdir(tmp_path)) == ["t.npz", "t.npz.part"]


@pytest.mark.parametrize("ending", ["trace", "npz"])
def test_two_runs_never_write_to_one_record(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"t.{ending}"
    with hapsim.start(scene_of(), record=path) as session:
        with pytest.raises(UsageError, match="another run writes its record there: name another file"):
            run(scene_of(), duration=0.01, record=path)
        session.stop()
        assert session.wait(60.0)
        assert load_trace(path).sample.size == session.trace.report.ticks
    run(scene_of(), duration=0.02, record=path)
    assert load_trace(path).sample.size == 20


def test_a_part_that_cannot_be_read_back_costs_no_older_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "t.npz"
    path.write_bytes(b"an older record")

    def spoil() -> None:
        with (tmp_path / "t.npz.part").open("r+b") as part:
            part.write(b"no magic")

    monkeypatch.setattr(recorder.RecordFile, "finish", _then(spoil, recorder.RecordFile.finish))
    with pytest.raises(RecordError, match=r"not a trace that hapsim wrote"):
        run(scene_of(), duration=0.05, record=path)
    assert path.read_bytes() == b"an older record"


def test_where_nothing_can_be_written_nothing_is_armed(tmp_path: Path) -> None:
    (tmp_path / "t.trace").symlink_to("/dev/full")
    armed: list[Any] = []
    with pytest.raises(UsageError, match=r"t\.trace: the trace cannot be written: No space left"):
        run(scene_of(), duration=0.01, record=tmp_path / "t.trace", on_start=armed.append)
    assert armed == []


LIMITED = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, resource.RLIM_INFINITY))
cli.main()
"""


@pytest.mark.parametrize("ending", ["trace", "npz"])
def test_on_a_full_disk_the_run_goes_on_and_what_was_written_stays(
    start_hapsim: Callable[..., Any], tmp_path: Path, ending: str
) -> None:
    """Full for files of more than so many bytes, which is all that a process may do to itself."""
    scene, record = tmp_path / "scene.yaml", tmp_path / f"t.{ending}"
    scene.write_text(yaml.safe_dump(scene_of().model_dump(mode="json", exclude_none=True)), "utf-8")
    ticks = 120_000
    words = ("run", scene, "--duration", ticks / 1000, "--record", record, "--json")
    host = start_hapsim(*words, program=LIMITED)
    assert host.wait() == 2, host.err
    assert "Traceback" not in host.err
    assert host.err.count("from here on rows are missing from the record (File too large)") == 1
    report = yaml.safe_load(host.out)
    assert report["ending"] == "done"
    assert report["ticks"] == ticks
    assert report["released"] is True
    assert "the run ended normally" in report["error"]
    missing = report["unrecorded_rows"]
    assert 0 < missing < ticks
    assert f"{missing} rows are missing" in report["error"]
    back = load_trace(record)
    assert back.sample.tolist() == list(range(ticks - missing))
    assert (back.report.ending, back.report.unrecorded_rows) == ("done", missing)


def test_a_disk_slower_than_the_run_costs_rows_and_no_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It takes nothing until the run is over, and then the rest."""
    goes_on = threading.Event()
    write = stream.StreamWriter.write_rows

    def write_later(self: Any, rows: Any) -> None:
        goes_on.wait(60.0)
        write(self, rows)

    monkeypatch.setattr(stream.StreamWriter, "write_rows", write_later)
    monkeypatch.setattr(background_file, "_MOST_BYTES", 1_500_000)
    monkeypatch.setattr(background_file, "_PATIENCE_S", 0.01)
    monkeypatch.setattr(recorder.RecordFile, "finish", _then(goes_on.set, recorder.RecordFile.finish))
    told: list[str] = []
    with pytest.raises(RecordError, match="the disk is slower than the run") as caught:
        run(scene_of(), duration=200.0, record=tmp_path / "t.trace", on_warning=told.append)
    trace = caught.value.trace
    assert caught.value.exit_status == 2
    assert (trace.sample.size, trace.report.ending, len(told)) == (200_000, "done", 1)
    back = load_trace(tmp_path / "t.trace")
    assert back.sample.size == 200_000 - trace.report.unrecorded_rows
    assert 0 < back.sample.size < 200_000


def _then(first: Callable[[], object], second: Callable[..., Any]) -> Callable[..., Any]:
    def both(*arguments: Any) -> Any:
        first()
        return second(*arguments)

    return both


def test_an_exception_of_the_caller_leaves_a_whole_record(tmp_path: Path) -> None:
    class OfTheirOwnError(Exception):
        pass

    def run_and_fail() -> None:
        with hapsim.start(scene_of(), duration=0.05, record=tmp_path / "t.npz") as session:
            session.wait(60.0)
            raise OfTheirOwnError

    with pytest.raises(OfTheirOwnError):
        run_and_fail()
    assert load_trace(tmp_path / "t.npz").report.ticks == 50
    assert os.listdir(tmp_path) == ["t.npz"]
