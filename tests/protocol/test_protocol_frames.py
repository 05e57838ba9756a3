"""Single frames and their parts, compiled and as plain Python: stuffing and checks against others' packages; what goes
in comes out, and what belongs elsewhere is refused and counted for what it is."""

from __future__ import annotations

import itertools
from typing import Any

import fastcrc
import numpy as np
import pytest
from cobs import cobs
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol import schema
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from firmware_protocol.frames import (
    SETUP,
    Format,
    armed_format,
    every_armed_format,
    frame_bytes,
    frame_to_device,
    frame_to_host,
    framing_of,
)
from firmware_protocol.lines import pack_line
from firmware_protocol.vectors import COUNTERS, TO_DEVICE, TO_HOST, sealed

LOWEST, HIGHEST = -(2**31), 2**31 - 1
words = st.one_of(st.integers(LOWEST, HIGHEST), st.sampled_from([LOWEST, HIGHEST, 0, -1, 1, 255, 256, -256]))
kinds = st.sampled_from(sorted((TO_HOST | TO_DEVICE).values()))
codes = st.one_of(st.integers(1, 6), st.integers(1, 255))
formats = st.sampled_from([SETUP, *every_armed_format()])
ALL = schema.PART_BITS & ~schema.ADMITTANCE
"""Parts of impedance."""


def read(wire: Format, to_device: bool, data: bytes) -> tuple[list[Frame], dict[str, int]]:
    """The frames in `data`, and the counters that are not zero."""
    decoder = new_decoder(wire, to_device)
    frames = frames_in(decoder, data)
    return frames, {name: int(decoder[name]) for name in COUNTERS if decoder[name]}


def made(wire: Format, to_device: bool, kind: int, number: int, argument: int, counts: list[int]) -> bytes:
    """A frame of one direction; only one to the device has an argument."""
    if to_device:
        return frame_to_device(wire, kind, number, argument, counts)
    return frame_to_host(wire, kind, number, counts)


@settings(max_examples=160, deadline=None)
@given(formats, kinds, st.integers(0, 4095), st.data())
def test_a_frame_comes_back_as_it_was(wire: Format, kind: int, number: int, data: st.DataObject) -> None:
    to_device = kind in TO_DEVICE.values()
    size, argument = wire.words(to_device), data.draw(st.integers(0, 255)) if to_device else 0
    counts = data.draw(st.lists(words, min_size=size, max_size=size))
    sent = made(wire, to_device, kind, number, argument, counts)
    assert len(sent) == frame_bytes(wire, to_device) == schema.frame_bytes(wire.channels, to_device, wire.parts)
    assert sent.index(0) == len(sent) - 1
    assert read(wire, to_device, sent) == ([Frame(kind, number, argument, tuple(counts))], {"accepted": 1})


def test_the_writer_writes_where_it_is_asked_to_and_cuts_what_does_not_fit(codec: Any) -> None:
    wire = armed_format(2)
    counts = np.array([2**31, -(2**31) - 1])
    buffer = np.full(64, 0xEE, np.uint8)
    stop = codec.write_frame(framing_of(wire, True), buffer, 10, schema.FORCE, 4096 + 5, 256 + 7, counts)
    assert (buffer[:10] == 0xEE).all()
    assert (buffer[stop:] == 0xEE).all()
    expected = Frame(schema.FORCE, 5, 7, (-(2**31), 2**31 - 1))
    assert read(wire, True, buffer[10:stop].tobytes())[0] == [expected]
    stop = codec.write_frame(framing_of(wire, False), buffer, 20, schema.POSITION, -1, 0, counts)
    assert read(wire, False, buffer[20:stop].tobytes())[0] == [Frame(schema.POSITION, 4095, 0, expected.counts)]


@settings(max_examples=80, deadline=None)
@given(
    formats,
    st.booleans(),
    st.integers(0, 15),
    st.integers(-(2**15), 2**15),
    st.integers(-300, 300),
    st.integers(0, 9),
    st.data(),
)
def test_plain_python_writes_a_frame_as_machine_code_does_what_does_not_fit_included(
    plain_codec: Any,
    compiled_codec: Any,
    wire: Format,
    to_device: bool,
    kind: int,
    number: int,
    argument: int,
    start: int,
    data: st.DataObject,
) -> None:
    size = wire.words(to_device)
    wide = st.one_of(words, st.integers(-(2**63), 2**63 - 1))
    counts = np.array(data.draw(st.lists(wide, min_size=size, max_size=size)), np.int64)
    framing = framing_of(wire, to_device)
    plain, compiled = (np.full(start + frame_bytes(wire, to_device) + 9, 0xEE, np.uint8) for _ in range(2))
    stop = plain_codec.write_frame(framing, plain, start, kind, number, argument, counts)
    assert compiled_codec.write_frame(framing, compiled, start, kind, number, argument, counts) == stop
    assert compiled.tobytes() == plain.tobytes()
    assert stop == start + frame_bytes(wire, to_device)


@pytest.mark.parametrize("fields", [(16, 0, 0), (-1, 0, 0), (3, 4096, 0), (3, -1, 0), (3, 0, 256), (3, 0, -1)])
def test_a_field_that_does_not_fit_is_an_error_and_not_another_field(fields: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="a frame carries"):
        frame_to_device(armed_format(1), *fields, [0])


@pytest.mark.parametrize("counts", [[], [1], [1, 2, 3], [[1, 2]], [2**31, 0], [0, -(2**31) - 1]])
def test_counts_that_do_not_fit_the_format_are_an_error(counts: list[int]) -> None:
    with pytest.raises(ValueError, match="counts"):
        frame_to_device(armed_format(2), schema.FORCE, 0, 0, counts)
    with pytest.raises(ValueError, match="counts"):
        frame_to_host(armed_format(2), schema.POSITION, 0, counts)


@pytest.mark.parametrize("channels", [-1, 0, 17])
def test_there_is_no_format_outside_of_1_to_16_channels(channels: int) -> None:
    with pytest.raises(ValueError, match="1 to 16"):
        armed_format(channels)


@settings(max_examples=80, deadline=None)
@given(formats, formats, st.booleans(), st.sampled_from([0, 1, 2, 3]), st.integers(0, 4095), words)
def test_a_frame_of_another_format_is_never_accepted(
    wire: Format, other: Format, to_device: bool, kind: int, number: int, word: int
) -> None:
    counts = [word] * other.words(to_device)
    sent = made(other, to_device, (schema.DESCRIBE if to_device else schema.DESCRIPTION) + kind, number, 1, counts)
    frames, counted = read(wire, to_device, sent)
    if other == wire:
        assert len(frames) == 1
    elif len(sent) < frame_bytes(wire, to_device):
        assert (frames, counted) == ([], {"length_errors": 1})
    elif len(sent) == frame_bytes(wire, to_device):
        assert (frames, counted) == ([], {"crc_errors": 1})
    else:
        assert frames == []
        assert counted.pop("garbage_bytes") == len(sent) - frame_bytes(wire, to_device)
        assert sum(counted.values()) == 1


@settings(max_examples=160, deadline=None)
@given(formats, kinds, st.integers(0, 4095), st.integers(0, 255), words)
def test_who_receives_itself_accepts_nothing(wire: Format, kind: int, number: int, argument: int, word: int) -> None:
    """A device, and a host."""
    by_host = kind in TO_DEVICE.values()
    sent = made(wire, by_host, kind, number, argument, [word] * wire.words(by_host))
    frames, counted = read(wire, not by_host, sent)
    assert frames == []
    if len(sent) < frame_bytes(wire, not by_host):
        assert counted == {"length_errors": 1}
    else:
        assert counted.pop("garbage_bytes") == len(sent) - frame_bytes(wire, not by_host)
        assert sum(counted.values()) == 1


@pytest.mark.parametrize("names", [("velocity",), ("acceleration",), ("velocity", "inputs")], ids="_".join)
def test_a_part_s_mark_keeps_a_device_of_one_channel_from_ever_taking_its_own_position_for_a_frame(
    compiled_codec: Any, names: tuple[str, ...]
) -> None:
    # It would look at all but the first three encoded bytes. Their check is the whole frame's only where the three
    # bytes before them (code and header) lead from the start value back to it, whatever follows. If this fails after a
    # change of the schema, count up the last byte of the last part's mark until it holds.
    parts = schema.parts_of(names)
    wire, payload_bytes = armed_format(1, parts), 4 * schema.words(1, False, parts)
    front = schema.encoded_bytes(1, False, parts) - schema.encoded_bytes(1, True, parts)
    back_to_the_start = compiled_codec.crc_of(wire.long_check, np.zeros(0, np.uint8), 0, 0, wire.seed)
    framing, buffer = framing_of(wire, to_device=False), np.zeros(frame_bytes(wire, to_device=False), np.uint8)
    fronts = set()
    for kind in (schema.POSITION, schema.POSITION_HELD):
        for number in range(schema.SAMPLE_MODULUS):
            for zeros in range(
                payload_bytes + 1
            ):  # where the first zero byte of the payload is, which the code in front points to
                payload = bytes(0 if i == zeros else 0xFF for i in range(payload_bytes))
                counts = np.frombuffer(payload, "<i4").astype(np.int64)
                compiled_codec.write_frame(framing, buffer, 0, kind, number, 0, counts)
                fronts.add(buffer[:front].tobytes())
    assert front == 3
    for start in fronts:
        data = np.frombuffer(bytearray(start), np.uint8)
        assert compiled_codec.crc_of(wire.long_check, data, 0, front, wire.seed) != back_to_the_start


@pytest.mark.parametrize(
    ("channels", "parts"),
    [
        (1, 0),
        (2, 0),
        (3, 0),
        (1, ALL ^ schema.WITH_WORDS),
        (1, schema.WITH_WORDS),
        (2, schema.WITH_WORDS),
        (1, schema.ADMITTANCE),
        (1, schema.ADMITTANCE | schema.WITH_WORDS),
    ],
)
def test_an_echo_s_header_points_beyond_the_end_of_a_short_frame(channels: int, parts: int) -> None:
    # Why a host with up to three channels never takes its own frame for the device's, whatever the check says.
    longer = schema.encoded_bytes(channels, True, parts) - schema.encoded_bytes(channels, False, parts)
    assert longer == 1
    assert min(TO_DEVICE.values()) << 4 > schema.encoded_bytes(channels, False, parts)


def test_with_lines_a_frame_to_the_device_is_longer_than_one_to_the_host() -> None:
    # Why a device never takes its own frame for the host's there.
    lengths = [
        [frame_bytes(wire, to) for to in (True, False)] for wire in every_armed_format() if "line" in wire.part_names
    ]
    assert len(lengths) == 128
    assert all(to_device > to_host for to_device, to_host in lengths)


@pytest.mark.parametrize("parts", [*schema.COMBINATIONS[1:4], *schema.COMBINATIONS[9:11], *schema.COMBINATIONS[13:15]])
def test_a_device_of_one_channel_never_takes_its_own_status_for_a_frame(parts: int) -> None:
    # What is left of it once its front is cut off has type 0, whatever the check says.
    wire = armed_format(1, parts)
    whole, rest_bytes = schema.encoded_bytes(1, False, parts), schema.encoded_bytes(1, True, parts)
    sealed_rests = b""
    numbers = range(0, schema.SAMPLE_MODULUS, 29)
    for fault, number in itertools.product(schema.FAULTS, numbers):
        sent = frame_to_host(wire, schema.STATUS, number, [schema.LATCHED | fault << 8, *[0] * (wire.words(False) - 1)])
        sealed_rests += sealed(wire, sent[whole - rest_bytes : whole])
    assert read(wire, True, sealed_rests) == ([], {"form_errors": len(schema.FAULTS) * len(numbers)})


def test_accelerations_stand_last_and_each_part_can_come_alone() -> None:
    bits = schema.MOTION_BITS
    both = armed_format(2, bits)
    sent = frame_to_host(both, schema.POSITION_HELD, 5, [1, 2, -3, -4, 6, 7])
    body = cobs.decode(sent[:-6])
    assert body == bytes.fromhex("b005 01000000 02000000 fdffffff fcffffff 06000000 07000000")
    alone = armed_format(1, schema.WITH_ACCELERATION)
    assert cobs.decode(frame_to_host(alone, schema.POSITION, 5, [1, 9])[:-4]) == bytes.fromhex("a005 01000000 09000000")
    assert (both.part_names, alone.part_names) == (["velocity", "acceleration"], ["acceleration"])
    assert schema.parts_of(["acceleration", "velocity"]) == bits == 0xA0
    assert len({armed_format(1, parts).seed for parts in schema.COMBINATIONS} | {SETUP.seed}) == 25


def test_a_digital_word_stands_behind_everything_else_in_each_direction() -> None:
    wire = armed_format(1, ALL)
    sent = frame_to_host(wire, schema.POSITION, 5, [1, 2, 3, -(2**31)])
    assert cobs.decode(sent[:-6]) == bytes.fromhex("a005 01000000 02000000 03000000 00000080")
    sent = frame_to_device(wire, schema.FORCE, 5, 9, [1, *pack_line(2, 3, -4, 5), 256])
    assert cobs.decode(sent[:-6]) == bytes.fromhex("3005 09 01000000 03000200 0500fcff 00010000")


def test_a_digital_word_costs_at_most_six_bytes_each_way_and_others_what_they_did() -> None:
    costs = {
        frame_bytes(armed_format(n, parts | schema.WITH_WORDS), to) - frame_bytes(armed_format(n, parts), to)
        for n in range(1, 17)
        for parts in schema.COMBINATIONS[:12]
        if schema.fits(n, parts | schema.WITH_WORDS)
        for to in (False, True)
    }
    assert costs == {4, 6}
    plain = [[frame_bytes(armed_format(n, 0), to) for n in (1, 3, 4, 16)] for to in (False, True)]
    assert plain == [[11, 19, 25, 73], [12, 20, 26, 74]]


def test_lines_stand_behind_the_forces_of_all_channels_in_every_frame_to_the_device() -> None:
    wire = armed_format(2, schema.WITH_LINE)
    line = [*pack_line(-2, 65535, -32767, 3), *pack_line(32767, 1, -1, -1)]
    body = cobs.decode(frame_to_device(wire, schema.FORCE, 5, 9, [1, -2, *line])[:-6])
    assert body == bytes.fromhex("3005 09 01000000 feffffff fffffeff 03000180 0100ff7f ffffffff")
    assert frame_bytes(armed_format(1, schema.WITH_LINE), to_device=True) == 20
    assert frame_bytes(wire, to_device=False) == frame_bytes(armed_format(2), to_device=False) + 2  # the long check


def test_more_words_than_cobs_stuffs_by_one_byte_are_refused() -> None:
    longest = armed_format(15, 0xF0)  # 15 channels of 4 values, and a word: 61
    counts = list(range(-30, 31))
    frames, _ = read(longest, False, frame_to_host(longest, schema.POSITION, 1, counts))
    assert list(frames[0].counts) == counts
    said = "hand_force, inputs, outputs: a frame of 65 words, expected at most 62: "
    with pytest.raises(ValueError, match=said):
        armed_format(16, 0xF0)
    assert schema.words(16, False, 0xF0) == 65
    assert schema.words(16, True, 0xF0) == 17
    assert 2 + 4 * schema.MAX_WORDS <= LONGEST_BODY < 2 + 4 * (schema.MAX_WORDS + 1)


@settings(max_examples=80, deadline=None)
@given(formats, st.booleans(), st.data())
def test_codes_that_do_not_add_up_under_a_right_check_are_a_form_error(
    wire: Format, to_device: bool, data: st.DataObject
) -> None:
    length = schema.encoded_bytes(wire.channels, to_device, wire.parts)
    encoded = bytes(data.draw(st.lists(codes, min_size=length, max_size=length)))
    try:
        kind = cobs.decode(encoded)[0] >> 4
    except cobs.DecodeError:
        kind = None
    known = kind in (TO_DEVICE if to_device else TO_HOST).values()
    assert read(wire, to_device, sealed(wire, encoded))[1] == ({"accepted": 1} if known else {"form_errors": 1})


LONGEST_BODY = 253
bodies = st.one_of(
    st.binary(max_size=LONGEST_BODY), st.lists(st.sampled_from([0, 0, 1, 254, 255]), max_size=LONGEST_BODY).map(bytes)
)


def stuffed(codec: Any, body: bytes) -> bytes:
    """Encoded in the middle of a buffer, whose other bytes have to stay as they are."""
    buffer = np.frombuffer(bytearray(b"\xaa\xaa\0" + body + b"\xbb\xbb"), np.uint8)
    codec.stuff(buffer, 2, 3 + len(body))
    data = buffer.tobytes()
    assert (data[:2], data[-2:]) == (b"\xaa\xaa", b"\xbb\xbb")
    return data[2:-2]


def unstuffed(codec: Any, encoded: bytes) -> bytes | None:
    """The body, or None where the codes do not add up; read past the end would be seen by what stands there."""
    buffer = np.frombuffer(bytearray(b"\xaa" + encoded + b"\1\1\1"), np.uint8)
    adds_up = codec.unstuff(buffer, 1, 1 + len(encoded))
    return buffer.tobytes()[2:-3] if adds_up else None


@settings(max_examples=80, deadline=None)
@given(bodies)
@example(bytes(LONGEST_BODY))
@example(bytes(range(1, 254)))
def test_a_body_is_stuffed_as_the_cobs_package_does_it_and_comes_back(codec: Any, body: bytes) -> None:
    encoded = stuffed(codec, body)
    assert encoded == cobs.encode(body)
    assert len(encoded) == len(body) + 1
    assert 0 not in encoded
    assert unstuffed(codec, encoded) == body


@settings(max_examples=80, deadline=None)
@given(st.lists(st.integers(1, 12), min_size=1, max_size=30).map(bytes))
def test_codes_that_do_not_add_up_are_refused_where_the_cobs_package_refuses_them(codec: Any, encoded: bytes) -> None:
    try:
        expected: bytes | None = cobs.decode(encoded)
    except cobs.DecodeError:
        expected = None
    assert unstuffed(codec, encoded) == expected


@pytest.mark.parametrize("length", [1, 8, 68])
def test_every_code_that_points_beyond_the_end_is_refused(codec: Any, length: int) -> None:
    for code in range(1, 256):
        body = unstuffed(codec, bytes([code]) + b"\xff" * (length - 1))
        assert (body is not None) == (code == length)


@settings(max_examples=80, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 0xFFFF))
def test_the_16_bit_check_is_fastcrc_s_from_any_start_value(codec: Any, data: bytes, seed: int) -> None:
    ours = int(codec.crc_of(0, np.frombuffer(bytearray(data), np.uint8), 0, len(data), seed))
    assert ours == fastcrc.crc16.dnp(data, seed ^ 0xFFFF)  # fastcrc starts from a check, final xor included


@settings(max_examples=80, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 0xFFFFFFFF))
def test_the_32_bit_check_is_fastcrc_s_from_any_start_value(codec: Any, data: bytes, seed: int) -> None:
    ours = int(codec.crc_of(1, np.frombuffer(bytearray(data), np.uint8), 0, len(data), seed))
    assert ours == fastcrc.crc32.iscsi(data, seed ^ 0xFFFFFFFF)
