"""Records that say what no hapsim writes, disks that are full, and links that others planted."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import resource
import signal
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hapsim.errors import HapsimError, UsageError
from hapsim.recording import report_file
from hapsim.recording.stream import MAGIC, StreamReader, _next_chunk
from hapsim.recording.trace import load_trace
from hapsim.replaying.export import Columns, export
from hapsim.replaying.replay import Record, device_of
from hapsim.running import run
from hapsim.whole_file import whole_file
from tests.one_hand import scene_of, touch
from tests.peak_memory import peak_memory

SCENE = scene_of({"touch": touch(500.0, 2.0)}, mock={"initial": {"velocity": 0.1}})
HEADS = 60
MOST_MB = 200.0  # beside what was there before: a mutated head of 20 kB
ODD: list[Any] = [
    None,
    True,
    -1,
    2**31,
    2**70,
    10**300,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "x",
    [],
    {},
    [1e300] * 3,
]


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("records") / "whole.trace"
    run(SCENE, duration=2.0, record=path, keep=False)
    return path


def with_head(record: Path, text: bytes) -> bytes:
    """The record with another head, whose check is right."""
    whole = record.read_bytes()
    at = len(MAGIC)
    kind, count, size, _ = struct.unpack_from("<4sIII", whole, at)
    check = zlib.crc32(text, zlib.crc32(kind + struct.pack("<II", count, len(text))))
    return MAGIC + struct.pack("<4sIII", kind, count, len(text), check) + text + whole[at + 16 + size :]


def head_of(record: Path) -> Any:
    whole, at = record.read_bytes(), len(MAGIC)
    return json.loads(whole[at + 16 : at + 16 + struct.unpack_from("<4sIII", whole, at)[2]])


def places(document: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if at:
        yield at
    if isinstance(document, dict | list):
        for key in document if isinstance(document, dict) else range(len(document)):
            yield from places(document[key], (*at, key))


def test_every_mutated_head_loads_or_ends_with_a_sentence_in_little_memory(record: Path, tmp_path: Path) -> None:
    chance, path = random.Random(1), tmp_path / "mutated.trace"
    refused = 0
    with peak_memory() as grown:
        for _ in range(HEADS):
            head = head_of(record)
            for place in chance.sample(list(places(head)), chance.choice((1, 1, 2))):
                inner = head
                with contextlib.suppress(KeyError, IndexError, TypeError):  # within what the first mutation took away
                    for key in place[:-1]:
                        inner = inner[key]
                    inner[place[-1]] = chance.choice(ODD)
            path.write_bytes(with_head(record, json.dumps(head).encode()))
            for read in (load_trace, Record, lambda one: list(Columns(one).pieces()), device_of):
                try:
                    read(path)
                except HapsimError:
                    refused += 1
    assert refused > HEADS
    assert grown[0] < 1e6 * MOST_MB


@pytest.mark.parametrize("key", ["velocity", "by_host", "position_scale", "force_scale", "run", "told"])
def test_a_head_is_what_its_model_writes(record: Path, tmp_path: Path, key: str) -> None:
    path = tmp_path / "damaged.trace"
    for text in (json.dumps(head_of(record) | {key: 2**70}).encode(), b"[" * 100_000):
        path.write_bytes(with_head(record, text))
        with pytest.raises(UsageError, match="the record is damaged: "):
            StreamReader(path)


@contextlib.contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """No file grows beyond `size` bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_reported_in_a_sentence_and_leaves_nothing(record: Path, tmp_path: Path) -> None:
    """HDF5 crashed, or printed its own words, where a write failed."""
    pytest.importorskip("h5py")
    pytest.importorskip("mcap.writer")
    for ending in ("csv", "npz", "wav", "mcap", "h5"):
        out, columns = tmp_path / f"out.{ending}", Columns(record)
        with (
            pytest.raises(UsageError, match=rf"out\.{ending}: the file cannot be written: File too large$"),
            files_of_at_most(3000),
        ):
            export(columns, out, "position.0" if ending == "wav" else None, lambda _: None)
    assert list(tmp_path.iterdir()) == []


def test_a_record_keeps_the_rows_that_there_was_room_for(tmp_path: Path) -> None:
    path = tmp_path / "cut.trace"
    try:
        with files_of_at_most(400_000):
            trace = run(SCENE, duration=30.0, record=path, keep=False)
    except HapsimError as error:
        assert "File too large" in str(error)  # noqa: PT017
        trace = error.trace  # type: ignore[attr-defined]
    kept = load_trace(path).sample.size
    assert 0 < kept < 30_000
    assert trace is None or trace.report.unrecorded_rows == 30_000 - kept


def test_no_planted_link_is_written_through(record: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    out = tmp_path / "out.csv"
    with whole_file(out) as one, whole_file(out) as other:
        assert one.name != other.name
        one.write_text("")
        other.write_text("")
    (tmp_path / "run.npz.part").symlink_to(victim)
    (tmp_path / "run.npz.part.whole").symlink_to(victim)
    with pytest.raises(UsageError, match="cannot be written"):
        run(SCENE, duration=0.1, record=tmp_path / "run.npz", keep=False)
    export(Columns(record), out, None, lambda _: None)
    assert victim.read_text() == "mine"


def test_a_report_is_begun_at_no_name_that_a_link_can_be_planted_at(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begun: list[str] = []

    class BegunError(Exception):
        pass

    def note(path: Path, *_: Any) -> None:
        begun.append(Path(path).name)
        raise BegunError

    monkeypatch.setattr(report_file.zipfile, "ZipFile", note)
    monkeypatch.setattr(report_file, "asdict", lambda _: {})
    monkeypatch.setattr(report_file, "to_registers", lambda _: [])
    monkeypatch.setattr(report_file, "last_frames", lambda _: b"")
    trace: Any = SimpleNamespace(write_npz=lambda _: None, report=SimpleNamespace(ending="done", released=True))
    failure: Any = SimpleNamespace(exit_status=4)
    scene: Any = SimpleNamespace(to_yaml=lambda: "")
    wire: Any = SimpleNamespace(from_device=None, to_device=None)
    for _ in range(2):
        with pytest.raises(BegunError):
            report_file.write_report(tmp_path, "port", failure, trace, scene, None, wire)
    assert len({name.rpartition(".")[2] for name in begun}) == 2
    assert str(os.getpid()) not in " ".join(begun)


def test_no_more_of_a_chunk_is_read_than_the_file_has(tmp_path: Path) -> None:
    asked: list[int] = []

    class Counted(io.FileIO):
        def read(self, size: int = -1) -> bytes:
            asked.append(size)
            return super().read(size)

    path = tmp_path / "cut.trace"
    path.write_bytes(b"ROWS" + (9).to_bytes(4, "little") + (1 << 25).to_bytes(4, "little") + bytes(100))
    with Counted(path) as stream:
        assert _next_chunk(stream) is None  # type: ignore[arg-type]
    assert max(asked) <= 100
