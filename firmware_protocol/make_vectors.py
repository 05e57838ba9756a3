"""Writes vectors.json, sessions.json and the generated parts of PROTOCOL.md and PORTING.md.

Run `python -m firmware_protocol.make_vectors` after a change of the protocol; a test fails until then. The generated
parts of a document stand between two comment lines. The C header's constants are changed by hand.
"""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol import schema
from firmware_protocol.frames import Format
from firmware_protocol.sessions import sessions
from firmware_protocol.vectors import FORMATS, TO_DEVICE, TYPES, frame, vectors
from firmware_protocol.wire_time import BITS_PER_BYTE, HOST_WORK_S

_HERE = Path(__file__).parent
VECTORS = _HERE / "vectors.json"
SESSIONS = _HERE / "sessions.json"
DOCUMENT = _HERE / "PROTOCOL.md"
PORTING = _HERE / "PORTING.md"


def vectors_text() -> str:
    """vectors.json as it has to be: one vector a line, so that a difference can be read."""
    return _by_lines(vectors())


def sessions_text() -> str:
    """sessions.json as it has to be: one session a line."""
    return _by_lines(sessions())


def document_text() -> str:
    """PROTOCOL.md as it has to be."""
    return with_blocks(DOCUMENT.read_text("utf-8"))


def porting_text() -> str:
    """PORTING.md as it has to be."""
    return with_blocks(PORTING.read_text("utf-8"), porting_blocks())


def _by_lines(document: dict[str, Any]) -> str:
    members = [f"{json.dumps(name)}: {_member(value)}" for name, value in document.items()]
    return "{\n" + ",\n".join(members) + "\n}\n"


def _member(value: Any) -> str:
    if not isinstance(value, list):
        return json.dumps(value)
    return "[\n" + ",\n".join(json.dumps(entry) for entry in value) + "\n]"


BAUDS = (115_200, 921_600, 2_000_000)


class _Example(NamedTuple):
    format_name: str
    kind: str
    number: int
    argument: int
    counts: tuple[int, ...]
    meaning: str
    payload_meaning: str


_LATCHED = schema.LATCHED | schema.HOST_QUIET << 8
_SENSING = schema.PACED_BY_DEVICE | schema.WITH_VELOCITY
_HASH = schema.SCHEMA_HASH - (schema.SCHEMA_HASH >> 31 << 32)

_EXAMPLES = (
    _Example("setup", "describe", 2, 0, (0,), "what does register 2 hold?", "unused"),
    _Example("setup", "description", 2, 0, (3,), "register 2 holds 3: three channels", "the register's value"),
    _Example("setup", "arm", 100, 0, (_HASH,), "watchdog of 100 samples, the device paces", "the schema hash"),
    _Example("setup", "status", 0, 0, (schema.ARMED,), "armed", "state 1, fault 0"),
    _Example("armed_1", "position", 300, 0, (-1234567,), "position of sample 300", "counts"),
    _Example("armed_1", "force", 300, 20, (1000000,), "answers sample 300, lives 20 samples", "counts"),
    _Example("armed_1", "position_held", 301, 0, (-1234560,), "sample 301; 300 went without its answer", "counts"),
    _Example("armed_1", "status", 400, 0, (_LATCHED,), "the host was quiet: latched", "state 2, fault 1"),
    _Example("armed_1", "disarm", 0, 0, (0,), "release", "unused"),
    _Example("setup", "status", 402, 0, (schema.HOST_QUIET << 8,), "idle", "state 0, fault 1, the last one"),
    _Example("armed_4", "position", 4095, 0, (0, -1, 2**31 - 1, -(2**31)), "four channels, 32-bit check", "counts"),
    _Example("armed_4", "force", 4095, 0, (0, 256, -256, 1), "answers sample 4095, for one sample", "counts"),
    _Example(
        "setup", "arm", 100, _SENSING, (_HASH,), "the same, and the device is to send velocities", "the schema hash"
    ),
    _Example("velocity_1", "position", 300, 0, (-1234567, 20000), "position of sample 300, and its velocity", "counts"),
    _Example("velocity_1", "force", 300, 20, (1000000,), "answers sample 300, lives 20 samples", "counts"),
    _Example("velocity_2", "position", 301, 0, (1, -1, 256, -256), "two channels, 32-bit check", "counts"),
)


def blocks() -> dict[str, str]:
    """The generated parts by name, as they stand between their comment lines."""
    return {
        "constants": _constants(),
        "schema": f"```text\n{schema.SCHEMA}```",
        "time on the wire": _wire_time(velocity=False),
        "time on the wire with velocities": _wire_time(velocity=True),
        "examples": "\n\n".join(_annotated(example) for example in _EXAMPLES),
    }


def porting_blocks() -> dict[str, str]:
    """The same for PORTING.md."""
    return {"baud and rate": _baud_and_rate(), "words of doubles": _words_of_doubles()}


def with_blocks(document: str, parts: dict[str, str] | None = None) -> str:
    """The document with every generated part brought up to date, `blocks()` or others. ValueError where one has no
    place in it."""
    for name, block in (blocks() if parts is None else parts).items():
        begin, end = f"<!-- made by make_vectors: {name} -->", f"<!-- end: {name} -->"
        around = re.split(f"{re.escape(begin)}.*?{re.escape(end)}", document, flags=re.DOTALL)
        if len(around) != 2:
            raise ValueError(f"the document has {len(around) - 1} places for the part {name!r}, expected one")
        document = f"{begin}\n\n{block}\n\n{end}".join(around)
    return document


def _constants() -> str:
    rows = [
        ("schema hash", schema.SCHEMA_HASH, 8),
        ("start value, set-up format (CRC-16)", schema.SETUP_SEED, 4),
        ("start value, armed format of 1 to 3 channels (CRC-16)", schema.ARMED_SEED_SHORT, 4),
        ("start value, armed format of 4 to 16 channels (CRC-32C)", schema.ARMED_SEED_LONG, 8),
        ("velocity mark", schema.VELOCITY_MARK, 8),
        ("start value, armed format with velocities of 1 channel (CRC-16)", schema.VELOCITY_SEED_SHORT, 4),
        ("start value, armed format with velocities of 2 to 16 channels (CRC-32C)", schema.VELOCITY_SEED_LONG, 8),
    ]
    lines = ["| constant | value |", "|---|---|"]
    return "\n".join(lines + [f"| {name} | `0x{value:0{digits}x}` |" for name, value, digits in rows])


def _wire_time(velocity: bool) -> str:
    lines = [
        "| channels | to host | to device | exchange | " + " | ".join(f"{baud} baud" for baud in BAUDS) + " |",
        "|---:|---:|---:|---:|" + "---:|" * len(BAUDS),
    ]
    for channels in range(1, schema.MAX_CHANNELS + 1):
        host, device = (schema.frame_bytes(channels, to_device, velocity) for to_device in (False, True))
        times = [1e3 * BITS_PER_BYTE * (host + device) / baud for baud in BAUDS]
        cells = [f"{channels}", f"{host} B", f"{device} B", f"{host + device} B", *(f"{t:.3f} ms" for t in times)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _annotated(example: _Example) -> str:
    wire = FORMATS[example.format_name]
    data = frame(example.format_name, example.kind, example.number, example.argument, list(example.counts))
    checked = len(data) - (6 if wire.long_check else 4)
    where = "set-up" if example.format_name == "setup" else f"armed, {wire.channels} channel{'s'[: wire.channels - 1]}"
    where += " with velocity" if wire.velocity else ""
    rows = [("body" if i == 0 else "", *row) for i, row in enumerate(_body_rows(example))]
    rows += [
        ("encoded", _hex(data[:checked]), ""),
        ("check", _hex(data[checked:-1]), _check_text(wire, data[checked:-1])),
        ("delimiter", "00", ""),
    ]
    width = max(len(text) for _, text, meaning in rows if meaning)
    lines = [f"{part:<9}  {text:<{width}}  {meaning}".rstrip() for part, text, meaning in rows]
    return "\n".join([f"**{example.kind.upper()}**, {where}: {example.meaning}", "", "```text", *lines, "```"])


def _body_rows(example: _Example) -> list[tuple[str, str]]:
    code = TYPES[example.kind]
    header = struct.pack(">H", code << 12 | example.number)
    rows = [(_hex(header), f"type {code:#x}, number {example.number:#05x} = {example.number}")]
    if example.kind in TO_DEVICE:
        rows.append((f"{example.argument:02x}", f"argument {example.argument}"))
    for channel, count in enumerate(example.counts):
        rows.append((_hex(struct.pack("<i", count)), f"payload {channel} = {count} ({example.payload_meaning})"))
    return rows


def _check_text(wire: Format, sent: bytes) -> str:
    value = sum((byte & 0x7F) << 7 * i for i, byte in enumerate(sent))
    name, digits = ("CRC-32C", 8) if wire.long_check else ("CRC-16/DNP", 4)
    return f"{name} from 0x{wire.seed:0{digits}x} over the encoded bytes: 0x{value:0{digits}x}"


def _hex(data: bytes) -> str:
    return data.hex(" ")


_PORTING_BAUDS = (115_200, 250_000, 500_000, 921_600, 1_000_000, 2_000_000)
_DOUBLES = (
    (1e-9, "1 nm, 1 nN"),
    (1e-8, "10 nm, 10 nN"),
    (1e-7, "0.1 µm"),
    (1e-6, "1 µm"),
    (1e-5, "10 µm"),
    (1e-4, "0.1 mm"),
    (1e-3, "1 mm, 1 mN"),
    (6.283185307179586 / 4096, "2π/4096: an encoder of 1024 lines, in rad"),
    (1.0, "1 N"),
    (2.0, "2 N"),
    (5.0, "5 N"),
    (10.0, "10 N"),
    (500.0, "500 Hz"),
    (1000.0, "1 kHz"),
    (2000.0, "2 kHz"),
)


def _baud_and_rate() -> str:
    """The highest rate whose force comes within one sample period, and within two, of 1, 2, 3 and 6 channels."""
    channels = (1, 2, 3, 6)
    heads = [f"{n} channel{'s' if n > 1 else ''}" for n in channels]
    lines = [f"| baud | {' | '.join(heads)} |", "|---:|" + "---:|" * len(channels)]
    for baud in _PORTING_BAUDS:
        cells = []
        for n in channels:
            exchange = sum(schema.frame_bytes(n, to_device, velocity=False) for to_device in (False, True))
            seconds = exchange * BITS_PER_BYTE / baud + HOST_WORK_S
            cells.append(f"{_rate(1.0 / seconds)} / {_rate(2.0 / seconds)}")
        lines.append(f"| {baud} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _rate(hertz: float) -> str:
    return f"{hertz / 1000:.2g} kHz" if hertz < 10_000 else f"{hertz / 1000:.0f} kHz"


def _words_of_doubles() -> str:
    lines = ["| value | `HAPSIM_F64(high, low)` | |", "|---:|---|---|"]
    for value, meaning in _DOUBLES:
        low, high = struct.unpack("<2I", struct.pack("<d", value))
        lines.append(f"| {value:.10g} | `HAPSIM_F64(0x{high:08x}, 0x{low:08x})` | {meaning} |")
    return "\n".join(lines)


def main() -> None:
    VECTORS.write_text(vectors_text(), "utf-8")
    SESSIONS.write_text(sessions_text(), "utf-8")
    DOCUMENT.write_text(document_text(), "utf-8")
    PORTING.write_text(porting_text(), "utf-8")
    print(f"wrote {VECTORS}, {SESSIONS}, {DOCUMENT} and {PORTING}")


if __name__ == "__main__":
    main()
