"""The Hamming distance that PROTOCOL.md promises, for every format and for all contents at once.

A CRC is linear: flips go unnoticed exactly when the checks of the single flips cancel, whatever the frame carries. So
one syndrome for each bit settles it: no five of them, or fewer, may cancel. A bit's syndrome depends on its distance
from the end alone, so the longest frame of each check settles the shorter ones.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, Format, armed_format, every_armed_format, frame_bytes

EVERY = [SETUP, *every_armed_format()]


def encoded_bytes(wire: Format, to_device: bool) -> int:
    return schema.encoded_bytes(wire.channels, to_device, wire.parts)


def syndromes(codec: Any, wire: Format, encoded: int) -> NDArray[np.int64]:
    """Returns the effect of each flipped bit, of the encoded bytes and then of the check, on the comparison of
    checks."""
    nothing = codec.crc_of(wire.long_check, np.zeros(encoded, np.uint8), 0, encoded, wire.seed)
    of_data = []
    for bit in range(8 * encoded):
        flipped = np.zeros(encoded, np.uint8)
        flipped[bit // 8] = 1 << bit % 8
        of_data.append(codec.crc_of(wire.long_check, flipped, 0, encoded, wire.seed) ^ nothing)
    return np.array(of_data + [1 << i for i in range(32 if wire.long_check else 16)])


def pairs_of(single: NDArray[np.int64]) -> NDArray[np.int64]:
    first, second = np.triu_indices(single.size, 1)
    return single[first] ^ single[second]


@pytest.mark.parametrize(
    "long_check",
    [pytest.param(False, id="16 bits"), pytest.param(True, id="32 bits", marks=pytest.mark.thorough)],
)
def test_no_one_to_five_flips_under_the_check_cancel(compiled_codec: Any, long_check: bool) -> None:
    frames = [each for each in itertools.product(EVERY, (False, True)) if each[0].long_check == long_check]
    longest = syndromes(compiled_codec, frames[0][0], max(encoded_bytes(*each) for each in frames))
    for wire, to_device in frames:
        single = syndromes(compiled_codec, wire, encoded_bytes(wire, to_device))
        assert (single == longest[-single.size :]).all()
    # An odd number of flips never cancels, because every syndrome has an odd number of ones.
    assert all(int(syndrome).bit_count() % 2 == 1 for syndrome in longest)
    # Two cancel where two syndromes are equal, four where two pairs of bits have the same sum.
    pairs = pairs_of(longest)
    assert np.unique(longest).size == longest.size
    assert np.unique(pairs).size == pairs.size


def test_the_distance_ends_where_the_document_states(compiled_codec: Any) -> None:
    # A fourth word under the short check would have been too much: the limit is not an accident of the test.
    for wire, longer in (
        (armed_format(schema.SHORT_CRC_WORDS), schema.encoded_bytes(4, to_device=True)),
        (armed_format(1, schema.WITH_LINE), schema.encoded_bytes(4, to_device=True)),
        (armed_format(1, schema.WITH_VELOCITY), schema.encoded_bytes(2, to_device=False, parts=schema.WITH_VELOCITY)),
    ):
        assert not wire.long_check
        pairs = pairs_of(syndromes(compiled_codec, wire, longer))
        assert np.unique(pairs).size < pairs.size


@pytest.mark.parametrize("to_device", [False, True], ids=["to the host", "to the device"])
def test_two_start_values_never_give_the_same_check(compiled_codec: Any, to_device: bool) -> None:
    # The start value enters linearly too: the checks of its single bits are independent, so no two values agree.
    for wire in EVERY:
        encoded, bits = encoded_bytes(wire, to_device), 32 if wire.long_check else 16
        data = np.zeros(encoded, np.uint8)
        nothing = compiled_codec.crc_of(wire.long_check, data, 0, encoded, 0)
        basis: list[int] = []  # over the field of two elements
        for i in range(bits):
            rest = int(compiled_codec.crc_of(wire.long_check, data, 0, encoded, 1 << i) ^ nothing)
            for vector in basis:
                rest = min(rest, rest ^ vector)
            assert rest
            basis.append(rest)


def test_no_two_formats_of_one_frame_length_have_a_start_value_in_common() -> None:
    # Their start value alone distinguishes frames of one length.
    for to_device in (False, True):
        assert len({(frame_bytes(wire, to_device), wire.long_check, wire.seed) for wire in EVERY}) == len(EVERY)
