"""Frames out of a stream: split anywhere, after anything, in formats that change."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import schema
from firmware_protocol.client import disarm_in_every_format
from firmware_protocol.decoder import Frame, frames_in, new_decoder, use_format
from firmware_protocol.frames import SETUP, armed_format, frame_to_device
from firmware_protocol.vectors import COUNTERS, FORMATS, NAMES, TO_DEVICE, TYPES, frame, sealed, words_in

EVERY_FORMAT_AND_DIRECTION = [(name, kind) for name in FORMATS for kind in ("force", "position")]


def new(name: str, kind: str) -> Any:
    return new_decoder(FORMATS[name], kind in TO_DEVICE)


def some(name: str, kind: str, number: int) -> tuple[bytes, Frame]:
    """A frame with a word of its own in every channel."""
    counts = [number * 7919 - (c << 20) for c in range(words_in(name, kind))]
    argument = 9 if kind in TO_DEVICE else 0
    return frame(name, kind, number, argument, counts), Frame(TYPES[kind], number, argument, tuple(counts))


def counters(decoder: Any) -> dict[str, int]:
    return {name: int(decoder[name]) for name in COUNTERS}


@pytest.mark.parametrize(("name", "kind"), EVERY_FORMAT_AND_DIRECTION)
def test_after_garbage_of_every_length_around_the_memory_s_size_the_next_frame_is_accepted(
    name: str, kind: str
) -> None:
    data, expected = some(name, kind, 77)
    for length in [*range(300), 100_003]:
        decoder = new(name, kind)
        assert frames_in(decoder, b"\x55" * length + data) == [expected]
        assert counters(decoder) == dict.fromkeys(COUNTERS, 0) | {"accepted": 1, "garbage_bytes": length}


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize(("name", "kind"), EVERY_FORMAT_AND_DIRECTION)
def test_a_frame_that_lost_any_of_its_bytes_is_refused_as_too_short(name: str, kind: str) -> None:
    (first, before), (hit, _), (last, after) = (some(name, kind, number) for number in (1, 2, 3))
    decoder = new(name, kind)
    for start in range(len(hit) - 1):
        short = [hit[:start] + hit[stop:] for stop in range(start + 1, len(hit))]
        errors = int(decoder.length_errors) + len(short) - (start == 0)  # once the whole frame is gone
        assert frames_in(decoder, b"".join(first + one + last for one in short)) == [before, after] * len(short), start
        assert decoder.length_errors == errors


@pytest.mark.parametrize("parts", [parts for parts in schema.COMBINATIONS if not schema.in_parts(parts, True)])
@pytest.mark.parametrize("channels", range(1, 17))
def test_disarm_sent_in_every_format_is_received_once_by_a_device_in_any_of_them(channels: int, parts: int) -> None:
    # How a host disarms a device of which it does not know anything.
    sent = frame_to_device(SETUP, schema.DISARM, 0, 0, [0]) + disarm_in_every_format()
    disarm = Frame(schema.DISARM, 0, 0, (0,) * channels)
    assert frames_in(new_decoder(armed_format(channels, parts), to_device=True), sent) == [disarm]
    assert frames_in(new_decoder(SETUP, to_device=True), sent) == [Frame(schema.DISARM, 0, 0, (0,))]


@pytest.mark.parametrize("earlier", sorted(FORMATS))
def test_a_frame_begun_in_one_format_is_forgotten_in_the_next_and_counters_go_on(earlier: str) -> None:
    begun, first = some(earlier, "force", 5)
    for later, wire in FORMATS.items():
        decoder = new(earlier, "force")
        data, second = some(later, "force", 6)
        assert frames_in(decoder, begun + begun[:-2]) == [first]
        use_format(decoder, wire)
        assert frames_in(decoder, data) == [second], later
        assert counters(decoder) == dict.fromkeys(COUNTERS, 0) | {"accepted": 2}, later


@st.composite
def pieces(draw: st.DrawFn) -> tuple[str, str, list[bytes]]:
    """A stream of good frames, damaged ones, strangers and noise, in pieces."""
    name, kind = draw(st.sampled_from(EVERY_FORMAT_AND_DIRECTION))
    good = some(name, kind, draw(st.integers(0, 4095)))[0]
    at = draw(st.integers(0, len(good) - 1))
    encoded = draw(st.binary(min_size=len(good) - 4, max_size=len(good) - 4).map(lambda b: b.replace(b"\0", b"\1")))
    wire = FORMATS[name]
    some_pieces = [
        good,
        good[:at],
        good[at:],
        good[:at] + bytes([good[at] ^ draw(st.integers(1, 255))]) + good[at + 1 :],
        good[:at] + draw(st.binary(max_size=3)) + good[at:],
        sealed(wire, encoded[: len(good) - (6 if wire.long_check else 4)]),
        some(draw(st.sampled_from(sorted(FORMATS))), kind, 1)[0],
        some(name, "position" if kind == "force" else "force", 1)[0],
        draw(st.binary(max_size=90)),
    ]
    return name, kind, draw(st.lists(st.sampled_from(some_pieces), max_size=12))


@settings(max_examples=80, deadline=None)
@given(pieces(), st.data())
def test_plain_python_reads_any_stream_split_anywhere_as_machine_code_does(
    plain_codec: Any, compiled_codec: Any, stream: tuple[str, str, list[bytes]], data: st.DataObject
) -> None:
    name, kind, parts = stream
    whole = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=20)))
    later = data.draw(st.sampled_from(sorted(FORMATS)))
    plain, compiled = new(name, kind), new(name, kind)
    for start, stop in zip([0, *cuts], [*cuts, len(whole)], strict=True):
        chunk = whole[start:stop]
        assert read_by(plain_codec, plain, chunk) == read_by(compiled_codec, compiled, chunk)
        assert plain.tobytes() == compiled.tobytes()
    for decoder in (plain, compiled):
        use_format(decoder, FORMATS[later])
    last = some(later, kind, 8)[0] + whole
    assert read_by(plain_codec, plain, last) == read_by(compiled_codec, compiled, last)
    assert counters(plain) == counters(compiled)


def read_by(codec: Any, decoder: Any, data: bytes) -> list[tuple[int, Frame]]:
    """Every frame that ends in `data`, and where it ends."""
    buffer = np.frombuffer(bytearray(data), np.uint8)
    read = []
    at, found = codec.next_frame(decoder, buffer, 0, buffer.size)
    while found:
        counts = tuple(decoder.counts[: decoder.framing.words].tolist())
        read.append((int(at), Frame(int(decoder.type), int(decoder.number), int(decoder.argument), counts)))
        at, found = codec.next_frame(decoder, buffer, at, buffer.size)
    return read


@settings(max_examples=80, deadline=None)
@given(pieces(), st.data())
def test_any_stream_in_chunks_of_any_size_reads_as_in_the_document(
    plain_decoder: Any, formats: dict[str, Any], stream: tuple[str, str, list[bytes]], data: st.DataObject
) -> None:
    name, kind, parts = stream
    whole = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=20)))
    decoder, plain = new(name, kind), plain_decoder(formats[name], "to_device" if kind in TO_DEVICE else "to_host")
    bounds = zip([0, *cuts], [*cuts, len(whole)], strict=True)
    read = [as_plain(one) for start, stop in bounds for one in frames_in(decoder, whole[start:stop])]
    assert read == plain.read(whole)
    assert counters(decoder) == dict(plain.counters)


def as_plain(read: Frame) -> dict[str, Any]:
    kind = NAMES[read.type]
    argument = {"argument": read.argument} if kind in TO_DEVICE else {}
    return {"type": kind, "number": read.number} | argument | {"payload": list(read.counts)}
