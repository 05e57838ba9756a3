"""COBS and the two CRCs against packages that other people wrote, as machine code and as plain Python."""

from __future__ import annotations

from typing import Any

import fastcrc
import numpy as np
import pytest
from cobs import cobs
from hypothesis import example, given, settings
from hypothesis import strategies as st

LONGEST_BODY = 253
bodies = st.one_of(
    st.binary(max_size=LONGEST_BODY),
    st.lists(st.sampled_from([0, 0, 1, 254, 255]), max_size=LONGEST_BODY).map(bytes),
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


@settings(max_examples=200, deadline=None)
@given(bodies)
@example(bytes(LONGEST_BODY))
@example(bytes(range(1, 254)))
def test_a_body_is_stuffed_as_the_cobs_package_does_it_and_comes_back(codec: Any, body: bytes) -> None:
    encoded = stuffed(codec, body)
    assert encoded == cobs.encode(body)
    assert len(encoded) == len(body) + 1
    assert 0 not in encoded
    assert unstuffed(codec, encoded) == body


@settings(max_examples=200, deadline=None)
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


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 0xFFFF))
def test_the_16_bit_check_is_fastcrc_s_from_any_start_value(codec: Any, data: bytes, seed: int) -> None:
    ours = int(codec.crc_of(0, np.frombuffer(bytearray(data), np.uint8), 0, len(data), seed))
    assert ours == fastcrc.crc16.dnp(data, seed ^ 0xFFFF)  # fastcrc starts from a check, final xor included


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 0xFFFFFFFF))
def test_the_32_bit_check_is_fastcrc_s_from_any_start_value(codec: Any, data: bytes, seed: int) -> None:
    ours = int(codec.crc_of(1, np.frombuffer(bytearray(data), np.uint8), 0, len(data), seed))
    assert ours == fastcrc.crc32.iscsi(data, seed ^ 0xFFFFFFFF)
