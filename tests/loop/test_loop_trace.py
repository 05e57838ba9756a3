"""A trace on disk."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from loop_rig import scene_of

from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram
from hapsim.recording.report_file import is_report, read_report
from hapsim.recording.trace import Trace, load_trace, require_writable_as_trace
from hapsim.running import run


@pytest.fixture
def trace() -> Trace:
    return run(scene_of(2), duration=0.05)


def test_a_trace_comes_back_as_it_was(trace: Trace, tmp_path: Path) -> None:
    trace.save(tmp_path / "t.npz")
    back = load_trace(tmp_path / "t.npz")
    assert vars(back).keys() == vars(trace).keys()
    for name, value in vars(trace).items():
        if isinstance(value, np.ndarray):
            assert getattr(back, name).dtype == value.dtype
            np.testing.assert_array_equal(getattr(back, name), value)
        else:
            assert getattr(back, name) == value
    np.testing.assert_array_equal(back.position, trace.position)
    np.testing.assert_array_equal(back.force, trace.force)


def test_a_trace_is_described_in_one_line(trace: Trace) -> None:
    assert repr(trace) == "Trace(50 rows (samples 0 to 49), channels=2, rate=1000, ending='done')"
    assert repr(trace.since(50)) == "Trace(0 rows, channels=2, rate=1000, ending='done')"
    age = trace.statistics.age
    assert repr(age) == "Histogram(count=50, p50=1, p99=1, max=1)"
    assert repr(Histogram(np.zeros_like(age.counts), 0.0)) == "Histogram(count=0)"
    told = repr(trace.statistics)
    assert f"age={age!r}" in told
    assert "\n" not in told


def test_a_trace_without_rows_comes_back_too(tmp_path: Path) -> None:
    empty = run(scene_of(2), duration=0.01, keep=False)
    for name in ("t.npz", "t.csv"):
        empty.save(tmp_path / name)
    assert load_trace(tmp_path / "t.npz").position.shape == (0, 2)


def test_a_csv_has_a_header_and_si_units(trace: Trace, tmp_path: Path) -> None:
    trace.save(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 50
    assert list(rows[0]) == [
        *("sample", "time_ns", "flags", "position_m[0]", "position_m[1]"),
        *("force_N[0]", "force_N[1]", "asked_force_N[0]", "asked_force_N[1]", "time_s", "marker"),
    ]
    np.testing.assert_allclose([float(row["position_m[1]"]) for row in rows], trace.position[:, 1], rtol=1e-11)
    np.testing.assert_allclose([float(row["force_N[0]"]) for row in rows], trace.force[:, 0], rtol=1e-11)
    assert [int(row["sample"]) for row in rows] == list(range(50))
    assert [int(row["time_ns"]) for row in rows] == trace.time_ns.tolist()
    np.testing.assert_allclose([float(row["time_s"]) for row in rows], trace.sample / trace.rate, rtol=1e-11)


def test_the_time_in_a_csv_counts_sample_periods(tmp_path: Path) -> None:
    run(scene_of(2).model_copy(update={"rate": 800.0}), duration=0.05).save(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(encoding="utf-8") as table:
        times = [float(row["time_s"]) for row in csv.DictReader(table)]
    np.testing.assert_allclose(times, np.arange(40) / 800.0, rtol=1e-11)


@pytest.mark.parametrize("name", ["t.txt", "t", "t.NPZ", "t.npz.gz", ".npz", "none/t.npz", "taken.npz"])
def test_a_place_where_no_trace_can_be_written_is_refused(trace: Trace, tmp_path: Path, name: str) -> None:
    (tmp_path / "taken.npz").mkdir()
    with pytest.raises(UsageError, match=name):
        require_writable_as_trace(tmp_path / name)
    with pytest.raises(UsageError):
        trace.save(tmp_path / name)
    assert os.listdir(tmp_path) == ["taken.npz"]


def test_a_pipe_without_read_permission_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "t.trace")
    with pytest.raises(UsageError, match="no file can be written there"):
        require_writable_as_trace(tmp_path / "t.trace")


def test_a_disk_that_is_full_is_reported(trace: Trace, tmp_path: Path) -> None:
    (tmp_path / "t.csv").symlink_to("/dev/full")
    with pytest.raises(UsageError, match="cannot be written: No space left on device"):
        trace.save(tmp_path / "t.csv")


@pytest.mark.parametrize("text", [b"", b"no zip", b"PK\x03\x04 torn", b"\x93NUMPY\x01\x00"])
def test_a_file_that_is_no_trace_is_reported(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "t.npz").write_bytes(text)
    with pytest.raises(UsageError, match="not a trace that hapsim wrote"):
        load_trace(tmp_path / "t.npz")


def test_a_column_that_no_memory_holds_is_reported(trace: Trace, tmp_path: Path) -> None:
    trace.save(tmp_path / "t.npz")
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<i8", "fortran_order": False, "shape": (1 << 55,)})
    with zipfile.ZipFile(tmp_path / "t.npz") as whole, zipfile.ZipFile(tmp_path / "vast.npz", "w") as vast:
        for name in whole.namelist():
            vast.writestr(name, header.getvalue() if name == "sample.npy" else whole.read(name))
    with pytest.raises(UsageError, match="not a trace that hapsim wrote"):
        load_trace(tmp_path / "vast.npz")


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("in_report", [False, True])
def test_of_a_flipped_bit_nothing_but_a_sentence_comes(trace: Trace, tmp_path: Path, in_report: bool) -> None:
    """Or the same rows: a bit that says nothing of them."""
    path = tmp_path / "t.npz"
    trace.save(path)
    if in_report:
        about = {"sentence": "", "port": "", "when": "", "registers": {}}
        with zipfile.ZipFile(tmp_path / "t.zip", "w", zipfile.ZIP_DEFLATED) as report:
            report.writestr("report.json", json.dumps(about))
            report.writestr("frames_from_device.bin", bytes(range(256)) * 4)
            report.writestr("frames_to_device.bin", b"some bytes")
            report.writestr("trace.npz", path.read_bytes())
        path = tmp_path / "t.zip"
        assert is_report(path)
        assert read_report(path).about == about
    whole = path.read_bytes()
    readers = (load_trace, is_report, read_report) if in_report else (load_trace,)
    random = np.random.default_rng(16)
    for at in [*range(60), *range(len(whole) - 250, len(whole), 3), *random.integers(0, len(whole), 60).tolist()]:
        path.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << int(random.integers(8)))]) + whole[at + 1 :])
        for read in readers:
            with contextlib.suppress(UsageError):
                found = read(path)
                if isinstance(found, Trace):
                    np.testing.assert_array_equal(found.position, trace.position)
                    np.testing.assert_array_equal(found.force, trace.force)


def test_a_trace_that_was_cut_off_or_belongs_to_somebody_else_is_reported(trace: Trace, tmp_path: Path) -> None:
    trace.save(tmp_path / "t.npz")
    whole = (tmp_path / "t.npz").read_bytes()
    for length in (10, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.npz").write_bytes(whole[:length])
        with pytest.raises(UsageError, match=r"not a trace.*a zip file that was cut short"):
            load_trace(tmp_path / "cut.npz")
    np.savez(tmp_path / "theirs.npz", x=np.zeros(3))
    np.save(tmp_path / "array.npy", np.zeros(3))
    for name in ("theirs.npz", "array.npy", "."):
        with pytest.raises(UsageError, match="not a trace"):
            load_trace(tmp_path / name)


def test_what_is_no_trace_is_reported_as_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"there is no such file$"):
        load_trace(tmp_path / "none.npz")
    (tmp_path / "cut.csv.part").write_bytes(b"")
    with pytest.raises(UsageError, match=r"there is no such file\. .*cut\.csv\.part is there"):
        load_trace(tmp_path / "cut.csv")
    table = tmp_path / "table.csv"
    table.write_text("sample\n1\n")
    with pytest.raises(UsageError, match=r"is not read back: record a .npz or a .trace"):
        load_trace(table)
    with pytest.raises(UsageError, match=r"found a directory, expected a .npz or .trace"):
        load_trace(tmp_path)
    (tmp_path / "empty.trace").touch()
    with pytest.raises(UsageError, match=r"the file is empty; expected a .npz or .trace"):
        load_trace(tmp_path / "empty.trace")
    (tmp_path / "scene.yaml").write_text("version: 1\n")
    with pytest.raises(UsageError, match=r"neither a .npz nor a stream"):
        load_trace(tmp_path / "scene.yaml")
