"""The Hamming distance that PROTOCOL.md promises, for every format and for all contents at once.

A CRC is linear: flips go unnoticed exactly when the checks of the single flips cancel, whatever the frame carries. So
one syndrome for each bit settles it: no five of them, or fewer, may cancel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, Format, armed_format, frame_bytes


def _syndromes(codec: Any, wire: Format, encoded: int) -> NDArray[np.int64]:
    """What each flipped bit, first of the encoded bytes and then of the check, does to the check's comparison."""
    nothing = codec.crc_of(wire.long_check, np.zeros(encoded, np.uint8), 0, encoded, wire.seed)
    of_data = []
    for bit in range(8 * encoded):
        flipped = np.zeros(encoded, np.uint8)
        flipped[bit // 8] = 1 << bit % 8
        of_data.append(codec.crc_of(wire.long_check, flipped, 0, encoded, wire.seed) ^ nothing)
    return np.array(of_data + [1 << i for i in range(32 if wire.long_check else 16)])


@pytest.mark.parametrize("velocity", [False, True], ids=["", "with velocities"])
@pytest.mark.parametrize("to_device", [False, True], ids=["to the host", "to the device"])
@pytest.mark.parametrize("channels", range(1, schema.MAX_CHANNELS + 1))
def test_no_one_to_five_flips_under_the_check_cancel(
    compiled_codec: Any, channels: int, to_device: bool, velocity: bool
) -> None:
    single = _syndromes(
        compiled_codec, armed_format(channels, velocity), schema.encoded_bytes(channels, to_device, velocity)
    )
    # An odd number of flips never cancels, because every syndrome has an odd number of ones.
    assert all(int(syndrome).bit_count() % 2 == 1 for syndrome in single)
    # Two cancel where two syndromes are equal, four where two pairs of bits have the same sum.
    first, second = np.triu_indices(single.size, 1)
    pairs = single[first] ^ single[second]
    assert np.unique(single).size == single.size
    assert np.unique(pairs).size == pairs.size


def test_the_distance_ends_where_the_document_says_that_it_does(compiled_codec: Any) -> None:
    # A fourth word under the short check would have been too much: the limit is not an accident of the test.
    for wire, longer in (
        (armed_format(schema.SHORT_CRC_WORDS), schema.encoded_bytes(4, to_device=True)),
        (armed_format(1, velocity=True), schema.encoded_bytes(2, to_device=False, velocity=True)),
    ):
        assert not wire.long_check
        single = _syndromes(compiled_codec, wire, longer)
        first, second = np.triu_indices(single.size, 1)
        assert np.unique(single[first] ^ single[second]).size < first.size


@pytest.mark.parametrize("velocity", [False, True], ids=["", "with velocities"])
@pytest.mark.parametrize("to_device", [False, True], ids=["to the host", "to the device"])
@pytest.mark.parametrize("channels", [1, 2, 3, 4, 16])
def test_two_start_values_never_give_the_same_check(
    compiled_codec: Any, channels: int, to_device: bool, velocity: bool
) -> None:
    # The start value enters linearly too: the checks of its single bits are independent, so no two values agree.
    wire = armed_format(channels, velocity)
    encoded = schema.encoded_bytes(channels, to_device, velocity)
    data = np.zeros(encoded, np.uint8)
    bits = 32 if wire.long_check else 16
    nothing = compiled_codec.crc_of(wire.long_check, data, 0, encoded, 0)
    columns = [compiled_codec.crc_of(wire.long_check, data, 0, encoded, 1 << i) ^ nothing for i in range(bits)]
    assert _rank(columns) == bits


def test_no_two_formats_of_one_frame_length_have_a_start_value_in_common() -> None:
    # Their start value alone distinguishes frames of one length.
    every = [SETUP, *(armed_format(n, velocity) for n in range(1, 17) for velocity in (False, True))]
    for to_device in (False, True):
        told_apart = {(frame_bytes(wire, to_device), wire.long_check, wire.seed) for wire in every}
        assert len(told_apart) == len(every)


def _rank(columns: list[int]) -> int:
    """Rank over the field of two elements."""
    basis: list[int] = []
    for column in columns:
        rest = column
        for vector in basis:
            rest = min(rest, rest ^ vector)
        if rest:
            basis.append(rest)
    return len(basis)
