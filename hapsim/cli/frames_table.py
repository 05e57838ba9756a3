"""A decoded capture as text and as a JSON document, entry by entry: it may be longer than memory."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, Format
from hapsim.bringup.capture import REASONS, Capture, Decoded, Refused

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
    scales = [capture.scale(which, channel) for channel in range(len(counts))]
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
