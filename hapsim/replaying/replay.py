"""Replay of a recorded run: its positions and changes pass through its scene or another one, in virtual time; or a
device on a pseudo-terminal sends its positions (`hapsim replay --device`)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from firmware_protocol import schema
from firmware_protocol.decoder import new_decoder
from hapsim.compiling.progress import Counted
from hapsim.device.connection import Connection
from hapsim.errors import UsageError
from hapsim.loop.compiled_loop import VALUES, replay_rows
from hapsim.loop.exchange import HOST_CLOCK
from hapsim.loop.ring import AWAY, BEFORE, COMMAND, SENSED, UNSENT, WORDS, lines_in, words_in
from hapsim.recording.stream import StreamReader, open_record, reading
from hapsim.replaying.notes import KINDS, kind_of
from hapsim.running.assemble_loop import LoopMemory, assemble_loop
from hapsim.running.changes import LiveScene
from hapsim.running.compile_ahead import compile_ahead
from hapsim.running.recorded_run import options_of, read_run, versions_of_now
from hapsim.running.snapshot import restore
from hapsim.scene import Scene, parse_scene
from hapsim.scene.load import recorded_scene
from hapsim.sound.play import SoundOutput
from hapsim.sound.wav import WavFile, require_writable_as_wav

if TYPE_CHECKING:
    from hapsim.device.mock.stand_ins import RecordedDevice

_AT_ONCE = 1 << 14  # rows
_MOST_DRAWN = 1 << 20

Rows = NDArray[Any]


@dataclass(frozen=True)
class Difference:
    """The first row of a replay that differs from the record."""

    tick: int
    sample: int
    what: str
    """Column, recorded value and replayed value, in words."""


class Record:
    """A record that can be replayed."""

    def __init__(self, path: Path) -> None:
        """Opens a record. Raises UsageError if it cannot be replayed."""
        self.path, self.reader = path, open_record(path)
        run = self.reader.head.run
        if run is None:
            raise UsageError(f"{path}: recorded by an older hapsim, without its scene: it cannot be replayed")
        with reading(path):
            self.run = read_run(run, self.reader.head.channels)
            self.scene = recorded_scene(run["scene"], str(path), self.reader.summary["report"].get("written", ()))
            self.description, self.options = self.run.description, options_of(self.run)
        self.notes = self.reader.notes
        """Changes and markers, as recorded."""

    def rows(self) -> Iterator[Rows]:
        """Returns an iterator over the rows, in pieces."""
        return self.reader.rows()

    @property
    def lost_rows(self) -> int:
        """Number of missing rows."""
        return int(self.reader.summary["report"].get("dropped_rows", 0))


class Replay:
    """A record through its scene, or through `scene`, which gets no changes."""

    def __init__(
        self, record: Record, scene: Scene | None = None, sound_file: Path | None = None, pick_up: str | None = None
    ) -> None:
        """`pick_up`: the one in the sound file [default: all]. UsageError if `scene` cannot answer the positions."""
        self.record, self.is_same = record, scene is None
        self.scene = record.scene if scene is None else _as_recorded(record, scene)
        _require_sensed(record, self.scene)
        connection = Connection(None, str(record.path), lambda: None, behind_port=record.run.behind_port)  # type: ignore[arg-type]
        connection.known_motors = record.run.known_motors
        self._resumes = self.is_same and record.run.first_tick > 0
        state = record.run.state if self._resumes else None
        with reading(record.path):
            first, *moved = [recorded_scene(one, str(record.path)) for one in state.scenes] if state else [self.scene]
        self.loop: LoopMemory = assemble_loop(first, connection, record.description, record.options)
        self.live = LiveScene(self.scene, self.loop, unstable=True if record.options.unstable else None)
        if self._resumes:
            with reading(record.path):
                if state and state.lease:
                    self.live.lease.restore(state.lease)
                fits = state is not None and restore(self.loop, state, moved)
            if not fits:
                raise UsageError(
                    f"{record.path}: it begins during a run, and the state of the scene then is that of another hapsim "
                    f"({record.run.versions['hapsim']}, this is {versions_of_now()['hapsim']}). Replay it there, or "
                    "another scene on its positions (`hapsim replay RECORD SCENE`)"
                )
        else:
            self.loop.control.pulse_begin -= record.run.first_tick
        self.loop.record.io.origin_at_arming[:] = self.loop.record.io.origin_counts[:] = 0  # rows count from there
        self._decoder = new_decoder(self.loop.wire, to_device=False)
        self._flushes = not record.run.in_python
        self._ticks, self.changes = 0, 0
        self._sound = self._sound_output(sound_file, pick_up)
        compile_ahead(("replay",), Counted(lambda *_: None))

    def pieces(self) -> Iterator[tuple[Rows, Rows]]:
        """Yields pieces of the record, and the rows that come out, of `row_type`, one for each."""
        begin = self.record.run.first_tick
        notes = self.record.notes if self.is_same else ()
        changes = [note | {"tick": note["tick"] - begin} for note in notes if "tick" in note]
        changes.sort(key=lambda note: note["tick"])
        of, rest = self.loop.ring.of, self.loop.ring.drain()
        before = UNSENT if self._resumes else 0  # the state has that sending, if there was one
        recorded: list[Rows] = []
        pieces = (piece[at : at + _AT_ONCE] for piece in self.record.rows() for at in range(0, len(piece), _AT_ONCE))
        following = next(pieces, None)
        while (piece := following) is not None:
            following = next(pieces, None)
            self._run(piece, before, changes, following is None)
            before = int(piece["flags"][-1])
            recorded.append(piece)
            rest = np.concatenate([rest, self.loop.ring.drain()])
            known = np.concatenate(recorded)
            yield known[: len(rest)], rest
            recorded, rest = [known[len(rest) :]], np.empty(0, of)

    def _run(self, piece: Rows, before: int, changes: list[dict[str, Any]], is_last: bool) -> None:
        """Runs a piece, and makes each change before the row that took it."""
        words = self._words(piece, before)
        done = 0
        while changes and changes[0]["tick"] < self._ticks + len(piece):
            change = changes.pop(0)
            at = max(change["tick"] - self._ticks, done)
            self._exchange(words[done:at], False)
            self._change(change)
            done = at
        self._exchange(words[done:], is_last)
        self._ticks += len(piece)

    def _exchange(self, words: NDArray[np.int64], is_last: bool) -> None:
        most = len(words) if self._sound is None else self._most_ticks
        for at in range(0, max(len(words), 1), max(most, 1)):
            piece = words[at : at + most]
            replay_rows(self.loop.record, self._decoder, piece, self._flushes, is_last and at + most >= len(words))
            if self._sound is not None:
                self._sound.collect()

    def close(self, keeps_part: bool = True) -> None:
        """Ends the sound file. Raises UsageError where it is not whole, or OSError if its part is not kept."""
        if self._sound is not None:
            self._sound.close()
            if self._sound.file is not None and self._sound.file.failure:
                file = self._sound.file
                raise UsageError(file.problem) if keeps_part else OSError(file.failure)

    def _sound_output(self, file: Path | None, pick_up: str | None) -> SoundOutput | None:
        if file is None:
            return None
        if self.loop.sound is None:
            raise UsageError(f"{file}: found no pick-up in the scene, expected a part `sound`")
        pick_ups = [name for name in self.scene.sound if pick_up in (None, name)]
        require_writable_as_wav(file, len(pick_ups), self.scene.step_rate)
        self._most_ticks = int(self.loop.sound.record.capacity) // (4 * self.scene.substeps)
        output = SoundOutput(self.loop.sound, [list(self.scene.sound).index(name) for name in pick_ups])
        output.file = WavFile(file, len(pick_ups), round(self.scene.step_rate), lambda _: None)
        return output

    def _change(self, change: dict[str, Any]) -> None:
        self.changes += 1
        with reading(self.record.path):
            KINDS[kind_of(change)].apply(self.live, change)

    def _words(self, piece: Rows, before: int) -> NDArray[np.int64]:
        """Returns rows in the format of `replay_rows`."""
        parts = schema.in_parts(self.loop.wire.parts)
        columns = (SENSED.get(part.name, part.name) for part in parts)
        counts = np.hstack([piece["position_counts"], *(piece[name].reshape(len(piece), -1) for name in columns)])
        if self.scene.away:
            counts = np.hstack([counts, np.ascontiguousarray(piece[AWAY]).view(np.int64)])
        words = np.zeros((len(piece), VALUES + counts.shape[1]), np.int64)
        flags = piece["flags"].astype(np.int64)
        words[:, :4] = np.transpose([piece["sample"], piece["time_ns"], flags, np.append(before, flags[:-1])])
        for at, name in enumerate(BEFORE, 4):
            words[:, at] = piece[name] if self.loop.control.clock == HOST_CLOCK else 0
        words[:, VALUES:] = counts
        return words


@dataclass(frozen=True)
class Comparison:
    """A replay beside its record. Forces are those that were sent, in N."""

    ticks: int
    changes: int
    difference: Difference | None
    """None where all rows are the same."""
    why: str
    """Likely cause of the difference, as a sentence to append; "" if unknown."""
    rms_recorded: list[float]
    rms_replayed: list[float]
    rms_apart: list[float]
    """Rms forces over all samples, by channel."""
    time_s: NDArray[np.float64]
    position: NDArray[np.float64]
    recorded: NDArray[np.float64]
    replayed: NDArray[np.float64]
    """(N,) s and (N, C) m and N, to be drawn; no rows where that was not asked for."""


def compare(record: Record, scene: Scene | None, sound_file: Path | None, with_curves: bool) -> Comparison:
    """Replays a record through its scene, or through `scene`. Raises UsageError where it cannot."""
    replay = Replay(record, scene, sound_file)
    io, used = replay.loop.record.io, slice(record.description.channels)
    position_scale, force_scale = io.position_scale[used].copy(), io.force_scale[used].copy()
    difference, ticks = None, 0
    sums = np.zeros((3, force_scale.size))
    curves: list[tuple[NDArray[Any], ...]] = []
    for recorded, replayed in replay.pieces():
        difference = difference or first_difference(recorded, replayed, ticks)
        ticks += len(recorded)
        forces = recorded["force_counts"] * force_scale, replayed["force_counts"] * force_scale
        sums += [np.sum(one**2, axis=0) for one in (*forces, forces[0] - forces[1])]
        if with_curves and ticks <= _MOST_DRAWN:
            curves.append(
                (recorded["sample"] / record.scene.rate, recorded["position_counts"] * position_scale, *forces)
            )
    replay.close()
    rms = np.sqrt(sums / ticks).tolist()
    drawn = [np.concatenate(one) for one in zip(*curves, strict=True)] or [
        np.zeros(0),
        *np.zeros((3, 0, force_scale.size)),
    ]
    why = _why(record) if difference is not None and scene is None else ""
    return Comparison(ticks, replay.changes, difference, why, *rms, *drawn)


def _why(record: Record) -> str:
    """Returns the likely cause of a difference: missing rows, or other versions than at the recording."""
    if record.lost_rows:
        return f". {record.lost_rows} rows are missing from the record: its reader was too slow"
    now = versions_of_now()
    before = record.run.versions
    other = [f"{name} {before[name]}, now {now[name]}" for name in before if before[name] != now.get(name)]
    return f". It was recorded with {'; '.join(other)}" if other else ""


def first_difference(recorded: Rows, replayed: Rows, first_tick: int) -> Difference | None:
    """Returns where rows differ first, in anything but when they were taken."""
    names = ["sample", "position_counts", "flags", "asked_force", "force_counts"]
    names += [COMMAND] if COMMAND in (recorded.dtype.names or ()) else []
    names += [*lines_in(recorded), *(name for name in words_in(recorded) if name in words_in(replayed))]
    differs = np.zeros(len(recorded), bool)
    for name in names:
        one = recorded[name] != replayed[name]
        differs |= one if one.ndim == 1 else one.any(axis=1)
    if not differs.any():
        return None
    at = int(differs.argmax())
    name = next(one for one in names if np.any(recorded[one][at] != replayed[one][at]))
    return Difference(
        first_tick + at,
        int(recorded["sample"][at]),
        f"{name}: recorded {recorded[name][at]}, replayed {replayed[name][at]}",
    )


def _as_recorded(record: Record, scene: Scene) -> Scene:
    """Another scene on the record's device. Raises UsageError."""
    before, name = record.scene, scene.path or "the scene"
    if scene.rate != before.rate:
        raise UsageError(f"{name}: found rate {scene.rate:g} Hz, expected the record's, {before.rate:g} Hz")
    if scene.channels > record.description.channels:
        raise UsageError(
            f"{name}: found {scene.channels} channels, expected the {record.description.channels} recorded"
        )
    try:
        Scene(**dict(scene) | {"device": before.device})  # its checks
    except ValidationError as error:
        raise UsageError(f"{name}: on the record's device: {error.errors()[0]['msg']}") from None
    return scene.model_copy(update={"device": before.device})


def _require_sensed(record: Record, scene: Scene) -> None:
    """Raises UsageError if the scene needs values that the record does not have."""
    for name in scene.sensed:
        if name not in record.reader.head.sensed:
            of_device = name in scene.device.sensors
            found = f"{name} in device.sensors, expected none" if of_device else "damper: sensed, expected another"
            values = {"velocity": "velocities", "acceleration": "accelerations", "hand_force": "forces"}[name]
            raise UsageError(f"{scene.path or 'the scene'}: found {found}: the record has no sensed {values}")
    if (points := len(scene.away)) != record.reader.head.away:
        found = f"found {points} points of other devices, expected {record.reader.head.away}"
        raise UsageError(f"{scene.path or 'the scene'}: {found}, as recorded")
    if scene.inputs and not record.reader.head.words:
        raise UsageError(f"{scene.path or 'the scene'}: found inputs, expected none: the record has no digital words")


def device_of(path: Path) -> RecordedDevice:
    """Returns the device of a record: it describes itself as the recorded one did, and sends the positions that it
    sent, at its rate. UsageError where the record does not have that."""
    with reading(path):
        return _device_of(path, open_record(path))


def _device_of(path: Path, reader: StreamReader) -> RecordedDevice:
    from hapsim.device.mock.stand_ins import RecordedDevice

    run, report = reader.head.run, reader.summary["report"]
    if run is None:
        raise UsageError(f"{path}: recorded by an older hapsim, without its device: it cannot be served")
    samples, time_ns = (np.concatenate([piece[name] for piece in reader.rows()]) for name in ("sample", "time_ns"))
    words = ["position_counts", *(SENSED[name] for name in reader.head.sensed), *WORDS[: reader.head.words]]
    each = ([piece[name].reshape(len(piece), -1).view(np.int32) for name in words] for piece in reader.rows())
    counts = np.concatenate([np.hstack(one) for one in each])
    description = read_run(run, reader.head.channels).description
    scene = parse_scene(json.dumps(run["scene"]), str(path))
    for c, origin in enumerate(scene.device.origins(scene.channels)):  # rows count from there
        counts[:, c] += round((origin or 0.0) / description.position_scale[c])
    absent: dict[str, Any] = {f"{name}_scale": () for name in SENSED if name not in reader.head.sensed}
    description = replace(
        description,
        **absent,
        sensors=sum(part.declared_by for part in schema.SENSED if part.name in reader.head.sensed)
        + schema.FOLLOWS_COMMANDS * reader.head.hand_force
        + schema.HAS_DIGITAL_WORD * reader.head.words,
    )
    samples -= samples[0] if run["first_tick"] else 0
    period = 1.0 / description.rate_hz
    if report["timed_by_device"] and len(samples) > 1:
        period = 1e-9 * float(time_ns[-1] - time_ns[0]) / float(samples[-1] - samples[0])
    return RecordedDevice(description, samples, counts, period)
