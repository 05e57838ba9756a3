"""hapsim_protocol.h against the vectors: compiled with the system's C compiler, where there is one."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from collections import Counter
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import SETUP, Format, every_armed_format, frame_bytes, framing_of
from firmware_protocol.make_vectors import VECTORS
from firmware_protocol.vectors import COUNTERS, FORMATS, TYPES, frame
from tests.thorough import points

HEADER = VECTORS.with_name("hapsim_protocol.h")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
Vectors = dict[str, Any]
Harness = Callable[[list[str]], list[str]]


def built_from(source: str, to: Path, *options: str) -> Path:
    """Compiles a program that stands beside this file."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) on this machine")
    words = [*STRICT, *options, f"-I{HEADER.parent}", str(Path(__file__).with_name(source)), "-o", str(to / "program")]
    built = subprocess.run([compiler, *words], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return to / "program"


@pytest.fixture(scope="module")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Harness:
    """Runs lines through the compiled harness: the lines that it answers."""
    program = built_from("header_harness.c", tmp_path_factory.mktemp("header"))

    def run(lines: list[str]) -> list[str]:
        text = "\n".join(lines) + "\n"
        return subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout.splitlines()

    return run


def wire_name(formats: Vectors, name: str) -> str:
    """Returns the harness's name of a format."""
    return "0 0" if name == "setup" else f"{formats[name]['channels']} {FORMATS[name].parts}"


def answer(fields: Vectors) -> str:
    """Returns the harness's text of a frame to the device."""
    counts = " ".join(str(count) for count in fields["payload"])
    return f"frame {TYPES[fields['type']]} {fields['number']} {fields['argument']} {counts}"


@pytest.mark.parametrize("member", ["streams", "refused"])
def test_streams_to_the_device_give_the_file_s_frames_and_counters(
    member: str, vectors: Vectors, formats: Vectors, harness: Harness
) -> None:
    entries = [entry for entry in vectors[member] if entry["direction"] == "to_device"]
    lines, expected = [], []
    for entry in entries:
        before = entry["steps"][0]["format"]
        lines += ["new", f"format {wire_name(formats, before)}"]
        for step in entry["steps"]:
            if step["format"] != before:
                before = step["format"]
                lines.append(f"format {wire_name(formats, before)}")
            lines.append(f"read {step['bytes']}")
        lines.append("counters")
        expected += [answer(fields) for fields in entry["frames"]]
        expected.append(" ".join(str(entry["counters"][name]) for name in COUNTERS))
    assert len(entries) > 30
    assert harness(lines) == expected


EVERY_FORMAT = {"0 0": SETUP} | {f"{wire.channels} {wire.parts}": wire for wire in every_armed_format()}
"""Formats by the harness's names."""


def some_frames(codec: Any, wire: Format, to_device: bool, count: int) -> tuple[list[bytes], list[tuple[int, ...]]]:
    """Random frames of one direction, and their fields: type, number, argument, words. Half of the words are zeros."""
    chance = np.random.default_rng([wire.seed, to_device])
    words = wire.words(to_device)
    types = chance.integers(1, 5, count) if to_device else chance.integers(9, 13, count)
    numbers, arguments = chance.integers(0, 4096, count), chance.integers(0, 256, count)
    payloads = chance.integers(-(2**31), 2**31, (count, words)) * chance.integers(0, 2, (count, words))
    framing, buffer = framing_of(wire, to_device), np.zeros(256, np.uint8)
    frames, fields = [], []
    for kind, number, argument, payload in zip(types, numbers, arguments, payloads, strict=True):
        end = codec.write_frame(framing, buffer, 0, kind, number, argument, payload)
        frames.append(buffer[:end].tobytes())
        fields.append((int(kind), int(number), int(argument), *payload.tolist()))
    return frames, fields


def damaged(stream: bytes, wire: Format) -> bytes:
    """One byte in a hundred is changed, lost, or comes twice; delimiters too."""
    chance = np.random.default_rng([wire.seed, 7])
    data = np.frombuffer(stream, np.uint8)
    hit = chance.random(data.size) < 0.01
    how = chance.integers(0, 4, data.size)
    data = np.where(hit & (how == 0), data ^ (1 << chance.integers(0, 8, data.size)), data).astype(np.uint8)
    data = np.where(hit & (how == 1), 0, data).astype(np.uint8)
    return np.repeat(data, np.where(hit & (how == 2), 0, np.where(hit & (how == 3), 2, 1))).tobytes()


def assert_answered(harness: Harness, asked: dict[str, tuple[list[str], list[str]]]) -> None:
    """Asserts that the lines of each format are answered as expected; names the first format that is not."""
    answers = iter(harness([line for name, (lines, _) in asked.items() for line in ("new", f"format {name}", *lines)]))
    for name, (_, expected) in asked.items():
        assert list(islice(answers, len(expected))) == expected, name


def test_of_random_frames_and_of_the_same_damaged_it_reads_what_python_reads(
    compiled_codec: Any, harness: Harness
) -> None:
    found, asked = Counter[str](), {}
    for name, wire in EVERY_FORMAT.items():
        frames, fields = some_frames(compiled_codec, wire, True, points(10, 100))
        sound, decoder = b"".join(frames), new_decoder(wire, to_device=True)
        read = frames_in(decoder, sound)
        assert [(one.type, one.number, one.argument, *one.counts) for one in read] == fields, name
        stream = sound + damaged(sound, wire)
        read += frames_in(decoder, stream[len(sound) :])
        counted = {counter: int(decoder[counter]) for counter in COUNTERS}
        found.update(counted)
        expected = [f"frame {one.type} {one.number} {one.argument} {' '.join(map(str, one.counts))}" for one in read]
        lines = [f"read {stream[at : at + 1000].hex()}" for at in range(0, len(stream), 1000)]
        asked[name] = ([*lines, "counters"], [*expected, " ".join(map(str, counted.values()))])
    assert_answered(harness, asked)
    assert min(found[name] for name in ("accepted", "crc_errors", "length_errors", "garbage_bytes")) > 300


def test_random_frames_to_the_host_are_written_as_python_writes_them(compiled_codec: Any, harness: Harness) -> None:
    asked = {}
    for name, wire in EVERY_FORMAT.items():
        frames, fields = some_frames(compiled_codec, wire, False, points(10, 100))
        lines = [f"write {kind} {number} {' '.join(map(str, counts))}" for kind, number, _, *counts in fields]
        asked[name] = (lines, [data.hex() for data in frames])
        assert {len(data) for data in frames} == {frame_bytes(wire, to_device=False)}
    assert_answered(harness, asked)


def test_hundred_thousand_damaged_streams_neither_break_it_nor_keep_it_from_the_next_frame(
    tmp_path: Path,
) -> None:
    program = built_from("header_mutations.c", tmp_path, "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    ran = subprocess.run([program, "100000", "7"], capture_output=True, text=True, check=False)
    assert (ran.stdout, ran.stderr, ran.returncode) == ("100000 0\n", "", 0)


def test_a_new_decoder_listens_for_the_set_up_format(harness: Harness) -> None:
    sent = frame("setup", "describe", 5, 0, [0]).hex()
    assert harness(["new", f"read {sent}", "counters"]) == ["frame 1 5 0 0", "1 0 0 0 0"]


def test_half_a_register_pair_and_the_age_of_a_force_come_out_right(harness: Harness) -> None:
    values = (1000.0, -2.5e-7, 1e300)
    expected = [" ".join(str(word) for word in struct.unpack("<2I", struct.pack("<d", v))) for v in values]
    assert harness([f"f64 {value!r}" for value in values]) == expected
    assert harness(["age 5 5", "age 4097 0", "age 4096 4095", "age 10 11"]) == ["0", "1", "1", "4095"]


def test_every_constant_is_the_schema_s() -> None:
    text = HEADER.read_text("utf-8")
    defined = re.findall(r"#define HAPSIM_(\w+) (0x[0-9a-f]+|\d+)u?\b", text)
    listed = re.findall(r"HAPSIM_(\w+) = (0x[0-9A-F]+|\d+)", text)
    ours = {"MAX_FRAME": schema.frame_bytes(15, to_device=False, parts=schema.PART_BITS)}
    constants = {name: int(value, 0) for name, value in defined + listed}
    marks = {f"{part.name.upper()}_MARK": part.mark for part in schema.PARTS if part.mark}
    assert {name: constants.pop(name) for name in marks} == marks
    assert constants == {name: ours[name] if name in ours else getattr(schema, name) for name in constants}
    expected = {name for name, value in vars(schema).items() if name.isupper() and isinstance(value, int)}
    # How long a force may live is the host's choice within a byte; bits per
    # byte are a UART's; what it senses a device asks part by part.
    assert expected - set(constants) == {"MAX_TIME_TO_LIVE_SAMPLES", "BITS_PER_BYTE", "MOTION_BITS", "ADMITTANCE"}


def test_a_device_s_memory_holds_the_longest_frame_of_the_host() -> None:
    # 128 bytes for 29 words, else 256, as HAPSIM_RECENT has them.
    assert schema.frame_bytes(16, to_device=True) < 128 <= schema.frame_bytes(10, True, schema.WITH_LINE)
    assert max(schema.encoded_bytes(29, to_device=True) + 5, schema.frame_bytes(9, True, schema.WITH_LINE)) < 128
    assert schema.frame_bytes(16, True, schema.WITH_LINE) < 256
