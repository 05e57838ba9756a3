"""A capture of the wire, decoded without knowing its format: by the protocol's own test vectors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import schema
from firmware_protocol.capture import KEPT, Capture, Decoded, Refused
from firmware_protocol.frames import armed_format, frame_to_device, frame_to_host
from firmware_protocol.vectors import FORMATS, NAMES, TO_DEVICE

VECTORS: dict[str, Any] = json.loads(
    (Path(__file__).resolve().parents[2] / "firmware_protocol" / "vectors.json").read_text(encoding="utf-8")
)
ONE = armed_format(1)


def found_in(data: bytes, piece: int = 1 << 20, capture: Capture | None = None) -> list[Decoded | Refused]:
    capture = capture or Capture()
    found: list[Decoded | Refused] = []
    for at in range(0, len(data), piece):
        found += capture.feed(data[at : at + piece])
    return [*found, *capture.finish()]


def test_every_frame_of_the_vectors_is_found_with_its_format_its_sender_and_its_fields() -> None:
    for entry in VECTORS["frames"]:
        (found,) = found_in(bytes.fromhex(entry["bytes"]))
        assert isinstance(found, Decoded), entry
        frame = found.frame
        assert (found.wire, found.from_host) == (FORMATS[entry["format"]], entry["type"] in TO_DEVICE), entry
        assert (NAMES[frame.type], frame.number, list(frame.counts)) == (
            entry["type"],
            entry["number"],
            entry["payload"],
        )
        assert frame.argument == entry.get("argument", 0), entry


@pytest.mark.parametrize("piece", [1, 7, 100_000])
def test_a_capture_of_many_formats_reads_the_same_in_pieces_of_any_size(piece: int) -> None:
    frames = [bytes.fromhex(entry["bytes"]) for entry in VECTORS["frames"]]
    found = found_in(b"".join(frames), piece)
    assert [one.data + b"\0" for one in found] == frames
    assert [one.offset for one in found] == [sum(map(len, frames[:i])) for i in range(len(frames))]


def test_of_the_vectors_streams_the_same_frames_are_found() -> None:
    for entry in VECTORS["streams"]:
        assert_frames_are_found(entry)


def assert_frames_are_found(entry: dict[str, Any]) -> None:
    """Behind one frame of each of their formats: garbage in front of a frame is known by what was heard before."""
    to_device = entry["direction"] == "to_device"
    data = b"".join(bytes.fromhex(step["bytes"]) for step in entry["steps"])
    known = b""
    for step in entry["steps"]:
        wire = FORMATS[step["format"]]
        words = [0] * wire.words(to_device)
        known += (
            frame_to_device(wire, schema.DISARM, 7, 0, words)
            if to_device
            else frame_to_host(wire, schema.STATUS, 7, words)
        )
    found = found_in(known + data, capture=Capture((to_device,)))[len(entry["steps"]) :]
    frames = [one.frame for one in found if isinstance(one, Decoded)]
    expected = [(one["type"], one["number"], one["payload"]) for one in entry["frames"]]
    # A frame of a format that was left is not acted on by a decoder, and is shown by a capture.
    read = [(NAMES[frame.type], frame.number, list(frame.counts)) for frame in frames]
    assert [one for one in read if one in expected] == expected, entry["about"]


def test_what_is_refused_is_shown_with_its_reason_its_place_and_its_bytes() -> None:
    whole = frame_to_host(ONE, schema.POSITION, 5, [77])
    wrong = bytes([whole[0], whole[1] ^ 1, *whole[2:]])
    unknown = frame_to_host(ONE, 0xF, 5, [77])
    data = wrong + whole[3:] + unknown + b"\x11" * 300 + b"\0" + b"noise" + whole + b"abc"
    found = found_in(whole + data)[1:]
    assert [(one.reason, one.length) for one in found if isinstance(one, Refused)] == [
        ("check", 10),
        ("short", 7),
        ("form", 10),
        ("garbage", 300),
        ("garbage", 5),
        ("unfinished", 3),
    ]
    assert [one.data for one in found[:3]] == [wrong[:-1], whole[3:-1], unknown[:-1]]
    assert len(found[3].data) == KEPT
    assert (whole + data)[found[5].offset :].startswith(whole)
    assert (whole + data)[found[4].offset :].startswith(b"noise")


def test_only_the_frames_of_the_sender_who_is_asked_for_are_taken_for_frames() -> None:
    data = frame_to_host(ONE, schema.POSITION, 5, [77]) + frame_to_device(ONE, schema.FORCE, 5, 20, [1])
    for senders, kinds in (((False,), [schema.POSITION]), ((True,), [schema.FORCE])):
        found = found_in(data, capture=Capture(senders))
        assert [one.frame.type for one in found if isinstance(one, Decoded)] == kinds
        assert len(found) == 2


def test_a_gigabyte_without_a_delimiter_is_not_kept() -> None:
    capture = Capture()
    for _ in range(1 << 10):
        assert list(capture.feed(b"\x42" * (1 << 20))) == []
    (refused,) = capture.finish()
    assert (refused.length, len(refused.data)) == (1 << 30, KEPT)
