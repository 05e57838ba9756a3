"""Test vectors of the protocol, in any language: bytes, and the fields and counters that belong to them. And sessions
of a device: the steps of sessions.yaml with their frames as bytes.

`make_vectors` writes them to vectors.json and sessions.json; PROTOCOL.md ("Test vectors") explains the entries. Rules
choose all vectors, not chance, so the file changes only with the protocol. Nothing in a session is worked out by a
device: what is expected stands beside what is done.
"""

from __future__ import annotations

from itertools import cycle, islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder, use_format
from firmware_protocol.frames import (
    SETUP,
    Format,
    armed_format,
    crc_of,
    frame_bytes,
    frame_to_device,
    frame_to_host,
    stuff,
)
from firmware_protocol.lines import pack_line

_FAMILIES = {
    0: ("armed", (1, 3, 4, 16)),
    schema.WITH_VELOCITY: ("velocity", (1, 2, 16)),
    schema.WITH_ACCELERATION: ("acceleration", (1, 2, 4, 16)),
    schema.MOTION_BITS: ("both", (1, 2, 4, 16)),
    schema.WITH_LINE: ("line", (1, 2, 16)),
    schema.WITH_WORDS: ("words", (1, 3)),
    schema.WITH_WORDS | schema.WITH_VELOCITY: ("words_velocity", (1,)),
    schema.WITH_WORDS | schema.WITH_LINE: ("words_line", (1,)),
    schema.PART_BITS & ~schema.ADMITTANCE: ("all", (1, 2, 16)),
    schema.ADMITTANCE: ("admittance", (1, 2)),
    schema.ADMITTANCE | schema.WITH_VELOCITY: ("admittance_velocity", (1,)),
    schema.PART_BITS & ~schema.WITH_LINE: ("admittance_all", (1, 15)),
}
FORMATS = {"setup": SETUP} | {
    f"{name}_{n}": armed_format(n, parts) for parts, (name, channels) in _FAMILIES.items() for n in channels
}
FAMILIES = {parts: name for parts, (name, _) in _FAMILIES.items()}
"""Beginning of a format's name, by its parts."""
NAMES = {code: name.lower() for code, name in schema.TYPES.items()}
TYPES = {name: code for code, name in NAMES.items()}
TO_DEVICE = {name: code for name, code in TYPES.items() if code <= schema.DISARM}
TO_HOST = {name: code for name, code in TYPES.items() if code > schema.DISARM}
COUNTERS = ("accepted", "crc_errors", "length_errors", "form_errors", "garbage_bytes")

_WORDS = (0, -1, 2**31 - 1, -(2**31), 1, 256, 0x01010101, -0x01010102, 0x00FF00FF, 1_000_000, -1_000_000, 0x12345678)
_NUMBERS = (0, 4095, 1, 256, 255, 3840, 2048, 1234)
_ARGUMENTS = (0, 255, 20, 1)

Entry = dict[str, Any]


def vectors() -> Entry:
    """Returns the document of vectors.json."""
    return {
        "about": "Test vectors of the hapsim wire protocol; PROTOCOL.md explains them. Bytes are hexadecimal.",
        "version": schema.VERSION,
        "schema_hash": schema.SCHEMA_HASH,
        "formats": [_format_entry(name) for name in FORMATS],
        "crc": _crc_vectors(),
        "cobs": _cobs_vectors(),
        "frames": _frame_vectors(),
        "streams": _stream_vectors(),
        "refused": _refused_vectors(),
    }


def frame(format_name: str, kind: str, number: int, argument: int, counts: list[int]) -> bytes:
    """Returns a frame by the vectors' names. A frame to the host has no argument."""
    wire = FORMATS[format_name]
    if kind in TO_DEVICE:
        return frame_to_device(wire, TO_DEVICE[kind], number, argument, counts)
    return frame_to_host(wire, TO_HOST[kind], number, counts)


def words_in(format_name: str, kind: str) -> int:
    """Returns the words of a frame's payload, by the vectors' names."""
    return FORMATS[format_name].words(kind in TO_DEVICE)


def _reading(about: str, direction: str, steps: list[tuple[str, bytes]]) -> Entry:
    """A vector of a stream: each step chooses a format, then a decoder reads a chunk."""
    before, read = steps[0][0], []
    decoder = new_decoder(FORMATS[before], direction == "to_device")
    for format_name, chunk in steps:
        if format_name != before:
            use_format(decoder, FORMATS[format_name])
            before = format_name
        read += frames_in(decoder, chunk)
    return {
        "about": about,
        "direction": direction,
        "steps": [{"format": name, "bytes": chunk.hex()} for name, chunk in steps],
        "frames": [_fields(NAMES[f.type], f.number, f.argument, list(f.counts)) for f in read],
        "counters": {counter: int(decoder[counter]) for counter in COUNTERS},
    }


def sealed(wire: Format, encoded: bytes) -> bytes:
    """Returns encoded bytes, right or wrong, with their check and the delimiter."""
    check = _crc(wire.long_check, encoded, wire.seed)
    return encoded + bytes(0x80 | check >> 7 * i & 0x7F for i in range(5 if wire.long_check else 3)) + b"\0"


def _crc(is_long: bool, data: bytes, seed: int) -> int:
    return int(crc_of(is_long, np.frombuffer(data, np.uint8), 0, len(data), seed))


def _fields(kind: str, number: int, argument: int, counts: list[int]) -> Entry:
    arguments = {"argument": argument} if kind in TO_DEVICE else {}
    return {"type": kind, "number": number} | arguments | {"payload": counts}


def _format_entry(name: str) -> Entry:
    wire = FORMATS[name]
    return {
        "name": name,
        "channels": wire.channels,
        **{part.name: bool(wire.parts & part.bit) for part in schema.PARTS},
        "check_bits": 32 if wire.long_check else 16,
        "seed": wire.seed,
        "bytes_to_device": frame_bytes(wire, to_device=True),
        "bytes_to_host": frame_bytes(wire, to_device=False),
    }


def _crc_vectors() -> list[Entry]:
    texts = [b"", b"\0", b"123456789", bytes(range(1, 69)), b"\xff" * 16]
    seeds = {"crc16_dnp": (0, schema.SETUP_SEED), "crc32_c": (0xFFFFFFFF, schema.SCHEMA_HASH)}
    return [
        {"check": check, "seed": seed, "bytes": text.hex(), "value": _crc(check == "crc32_c", text, seed)}
        for check in seeds
        for seed in seeds[check]
        for text in texts
    ]


def _cobs_vectors() -> list[Entry]:
    bodies = [b"", b"\0", b"\0\0", b"\1", b"\1\0", b"\0\1", bytes([17, 34, 0, 51]), bytes(68), b"\xff" * 68]
    bodies += [bytes(range(68)), bytes(range(1, 254)), bytes(253)]
    entries = []
    for body in bodies:
        buffer = np.frombuffer(bytearray(b"\0" + body), np.uint8)
        stuff(buffer, 0, buffer.size)
        entries.append({"body": body.hex(), "encoded": buffer.tobytes().hex()})
    return entries


def _frame_vectors() -> list[Entry]:
    numbers, arguments, words = cycle(_NUMBERS), cycle(_ARGUMENTS), cycle(_WORDS)
    entries = []
    for name in FORMATS:
        for kind in TYPES:
            for _ in range(3):
                fields = (kind, next(numbers), next(arguments), list(islice(words, words_in(name, kind))))
                next(words)  # so that the words wander over the channels
                entries.append({"format": name} | _fields(*fields) | {"bytes": frame(name, *fields).hex()})
    return entries


def _stream_vectors() -> list[Entry]:
    entries = []
    for name, direction, kind in (
        ("setup", "to_device", "describe"),
        ("armed_1", "to_host", "position"),
        ("armed_1", "to_device", "force"),
        ("armed_4", "to_device", "force"),
        ("armed_16", "to_host", "position_held"),
        ("velocity_1", "to_host", "position"),
        ("velocity_2", "to_device", "force"),
        ("velocity_16", "to_host", "position"),
        ("acceleration_1", "to_host", "position"),
        ("both_2", "to_device", "force"),
        ("both_16", "to_host", "position"),
        ("line_1", "to_device", "force"),
        ("line_2", "to_host", "position"),
        ("line_16", "to_device", "force"),
        ("words_1", "to_device", "force"),
        ("words_velocity_1", "to_host", "position"),
        ("words_line_1", "to_device", "force"),
        ("all_2", "to_device", "force"),
        ("all_16", "to_host", "position"),
    ):
        frames = [frame(name, kind, n, 9, [n - 2] * words_in(name, kind)) for n in (1, 2, 3)]
        entries += [_reading(about, direction, [(name, c) for c in chunks]) for about, chunks in _streams_of(frames)]
    return entries + _arming_streams()


def _streams_of(frames: list[bytes]) -> list[tuple[str, list[bytes]]]:
    """(description, chunks) of mishaps on the wire, each among three whole frames."""
    first, second, third = frames
    return [
        ("three frames in one read", [first + second + third]),
        ("one byte at a time", [bytes([byte]) for byte in first + second]),
        ("reading begins in the middle of a frame", [first[4:] + second, third]),
        ("a text without a delimiter before the first frame", [b"boot: ready\r\n", first]),
        ("noise with delimiters in it", [bytes([0, 7, 0, 0, 255, 1, 0]) + first]),
        ("a thousand bytes of noise without a delimiter", [bytes([200, 17, 4, 99]) * 250, first]),
        ("noise of one delimiter after another", [b"\0" * 5 + first + b"\0" * 3 + second]),
        ("a delimiter was lost: two frames run together", [first[:-1] + second + third]),
        ("a delimiter was flipped", [first[:-1] + b"\x10" + second + third]),
        ("a byte was lost", [first + second[:3] + second[4:] + third]),
        ("a byte came twice", [first + second[:3] + second[2:] + third]),
        ("a byte became a delimiter", [first + second[:3] + b"\0" + second[4:] + third]),
        ("the wire broke in the middle of a frame", [first + second[:5], b"\0" + third]),
    ]


def _arming_streams() -> list[Entry]:
    """Streams to the host around arming and a fault, in both formats, without velocities and with them."""
    fault = schema.LATCHED | schema.HOST_QUIET << 8
    armed = ("setup", frame("setup", "status", 0, 0, [schema.ARMED]))
    latched = ("setup", frame("setup", "status", 2, 0, [fault]))

    def stream(about: str, name: str, first: list[int], second: list[int], cut_off: bytes) -> Entry:
        positions = frame(name, "position", 0, 0, first) + frame(name, "position_held", 1, 0, second)
        last = frame(name, "status", 2, 0, [fault] + [0] * (len(first) - 1)) + cut_off
        return _reading(about, "to_host", [armed, (name, positions), (name, last), latched])

    begun = frame("armed_3", "position", 3, 0, [0, 0, 0])[:6]
    plain = "arming, two positions, a fault; a frame begun in one format is forgotten in the next"
    sensed = "arming with velocities, two positions and their velocities, a fault"
    both = "arming with velocities and accelerations, two positions with both, a fault"
    return [
        stream(plain, "armed_3", [5, -5, 0], [6, -6, 0], begun),
        stream(sensed, "velocity_1", [5, -500], [-6, 7], b""),
        stream(both, "both_1", [5, -500, 60000], [-6, 7, -8], b""),
    ]


def _refused_vectors() -> list[Entry]:
    entries = []
    for name, wire in FORMATS.items():
        for direction, kind, back in (("to_device", "force", "position"), ("to_host", "position", "force")):
            counts, counts_back = (list(islice(cycle(_WORDS), words_in(name, k))) for k in (kind, back))
            cases = _refused_of(wire, direction == "to_device", frame(name, kind, 300, 20, counts))
            cases["a frame of the other direction"] = frame(name, back, 300, 20, counts_back)
            for other in [other for other in FORMATS if other != name]:
                cases[f"a frame of the format {other}"] = frame(other, kind, 300, 20, [7] * words_in(other, kind))
            entries += [_reading(about, direction, [(name, data)]) for about, data in cases.items()]
    return entries


def _refused_of(wire: Format, to_device: bool, good: bytes) -> dict[str, bytes]:
    """Ways to spoil a good frame, and frames that are good elsewhere, by description."""
    checked = len(good) - (6 if wire.long_check else 4)
    last = len(good) - 2
    zeros = [0] * wire.words(to_device)

    def written(wire: Format, code: int) -> bytes:
        return frame_to_device(wire, code, 300, 20, zeros) if to_device else frame_to_host(wire, code, 300, zeros)

    unknown = (0, 5, 8, 9, 15) if to_device else (0, 1, 8, 13, 15)
    return {
        "one bit of the code is flipped": _flip(good, 0, 0x01),
        "one bit of the payload is flipped": _flip(good, checked - 1, 0x40),
        "one bit of the check is flipped": _flip(good, checked, 0x02),
        "a bit of the check that is always clear is set": _flip(good, last, 0x40),
        "the bit of a check's byte that is always set is clear": _flip(good, last, 0x80),
        "three bits are flipped": _flip(_flip(_flip(good, 1, 0x04), 2, 0x20), 5, 0x08),
        "the first byte is missing": good[1:],
        "the last byte before the delimiter is missing": good[:last] + good[last + 1 :],
        "another start value": written(wire._replace(seed=wire.seed ^ 1), 3 if to_device else 10),
        "a right check over a code that points beyond the end": sealed(
            wire, bytes([checked + 1]) + b"\x33" * (checked - 1)
        ),
        **{f"a right check over type {code:#x}": written(wire, code) for code in unknown},
    }


def _flip(data: bytes, at: int, bits: int) -> bytes:
    return data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]


LIMIT = 1_000_000_000  # counts: 10 N of 1e-8 N
_PLAIN = {"channels": 1, "pacings": 3, "max_watchdog": 2047, "velocity": True, "acceleration": True}
_PLAIN |= {"impulse": False, "steps": 0, "words": False, "servo": False}
DEVICES: dict[str, dict[str, Any]] = {
    "plain": _PLAIN,
    "bare": _PLAIN | {"pacings": 1, "max_watchdog": 100, "velocity": False, "acceleration": False},
    "four": _PLAIN | {"channels": 4},
    "impulse": _PLAIN | {"impulse": True},
    "lines": _PLAIN | {"steps": 4},
    "words": _PLAIN | {"words": True},
    "all": _PLAIN | {"steps": 4, "words": True},
    "servo": _PLAIN | {"servo": True, "words": True},
}
STATES = ("idle", "armed", "latched")

_SOURCE = Path(__file__).with_name("sessions.yaml")
_MEASURED = ("position", *(part.name for part in (*schema.SENSED, schema.INPUTS)))
_OF_SETUP = ("describe", "description", "arm", "status")  # unless a frame names another format


def sessions() -> Entry:
    """All of sessions.json."""
    return {
        "about": "Sessions of a device, step by step; PROTOCOL.md explains them. Bytes are hexadecimal.",
        "version": schema.VERSION,
        "schema_hash": schema.SCHEMA_HASH,
        "devices": [{"name": name} | device for name, device in DEVICES.items()],
        "sessions": [_session(**written) for written in yaml.safe_load(_SOURCE.read_text("utf-8"))],
    }


def steps_of(device: str, written: list[Entry]) -> list[Entry]:
    """The steps of a session of sessions.json, from those of sessions.yaml."""
    session = _Session(DEVICES[device])
    return [session.step(**step) for step in written]


def _session(section: int, says: str, steps: list[Entry], device: str = "plain") -> Entry:
    return {"section": str(section), "says": says, "device": device, "steps": steps_of(device, steps)}


class _Session:
    """State of a session: the format of the frames, and the positions, forces, outputs, commands and states it has come
    to."""

    def __init__(self, device: dict[str, Any]) -> None:
        self.channels, self.wire = int(device["channels"]), "setup"
        self.parts: tuple[str, ...] = ()
        self.force, self.state = [0] * self.channels, "idle"
        self.outputs = {"outputs": 0} if device["words"] else {}
        self.command: dict[str, list[int] | None] = {"command": None} if device["servo"] else {}
        self.measured = {name: [0] * self.channels for name in _MEASURED} | {"inputs": [0]}

    def step(
        self,
        out: list[str] | None = None,
        force: list[int] | None = None,
        state: str | None = None,
        outputs: int | None = None,
        command: list[int] | Literal["none"] | None = None,
        registers: dict[str, int] | None = None,
        wire: str | None = None,
        **action: Any,
    ) -> Entry:
        """One step of sessions.json."""
        self.wire = wire or self.wire
        if "arm" in action:
            bytes_of_host, answered = self._arm(**action.pop("arm"))
            force, state, action = [0] * self.channels, "armed", {"bytes": bytes_of_host.hex()}
            self.outputs = dict.fromkeys(self.outputs, 0)
            self.command = dict.fromkeys(self.command, self.measured["position"] if "command" in self.parts else None)
        else:
            if "host" in action:
                action = {"bytes": self._bytes(action["host"]).hex()}
            answered = self._bytes(out or [])
        self.measured |= {name: counts for name, counts in action.items() if name in _MEASURED}
        self.force, self.state = force or self.force, state or self.state
        self.outputs |= {} if outputs is None else {"outputs": outputs}
        self.command |= {} if command is None else {"command": None if command == "none" else command}
        expected: Entry = (
            {"out": answered.hex(), "force": self.force, "state": self.state} | self.outputs | self.command
        )
        if registers is not None:
            expected["registers"] = {str(getattr(schema, f"REG_{name.upper()}")): registers[name] for name in registers}
        return action | expected

    def _arm(self, watchdog: int = 100, pacing: int = 0, parts: tuple[str, ...] = ()) -> tuple[bytes, bytes]:
        self.parts, asked = parts, schema.parts_of(parts)
        host = self._bytes([f"arm {watchdog} hash argument={pacing | asked}"])
        self.wire = f"{FAMILIES[asked]}_{self.channels}"
        return host, self._bytes(["status 0 armed", "position 0"])

    def _bytes(self, written: list[str]) -> bytes:
        return b"".join(map(self._frame, written))

    def _frame(self, written: str) -> bytes:
        head, first, *rest = written.split()
        if head == "hex":
            return bytes.fromhex(first)
        wire, _, kind = head.rpartition("/")
        wire = wire or ("setup" if kind in _OF_SETUP else self.wire)
        options = dict(option.split("=") for option in rest if "=" in option)
        words = [_word(word) for word in rest if "=" not in word]
        number, argument = int(first), int(options.get("argument", "0"), 0)
        if "line" in options:
            words += pack_line(*map(int, options["line"].split(",")))
        if "command" in options:
            words += map(int, options["command"].split(","))
        if "outputs" in options:
            words.append(_word(options["outputs"]))
        if kind == "latched":  # the last frame in the armed format
            kind, words, self.wire = "status", [schema.LATCHED, *words], "setup"
        if kind == "status":
            words = [words[0] | sum(words[1:]) << 8]
        if kind in ("position", "held"):
            kind = "position_held" if kind == "held" else kind
            on_wire = ("position", *(part.name for part in schema.in_parts(FORMATS[wire].parts)))
            words = [_signed(count) for name in on_wire for count in self.measured[name]]
        if kind in TYPES:
            words = (words + [0] * schema.MAX_WORDS)[: words_in(wire, kind)]
            whole = frame(wire, kind, number % schema.SAMPLE_MODULUS, argument, words)
        else:
            whole = frame_to_device(FORMATS[wire], int(kind.removeprefix("type_")), number, argument, [0])
        return whole[int(options.get("from", 0)) : int(options.get("until", len(whole)))]


def _word(written: str) -> int:
    """A word of a payload, as a signed number of 32 bits."""
    if written in STATES:
        return STATES.index(written)
    word = {"hash": schema.SCHEMA_HASH, "hash^1": schema.SCHEMA_HASH ^ 1}.get(written)
    return _signed(int(written, 0) if word is None else word)


def _signed(word: int) -> int:
    return word - (word >> 31 << 32) if word > 0 else word
