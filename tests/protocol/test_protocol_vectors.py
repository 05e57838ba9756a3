"""vectors.json: up to date, and right by other people's packages and by a decoder that shares nothing with ours."""

from __future__ import annotations

from collections import Counter
from typing import Any

import fastcrc
import pytest
from cobs import cobs

from firmware_protocol.make_vectors import VECTORS, made_text

Vectors = dict[str, Any]


def plain_reading(plain_decoder: Any, formats: Vectors, entry: Vectors) -> tuple[list[Vectors], dict[str, int]]:
    """What the plain decoder makes of a stream: its frames and its counters."""
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


def test_the_check_vectors_are_fastcrc_s(vectors: Vectors) -> None:
    for entry in vectors["crc"]:
        data = bytes.fromhex(entry["bytes"])
        # fastcrc goes on from a check, the final xor included; the vectors name the register's start value.
        if entry["check"] == "crc16_dnp":
            assert entry["value"] == fastcrc.crc16.dnp(data, entry["seed"] ^ 0xFFFF)
        else:
            assert entry["value"] == fastcrc.crc32.iscsi(data, entry["seed"] ^ 0xFFFFFFFF)
    assert {entry["check"] for entry in vectors["crc"]} == {"crc16_dnp", "crc32_c"}


def test_the_stuffing_vectors_are_the_cobs_package_s(vectors: Vectors) -> None:
    assert len(vectors["cobs"]) >= 10
    for entry in vectors["cobs"]:
        assert cobs.encode(bytes.fromhex(entry["body"])).hex() == entry["encoded"]


def test_every_frame_decodes_by_the_document_to_its_fields(
    vectors: Vectors, formats: Vectors, plain_decoder: Any
) -> None:
    for entry in vectors["frames"]:
        decoder = plain_decoder(formats[entry["format"]], direction_of(entry))
        fields = {key: entry[key] for key in ("type", "number", "argument", "payload") if key in entry}
        data = bytes.fromhex(entry["bytes"])
        assert len(data) == formats[entry["format"]][f"bytes_{direction_of(entry)}"]
        assert decoder.read(data) == [fields]


def test_every_frame_is_stuffed_and_checked_as_the_packages_do_it(vectors: Vectors, formats: Vectors) -> None:
    for entry in vectors["frames"]:
        wire, data = formats[entry["format"]], bytes.fromhex(entry["bytes"])
        check_bytes = {16: 3, 32: 5}[wire["check_bits"]]
        encoded, sent = data[: -check_bytes - 1], data[-check_bytes - 1 : -1]
        assert cobs.encode(cobs.decode(encoded)) == encoded
        value = sum((byte & 0x7F) << 7 * i for i, byte in enumerate(sent))
        if wire["check_bits"] == 16:
            assert value == fastcrc.crc16.dnp(encoded, wire["seed"] ^ 0xFFFF)
        else:
            assert value == fastcrc.crc32.iscsi(encoded, wire["seed"] ^ 0xFFFFFFFF)


@pytest.mark.parametrize("member", ["streams", "refused"])
def test_streams_read_by_the_document_as_the_file_says(
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
    there = {(wire["channels"], wire["velocity"]) for name, wire in formats.items() if name != "setup"}
    assert there == {(n, False) for n in (1, 3, 4, 16)} | {(n, True) for n in (1, 2, 16)}
    counters = Counter(name for e in vectors["streams"] + vectors["refused"] for name, n in e["counters"].items() if n)
    assert set(counters) == {"accepted", "crc_errors", "length_errors", "form_errors", "garbage_bytes"}
