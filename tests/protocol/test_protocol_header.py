"""hapsim_protocol.h against the vectors: compiled with the system's C compiler, where there is one."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from math import comb
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import schema
from firmware_protocol.make_vectors import VECTORS
from firmware_protocol.vectors import COUNTERS, TO_DEVICE, TYPES, frame

HEADER = VECTORS.with_name("hapsim_protocol.h")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
Vectors = dict[str, Any]
Harness = Callable[[list[str]], list[str]]


@pytest.fixture(scope="module")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Harness:
    """Runs lines through the compiled harness: the lines that it answers."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) on this machine")
    program = tmp_path_factory.mktemp("header") / "harness"
    source = Path(__file__).with_name("header_harness.c")
    command = [compiler, *STRICT, f"-I{HEADER.parent}", str(source), "-o", str(program)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr

    def run(lines: list[str]) -> list[str]:
        text = "\n".join(lines) + "\n"
        return subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout.splitlines()

    return run


def spoken(formats: Vectors, name: str) -> str:
    """What the harness calls a format."""
    return "0 0" if name == "setup" else f"{formats[name]['channels']} {formats[name]['velocity']:d}"


def answer(fields: Vectors) -> str:
    """How the harness prints a frame to the device."""
    counts = " ".join(str(count) for count in fields["payload"])
    return f"frame {TYPES[fields['type']]} {fields['number']} {fields['argument']} {counts}"


def test_every_frame_to_the_device_decodes_to_its_fields(vectors: Vectors, formats: Vectors, harness: Harness) -> None:
    entries = [entry for entry in vectors["frames"] if entry["type"] in TO_DEVICE]
    lines = ["new"]
    for entry in entries:
        lines += [f"format {spoken(formats, entry['format'])}", f"read {entry['bytes']}"]
    assert harness(lines) == [answer(entry) for entry in entries]


def test_every_frame_to_the_host_is_written_byte_for_byte(vectors: Vectors, formats: Vectors, harness: Harness) -> None:
    entries = [entry for entry in vectors["frames"] if entry["type"] not in TO_DEVICE]
    lines = ["new"]
    for entry in entries:
        counts = " ".join(str(count) for count in entry["payload"])
        lines += [f"format {spoken(formats, entry['format'])}"]
        lines += [f"write {TYPES[entry['type']]} {entry['number']} {counts}"]
    assert harness(lines) == [entry["bytes"] for entry in entries]


@pytest.mark.parametrize("member", ["streams", "refused"])
def test_streams_to_the_device_give_the_file_s_frames_and_counters(
    member: str, vectors: Vectors, formats: Vectors, harness: Harness
) -> None:
    entries = [entry for entry in vectors[member] if entry["direction"] == "to_device"]
    lines, expected = [], []
    for entry in entries:
        before = entry["steps"][0]["format"]
        lines += ["new", f"format {spoken(formats, before)}"]
        for step in entry["steps"]:
            if step["format"] != before:
                before = step["format"]
                lines.append(f"format {spoken(formats, before)}")
            lines.append(f"read {step['bytes']}")
        lines.append("counters")
        expected += [answer(fields) for fields in entry["frames"]]
        expected.append(" ".join(str(entry["counters"][name]) for name in COUNTERS))
    assert len(entries) > 30
    assert harness(lines) == expected


def test_no_one_two_or_three_flips_get_a_frame_past_it(formats: Vectors, harness: Harness) -> None:
    lines, expected = [], []
    heard = [("setup", "arm"), ("setup", "disarm")]
    heard += [(name, kind) for name in ("armed_1", "velocity_1") for kind in ("force", "disarm")]
    for name, kind in heard:
        frames = [frame(name, kind, n, 20, [word]) for n, word in ((1, 77), (0x123, 0x01020408), (3, -78))]
        first, last = len(frames[0]), len(frames[0] + frames[1])
        lines += ["new", f"format {spoken(formats, name)}", f"flips {first} {last} {b''.join(frames).hex()}"]
        expected.append(f"{sum(comb(8 * (last - first), flips) for flips in (1, 2, 3))} 0")
    assert harness(lines) == expected


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
    ours = {"MAX_FRAME": schema.frame_bytes(16, to_device=False, velocity=True), "RECENT": 128}
    constants = {name: int(value, 0) for name, value in defined + listed}
    assert constants == {name: ours[name] if name in ours else getattr(schema, name) for name in constants}
    expected = {name for name, value in vars(schema).items() if name.isupper() and isinstance(value, int)}
    # Start values are computed from the hash; how long a force may live is the host's choice within a byte.
    computed = {f"{kind}_SEED_{length}" for kind in ("ARMED", "VELOCITY") for length in ("SHORT", "LONG")}
    assert expected - set(constants) == computed | {"MAX_TIME_TO_LIVE_SAMPLES"}


def test_a_device_s_memory_holds_the_longest_frame_of_the_host() -> None:
    assert max(schema.frame_bytes(16, to_device=True, velocity=velocity) for velocity in (False, True)) < 128
