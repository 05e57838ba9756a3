"""A program's changes of a running session: values, scenes, trials, pulses, leases, marks and records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hapsim.device.open_connection import on_device
from hapsim.errors import UsageError
from hapsim.recording.recorder import RecordFile
from hapsim.recording.stream import Head
from hapsim.recording.times import clock_now
from hapsim.recording.trace import Report, Statistics, require_writable_as_trace
from hapsim.running import outcome
from hapsim.running.changed_scene import Changes
from hapsim.running.changes import OVER
from hapsim.running.live_parameters import by_part, python_values
from hapsim.running.pulse_shapes import Pulse, require_possible
from hapsim.running.recorded_run import run_of
from hapsim.running.saving import save
from hapsim.running.session_view import Event, EventKind, SessionView
from hapsim.running.snapshot import LoopState
from hapsim.running.trials import Code, trial_changes
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene

_POLL_S = 1e-3


def _by_name(changes: Changes) -> dict[str, Any]:
    return {f"{part}.{key}": value for part, keys in changes.items() for key, value in keys.items()}


class SessionChanges(SessionView):
    """The part of a `Session` that changes, marks and records the running loop, and publishes its events."""

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
        changes, over = python_values(changes), python_values(over)
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
        number, set, restart, code, over = python_values((number, {} if set is None else set, restart, code, over))
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
        self._live.adopt(on_device(scene, self._options.transport), python_values(over))
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
        pulse = Pulse(*python_values((channel, shape, force, seconds, periods)))
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
        self._publish_lease(self._live.ask_for_lease(python_values(seconds), scene, owner))

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
        state = self._loop.state
        while True:  # until no sample came meanwhile
            sample, newest_ns = int(state.sample), int(state.newest_ns)
            if sample == int(state.sample):
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
            hand_force=bool(io.hand_forces),
            by_host=scene.device.clock == "host",
            lines=bool(io.lines),
            words=bool(io.words),
            away=int(io.away_end - io.away_first),
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
