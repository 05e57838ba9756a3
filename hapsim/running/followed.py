"""What a program sees of a running session, and what it may note and record meanwhile."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.description import Description
from hapsim.device.connection import Connection
from hapsim.errors import UsageError
from hapsim.progress import Progress
from hapsim.recording.feed import Samples, Scales, Stream
from hapsim.recording.recorder import Recorder, RecordFile
from hapsim.recording.stream import Head
from hapsim.recording.trace import Report, Statistics, require_writable_as_trace
from hapsim.running import outcome
from hapsim.running.assemble import LoopMemory
from hapsim.running.changes import OVER, LiveScene
from hapsim.running.options import RunOptions
from hapsim.running.parameters import Parameter, parameters_of
from hapsim.running.recorded_run import run_of
from hapsim.running.state import Event, EventKind, State, StateReader
from hapsim.scene import Scene

_STREAM_S = 60.0  # that a stream keeps for who reads it late


class Followed:
    """The part of a `Session` that reads the loop beside it; `Session` sets the attributes."""

    markers: list[Event]
    """Of `mark`."""
    _noted_markers: int
    """How many of them a record has."""
    _description: Description
    _in_python: bool
    _options: RunOptions
    _over: threading.Event
    """The loop has ended."""
    _done: threading.Event
    """Everything has."""
    _connection: Connection
    _loop: LoopMemory
    _live: LiveScene
    _recorder: Recorder
    _recorded_scene: Scene
    """As it was when the record began."""
    _state: StateReader
    _to_file: threading.Lock

    @property
    def scene(self) -> Scene:
        """The scene as it is now, with every change that was made."""
        return self._live.scene

    @property
    def sound_peaks(self) -> dict[str, float]:
        """The largest size that each pick-up has had, before the soft clip; 1.0 is full scale."""
        return dict(zip(self.scene.sound, self._loop.record.sound.peak.tolist(), strict=False))

    @property
    def has_mock(self) -> bool:
        """Whether its device is a mock of this process."""
        return self._connection.mock is not None

    @property
    def parameters(self) -> dict[str, Parameter]:
        """What may change while the scene runs, by name ("touch.stiffness"), with its value, unit and bounds."""
        return parameters_of(self.scene, self.has_mock)

    def progress(self) -> Progress:
        """Returns the counters of the loop now; its phase is "ended" once it is over."""
        progress = outcome.progress_of(self._loop)
        return replace(progress, phase="ended") if self._over.is_set() else progress

    def state(self) -> State:
        """Returns the latest position, velocity and force of each channel, the position of each module, and how old
        they are. It takes some tens of microseconds, and the loop does not notice."""
        return self._state.read(self.progress())

    def positions(self, names: Sequence[str]) -> tuple[int, NDArray[np.float64]]:
        """Returns the newest sample's number, and where points and masses of structures ("gut.7", "skin.3.4") are:
        (names,) m. Raises UsageError where there is no such one."""
        return self._state.positions(names)

    def stream(self, history_s: float = 0.0) -> Stream:
        """Returns an iterator over all `Samples` from now on, without gaps, in pieces as they come. It ends with the
        run. In real time one that is not read for a minute raises UsageError for the samples that are lost.
        `history_s`: seconds of `history` that come first."""
        rate = self.scene.rate
        longest = None if self._loop.record.ring.waits else math.ceil(_STREAM_S * rate)
        stream = Stream(self._scales(), longest, self._done.is_set, self._recorder.collect)
        self._recorder.follow(stream, math.ceil(history_s * rate))
        return stream

    def history(self) -> Samples:
        """Returns the last samples: those of a second, or of `start(history_s=...)`."""
        self._recorder.collect()
        return self._scales().samples(self._recorder.last_rows())

    def _scales(self) -> Scales:
        io, used = self._loop.record.io, slice(self._loop.wire.channels)
        return Scales(self.scene.rate, io.position_scale[used].copy(), io.force_scale[used].copy())

    def subscribe(self, rate: float) -> Iterator[State]:
        """Yields the `State` `rate` times per second until the run has ended. Who is late gets the next one, not a
        backlog."""
        if not (math.isfinite(rate) and rate > 0):
            raise UsageError(f"rate: found {rate}, expected how often a second, above 0 (Hz)")
        due = time.monotonic()
        while not self._over.is_set():
            yield self.state()
            due = max(due + 1.0 / rate, time.monotonic() - 1.0 / rate)
            self._over.wait(max(due - time.monotonic(), 0.0))

    def mark(self, text: str = "") -> Event:
        """Notes that something happened at this sample; returns the event. `markers` lists them."""
        event = self._tell("marker", text)
        self.markers.append(event)
        return event

    def record(self, path: str | Path) -> None:
        """Begins to write every sample from now on to `path`, a new .trace, .npz or .csv. UsageError where it cannot,
        or where a record is being written."""
        self._require_running()
        with self._to_file:
            if self._recorder.file is not None:
                raise UsageError(f"{path}: {self._recorder.file.path} is being recorded: stop that first")
            require_writable_as_trace(Path(path))
            if Path(path).exists():
                raise UsageError(f"{path}: the file exists; it was not touched")
            self._recorder.use_file(self._begin_record(self.scene, Path(path)))
        self._tell("recording", str(path))

    @property
    def recording(self) -> Path | None:
        """The file that is being written; None where there is none."""
        file = self._recorder.file
        return None if file is None else file.path

    def stop_recording(self) -> Path | None:
        """Ends the record that is being written, and returns its file; None where there is none."""
        with self._to_file:
            file = self._recorder.use_file(None)
        if file is None:
            return None
        file.finish(outcome.report_of(self.scene, self._loop, "running"), outcome.statistics_of(self._loop))
        self._tell("recorded", file.problem or str(file.path))
        return file.path

    def _tell(self, kind: EventKind, sentence: str = "", values: Mapping[str, Any] | None = None) -> Event:
        event = Event(kind, sentence, values or {}, int(self._loop.state.sample))
        if self._options.on_event is not None:
            self._options.on_event(event)
        return event

    def statistics(self) -> Statistics:
        """Returns lateness, exchange time and age of the force of all ticks so far."""
        return outcome.statistics_of(self._loop)

    def _take_notes(self) -> list[dict[str, Any]]:
        """What is noted in a record: changes of the scene, and markers."""
        new = self.markers[self._noted_markers :]
        self._noted_markers += len(new)
        return self._live.take_notes() + [{"marker": one.sentence, "sample": one.sample, "at": one.at} for one in new]

    def _begin_record(self, scene: Scene, path: Path) -> RecordFile:
        loop, io = self._loop, self._loop.record.io
        self._recorded_scene = scene
        position, force = (scale[: loop.wire.channels].tolist() for scale in (io.position_scale, io.force_scale))
        run = run_of(scene, loop, self._description, self._connection.behind_port, self._in_python, self._options)
        head = Head(
            scene.rate,
            position,
            force,
            scene.path or "",
            datetime.now(UTC).isoformat(),
            velocity=loop.wire.velocity,
            by_host=scene.device.clock == "host",
            run=run,
        )

        def report_so_far() -> tuple[Report, Statistics]:
            return outcome.report_of(scene, loop, "running"), outcome.statistics_of(loop)

        return RecordFile(path, head, report_so_far, self._options.on_warning or (lambda _: None))

    def _require_running(self) -> None:
        if self._over.is_set():
            raise UsageError(OVER)
