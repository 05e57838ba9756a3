"""The reader of the loop's ring: it keeps rows for a trace in memory, or writes them to a file during the run."""

from __future__ import annotations

import itertools
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import ACTED, Ring, sensed_in, words_in
from hapsim.recording.background_file import BackgroundFile, in_words, lock
from hapsim.recording.report import Report, Statistics, summary_document
from hapsim.recording.stream import Head, StreamReader, StreamWriter
from hapsim.recording.trace import convert
from hapsim.whole_file import whole_file


class Recorder:
    """The ring's reader. `keep`: False frees all rows but about the last `recent`. Every `Stream` gets the rows."""

    def __init__(
        self, ring: Ring, keep: bool, recent: int = 1, notes: Callable[[], list[dict[str, Any]]] = list
    ) -> None:
        """Makes a reader. `notes()`: returns the notes since the last call, for a file."""
        self._ring, self._keep, self._recent, self._notes = ring, keep, recent, notes
        self._lock = threading.Lock()
        self._kept: list[NDArray[Any]] = []
        self._last = deque([ring.drain()])
        self._held: list[tuple[NDArray[Any], list[dict[str, Any]]]] | None = None  # rows and notes for the next file
        self._streams: weakref.WeakSet[Stream] = weakref.WeakSet()
        self.file: RecordFile | None = None
        """The file that is written during the run, or None."""
        self.on_rows: Callable[[NDArray[Any]], None] = lambda _: None
        """Called with all new rows."""

    def collect(self) -> None:
        """Empties the ring; from any thread."""
        with self._lock:
            rows = self._ring.drain()
            notes = self._notes()  # after the rows: none of them was made by a change that is not noted
            if self.file is not None:
                self.file.take_notes(notes)
            if self._held is not None:
                self._held.append((rows, notes))
            if not rows.size:
                return
            self.on_rows(rows)
            if self._keep:
                self._kept.append(rows)
            self._last.append(rows)
            while sum(one.size for one in self._last) - self._last[0].size >= self._recent:
                self._last.popleft()
            for stream in list(self._streams):
                stream.put(rows)
            if self.file is not None:
                self.file.put(rows, patient=bool(self._ring.record.waits))

    def follow(self, stream: Stream, before: int = 0) -> None:
        """Sends `stream` the last `before` rows and every later one, until the stream is deleted."""
        self.collect()
        with self._lock:
            rows = np.concatenate(list(self._last))[-before:] if before else self._last[0][:0]
            if rows.size:
                stream.put(rows)
            self._streams.add(stream)

    def hold(self) -> None:
        """Holds rows and notes from now on for the file of the next `use_file`."""
        with self._lock:
            self._held = []

    def use_file(self, file: RecordFile | None, tick: int = 0, sample: int = -1) -> RecordFile | None:
        """Writes the rows from now on to `file`, and those held since `hold`: from this tick on, behind this
        sample. Returns the file before."""
        self.collect()
        with self._lock:
            for rows, notes in self._held or ():
                if file is not None:
                    later = [one for one in notes if one.get("tick", tick) >= tick]
                    file.take_notes(one for one in later if one.get("sample", sample + 1) > sample)
                    file.put(rows[rows["sample"] > sample])
            self._held = None
            self.file, before = file, self.file
        return before

    def rows(self) -> NDArray[Any]:
        """Returns all kept rows."""
        return np.concatenate([self._last[0][:0], *self._kept])

    def last_rows(self, count: int | None = None) -> NDArray[Any]:
        """Returns the last `count` rows, or all `recent` ones."""
        with self._lock:
            rows = list(self._last)
        return np.concatenate(rows)[-(count or self._recent) :]


class RecordFile(BackgroundFile):
    """A record under way. A .trace is itself a stream; that of a .npz or .csv is FILE.part until the run ends."""

    def __init__(
        self,
        path: Path,
        head: Head,
        report_so_far: Callable[[], tuple[Report, Statistics]],
        on_warning: Callable[[str], None],
    ) -> None:
        """Opens the file, or raises UsageError. The writing thread calls `on_warning` if the disk fails."""
        super().__init__(path, on_warning, "record", "row")
        self._summary = lambda: summary_document(*report_so_far(), False)
        try:
            self._part, descriptor = _open_free(path)
            self._writer = StreamWriter(descriptor, head, self._summary())
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {in_words(error)}") from error
        self._start()

    def finish(self, report: Report, statistics: Statistics, notes: Iterable[dict[str, Any]] = ()) -> Report:
        """Writes the backlog, the last notes, the report and the histograms, and makes the requested file. Returns the
        report, with the number of rows that were not written."""
        self._join()
        report = replace(report, unrecorded_rows=self.unwritten)
        try:
            for note in notes:
                self._writer.write_note(note)
            self._writer.write_summary(summary_document(report, statistics, True))
            if self._part != self._path:  # under its own name the file is whole, or the older file stays
                with whole_file(self._path) as whole:
                    convert(StreamReader(self._part), whole, self._path.suffix)
                self._part.unlink()
        except Exception as error:  # of the disk, or of a damaged stream
            self.failure = self.failure or in_words(error)
        self._writer.close()
        return report

    @property
    def path(self) -> Path:
        """The requested file."""
        return self._path

    @property
    def written(self) -> int:
        """Rows in the file."""
        return self._writer.written

    def _write(self, rows: NDArray[Any]) -> None:
        self._writer.write_rows(rows)

    def _write_note(self, note: dict[str, Any]) -> None:
        self._writer.write_note(note)

    def _summarize(self) -> None:
        self._writer.write_summary(self._summary())


def _open_free(path: Path) -> tuple[Path, int]:
    """Returns the stream's file and its descriptor, empty and locked for this run. The part of a killed run stays: the
    next is FILE.part2. Raises UsageError if another run writes there."""
    flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0)
    if path.suffix != ".trace":  # a name that the user did not give, where anyone may have planted a link
        flags |= getattr(os, "O_NOFOLLOW", 0)
    parts = (path.with_name(f"{path.name}.part{number if number > 1 else ''}") for number in itertools.count(1))
    for part in itertools.repeat(path) if path.suffix == ".trace" else parts:
        descriptor = os.open(part, flags, 0o666)
        try:
            lock(descriptor, part, "record")
            if part == path and os.fstat(descriptor).st_size:
                os.ftruncate(descriptor, 0)
            if os.fstat(descriptor).st_size == 0:
                return part, descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    raise AssertionError


_WAIT_S = 0.1  # interval between two checks whether the run is over


@dataclass(frozen=True)
class Samples:
    """N samples of C channels, in the order in which the positions arrived."""

    sample: NDArray[np.int64]
    """(N,) the device's number of each position, counted from arming."""
    time_ns: NDArray[np.int64]
    """(N,) monotonic time at which it arrived."""
    flags: NDArray[np.uint8]
    """(N,) of hapsim.loop.ring."""
    position: NDArray[np.float64]
    """(N, C) m."""
    velocity: NDArray[np.float64]
    """(N, C) m/s: the backward difference of the positions."""
    force: NDArray[np.float64]
    """(N, C) N, that was sent; where the device follows lines, that of the sample which ended with the position."""
    sensed: NDArray[np.float64]
    """(N, S C) m/s and m/s², sent beside the positions: the velocities, then the accelerations."""
    words: NDArray[np.uint32]
    """(N, W) values of the scene's inputs (1: on), then of its outputs."""

    def __len__(self) -> int:
        return int(self.sample.size)


class Scales:
    """Rows of `row_type` -> `Samples`, one piece after the other.

    `rate`: Hz; `scale_of`: of "position", "force" and what is sensed: (C,) SI units per count. `word_values`: of a
    scene."""

    def __init__(
        self,
        rate: float,
        scale_of: Callable[[str], NDArray[np.float64]],
        word_values: Callable[..., dict[str, Any]] = lambda **_: {},
    ) -> None:
        self._rate, self._scale_of, self._word_values = rate, scale_of, word_values
        self._position, self._force = scale_of("position"), scale_of("force")
        self._before: NDArray[Any] | None = None  # the last row of the piece before

    def samples(self, rows: NDArray[Any]) -> Samples:
        """Returns the samples of the rows that follow those of the last call."""
        before = rows[:1] if self._before is None else self._before
        if rows.size:
            self._before = rows[-1:].copy()
        counts = np.concatenate([before, rows])["position_counts"].astype(np.float64)
        apart = np.maximum(np.diff(rows["sample"], prepend=before["sample"]), 1)
        words = [*self._word_values(**of_rows).values()] if (of_rows := words_in(rows)) else []
        return Samples(
            sample=rows["sample"].copy(),
            time_ns=rows["time_ns"].copy(),
            flags=rows["flags"].copy(),
            position=rows["position_counts"] * self._position,
            velocity=np.diff(counts, axis=0) * self._position * self._rate / apart[:, None],
            force=rows[ACTED] if ACTED in (rows.dtype.names or ()) else rows["force_counts"] * self._force,
            sensed=np.hstack([np.zeros((rows.size, 0)), *sensed_in(rows, self._scale_of).values()]),
            words=np.stack(words, axis=1) if words else np.zeros((rows.size, 0), np.uint32),
        )


class Stream:
    """An iterator over all later `Samples` of a run; it ends with the run.

    It holds samples until they are taken. In real time, beyond `longest` rows, it drops them and `next` raises."""

    def __init__(self, scales: Scales, longest: int | None, is_over: Any, collect: Any) -> None:
        """Makes a stream. `longest`: None for no limit, in virtual time. `is_over()`: True once no more rows come.
        `collect()`: fetches the newest ones."""
        self._scales, self._longest, self._is_over, self._collect = scales, longest, is_over, collect
        self._waiting: deque[NDArray[Any]] = deque()
        self._count, self._lost = 0, 0
        self._news = threading.Condition()

    def put(self, rows: NDArray[Any]) -> None:
        """Adds rows; called by the thread that empties the ring."""
        with self._news:
            if self._longest is not None and self._count + rows.size > self._longest:
                self._lost += self._count + rows.size
                self._waiting.clear()
                self._count = 0
            else:
                self._waiting.append(rows)
                self._count += rows.size
            self._news.notify_all()

    def __iter__(self) -> Iterator[Samples]:
        return self

    def __next__(self) -> Samples:
        while True:
            was_over = self._is_over()
            if (samples := self.take()) is not None:
                return samples
            if was_over:
                raise StopIteration
            with self._news:
                self._news.wait_for(lambda: self._count > 0 or self._lost > 0, _WAIT_S)

    def take(self, most: int | None = None) -> Samples | None:
        """Returns the samples since the last call, at most `most`, without waiting; None if there are none. Raises
        UsageError if some were lost."""
        self._collect()
        with self._news:
            lost, self._lost = self._lost, 0
            left, rows = self._count if most is None else min(most, self._count), []
            self._count -= left
            while left:
                piece = self._waiting.popleft()
                rows.append(piece[:left])
                if piece.size > left:
                    self._waiting.appendleft(piece[left:])
                left -= rows[-1].size
        if lost:
            raise UsageError(f"the stream was read too late: {lost} samples are lost. Read it more often")
        return self._scales.samples(np.concatenate(rows)) if rows else None
