"""`hapsim frames`."""

from __future__ import annotations

import contextlib
import json as standard_json
import os
import select
import stat
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol import schema
from firmware_protocol.capture import REASONS, Capture, Decoded, Refused
from firmware_protocol.frames import SETUP, Format
from firmware_protocol.lines import unpack_line
from hapsim.cli.command_options import Baud, Json, argument, flag, option, seconds
from hapsim.cli.live import live_words
from hapsim.cli.output import exit_if_failed, failure_document, output_units, print_line, set_output_units, stderr
from hapsim.cli.streams import output_ended
from hapsim.device.connection import Connection
from hapsim.device.ports import link_target, open_portable_port
from hapsim.documents import plain
from hapsim.errors import DeviceError, UsageError
from hapsim.number_format import plural
from hapsim.recording.report_file import is_report, read_report
from hapsim.scene.addresses import is_address
from hapsim.stopping import stopping_on_signals
from hapsim.units import Units

_SENDERS = {"host": (True,), "device": (False,), "both": (True, False)}
_PIECE = 1 << 16
_LONG = 1 << 22  # bytes: of a longer file it shows how far it is
_AT_ONCE = getattr(os, "O_NONBLOCK", 0)
_LOOK_S = 0.2  # how often a silent port or pipe is left to see whether it is enough
_TEXT_INDENT = " " * 10  # of an entry that goes on in the next line: below what follows its offset

Piece = tuple[bytes, float | None]
"""Bytes, and their time of arrival in s, or None."""


def frames(
    source: str = argument(
        "FILE|PORT", "Capture of raw bytes, report file or serial port; - for standard input.", default=...
    ),
    sender: str = option("WHO", "Sender of the frames to decode: host, device or both.", "--from", default="both"),
    hex_too: bool = flag("--hex", "Also print the bytes of every frame."),
    baud: Baud = 2_000_000,
    duration: float | None = seconds("Time to listen to a port, in seconds [default: until Ctrl-C]"),
    json: Json = False,
) -> None:
    """Decode the frames of a capture, a report file or a serial port, field by field.

    Bytes that are no valid frame are printed with the reason. At a port, hapsim only listens: it sends nothing.
    """
    if sender not in _SENDERS:
        raise UsageError(f"--from: found '{sender}', expected host, device or both")
    stopped: list[bool] = []
    show = _Output(source, sender, hex_too, json)
    failure: DeviceError | None = None
    about: dict[str, Any] = {}
    with stopping_on_signals(lambda: stopped.append(True)):
        if _is_report(source):
            about = _show_report(Path(source), show, sender)
        else:
            with _pieces_of(source, baud, duration, lambda: bool(stopped) or output_ended()) as pieces:
                failure = show.all_of(Capture(_SENDERS[sender]), pieces)
    show.close({"stopped": bool(stopped)} | about | failure_document(failure))
    exit_if_failed(failure)


class _Output:
    """Prints the frames: lines for people, or one JSON document as it grows."""

    def __init__(self, source: str, sender: str, hex_too: bool, json: bool) -> None:
        self._sender, self._hex_too, self._json = sender, hex_too, json
        self._counters: Counter[str] = Counter()
        self._before = f'{{"source": {standard_json.dumps(source)}, "entries": [\n'  # what goes before the next entry

    def all_of(self, capture: Capture, pieces: Iterator[Piece]) -> DeviceError | None:
        """Prints every frame, and the counters. Returns the error if the port was lost."""
        failure, time_s = None, None
        try:
            for data, time_s in pieces:
                for found in capture.feed(data):
                    set_output_units(Units.of(capture.registers.motions))
                    self._show(entry_of(capture, found, time_s, self._hex_too))
                if time_s is not None:
                    sys.stdout.flush()
        except DeviceError as error:
            failure = error
        for found in capture.finish():
            self._show(entry_of(capture, found, time_s, self._hex_too))
        self._counters += capture.counters
        self.print_line(_summary(capture.counters, self._sender))
        return failure

    def _show(self, entry: dict[str, Any]) -> None:
        if self._json:
            sys.stdout.write(self._before + _json(entry))
            self._before = ",\n"
        else:
            print_line(text_of(entry), indent=_TEXT_INDENT)

    def print_line(self, sentence: str) -> None:
        """Prints a sentence, except into a document."""
        if not self._json:
            print_line(sentence)

    def close(self, about: dict[str, Any]) -> None:
        """Writes the end of a document."""
        counters: dict[str, Any] = {"refused": {name: self._counters[f"refused: {name}"] for name in REASONS}}
        for key in ("bytes", "from the host", "from the device", "refused bytes"):
            counters[key.replace("the ", "").replace(" ", "_")] = self._counters[key]
        if self._json:
            begin = "" if self._before == ",\n" else self._before
            sys.stdout.write(f"{begin}], {_json({'counters': counters} | about)[1:]}\n")


def _json(value: dict[str, Any]) -> str:
    return standard_json.dumps(plain(value), allow_nan=False)


def _is_report(source: str) -> bool:
    path = Path(source)
    try:
        return path.is_file() and is_report(path)
    except OSError:
        return False  # opening it says why


def _show_report(path: Path, show: _Output, sender: str) -> dict[str, Any]:
    """Prints one direction after the other, as a report has no time of each byte. Returns entries for a document."""
    report = read_report(path)
    registers = {int(number): value for number, value in report.about["registers"].items()}
    show.print_line(f"{report.about['when']}  {report.about['sentence']}")
    for from_host, data in ((False, report.wire.from_device), (True, report.wire.to_device)):
        if from_host in _SENDERS[sender]:
            show.print_line("\nto the device:" if from_host else "\nfrom the device:")
            capture = Capture((from_host,))
            capture.registers.update(registers)
            show.all_of(capture, iter([(data, None)]))
    return {"report": {name: report.about[name] for name in ("when", "port", "sentence")}}


@contextlib.contextmanager
def _pieces_of(
    source: str, baud: int, duration: float | None, stopped: Callable[[], bool]
) -> Iterator[Iterator[Piece]]:
    """Yields the bytes of a file, of standard input, or of a port. Raises UsageError or DeviceError."""
    if source == "-":
        yield _of_stream("standard input", sys.stdin.buffer, stopped)
        return
    if is_address(source):
        with contextlib.closing(open_portable_port(source, baud)) as connection:
            yield _of_port(source, connection, duration, stopped)
        return
    try:
        kind = Path(source).stat().st_mode
    except OSError as error:
        if sys.platform != "win32" or not source.upper().startswith("COM"):
            link = link_target(source) if isinstance(error, FileNotFoundError) else None
            why = f"neither a file nor a port: {error.strerror}" if link is None else f"a link to {link}, which is gone"
            raise UsageError(f"{source}: {why}") from error
        kind = stat.S_IFCHR
    if stat.S_ISCHR(kind):
        with contextlib.closing(open_portable_port(source, baud)) as connection:
            yield _of_port(source, connection, duration, stopped)
    elif stat.S_ISDIR(kind):
        raise UsageError(f"{source}: found a directory, expected a capture (raw bytes) or a serial port")
    else:
        with _reading(source):
            # Closed below: only a failed opening is reported as one. It does not wait for a FIFO's writer: no signal
            # would end that, and `_of_stream` waits.
            stream = open(source, "rb", opener=lambda path, flags: os.open(path, flags | _AT_ONCE))  # noqa: SIM115
        with stream:
            yield _of_stream(source, stream, stopped)


@contextlib.contextmanager
def _reading(source: str) -> Iterator[None]:
    """Raises UsageError for a failed read. Writing stays outside: a full output is no fault of the capture."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{source}: cannot be read: {error.strerror}") from error


def _of_stream(name: str, stream: Any, stopped: Callable[[], bool]) -> Iterator[Piece]:
    descriptor = stream.fileno()
    status = os.fstat(descriptor)
    regular = stat.S_ISREG(status.st_mode)
    done = 0
    with live_words(stderr()) if regular and status.st_size > _LONG else contextlib.nullcontext() as show:
        while not stopped():
            if not regular and not select.select([descriptor], [], [], _LOOK_S)[0]:
                continue
            with _reading(name):
                data = os.read(descriptor, _PIECE)
            if not data:
                break
            done += len(data)
            if show is not None:
                show(f"decoding {name}: {100.0 * done / status.st_size:.0f} %")
            yield data, None
    if not done and not stopped():
        raise UsageError(f"{name}: found no bytes: the capture is empty")


def _of_port(path: str, connection: Connection, duration: float | None, stopped: Callable[[], bool]) -> Iterator[Piece]:
    begun = time.monotonic()
    while not stopped() and (duration is None or time.monotonic() - begun < duration):
        try:
            data = connection.receive_bytes(_LOOK_S)
        except DeviceError as error:
            raise DeviceError(f"{path}: the port is gone") from error
        if data:
            yield data, time.monotonic() - begun


_NAMED = "version schema channels pacings rate max_watchdog fault accepted rejected held expired limited rotary bridge"
_NAMED += " board_steps board_delay board_window kept_reports"
_REGISTERS: dict[int, str] = {getattr(schema, f"REG_{name.upper()}"): name for name in _NAMED.split(" ")}
_REGISTERS[schema.REG_RATE + 1] = "rate, high word"
_OF_MORE = ["acceleration_scale", "acceleration_scale, high word", "line_shifts", "largest"]
_OF_MORE += [f"{name}{half}" for name in ("hand_force_scale", "hand_force_range") for half in ("", ", high word")]
_OF_MORE += [f"{name}{half}" for name in schema.SERVO_REGISTERS for half in ("", ", high word")]


class _Part(NamedTuple):
    plural: str
    field: str
    unit: str

    @property
    def key(self) -> str:
        """Key of an ARM that requests it."""
        return self.plural.replace(" ", "_")


_PARTS = {
    "velocity": _Part("velocities", "velocity_m_s", "m/s"),
    "acceleration": _Part("accelerations", "acceleration_m_s2", "m/s²"),
    "inputs": _Part("inputs", "", ""),
    "hand_force": _Part("hand forces", "hand_force_N", "N"),
    "line": _Part("lines", "", ""),
    "command": _Part("position commands", "", ""),
    "outputs": _Part("outputs", "", ""),
}
_OF_CHANNEL = tuple(schema.CHANNEL_REGISTERS)


def _format_name(wire: Format) -> str:
    if wire == SETUP:
        return "set-up"
    return f"armed, {plural(wire.channels, 'channel')}" + "".join(
        f", {_PARTS[name].plural}" for name in wire.part_names
    )


def _register_name(number: int) -> str:
    """Returns the name that PROTOCOL.md has for a register; "" for one that it does not name."""
    if schema.REG_NAME <= number < schema.REG_NAME + schema.NAME_WORDS:
        return "name"
    channel, within = divmod(number - schema.REG_MORE, schema.MORE_WORDS)
    if 0 <= channel < schema.MAX_CHANNELS:
        name, comma, half = _OF_MORE[within].partition(", ")
        return f"{name} of channel {channel}{comma}{half}"
    if schema.REG_CHANNEL <= number < schema.REG_MORE:
        channel, within = divmod(number - schema.REG_CHANNEL, schema.CHANNEL_WORDS)
        return f"{_OF_CHANNEL[within // 2]} of channel {channel}" + (", high word" if within % 2 else "")
    return _REGISTERS.get(number, "")


def entry_of(capture: Capture, found: Decoded | Refused, time_s: float | None, with_hex: bool) -> dict[str, Any]:
    """Returns the fields of a frame. `time_s`: its time of arrival in s, or None."""
    place: dict[str, Any] = {"offset": found.offset, "time_s": time_s}
    if isinstance(found, Refused):
        return place | {"refused": found.reason, "bytes": found.length, "hex": found.data.hex(" ")}
    entry = place | {
        "from": "host" if found.from_host else "device",
        "format": _format_name(found.wire),
        "type": schema.TYPES[found.frame.type],
        "number": found.frame.number,
        "argument": found.frame.argument if found.from_host else None,
        "counts": list(found.frame.counts),
    }
    entry |= _meaning(capture, found)
    return entry | ({"hex": found.data.hex(" ") + " 00"} if with_hex else {})


def _meaning(capture: Capture, found: Decoded) -> dict[str, Any]:
    """Returns the fields of this type of frame, in SI units if the capture describes the scales, else null."""
    counts, argument = found.frame.counts, found.frame.argument
    match schema.TYPES[found.frame.type]:
        case "DESCRIBE":
            return {"register": _register_name(found.frame.number)}
        case "DESCRIPTION":
            return {"register": _register_name(found.frame.number), "value": counts[0] & 0xFFFFFFFF}
        case "ARM":
            word, pacing = counts[0] & 0xFFFFFFFF, argument & ~schema.PART_BITS
            return {
                "watchdog_samples": found.frame.number,
                "pacing": schema.PACINGS.get(pacing, str(pacing)),
                **{_PARTS[part.name].key: bool(argument & part.bit) for part in schema.PARTS},
                "schema": f"{word:08x}",
                "schema_is_ours": word == schema.SCHEMA_HASH,
            }
        case "STATUS":
            state, fault = counts[0] & 0xFF, counts[0] >> 8 & 0xFF
            text = schema.FAULTS.get(fault, "unknown")
            return {"state": schema.STATES.get(state, str(state)), "fault": fault, "fault_text": text}
        case "FORCE":
            channels = found.wire.channels
            force = _scaled(capture, schema.REG_CHANNEL + schema.REG_FORCE_SCALE, counts[:channels])
            ends = len(counts) - bool(found.wire.parts & schema.WITH_WORDS)
            behind: dict[str, Any] = {}
            if found.wire.parts & schema.WITH_COMMANDS:
                behind = {
                    "command_m": _scaled(capture, schema.REG_CHANNEL + schema.REG_POSITION_SCALE, counts[channels:ends])
                }
            elif found.wire.parts & schema.WITH_LINE:
                behind = {"line_counts": [unpack_line(*counts[at : at + 2]) for at in range(channels, ends, 2)]}
            behind |= {"outputs": counts[-1] & 0xFFFFFFFF} if counts[ends:] else {}
            return {"time_to_live_samples": argument, "force_N": force} | behind
        case "POSITION" | "POSITION_HELD":
            channels = found.wire.channels
            motion = {"position_m": _scaled(capture, schema.REG_CHANNEL + schema.REG_POSITION_SCALE, counts[:channels])}
            for i, part in enumerate(schema.in_parts(found.wire.parts & ~schema.WITH_WORDS), 1):
                own = counts[i * channels : (i + 1) * channels]
                motion[_PARTS[part.name].field] = _scaled(capture, part.scale_register, own, part.register_step)
            return motion | ({"inputs": counts[-1] & 0xFFFFFFFF} if found.wire.parts & schema.WITH_WORDS else {})
    return {}


def _scaled(
    capture: Capture, register: int, counts: tuple[int, ...], step: int = schema.CHANNEL_WORDS
) -> list[float | None]:
    """Returns values in SI units; None without a scale. `register`: of channel 0's scale, `step` before the next."""
    scales = [capture.registers.number(register + channel * step) for channel in range(len(counts))]
    return [None if scale is None else scale * count for scale, count in zip(scales, counts, strict=True)]


def text_of(entry: dict[str, Any]) -> str:
    """Returns an entry as a line."""
    time = "" if entry["time_s"] is None else f"{entry['time_s']:10.4f} s  "
    place = f"{entry['offset']:8d}  {time}"
    if "refused" in entry:
        is_whole = 3 * entry["bytes"] - 1 == len(entry["hex"])
        data = entry["hex"] if is_whole else f"the last: {entry['hex']}"
        return f"{place}refused: {plural(entry['bytes'], 'byte')}; {REASONS[entry['refused']]}: {data}"
    line = f"{place}{entry['from']:6}  {entry['format']:18}  {entry['type']:13}  {_words(entry)}".rstrip()
    return line + (f"  | {entry['hex']}" if "hex" in entry else "")


_WORDS = {
    "DESCRIBE": "register {number} ({name})",
    "DESCRIPTION": "register {number} ({name}) = {value} (0x{value:08x})",
    "ARM": "paced by {pacing}{parts}, watchdog {watchdog_samples} samples, schema {schema} ({whose})",
    "STATUS": "sample {number}: {state}{why}",
    "FORCE": "answers {number}, lives {time_to_live_samples} samples: {forces}{digital}",
    "POSITION": "sample {number}: {motion}{digital}",
    "POSITION_HELD": "sample {number}: {motion}{digital}",
}


def _words(entry: dict[str, Any]) -> str:
    """Returns the content of a frame in words, from its entry."""
    counts, motion, at = entry["counts"], [], 0
    for field, unit in (("position_m", "m"), *((part.field, part.unit) for part in _PARTS.values() if part.field)):
        scaled = entry.get(field, [])
        motion.append(_values(counts[at : at + len(scaled)], scaled, unit))
        at += len(scaled)
    words = {
        "name": entry.get("register") or "none",
        "parts": "".join(f", {part.plural} too" for part in _PARTS.values() if entry.get(part.key)),
        "whose": "ours" if entry.get("schema_is_ours") else "another one",
        "why": f", fault {entry['fault']}: {entry['fault_text']}" if entry.get("fault") else "",
        "forces": _values(counts, entry.get("force_N", []), "N") + _behind(entry),
        "motion": "; ".join(filter(None, motion)),
    }
    words |= {
        "digital": "".join(
            f"; {name} 0x{entry[name]:08x}" for name in ("inputs", "outputs") if type(entry.get(name)) is int
        )
    }
    return _WORDS.get(entry["type"], "").format(**entry | words)


def _behind(entry: dict[str, Any]) -> str:
    """Returns what stands behind the forces of a FORCE: lines or position commands."""
    lines, commands = entry.get("line_counts", []), entry.get("command_m", [])
    words = "".join("; line k {}, b {}, low {}, high {} counts".format(*line) for line in lines)
    return words + (f"; to {_values(entry['counts'][len(commands) :], commands, 'm')}" if commands else "")


def _values(counts: list[int], scaled: list[float | None], unit: str) -> str:
    return ", ".join(
        f"{count} counts" + ("" if value is None else f" ({output_units()(value, unit)})")
        for count, value in zip(counts, scaled, strict=False)
    )


def _summary(counters: Counter[str], sender: str) -> str:
    """Returns the counters as a sentence. `sender`: whose frames were looked for, host, device or both."""
    refused = [f"{count} {name}" for name in REASONS if (count := counters[f"refused: {name}"])]
    frames = f"{counters['from the host']} frames from the host, {counters['from the device']} from the device"
    if not refused:
        return f"{counters['bytes']} bytes: {frames}; nothing refused."
    sentence = f"{counters['bytes']} bytes: {frames}; refused {counters['refused bytes']} bytes: {', '.join(refused)}."
    if counters["from the host"] or counters["from the device"]:
        return sentence
    whose = "" if sender == "both" else f" of the {sender}"
    return f"{sentence} Nothing in it is a frame{whose}: is it raw bytes of the wire?"
