"""A program's view of a running session: its state, positions, samples and parameters."""

from __future__ import annotations

import html
import math
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.program import Program, positions_of
from hapsim.device.connection import Connection
from hapsim.errors import UsageError
from hapsim.loop.buffers import force_now
from hapsim.loop.counts import Progress
from hapsim.loop.ring import sensed_by
from hapsim.recording.recorder import Recorder, Samples, Scales, Stream
from hapsim.recording.trace import Statistics
from hapsim.running import outcome
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.changes import LiveScene
from hapsim.running.live_parameters import Parameter, parameters_of, word_parameters
from hapsim.running.lsl import Outlets
from hapsim.running.places import PlaceChanges, places_in
from hapsim.running.session_options import RunOptions
from hapsim.scene import Scene
from hapsim.scene.issue import did_you_mean
from hapsim.scene.scene import AXES

_STREAM_S = 60.0  # length that a stream keeps for a late reader
_TRIES = 8  # to read all values of one sample
_MOST_ASKED = 64  # sets of names


OfDevice = Literal["lost", "paused", "waiting", "reconnected"]
EventKind = Literal[
    "armed",
    "changed",
    "saved",
    "place",
    "rejected",
    "marker",
    "pulse",
    "trial",
    "recording",
    "recorded",
    "lease",
    OfDevice,
    "guard",
    "ended",
]


@dataclass(frozen=True)
class Event:
    """An event of a run."""

    kind: EventKind
    sentence: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Parameters of `changed`, by name; of `place` the number of a detent's new place ("rests.place"); of `trial` its
    number "trial" and its "phase", "begun" or "settled"; of `lease` its "seconds", and "out", 1 from when it ran out
    until it is renewed."""
    sample: int = 0
    """Device's sample at that time, counted from arming."""
    at: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))
    """Time, UTC, ISO 8601."""
    device: str = ""
    """Name of the device, of several; its samples count."""


@dataclass(frozen=True)
class State:
    """The latest values of a running scene of C channels."""

    sample: int
    """Device's number of the newest position, counted from arming."""
    age_s: float
    """Time since that position arrived, s."""
    position: tuple[float, ...]
    """Position of each channel, (C,) m."""
    velocity: tuple[float, ...]
    """Velocity of each channel, (C,) m/s: the difference of the last two positions over the time between them."""
    force: tuple[float, ...]
    """Last sent force of each channel, (C,) N: 0 once the run is over."""
    modules: Mapping[str, float | NDArray[np.float64]]
    """Position of each point, m, in the plane by "ball.x" and "ball.y"; of all masses of a string or a membrane,
    (masses,). They are read while the loop runs: masses of one structure may differ by a sample."""
    progress: Progress
    """Phase, rate and counters."""
    places: Mapping[str, int] = field(default_factory=dict)
    """Number of the place in which the ends of each detent are that remembers it."""


def _places_in(numbers: Mapping[str, int]) -> dict[str, int | NDArray[np.int64]]:
    """Returns the index of each point in a program's rows, or the indices of a structure's masses."""
    places: dict[str, Any] = {}
    for name, number in numbers.items():
        module, _, mass = name.partition(".")
        if mass and mass not in AXES:
            places.setdefault(module, []).append(number)
        else:
            places[name] = number
    return {name: np.array(place) if isinstance(place, list) else place for name, place in places.items()}


def _numbers_of(program: Program, names: tuple[str, ...]) -> tuple[NDArray[np.intp], dict[str, list[int]]]:
    """Returns the number of each of these points in the program's rows, and where each is among them. Raises UsageError
    for an unknown name."""
    numbers, order = program.numbers, dict[str, list[int]]()
    for i, name in enumerate(names):
        if name not in numbers:
            part = name.partition(".")[0]
            masses = [one for one in numbers if one.startswith(f"{part}.")]
            near = f"one of its masses, {masses[0]} to {masses[-1]}" if masses else "a point, or a structure's mass"
            others = {one.partition(".")[0]: None for one in numbers}
            raise UsageError(f"found '{name}', expected {near}{'' if masses else did_you_mean(part, list(others))}")
        order.setdefault(name, []).append(i)
    return np.array([numbers[name] for name in names], np.intp), order


def as_html(scene: Scene, name: str, state: State, parameters: Mapping[str, Any]) -> str:
    """Returns a session as a table for a notebook: scene, device, channels and parameters."""
    progress = state.progress
    title = f"{scene.path or 'a scene'} on {name}: {progress.phase}, {progress.elapsed_s:.1f} s"
    rate = "" if progress.seen_rate_hz is None else f", {progress.seen_rate_hz:.1f} Hz"
    channels = ""
    for c, (x, v, f) in enumerate(zip(state.position, state.velocity, state.force, strict=True)):
        units = scene.units_of(c)
        cells = f"channel {c}", units(x, "m", ".6g"), units(v, "m/s", ".4g"), units(f, "N", ".4g")
        channels += f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    values = "".join(
        f"<tr><td>{html.escape(one.name)}</td><td colspan=3>{html.escape(_short(one.value))} {one.unit}</td></tr>"
        for one in parameters.values()
    )
    misses = f", {progress.deadline_misses} deadline misses of {progress.ticks} ticks"
    return f"<table><caption>{html.escape(title + rate + misses)}</caption>{channels}{values}</table>"


def _short(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_short, value[:4]))}{', …' if len(value) > 4 else ''}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


class Closing:
    """The part of a session that ends it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        failure = self._end()
        if failure is not None and (kind is None or issubclass(kind, UsageError)):  # such as "the run is over"
            raise failure

    def close(self) -> None:
        """Ends the run cleanly. Returns when the device is disarmed, the record is complete and the port is free.

        The first call raises the error that had ended the run, as `start` describes.
        """
        if (failure := self._end()) is not None:
            raise failure

    def _end(self) -> BaseException | None:
        """Ends the run and waits until everything is released. Returns its error, if that was not raised yet."""
        raise NotImplementedError


class SessionView:
    """The part of a `Session` that reads the running loop; `Session` sets the attributes."""

    markers: list[Event]
    """Events of `mark`."""
    _beginning: threading.Lock
    """Held until the event of a trial's beginning is published."""
    trials: list[tuple[int, int]]
    """First sample and number of each trial."""
    _noted_markers: int
    """Number of them in a record."""
    _lsl: Outlets | None = None
    _place_changes: PlaceChanges
    _new_notes: deque[dict[str, Any]]
    """Notes of places, settled trials and leases that ran out that no record has yet."""
    _in_python: bool
    _options: RunOptions
    _over: threading.Event
    """Set when the loop has ended."""
    _done: threading.Event
    """Set when everything has ended."""
    _connection: Connection
    _loop: LoopMemory
    _live: LiveScene
    _recorder: Recorder
    _recorded_scene: Scene
    """Scene at the beginning of the record."""
    _program: Program | None = None
    _places: Mapping[str, int | NDArray[np.int64]] = {}
    """Indices of that program's modules in its rows."""
    _asked: tuple[Program | None, dict[tuple[str, ...], tuple[NDArray[np.intp], dict[str, list[int]]]]] = (None, {})
    """Names that `positions` has looked up in a program: a picture asks for the same points 30 times a second."""
    _to_file: threading.Lock

    def __repr__(self) -> str:
        progress = self.progress()
        moved = enumerate(zip(progress.position, progress.force, strict=False))
        each = ((self.scene.units_of(c), x, force) for c, (x, force) in moved)
        channels = ", ".join(f"{units(x, 'm', '+.3g')} {units(force, 'N', '+.3g')}" for units, x, force in each)
        how = f"{progress.phase}, {progress.elapsed_s:.1f} s, {channels}, {progress.deadline_misses} misses"
        return f"<Session: {self.scene.path or 'a scene'} on {self.label}, {how}>"

    def _repr_html_(self) -> str:
        return as_html(self.scene, self.name, self.state(), self.parameters)

    @property
    def name(self) -> str:
        """Port of the device."""
        return self._connection.name

    @property
    def label(self) -> str:
        """The same in sentences: of several devices with the device's name."""
        at = self._live.scene.at
        return self.name if at is None else f"{at.device} ({self.name})"

    @property
    def scene(self) -> Scene:
        """Current scene, with every change so far."""
        return self._live.scene

    @property
    def sound_peaks(self) -> dict[str, float]:
        """Largest absolute value of each pick-up before the soft clip; 1.0 is full scale."""
        return dict(zip(self.scene.sound, self._loop.record.sound.peak.tolist(), strict=False))

    @property
    def sensed(self) -> tuple[str, ...]:
        """Names of the values that the device sends beside its positions."""
        return sensed_by(self._loop.wire.parts)

    @property
    def has_mock(self) -> bool:
        """True if the device is a mock of this process."""
        return self._connection.mock is not None

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters that may change while the scene runs, by name ("touch.stiffness"), with value, unit and bounds."""
        return parameters_of(self.scene, self.has_mock) | word_parameters(self.scene, self._live.word_values)

    def progress(self) -> Progress:
        """Returns the counters of the loop now; its phase is "ended" once it is over."""
        progress = outcome.progress_of(self._loop)
        return replace(progress, phase="ended") if self._over.is_set() else progress

    def state(self) -> State:
        """Returns the latest position, velocity and force of each channel, the position of each module, and their age.
        It takes some tens of microseconds and does not disturb the loop."""
        io, state, used = self._loop.record.io, self._loop.state, slice(self._loop.wire.channels)
        for _ in range(_TRIES):  # until no sample came meanwhile
            sample, newest = int(state.sample), int(state.newest_ns)
            here, before, gap = io.measured[used].copy(), io.before[used].copy(), max(int(state.gap), 1)
            force = force_now(io, self._loop.wire.channels)
            if sample == int(state.sample):
                break
        return State(
            sample=sample,
            age_s=max(time.monotonic_ns() - newest, 0) * 1e-9 if newest else 0.0,
            position=tuple(here.tolist()),
            velocity=tuple(((here - before) * self.scene.rate / gap).tolist()),
            force=tuple(force.tolist()),
            modules=self._modules(),
            progress=self.progress(),
            places=places_in(self._loop.program),
        )

    def positions(self, names: Sequence[str]) -> tuple[int, NDArray[np.float64]]:
        """Returns the newest sample's number, and the positions of points and masses of structures ("gut.7",
        "skin.3.4"), (names,) m. Raises UsageError for an unknown name."""
        program = self._loop.program
        asked = self._asked if self._asked[0] is program and len(self._asked[1]) < _MOST_ASKED else (program, {})
        self._asked, key = asked, tuple(names)
        numbers, order = asked[1].get(key) or asked[1].setdefault(key, _numbers_of(program, key))
        places = positions_of(program)[0][numbers].astype(np.float64)
        for name, x in self._hands().items():
            places[order.get(name, [])] = x
        return int(self._loop.state.sample), places

    def _modules(self) -> dict[str, float | NDArray[np.float64]]:
        """Returns the position of each point, m."""
        program = self._loop.program
        if program is not self._program:
            self._program, self._places = program, _places_in(program.numbers)
        row = positions_of(program)[0]
        return {
            name: row[place].astype(np.float64) if isinstance(place, np.ndarray) else float(row[place])
            for name, place in self._places.items()
        } | self._hands()

    def _hands(self) -> dict[str, float]:
        """Returns the measured positions of the hands, m: those in the program are valid only within a tick."""
        measured = self._loop.record.io.measured
        return {name: float(measured[one.channel]) for name, one in self._loop.rendered_scene.device_points.items()}

    def remembered(self, name: str) -> dict[str, float]:
        """Returns one of the numbers that links remember, by their names: "touches" of shapes (1 while they do), "side"
        of plectra (0 while they grip)."""
        memories = [part.memory for part in self._loop.program.parts if part.memory and name in part.memory.columns]
        return {link: float(one.columns[name][i]) for one in memories for i, link in enumerate(one.modules)}

    def stream(self, history_s: float = 0.0) -> Stream:
        """Returns an iterator over all `Samples` from now on, in pieces without gaps. It ends with the run. In real
        time a stream that is not read for a minute raises UsageError for the lost samples. `history_s`: seconds of
        `history` that come first."""
        rate = self.scene.rate
        longest = None if self._loop.record.ring.waits else math.ceil(_STREAM_S * rate)
        stream = Stream(self._scales(), longest, self._done.is_set, self._recorder.collect)
        self._recorder.follow(stream, math.ceil(history_s * rate))
        return stream

    def history(self) -> Samples:
        """Returns the samples of the last second, or of the last `start(history_s=...)`."""
        self._recorder.collect()
        return self._scales().samples(self._recorder.last_rows())

    def _scales(self) -> Scales:
        io, used = self._loop.record.io, slice(self._loop.wire.channels)
        return Scales(self.scene.rate, lambda name: io[f"{name}_scale"][used].copy(), self.scene.word_values)

    def subscribe(self, rate: float) -> Iterator[State]:
        """Yields the `State` `rate` times per second until the run has ended. A late reader gets the next state, not a
        backlog. Raises UsageError for an invalid rate."""
        if not (math.isfinite(rate) and rate > 0):
            raise UsageError(f"rate: found {rate}, expected how often a second, above 0 (Hz)")
        due = time.monotonic()
        while not self._over.is_set():
            yield self.state()
            due = max(due + 1.0 / rate, time.monotonic() - 1.0 / rate)
            self._over.wait(max(due - time.monotonic(), 0.0))

    def statistics(self) -> Statistics:
        """Returns lateness, exchange time and age of the force of all ticks so far."""
        return outcome.statistics_of(self._loop)
