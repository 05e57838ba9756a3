"""vectors.json and PROTOCOL.md: up to date, and right by others' packages, by the schema, and by a decoder that shares
nothing with ours."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import pytest
from cobs import cobs

from firmware_protocol import schema
from firmware_protocol.client import ANSWER_S, disarm_in_every_format
from firmware_protocol.make_vectors import DOCUMENT, VECTORS, made_text, with_blocks
from firmware_protocol.vectors import TO_DEVICE, TO_HOST, TYPES

Vectors = dict[str, Any]


def plain_reading(plain_decoder: Any, formats: Vectors, entry: Vectors) -> tuple[list[Vectors], dict[str, int]]:
    """Returns the frames and counters of a stream in the plain decoder."""
    name = entry["steps"][0]["format"]
    decoder = plain_decoder(formats[name], entry["direction"])
    frames = []
    for step in entry["steps"]:
        if step["format"] != name:
            name = step["format"]
            decoder.use(formats[name])
        frames += decoder.read(bytes.fromhex(step["bytes"]))
    return frames, dict(decoder.counters)


def direction_of(entry: Vectors) -> str:
    return "to_device" if "argument" in entry else "to_host"


def test_the_file_is_what_the_codec_makes_now() -> None:
    assert VECTORS.read_text("utf-8") == made_text(VECTORS), "run python -m firmware_protocol.make_vectors"


def test_every_frame_decodes_by_the_document_to_its_fields(
    vectors: Vectors, formats: Vectors, plain_decoder: Any
) -> None:
    for entry in vectors["frames"]:
        decoder = plain_decoder(formats[entry["format"]], direction_of(entry))
        fields = {key: entry[key] for key in ("type", "number", "argument", "payload") if key in entry}
        data = bytes.fromhex(entry["bytes"])
        assert len(data) == formats[entry["format"]][f"bytes_{direction_of(entry)}"]
        assert decoder.read(data) == [fields]


@pytest.mark.parametrize("member", ["streams", "refused"])
def test_streams_read_by_the_document_as_in_the_file(
    member: str, vectors: Vectors, formats: Vectors, plain_decoder: Any
) -> None:
    for entry in vectors[member]:
        assert plain_reading(plain_decoder, formats, entry) == (entry["frames"], entry["counters"]), entry["about"]


def test_nothing_comes_out_of_what_has_to_be_refused(vectors: Vectors) -> None:
    for entry in vectors["refused"]:
        assert entry["frames"] == []
        assert entry["counters"]["accepted"] == 0
        assert sum(entry["counters"][f"{kind}_errors"] for kind in ("crc", "length", "form")) == 1


def test_every_type_in_every_format_is_there(vectors: Vectors, formats: Vectors) -> None:
    seen = Counter((entry["format"], entry["type"]) for entry in vectors["frames"])
    assert len(seen) == 8 * len(formats)
    names = ("channels", "velocity", "acceleration", "line", "inputs")
    by_force = [wire for wire in list(formats.values())[1:] if not wire["command"]]
    there = {tuple(wire[name] for name in names) for wire in by_force}
    with_parts = {(n, True, False, False, False) for n in (1, 2, 16)} | {(n, *[True] * 4) for n in (1, 2, 16)}
    with_parts |= {(n, velocity, True, False, False) for n in (1, 2, 4, 16) for velocity in (False, True)}
    with_parts |= {(n, False, False, True, False) for n in (1, 2, 16)} | {(1, False, False, True, True)}
    with_parts |= {(n, False, False, False, True) for n in (1, 3)} | {(1, True, False, False, True)}
    assert there == {(n, *[False] * 4) for n in (1, 3, 4, 16)} | with_parts
    assert all(wire["inputs"] == wire["outputs"] for wire in formats.values())
    assert all(wire["hand_force"] == wire["command"] for wire in formats.values())
    there = {tuple(wire[name] for name in names) for wire in formats.values() if wire["command"]}
    assert there == {(n, *[False] * 4) for n in (1, 2)} | {(1, True, *[False] * 3)} | {
        (n, True, True, False, True) for n in (1, 15)
    }
    counters = Counter(name for e in vectors["streams"] + vectors["refused"] for name, n in e["counters"].items() if n)
    assert set(counters) == {"accepted", "crc_errors", "length_errors", "form_errors", "garbage_bytes"}


NAMES = {name.upper() for name in TO_DEVICE | TO_HOST}
TEXT = DOCUMENT.read_text("utf-8")


def section(title: str) -> str:
    """The text from a heading to the next one of its level."""
    return re.split(r"^## ", TEXT.split(f"## {title}", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def rows(text: str) -> list[list[str]]:
    """The cells of every table row."""
    lines = [line for line in text.splitlines() if line.startswith("|") and not set(line) <= set("|-: ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_generated_parts_are_what_the_codec_makes_now() -> None:
    assert made_text(DOCUMENT) == TEXT, "run python -m firmware_protocol.make_vectors"


def test_a_document_without_a_place_for_a_part_is_an_error() -> None:
    with pytest.raises(ValueError, match="0 places for the part 'constants'"):
        with_blocks("nothing here", {"constants": "1"})


def test_the_table_of_frames_is_the_schema_s() -> None:
    table = {row[1].lower(): (row[0], row[2]) for row in rows(section("4. Frames")) if row[1] in NAMES}
    expected = {name: (f"`{code:#x}`", "to device" if name in TO_DEVICE else "to host") for name, code in TYPES.items()}
    assert table == expected


def test_the_tables_of_states_and_faults_are_the_schema_s() -> None:
    numbered = [(int(row[0]), row[1]) for row in rows(section("4. Frames")) if row[0].isdigit()]
    states, faults = numbered[:3], numbered[3:]
    assert [(number, name.split(":")[0]) for number, name in states] == [
        (schema.IDLE, "idle"),
        (schema.ARMED, "armed"),
        (schema.LATCHED, "latched"),
    ]
    assert [number for number, _ in faults] == sorted(schema.FAULTS)
    words = {schema.HOST_QUIET: "quiet", schema.POSITION_OUT_OF_RANGE: "range", schema.WRONG_SCHEMA: "schema"}
    words |= {schema.WRONG_PACING: "paced", schema.WRONG_WATCHDOG: "watchdog", schema.HARDWARE: "hardware"}
    words[schema.WRONG_SENSING] = "velocity, acceleration, hand force, line, position command or digital word"
    assert all(words[number] in text for number, text in faults[1:])


def test_the_table_of_registers_is_the_schema_s() -> None:
    table = {name: cell for cell, name, *_ in rows(section("5. Registers").split("**Unarmed only.**")[0])[1:]}
    plain = ("version", "schema", "channels", "pacings", "max_watchdog", "fault")
    counters = ("accepted", "rejected", "held", "expired", "limited", "rotary", "bridge", "sensors")
    counters += ("board_steps", "board_delay", "board_window", "kept_reports")
    expected = {name: str(getattr(schema, f"REG_{name.upper()}")) for name in plain + counters}
    expected["rate"] = f"{schema.REG_RATE}, {schema.REG_RATE + 1}"
    expected["name"] = f"{schema.REG_NAME} to {schema.REG_NAME + schema.NAME_WORDS - 1}"
    for name in ("position_scale", "force_scale", "force_limit", "velocity_scale"):
        base = schema.REG_CHANNEL + getattr(schema, f"REG_{name.upper()}")
        expected[name] = f"{base} + {schema.CHANNEL_WORDS}c, +1"
    expected["acceleration_scale"] = f"{schema.REG_MORE} + {schema.MORE_WORDS}c, +1"
    expected["line_shifts"] = f"{schema.REG_LINE_SHIFTS} + {schema.MORE_WORDS}c"
    for name in ("hand_force_scale", "hand_force_range", "speed_limit", "braking", "bandwidth", "servo_damping"):
        expected[name] = f"{getattr(schema, f'REG_{name.upper()}')} + {schema.MORE_WORDS}c, +1"
    expected["largest"] = f"{schema.REG_LARGEST} + {schema.MORE_WORDS}c"
    assert table == expected


def test_the_time_on_the_wire_agrees_with_the_vectors(formats: dict[str, Any]) -> None:
    of_tables = "With velocities, or with accelerations:|With both:|With lines:|With digital words.|In admittance,"
    tables = re.split(of_tables, section("11. Time on the wire"))
    assert len(tables) == 6
    for parts, text in enumerate(tables):
        table = {int(row[0]): row[1:4] for row in rows(text)[1:]}
        assert sorted(table) == list(range(1, 17))
        for wire in formats.values():
            host, device = wire["bytes_to_host"], wire["bytes_to_device"]
            others = (
                5 * wire["command"]
                + (3 + wire["velocity"]) * wire["line"]
                + (4 + wire["velocity"] + wire["line"]) * wire["inputs"]
            )
            if wire["velocity"] + wire["acceleration"] + others == parts:
                assert table[wire["channels"]] == [f"{host} B", f"{device} B", f"{host + device} B"]
    # The largest, by hand: 147 and 211 bytes of ten bits at 115200 baud.
    assert "| 16 | 73 B | 74 B | 147 B | 12.760 ms |" in tables[0]
    assert "| 16 | 137 B | 74 B | 211 B | 18.316 ms |" in tables[1]
    assert "| 16 | 201 B | 74 B | 275 B | 23.872 ms |" in tables[2]


def test_every_type_has_an_example_that_decodes_to_what_stands_next_to_it(
    formats: dict[str, Any], plain_decoder: Any
) -> None:
    pattern = r"\*\*(\w+)\*\*, (set-up|armed, \d+ channels?(?: with [a-z_ ]+)?): .*?\n\n```text\n(.*?)\n```"
    examples = re.findall(pattern, section("12. Examples"), re.DOTALL)
    assert {kind.lower() for kind, _, _ in examples} == set(TYPES)
    for kind, where, lines in examples:
        words = where.partition(" with ")[2]
        family = {
            "": "armed",
            "hand_force and command": "admittance",
            "velocity and acceleration": "both",
            "inputs and outputs": "words",
        }.get(words, words)
        wire = formats["setup" if where == "set-up" else f"{family}_{re.findall(r'[0-9]+', where)[0]}"]
        decoder = plain_decoder(wire, "to_device" if kind.lower() in TO_DEVICE else "to_host")
        sent = re.findall(r"^(?:encoded|check|delimiter)\s+((?:[0-9a-f]{2} ?)+)", lines, re.MULTILINE)
        (frame,) = decoder.read(bytes.fromhex("".join(sent)))
        assert (frame["type"], frame["number"]) == (kind.lower(), int(re.findall(r"number \S+ = (\d+)", lines)[0]))
        assert frame["payload"] == [int(word) for word in re.findall(r"payload \d+ = (-?\d+)", lines)]
        assert str(frame.get("argument", "")) == "".join(re.findall(r"argument (\d+)", lines))


def test_the_example_of_stuffing_is_right() -> None:
    body, encoded = re.findall(r"^    (?:body   |encoded) +([0-9a-f ]+)$", section("2. Framing"), re.MULTILINE)
    assert cobs.encode(bytes.fromhex(body)) == bytes.fromhex(encoded)


def test_the_frames_for_a_silent_device_are_as_many_bytes_as_stated() -> None:
    burst = len(disarm_in_every_format())
    assert f"{burst} bytes, which take {burst * 10 / 115200:.2f} s at 115200" in section(
        "8. Failures of the other side"
    )
    assert burst * 10 / 115200 < ANSWER_S  # else the answer to the question behind them came when the next one leaves


def test_the_schema_text_gives_its_hash() -> None:
    text = re.findall(r"```text\n(.*?)```", section("14. The schema"), re.DOTALL)[0]
    assert text == schema.SCHEMA
    assert f"`{schema.SCHEMA_HASH:#010x}`" in section("3. Formats")
    assert text.isascii()


def test_the_schema_hash_is_the_one_that_boards_in_the_field_have() -> None:
    # It seeds the check on every frame of an armed device: with another one no board that was built before would arm.
    assert schema.SCHEMA_HASH == 0x314A417F


def test_every_number_of_the_schema_module_that_goes_on_the_wire_is_in_the_schema_text() -> None:
    # A meaning that the text leaves out could change without changing the hash.
    later = {
        "REG_BOARD_STEPS",
        "REG_BOARD_DELAY",
        "REG_BOARD_WINDOW",
        "REG_KEPT_REPORTS",
        "REG_LINE_SHIFTS",
        "REG_LARGEST",
        "REG_ROTARY",
        "REG_BRIDGE",
        "REG_SENSORS",
        "REG_MORE",
        "REG_HAND_FORCE_SCALE",
        "REG_HAND_FORCE_RANGE",
        "REG_SPEED_LIMIT",
        "REG_BRAKING",
        "REG_BANDWIDTH",
        "REG_SERVO_DAMPING",
    }  # they came after the hash was fixed, and read 0 on a board from before
    registers = [name for name in vars(schema) if name.startswith("REG_") and name not in later]
    names = [*registers, *NAMES, "PACED_BY_DEVICE", "PACED_BY_HOST", "LOCKSTEP", "IDLE", "ARMED", "LATCHED"]
    names += ["HOST_QUIET", "POSITION_OUT_OF_RANGE", "WRONG_SCHEMA", "WRONG_PACING", "WRONG_WATCHDOG", "HARDWARE"]
    names += ["WRONG_SENSING", "WITH_VELOCITY"]
    spoken = {"POSITION_HELD": "held", "PACED_BY_DEVICE": "device", "PACED_BY_HOST": "host"}
    for name in names:
        word = spoken.get(name, name.removeprefix("REG_").lower())
        value = getattr(schema, name)
        forms = {str(value), f"{value:x}"} if name in NAMES | {"WITH_VELOCITY"} else {str(value)}
        assert any(re.search(rf"\b{word}={form}\b", schema.SCHEMA) for form in forms), name
