"""A program's view of a running session: its state, and the methods that change, mark and record it."""

from __future__ import annotations

import html
import math
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.program import Program, positions_of
from hapsim.device.connection import Connection
from hapsim.device.open_connection import on_device
from hapsim.errors import UsageError
from hapsim.loop.buffers import force_now
from hapsim.loop.counts import Progress
from hapsim.loop.ring import sensed_by
from hapsim.recording.recorder import Recorder, RecordFile, Samples, Scales, Stream
from hapsim.recording.stream import Head
from hapsim.recording.times import clock_now
from hapsim.recording.trace import Report, Statistics, require_writable_as_trace
from hapsim.running import outcome
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.changes import OVER, Changes, LiveScene
from hapsim.running.live_parameters import Parameter, by_part, parameters_of, plain, word_parameters
from hapsim.running.lsl import Outlets
from hapsim.running.places import PlaceChanges, places_in
from hapsim.running.pulse_shapes import Pulse, require_possible
from hapsim.running.recorded_run import run_of
from hapsim.running.saving import save
from hapsim.running.session_options import RunOptions
from hapsim.running.snapshot import LoopState
from hapsim.running.trials import Code, trial_changes
from hapsim.scene import Scene
from hapsim.scene.issue import did_you_mean
from hapsim.scene.load import SceneSource, as_scene
from hapsim.scene.scene import AXES

_STREAM_S = 60.0  # length that a stream keeps for a late reader
_POLL_S = 1e-3
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


def _by_name(changes: Changes) -> dict[str, Any]:
    return {f"{part}.{key}": value for part, keys in changes.items() for key, value in keys.items()}


class SessionView:
    """The part of a `Session` that reads and changes the running loop; `Session` sets the attributes."""

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
        return f"<Session: {self.scene.path or 'a scene'} on {self.name}, {how}>"

    def _repr_html_(self) -> str:
        return as_html(self.scene, self.name, self.state(), self.parameters)

    @property
    def name(self) -> str:
        """Port of the device."""
        return self._connection.name

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

    def set(self, changes: Changes, over: float = 0.02) -> None:
        """Changes parameters between two samples, all or none: `{"touch": {"stiffness": 500.0, "damping": 2.0},
        "wall": {"position": 0.01}}`, or by path, `{"touch.stiffness": 500.0}`, in the scene's names: numbers
        in SI units, or quantities such as "0.5 N/mm".

        The values ramp to their targets within `over` seconds (0: at once); no value moves by more than 1.5/N of its
        way in one of the N samples. A `set` during another's ramp retargets it: all values arrive together. If the
        energy guard is enabled, it slows a change that would give the hand too much energy, with all values in step.
        Tables of `nonlinear` (lists of points) and the shape of a `detent` crossfade the scene, as `adopt` does.
        "mock.hand" is the hand that holds the mock: it ramps along a straight line, for 4 ms at least.

        Raises UsageError, and changes nothing, if a name, a key or a value is wrong, if the parameter cannot change
        while the scene runs, or, with `start(unstable=False)`, if the changed scene is predicted unstable.
        """
        self._require_changeable()
        changes, over = plain(changes), plain(over)
        changes = by_part(changes, self.scene) if isinstance(changes, Mapping) else changes
        self._live.set(changes, over)
        self._publish("changed", values=_by_name(changes))

    def trial(
        self,
        number: int,
        set: Mapping[str, Any] | None = None,
        restart: Sequence[str] = (),
        code: Code = None,
        over: float = 0.02,
    ) -> Event:
        """Begins a trial between two samples, all of it or nothing. Returns its event, with the first sample.

        * `set`: values, as for the method `set`, reached within `over` seconds.
        * `restart`: modules that return to their initial state: the scene crossfades within `over`, and they do not
          continue in the new one. Their live values stay.
        * `code`: a number on the output `code`, or on the only one that programs set; or `{"name": 17}`. The first
          sample of the trial has it. It stays until it is set again.

        When ramp and crossfade are over, an event of the same kind has the phase "settled" and the last sample of them.
        Records note the trial, and `Trace.trial` has its number from the first sample on.

        Raises UsageError, and changes nothing, for what `set` refuses, for an unknown module or output, for a code that
        the output has no bits for, and while another trial begins.
        """
        self._require_changeable()
        number, set, restart, code, over = plain((number, {} if set is None else set, restart, code, over))
        changes = trial_changes(self.scene, number, set, restart, code)
        self._wait_for_first_sample()
        with self._beginning:
            self._live.trial(number, changes, restart, over)
            sample = self._live.begun_in()
            self.trials.append((sample, number))
            if changes:
                self._publish("changed", values=_by_name(changes))
            values = {"trial": number, "phase": "begun"}
            return self._publish("trial", f"trial {number} has begun", values, sample)

    def adopt(self, scene: Scene, over: float = 0.02) -> None:
        """Changes to `scene`. If only live parameters differ, this is `set`. Otherwise its modules are compiled in the
        background. The loop then moves both scenes for `over` seconds and crossfades the force, by no more than 1.5/N
        of the difference in one of the N samples.

        Modules of the same name and type continue from their state: points with their velocities, live parameters, the
        memory of links. Raises UsageError, and changes nothing, if the rate, the device or the mock differ, if the
        device has too few channels or does not send the velocities that are needed, if the scene is predicted unstable
        (except with `start(unstable=True)`), or if it is too large for its scheme.
        """
        self._require_changeable()
        self._live.adopt(on_device(scene, self._options.transport), plain(over))
        self._publish("changed")

    def pulse(self, channel: int, shape: str, force: float, seconds: float, periods: float | None = None) -> Event:
        """Adds a pulse of force to the scene's, from the next sample on: a "click" (half a sine), a "knock" (a decay)
        or a "buzz" (a sine of this number of `periods`). `force`: its largest, N (N·m on a rotary channel). `seconds`:
        its length, at most 5. Returns its event, with the first sample. Limits apply to the sum. A pulse is lowered
        when its work on the hand would exceed the energy that live changes may add.

        Raises UsageError for an unknown shape, a channel that the scene does not have or on which another pulse runs, a
        force beyond the limit, or a length that the loop cannot render.
        """
        self._require_changeable()
        pulse = Pulse(*plain((channel, shape, force, seconds, periods)))
        require_possible(pulse, self.scene, self._loop.setting.description.force_limit)
        if self._options.excitation is not None:
            raise UsageError("found a run that an excitation moves, expected one without, to add a pulse")
        self._wait_for_first_sample()
        self._live.pulse(pulse)
        return self._publish("pulse", pulse.describe(self.scene), asdict(pulse), self._live.begun_in())

    def lease(self, seconds: float | None, fallback: SceneSource | None = None, *, owner: object = None) -> None:
        """Promises to call this again within `seconds` (0.005 to 3600): begins a lease, or renews it. None ends it.

        The loop itself counts. When the lease runs out, the force of `fallback` takes over from the scene's within
        50 ms, or longer where that adds energy. Until the lease is renewed or ended, other changes are refused.
        `fallback`: a scene, or the path of one, at the same rate and on the same device [default: nothing but dampers,
        of nine tenths of what the device's friction makes passive in any hand]. It begins anew each time, its
        hands where they are, and stays that of the lease. `owner`: who asks; another owner may neither renew nor end
        the lease before it has run out. Beginning takes as long as fallback and takeover have to be compiled and
        predicted; renewing takes no time.

        Raises UsageError, and changes nothing, for a wrong time, for a fallback that cannot run in the scene's place,
        if scene, fallback or their mean at any weight is predicted unstable, with `law: board` or a predictor, and for
        another fallback while a lease is on.
        """
        self._require_running()
        scene = None if fallback is None else as_scene(fallback)
        self._publish_lease(self._live.ask_for_lease(plain(seconds), scene, owner))

    def renew(self, *, owner: object = None) -> None:
        """Renews the lease for as long as before; once it has run out anyone may. Raises UsageError if there is none,
        or if another owner holds it."""
        self._require_running()
        self._publish_lease(self._live.lease.renew(owner))

    def _publish_lease(self, news: str) -> None:
        if news:
            self._publish("lease", news, self.lease_state | {"out": 0})

    @property
    def lease_state(self) -> dict[str, Any]:
        """The lease as its events say it: its "seconds", None if there is none, and "out"."""
        return {"seconds": self._live.lease.seconds, "out": int(self._live.lease.is_out)}

    def save(self, path: str | Path | None = None) -> Path:
        """Writes the live values into the scene's own file, in their places: comments, units and order stay. Returns
        the file. `path`: a new file for the whole scene, which is its own from then on.

        Raises UsageError, and leaves the file as it is, if the scene has no file of its own (a shipped scene, standard
        input), if the file cannot be written or was changed since it was read, if a value stands there for others too
        (an anchor), or if the new file exists.
        """
        with self._to_file:
            file = save(self.scene, path)
            self._live.note_saved(file)
        self._publish("saved", file.path or "")
        return Path(file.path or "")

    def mark(self, text: str = "") -> Event:
        """Marks this sample. Returns the event; `markers` lists all of them."""
        event = self._publish("marker", str(text))
        self.markers.append(event)
        return event

    def record(self, path: str | Path) -> None:
        """Begins to write every sample from now on to `path`, a new .trace, .npz or .csv. A .trace also has the state
        of the scene at its first sample, so that it can be replayed. Raises UsageError if it cannot write, or if a
        record is being written."""
        self._require_running()
        with self._to_file:
            if self._recorder.file is not None:
                raise UsageError(f"{path}: {self._recorder.file.path} is being recorded: stop that first")
            require_writable_as_trace(Path(path))
            if Path(path).exists():
                raise UsageError(f"{path}: the file exists; it was not touched")
            file, state = None, None
            self._recorder.hold()
            try:
                state = self._live.state()
                file = self._begin_record(Path(path), state)
            finally:
                self._recorder.use_file(file, *((state.tick, state.sample) if state else ()))
        self._publish("recording", str(path))

    @property
    def recording(self) -> Path | None:
        """File that is being written; None if no record is."""
        file = self._recorder.file
        return None if file is None else file.path

    def stop_recording(self) -> Path | None:
        """Ends the record that is being written. Returns its file; None if there was none, or the run has ended it."""
        with self._to_file:
            file = None if self._over.is_set() else self._recorder.use_file(None)
        if file is None:
            return None
        file.finish(*outcome.report_of(self.scene, self._loop, "running"))
        self._publish("recorded", file.problem or str(file.path))
        return file.path

    def _publish(
        self, kind: EventKind, sentence: str = "", values: Mapping[str, Any] | None = None, sample: int | None = None
    ) -> Event:
        newest = self._newest()
        return self._announce(Event(kind, sentence, values or {}, newest[0] if sample is None else sample), newest)

    def _announce(self, event: Event, newest: tuple[int, int] | None = None) -> Event:
        """Passes an event to all who want them. `newest`: of `_newest`, at its time [default: now]."""
        if self._options.on_event is not None:
            self._options.on_event(event)
        if self._lsl is not None:
            sample, newest_ns = newest or self._newest()
            time_ns = newest_ns - round((sample - event.sample) * 1e9 / self.scene.rate)
            self._lsl.send_event(event.kind, event.sentence, event.values, time_ns)
        return event

    def _newest(self) -> tuple[int, int]:
        """Returns the newest sample and the time at which its position arrived, ns."""
        state, sample = self._loop.state, -1
        while sample != int(state.sample):  # until no sample came meanwhile
            sample, newest_ns = int(state.sample), int(state.newest_ns)
        return sample, newest_ns

    def _publish_news(self) -> None:
        """Publishes that a trial has settled, and what detents remember anew; from the one thread that empties the
        ring."""
        if self._beginning.acquire(blocking=False):  # else the event of the beginning, which comes first, is not out
            for number, sample in self._live.take_settled():
                self._new_notes.append({"settled": number, "sample": sample})
                self._publish("trial", f"trial {number} has settled", {"trial": number, "phase": "settled"}, sample)
            self._beginning.release()
        for new in self._place_changes.new(self._loop):
            self._new_notes.append(new._asdict())
            self._announce(Event("place", "", {f"{new.name}.place": new.place}, new.sample))

    def _publish_lease_ends(self) -> None:
        for sample in self._live.lease.new_ends():
            self._new_notes.append({"lease_ran_out": sample, "sample": sample})
            self._publish("lease", "ran out: the fallback takes over", self.lease_state | {"out": 1}, sample)

    def statistics(self) -> Statistics:
        """Returns lateness, exchange time and age of the force of all ticks so far."""
        return outcome.statistics_of(self._loop)

    def _take_notes(self) -> list[dict[str, Any]]:
        """Returns the new notes of a record: changes of the scene, markers, new places of detents, settled trials."""
        new = self.markers[self._noted_markers :]
        self._noted_markers += len(new)
        marked = [{"marker": one.sentence, "sample": one.sample, "at": one.at} for one in new]
        others = [self._new_notes.popleft() for _ in range(len(self._new_notes))]
        return self._live.take_notes() + marked + others

    def _begin_record(self, path: Path, state: LoopState | None = None) -> RecordFile:
        loop, io = self._loop, self._loop.record.io
        self._recorded_scene = scene = self.scene if state else loop.setting.scene
        position, force = (scale[: loop.wire.channels].tolist() for scale in (io.position_scale, io.force_scale))
        run = run_of(scene, loop, self._in_python, self._options, state)
        head = Head(
            scene.rate,
            position,
            force,
            scene.path or "",
            datetime.now(UTC).isoformat(),
            velocity=bool(io.velocities),
            acceleration=bool(io.accelerations),
            by_host=scene.device.clock == "host",
            lines=bool(io.lines),
            words=bool(io.words),
            clock=clock_now(),
            run=run,
        )

        def report_so_far() -> tuple[Report, Statistics]:
            return outcome.report_of(scene, loop, "running")

        return RecordFile(path, head, report_so_far, self._options.on_warning or (lambda _: None))

    def _wait_for_first_sample(self) -> None:
        while not self._loop.state.ticks and not self._over.wait(_POLL_S):  # before it, none has a number
            pass

    def _require_changeable(self) -> None:
        self._require_running()
        self._live.lease.require_kept()

    def _require_running(self) -> None:
        if self._over.is_set():
            raise UsageError(OVER)
