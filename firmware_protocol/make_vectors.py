"""Writes vectors.json, sessions.json and the generated parts of PROTOCOL.md and PORTING.md.

Run `python -m firmware_protocol.make_vectors` after a change of the protocol; a test fails until then. Two comments
enclose each generated part of a document. The C header's constants are changed by hand.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from firmware_protocol import schema
from firmware_protocol.lines import pack_line
from firmware_protocol.schema import BITS_PER_BYTE, HOST_WORK_S
from firmware_protocol.vectors import FAMILIES, FORMATS, TO_DEVICE, TYPES, frame, sessions, vectors

VECTORS, SESSIONS, DOCUMENT, PORTING = (
    Path(__file__).with_name(name) for name in ("vectors.json", "sessions.json", "PROTOCOL.md", "PORTING.md")
)


def made_text(path: Path) -> str:
    """Returns the up-to-date text of one of the four files."""
    if path in (VECTORS, SESSIONS):
        document = vectors() if path == VECTORS else sessions()
        # Each vector on a line of its own, so that a difference can be read.
        members = []
        for name, value in document.items():
            lines = ",\n".join(map(json.dumps, value)) if isinstance(value, list) else ""
            members.append(f"{json.dumps(name)}: " + (f"[\n{lines}\n]" if lines else json.dumps(value)))
        return "{\n" + ",\n".join(members) + "\n}\n"
    porting = {"baud and rate": _baud_and_rate(), "words of doubles": _words_of_doubles()}
    return with_blocks(path.read_text("utf-8"), _document_blocks() if path == DOCUMENT else porting)


def with_blocks(document: str, blocks: dict[str, str]) -> str:
    """Returns the document with its generated parts replaced by `blocks`. ValueError where one has no place in it."""
    for name, block in blocks.items():
        begin, end = f"<!-- made by make_vectors: {name} -->", f"<!-- end: {name} -->"
        around = re.split(f"{re.escape(begin)}.*?{re.escape(end)}", document, flags=re.DOTALL)
        if len(around) != 2:
            raise ValueError(f"the document has {len(around) - 1} places for the part {name!r}, expected one")
        document = f"{begin}\n\n{block}\n\n{end}".join(around)
    return document


def _table(head: Iterable[str], align: str, rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table. `align`: "r" for each right-aligned column, "l" for each other one."""
    rule = "".join({"r": "---:|", "l": "---|"}[each] for each in align)
    return "\n".join([f"| {' | '.join(head)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)])


# PROTOCOL.md.


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
_LINE = (1000000, *pack_line(800, 500, -32767, 0))
_HASH = schema.SCHEMA_HASH - (schema.SCHEMA_HASH >> 31 << 32)

_EXAMPLES = (
    _Example("setup", "describe", 2, 0, (0,), "what does register 2 hold?", "unused"),
    _Example("setup", "description", 2, 0, (3,), "register 2 holds 3: three channels", "the register's value"),
    _Example("setup", "arm", 100, 0, (_HASH,), "watchdog of 100 samples, the device paces", "the schema hash"),
    _Example("setup", "status", 0, 0, (schema.ARMED,), "armed", "state 1, fault 0"),
    _Example("armed_1", "position", 300, 0, (-1234567,), "position of sample 300", "counts"),
    _Example("armed_1", "force", 300, 20, (1000000,), "answers sample 300, time to live 20 samples", "counts"),
    _Example("armed_1", "position_held", 301, 0, (-1234560,), "sample 301; sample 300 got no answer", "counts"),
    _Example("armed_1", "status", 400, 0, (_LATCHED,), "the host was quiet: latched", "state 2, fault 1"),
    _Example("armed_1", "disarm", 0, 0, (0,), "release", "unused"),
    _Example("setup", "status", 402, 0, (schema.HOST_QUIET << 8,), "idle", "state 0, fault 1, the last one"),
    _Example("armed_4", "position", 4095, 0, (0, -1, 2**31 - 1, -(2**31)), "four channels, 32-bit check", "counts"),
    _Example("armed_4", "force", 4095, 0, (0, 256, -256, 1), "answers sample 4095, acts for one sample", "counts"),
    _Example("setup", "arm", 100, _SENSING, (_HASH,), "watchdog of 100 samples, with velocities", "the schema hash"),
    _Example("velocity_1", "position", 300, 0, (-1234567, 20000), "position of sample 300, and its velocity", "counts"),
    _Example("velocity_1", "force", 300, 20, (1000000,), "answers sample 300, time to live 20 samples", "counts"),
    _Example("velocity_2", "position", 301, 0, (1, -1, 256, -256), "two channels, 32-bit check", "counts"),
    _Example("line_1", "force", 300, 20, _LINE, "k 800, b 500, low -32767, high 0", "counts"),
    _Example("words_1", "position", 300, 0, (-1234567, 5), "position of sample 300; inputs 0 and 2 are on", "counts"),
    _Example("words_1", "force", 300, 20, (1000000, 256), "turns output 8 on, and all others off", "counts"),
    _Example(
        "setup", "arm", 100, schema.ADMITTANCE, (_HASH,), "for admittance, paced by the device", "the schema hash"
    ),
    _Example("admittance_1", "position", 300, 0, (-1234567, 50000), "position of sample 300, and hand force", "counts"),
    _Example("admittance_1", "force", 300, 20, (0, -1234500), "a position command that answers sample 300", "counts"),
    _Example("both_1", "position", 300, 0, (-1234567, 20000, -9810), "position, velocity, acceleration", "counts"),
)


def _document_blocks() -> dict[str, str]:
    return {
        "constants": _constants(),
        "schema": f"```text\n{schema.SCHEMA}```",
        "time on the wire": _wire_time(0),
        "time on the wire with velocities": _wire_time(schema.WITH_VELOCITY),
        "time on the wire with both": _wire_time(schema.MOTION_BITS),
        "time on the wire with lines": _wire_time(schema.WITH_LINE),
        "time on the wire with words": _wire_time(schema.WITH_WORDS),
        "time on the wire in admittance": _wire_time(schema.ADMITTANCE),
        "examples": "\n\n".join(_annotated(example) for example in _EXAMPLES),
    }


def _constants() -> str:
    rows = {
        "schema hash": f"{schema.SCHEMA_HASH:08x}",
        "start value, set-up format (CRC-16)": f"{schema.SETUP_SEED:04x}",
    } | {f"{part.name} mark": f"{part.mark:08x}" for part in schema.PARTS if part.mark}
    for parts in FAMILIES:
        names = " and ".join(part.name for part in schema.PARTS if part.bit & parts)
        of, word = "start value, armed format" + (f" with {names}" if names else ""), schema.seed_word(parts)
        most = max((n for n in range(1, schema.MAX_CHANNELS) if not schema.has_long_check(n, parts)), default=0)
        if most:
            short = "1 channel" if most == 1 else f"1 to {most} channels"
            rows[f"{of}, {short} (CRC-16)"] = f"{schema.folded(word):04x}"
        largest = max(n for n in range(1, schema.MAX_CHANNELS + 1) if schema.fits(n, parts))
        rows[f"{of}, {most + 1} to {largest} channels (CRC-32C)"] = f"{word:08x}"
    return _table(("constant", "value"), "ll", ((name, f"`0x{value}`") for name, value in rows.items()))


def _wire_time(parts: int) -> str:
    bauds = (115_200, 921_600, 2_000_000)
    rows = []
    for channels in range(1, schema.MAX_CHANNELS + 1):
        host, device = (schema.frame_bytes(channels, to_device, parts) for to_device in (False, True))
        times = (f"{1e3 * (host + device) * BITS_PER_BYTE / baud:.3f} ms" for baud in bauds)
        rows.append((f"{channels}", f"{host} B", f"{device} B", f"{host + device} B", *times))
    return _table(("channels", "to host", "to device", "exchange", *(f"{baud} baud" for baud in bauds)), "r" * 7, rows)


def _annotated(example: _Example) -> str:
    """A frame part by part, in hexadecimal, with its meaning beside it."""
    wire, code = FORMATS[example.format_name], TYPES[example.kind]
    data = frame(example.format_name, example.kind, example.number, example.argument, list(example.counts))
    checked = len(data) - (6 if wire.long_check else 4)
    where = "set-up" if example.format_name == "setup" else f"armed, {wire.channels} channel{'s'[: wire.channels - 1]}"
    where += f" with {' and '.join(wire.part_names)}" if wire.parts else ""
    header = struct.pack(">H", code << 12 | example.number)
    rows = [("body", header, f"type {code:#x}, number {example.number:#05x} = {example.number}")]
    if example.kind in TO_DEVICE:
        rows.append(("", bytes([example.argument]), f"argument {example.argument}"))
    for i, count in enumerate(example.counts):
        rows.append(("", struct.pack("<i", count), f"payload {i} = {count} ({example.payload_meaning})"))
    value = sum((byte & 0x7F) << 7 * i for i, byte in enumerate(data[checked:-1]))
    name, digits = ("CRC-32C", 8) if wire.long_check else ("CRC-16/DNP", 4)
    check = f"{name} from 0x{wire.seed:0{digits}x} over the encoded bytes: 0x{value:0{digits}x}"
    rows += [("encoded", data[:checked], ""), ("check", data[checked:-1], check), ("delimiter", data[-1:], "")]
    width = max(len(part.hex(" ")) for _, part, meaning in rows if meaning)
    lines = [f"{name:<9}  {part.hex(' '):<{width}}  {meaning}".rstrip() for name, part, meaning in rows]
    return "\n".join([f"**{example.kind.upper()}**, {where}: {example.meaning}", "", "```text", *lines, "```"])


# PORTING.md.

_DOUBLES = {
    1e-9: "1 nm, 1 nN",
    1e-8: "10 nm, 10 nN",
    1e-7: "0.1 µm",
    1e-6: "1 µm",
    1e-5: "10 µm",
    1e-4: "0.1 mm",
    1e-3: "1 mm, 1 mN",
    6.283185307179586 / 4096: "2π/4096: an encoder of 1024 lines, in rad",
    1.0: "1 N",
    2.0: "2 N",
    5.0: "5 N",
    10.0: "10 N",
    500.0: "500 Hz",
    1000.0: "1 kHz",
    2000.0: "2 kHz",
}


def _baud_and_rate() -> str:
    """The highest rates whose force comes within one sample period, and within two."""
    channels = (1, 2, 3, 6)
    rows = []
    for baud in (115_200, 250_000, 500_000, 921_600, 1_000_000, 2_000_000):
        exchanges = (sum(schema.frame_bytes(n, to_device) for to_device in (False, True)) for n in channels)
        seconds = [exchange * BITS_PER_BYTE / baud + HOST_WORK_S for exchange in exchanges]
        rows.append((f"{baud}", *(f"{_rate(1.0 / each)} / {_rate(2.0 / each)}" for each in seconds)))
    return _table(("baud", *(f"{n} channel{'s' if n > 1 else ''}" for n in channels)), "r" * 5, rows)


def _rate(hertz: float) -> str:
    return f"{hertz / 1000:.2g} kHz" if hertz < 10_000 else f"{hertz / 1000:.0f} kHz"


def _words_of_doubles() -> str:
    rows = []
    for value, meaning in _DOUBLES.items():
        words = struct.pack(">d", value).hex()
        rows.append((f"{value:.10g}", f"`HAPSIM_F64(0x{words[:8]}, 0x{words[8:]})`", meaning))
    return _table(("value", "`HAPSIM_F64(high, low)`", ""), "rll", rows).replace("|  |", "| |", 1)


def main() -> None:
    """Writes the four files."""
    for path in (VECTORS, SESSIONS, DOCUMENT, PORTING):
        path.write_text(made_text(path), "utf-8")
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
