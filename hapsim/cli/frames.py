"""`hapsim frames`."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import stat
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, Format
from hapsim.bringup.capture import REASONS, Capture, Decoded, Refused
from hapsim.cli.live import live_words
from hapsim.cli.options import Baud, Json, seconds
from hapsim.cli.output import complain, say, stderr
from hapsim.cli.streams import output_ended
from hapsim.device.port_name import leads_to
from hapsim.device.serial_port import open_portable_port
from hapsim.errors import DeviceError, UsageError
from hapsim.recording.report_file import is_report, read_report
from hapsim.stopping import stopping_on_signals

if TYPE_CHECKING:
    from hapsim.bringup.capture import Capture, Decoded, Refused

_SENDERS = {"host": (True,), "device": (False,), "both": (True, False)}
_PIECE = 1 << 16
_LONG = 1 << 22  # bytes: of a longer file it says how far it is
_LOOK_S = 0.2  # how often a silent port or pipe is left to see whether it is enough

Piece = tuple[bytes, float | None]


def frames(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE|PORT", help="A capture, raw bytes, or a report file; - for standard input; or a serial port."
        ),
    ],
    sender: Annotated[
        str, typer.Option("--from", metavar="WHO", help="Whose frames to look for: host, device or both.")
    ] = "both",
    hex_too: Annotated[bool, typer.Option("--hex", help="Show the bytes of every frame too.")] = False,
    baud: Baud = 2_000_000,
    duration: Annotated[
        float | None,
        seconds("Seconds to listen to a port [default: until Ctrl-C]"),
    ] = None,
    json: Json = False,
) -> None:
    """Decode a capture of the wire or the frames of a report file, or listen at a port without sending: every frame
    field by field, and what is refused."""
    if sender not in _SENDERS:
        raise UsageError(f"--from: found '{sender}', expected host, device or both")

    document = JsonDocument(sys.stdout.write, source) if json else None
    stopped: list[bool] = []
    show = _Shown(sender, hex_too, document)
    failure: DeviceError | None = None
    with stopping_on_signals(lambda: stopped.append(True)):
        if _is_report(source):
            _show_report(Path(source), show)
        else:
            with _pieces_of(source, baud, duration, lambda: bool(stopped) or output_ended()) as pieces:
                failure = show.all_of(Capture(_SENDERS[sender]), pieces)
    if document is not None:
        error = {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}
        document.close({"counters": counters_of(show.captures), "stopped": bool(stopped)} | show.beside | error)
    if failure is not None:
        complain(failure)  # its document is written
        raise typer.Exit(failure.exit_status)


class _Shown:
    """What is found, as text or in a document."""

    def __init__(self, sender: str, hex_too: bool, document: JsonDocument | None) -> None:
        self.sender, self.document = sender, document
        self.captures: list[Capture] = []
        self.beside: dict[str, Any] = {}
        """What a document tells beside the entries."""
        self._hex_too = hex_too

    def all_of(self, capture: Capture, pieces: Iterator[Piece]) -> DeviceError | None:
        """Shows every piece, and what they come to."""

        self.captures.append(capture)

        def show(found: Decoded | Refused, time_s: float | None) -> None:
            entry = entry_of(capture, found, time_s, self._hex_too)
            if self.document is not None:
                self.document.add(entry)
            else:
                say(text_of(entry), indent=TEXT_INDENT)

        failure = _decode(capture, pieces, show)
        if self.document is None:
            say(summary_of(capture, self.sender))
        return failure


def _is_report(source: str) -> bool:

    path = Path(source)
    try:
        return path.is_file() and is_report(path)
    except OSError:
        return False  # whoever reads it says so


def _show_report(path: Path, show: _Shown) -> None:
    """One direction after the other: nothing tells when which byte was on the wire."""

    report = read_report(path)
    registers = {int(number): value for number, value in report.about["registers"].items()}
    show.beside = {"report": {name: report.about[name] for name in ("when", "port", "sentence")}}
    if show.document is None:
        say(f"{report.about['when']}  {report.about['sentence']}")
    for from_host, data in ((False, report.wire.from_device), (True, report.wire.to_device)):
        if from_host not in _SENDERS[show.sender]:
            continue
        if show.document is None:
            say("\nto the device:" if from_host else "\nfrom the device:")
        capture = Capture((from_host,))
        capture.registers.update(registers)
        show.all_of(capture, iter([(data, None)]))


def _decode(
    capture: Capture, pieces: Iterator[Piece], show: Callable[[Decoded | Refused, float | None], None]
) -> DeviceError | None:
    """Shows what there is to the end, which may be that the port went away: that is returned."""
    failure, time_s = None, None
    try:
        for data, time_s in pieces:
            for found in capture.feed(data):
                show(found, time_s)
            if time_s is not None:
                sys.stdout.flush()
    except DeviceError as error:
        failure = error
    for found in capture.finish():
        show(found, time_s)
    return failure


@contextlib.contextmanager
def _pieces_of(
    source: str, baud: int, duration: float | None, stopped: Callable[[], bool]
) -> Iterator[Iterator[Piece]]:
    """The bytes of a file, of standard input, or of a port, each with when it came, in s, where that is known.
    UsageError and DeviceError with what to do where there are none."""
    if source == "-":
        yield _of_stream("standard input", sys.stdin.buffer, stopped)
        return
    try:
        kind = Path(source).stat().st_mode
    except OSError as error:
        if sys.platform == "win32" and source.upper().startswith("COM"):
            kind = stat.S_IFCHR
        else:
            link = leads_to(source) if isinstance(error, FileNotFoundError) else None
            why = f"neither a file nor a port: {error.strerror}" if link is None else f"a link to {link}, which is gone"
            raise UsageError(f"{source}: {why}") from error
    if stat.S_ISCHR(kind):
        yield from _of_port(source, baud, duration, stopped)
    elif stat.S_ISDIR(kind):
        raise UsageError(f"{source}: found a directory, expected a capture (raw bytes) or a serial port")
    else:
        with _reading(source):
            stream = open(source, "rb")  # noqa: SIM115 - closed below: only a failed opening is reported as one
        with stream:
            yield _of_stream(source, stream, stopped)


@contextlib.contextmanager
def _reading(source: str) -> Iterator[None]:
    """Only around what reads: where the output cannot be written, the capture is not to blame."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{source}: cannot be read: {error.strerror}") from error


def _of_stream(name: str, stream: Any, stopped: Callable[[], bool]) -> Iterator[Piece]:

    descriptor = stream.fileno()
    status = os.fstat(descriptor)
    regular = stat.S_ISREG(status.st_mode)
    done = 0
    with live_words(stderr()) if regular and status.st_size > _LONG else contextlib.nullcontext() as say:
        while not stopped():
            if not regular and not select.select([descriptor], [], [], _LOOK_S)[0]:
                continue
            with _reading(name):
                data = os.read(descriptor, _PIECE)
            if not data:
                break
            done += len(data)
            if say is not None:
                say(f"decoding {name}: {done / status.st_size:.0%}")
            yield data, None
    if not done and not stopped():
        raise UsageError(f"{name}: found no bytes: the capture is empty")


def _of_port(path: str, baud: int, duration: float | None, stopped: Callable[[], bool]) -> Iterator[Iterator[Piece]]:

    def listen() -> Iterator[Piece]:
        buffer, begun = np.zeros(_PIECE, np.uint8), time.monotonic()
        while not stopped() and (duration is None or time.monotonic() - begun < duration):
            count = connection.transport.receive(buffer, round(_LOOK_S * 1e9))
            if count < 0:
                raise DeviceError(f"{path}: the port is gone")
            if count:
                yield buffer[:count].tobytes(), time.monotonic() - begun

    with contextlib.closing(open_portable_port(path, baud)) as connection:
        yield listen()


_NAMES = {
    schema.DESCRIBE: "DESCRIBE",
    schema.ARM: "ARM",
    schema.FORCE: "FORCE",
    schema.DISARM: "DISARM",
    schema.DESCRIPTION: "DESCRIPTION",
    schema.POSITION: "POSITION",
    schema.POSITION_HELD: "POSITION_HELD",
    schema.STATUS: "STATUS",
}
_REGISTERS = {
    schema.REG_VERSION: "version",
    schema.REG_SCHEMA: "schema",
    schema.REG_CHANNELS: "channels",
    schema.REG_PACINGS: "pacings",
    schema.REG_RATE: "rate",
    schema.REG_RATE + 1: "rate, high word",
    schema.REG_MAX_WATCHDOG: "max_watchdog",
    schema.REG_FAULT: "fault",
    schema.REG_ACCEPTED: "accepted",
    schema.REG_REJECTED: "rejected",
    schema.REG_HELD: "held",
    schema.REG_EXPIRED: "expired",
    schema.REG_LIMITED: "limited",
}
_OF_CHANNEL = ("position_scale", "force_scale", "force_limit", "velocity_scale")
_PACINGS = {schema.PACED_BY_DEVICE: "device", schema.PACED_BY_HOST: "host", schema.LOCKSTEP: "lockstep"}
_STATES = {schema.IDLE: "idle", schema.ARMED: "armed", schema.LATCHED: "latched"}
_MOVING = (schema.POSITION, schema.POSITION_HELD)


TEXT_INDENT = " " * 10
"""Of an entry that goes on in the next line: below what follows its offset."""


def format_name(wire: Format) -> str:
    """As people call a format."""
    if wire == SETUP:
        return "set-up"
    return f"armed, {wire.channels} channel{'s'[: wire.channels - 1]}" + (", velocities" if wire.velocity else "")


def register_name(number: int) -> str:
    """As PROTOCOL.md calls it; "" for one that it does not name."""
    if schema.REG_NAME <= number < schema.REG_NAME + schema.NAME_WORDS:
        return "name"
    if schema.REG_CHANNEL <= number < schema.REGISTERS:
        channel, within = divmod(number - schema.REG_CHANNEL, schema.CHANNEL_WORDS)
        return f"{_OF_CHANNEL[within // 2]} of channel {channel}" + (", high word" if within % 2 else "")
    return _REGISTERS.get(number, "")


def entry_of(capture: Capture, found: Decoded | Refused, time_s: float | None, with_hex: bool) -> dict[str, Any]:
    """What was found, field by field. `time_s`: when it came, where that is known."""
    place: dict[str, Any] = {"offset": found.offset, "time_s": time_s}
    if isinstance(found, Refused):
        return place | {"refused": found.reason, "bytes": found.length, "hex": found.data.hex(" ")}
    kind, counts = found.frame.type, list(found.frame.counts)
    entry = place | {
        "from": "host" if found.from_host else "device",
        "format": format_name(found.wire),
        "type": _NAMES[kind],
        "number": found.frame.number,
        "argument": found.frame.argument if found.from_host else None,
        "counts": counts,
    }
    entry |= _meaning(capture, found)
    return entry | ({"hex": found.data.hex(" ") + " 00"} if with_hex else {})


def _meaning(capture: Capture, found: Decoded) -> dict[str, Any]:
    """The fields that this type of frame gives a meaning to; SI where the capture describes the scales, else null."""
    kind, counts = found.frame.type, found.frame.counts
    if kind in (schema.DESCRIBE, schema.DESCRIPTION):
        value = {"value": counts[0] & 0xFFFFFFFF} if kind == schema.DESCRIPTION else {}
        return {"register": register_name(found.frame.number)} | value
    if kind == schema.ARM:
        argument, word = found.frame.argument, counts[0] & 0xFFFFFFFF
        pacing = argument & (schema.WITH_VELOCITY - 1)
        return {
            "watchdog_samples": found.frame.number,
            "pacing": _PACINGS.get(pacing, str(pacing)),
            "velocities": bool(argument & schema.WITH_VELOCITY),
            "schema": f"{word:08x}",
            "schema_is_ours": word == schema.SCHEMA_HASH,
        }
    if kind == schema.STATUS:
        state, fault = counts[0] & 0xFF, counts[0] >> 8 & 0xFF
        return {
            "state": _STATES.get(state, str(state)),
            "fault": fault,
            "fault_text": schema.FAULTS.get(fault, "unknown"),
        }
    if kind == schema.FORCE:
        force = _scaled(capture, schema.REG_FORCE_SCALE, counts)
        return {"time_to_live_samples": found.frame.argument, "force_N": force}
    if kind in _MOVING:
        channels = found.wire.channels
        position = _scaled(capture, schema.REG_POSITION_SCALE, counts[:channels])
        velocity = _scaled(capture, schema.REG_VELOCITY_SCALE, counts[channels:])
        return {"position_m": position} | ({"velocity_m_s": velocity} if found.wire.velocity else {})
    return {}


def _scaled(capture: Capture, which: int, counts: tuple[int, ...]) -> list[float | None]:
    scales = [capture.registers.scale(which, channel) for channel in range(len(counts))]
    return [None if scale is None else scale * count for scale, count in zip(scales, counts, strict=True)]


def text_of(entry: dict[str, Any]) -> str:
    """An entry as a line."""
    time = "" if entry["time_s"] is None else f"{entry['time_s']:10.4f} s  "
    place = f"{entry['offset']:8d}  {time}"
    if "refused" in entry:
        cut = "" if 3 * entry["bytes"] - 1 == len(entry["hex"]) else "the last: "
        plural = "byte" if entry["bytes"] == 1 else "bytes"
        return f"{place}refused: {entry['bytes']} {plural}; {REASONS[entry['refused']]}: {cut}{entry['hex']}"
    line = f"{place}{entry['from']:6}  {entry['format']:18}  {entry['type']:13}  {_words(entry)}".rstrip()
    return line + (f"  | {entry['hex']}" if "hex" in entry else "")


def _words(entry: dict[str, Any]) -> str:
    number = entry["number"]
    match entry["type"]:
        case "DESCRIBE":
            return f"register {number} ({entry['register'] or 'none'})"
        case "DESCRIPTION":
            return f"register {number} ({entry['register'] or 'none'}) = {entry['value']} (0x{entry['value']:08x})"
        case "ARM":
            whose = "ours" if entry["schema_is_ours"] else "another one"
            velocities = ", velocities too" if entry["velocities"] else ""
            pacing, samples = entry["pacing"], entry["watchdog_samples"]
            return f"paced by {pacing}{velocities}, watchdog {samples} samples, schema {entry['schema']} ({whose})"
        case "STATUS":
            fault = f", fault {entry['fault']}: {entry['fault_text']}" if entry["fault"] else ""
            return f"sample {number}: {entry['state']}{fault}"
        case "FORCE":
            values = _values(entry["counts"], entry["force_N"], "N")
            return f"answers {number}, lives {entry['time_to_live_samples']} samples: {values}"
        case "POSITION" | "POSITION_HELD":
            channels = len(entry["position_m"])
            values = _values(entry["counts"][:channels], entry["position_m"], "m")
            velocity = entry.get("velocity_m_s")
            beside = "" if velocity is None else f"; {_values(entry['counts'][channels:], velocity, 'm/s')}"
            return f"sample {number}: {values}{beside}"
    return ""


def _values(counts: list[int], scaled: list[float | None], unit: str) -> str:
    return ", ".join(
        f"{count} counts" + ("" if value is None else f" ({value:.6g} {unit})")
        for count, value in zip(counts, scaled, strict=True)
    )


def summary_of(capture: Capture, sender: str = "both") -> str:
    """The counters, as a sentence. `sender`: whose frames were looked for, host, device or both."""
    counted = capture.counters
    refused = [f"{counted[f'refused: {name}']} {name}" for name in REASONS if counted[f"refused: {name}"]]
    frames = f"{counted['from the host']} frames from the host, {counted['from the device']} from the device"
    if not refused:
        return f"{counted['bytes']} bytes: {frames}; nothing refused."
    told = f"{counted['bytes']} bytes: {frames}; refused {counted['refused bytes']} bytes: {', '.join(refused)}."
    if counted["from the host"] or counted["from the device"]:
        return told
    whose = "" if sender == "both" else f" of the {sender}"
    return f"{told} Nothing in it is a frame{whose}: is it raw bytes of the wire?"


def counters_of(captures: Iterable[Capture]) -> dict[str, Any]:
    """The counters of all of them, for JSON."""
    counted = sum((capture.counters for capture in captures), Counter[str]())
    return {
        "bytes": counted["bytes"],
        "from_host": counted["from the host"],
        "from_device": counted["from the device"],
        "refused": {name: counted[f"refused: {name}"] for name in REASONS},
        "refused_bytes": counted["refused bytes"],
    }


class JsonDocument:
    """One document, written as it grows: `entries`, and then what is known at the end."""

    def __init__(self, write: Callable[[str], object], source: str) -> None:
        self._write = write
        self._between = f'{{"source": {json.dumps(source)}, "entries": [\n'

    def add(self, entry: dict[str, Any]) -> None:
        self._write(self._between + _text(entry))
        self._between = ",\n"

    def close(self, rest: dict[str, Any]) -> None:
        self._write(("" if self._between == ",\n" else self._between) + "], " + _text(rest)[1:] + "\n")


def _text(value: dict[str, Any]) -> str:
    """A scale that a device describes may be no number: null."""
    return json.dumps(_finite(value), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
