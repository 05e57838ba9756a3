"""Flipped bits on the wire: a damaged frame never comes out of the decoder, and the frames around it always do.

Every test puts the damaged frame between two good ones, as it stands on a line, its delimiter among what is damaged.
"""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_protocol.compiled import entry, inlined
from firmware_protocol.decoder import Frame, frames_in, new_decoder, next_frame
from firmware_protocol.frames import Format
from firmware_protocol.vectors import FORMATS, TO_DEVICE, TYPES, frame, words_in

# Payloads and numbers with many zeros, none, bytes that are one flip away from a zero, and nothing special.
FIELDS = ((0, 0), (4095, -1), (257, 0x01010101), (2048, -(2**31)), (0x123, 0x12345678), (16, 0x40100402))
EVERY_TYPE = [(name, kind) for name in ("setup", "armed_1", "velocity_1") for kind in TYPES]


@inlined
def _is(decoder, fields):
    same = decoder.type == fields[0] and decoder.number == fields[1]
    for i in range(decoder.framing.words):
        same = same and decoder.counts[i] == fields[2 + i]
    return same


@entry
def _reads_as(decoder, stream, fields):
    """Returns whether the decoder finds these frames and no others, in order."""
    decoder.seen = 0
    at, k = 0, 0
    while True:
        at, found = next_frame(decoder, stream, at, stream.size)
        if not found:
            return k == fields.shape[0]
        if k == fields.shape[0] or not _is(decoder, fields[k]):
            return False
        k += 1


@inlined
def _flip(stream, bit):
    stream[bit >> 3] ^= np.uint8(1 << (bit & 7))


def _flip_every(decoder, stream, first, last, flips, fields):
    """Flips every choice of `flips` bits of stream[first:last]: how many choices there were, how many were misread."""
    return _flip_all_from(np.arange(flips), decoder, stream, first, last, fields)


@entry
def _flip_all_from(chosen, decoder, stream, first, last, fields):
    flips = chosen.size
    bits = 8 * (last - first)
    tried = 0
    misread = 0
    i = 0
    while i >= 0:
        for bit in chosen:
            _flip(stream, 8 * first + bit)
        tried += 1
        misread += 0 if _reads_as(decoder, stream, fields) else 1
        for bit in chosen:
            _flip(stream, 8 * first + bit)
        i = flips - 1
        while i >= 0 and chosen[i] == bits - flips + i:
            i -= 1
        if i >= 0:
            chosen[i] += 1
            for j in range(i + 1, flips):
                chosen[j] = chosen[j - 1] + 1
    return tried, misread


def _line(name: str, kind: str, number: int, word: int) -> tuple[Any, NDArray[np.uint8], NDArray[np.int64]]:
    """A decoder, three frames on the wire, and what should be read of them; the middle one carries the arguments."""
    counts = [[w, ~w][: words_in(name, kind)] for w in (77, word, -78)]
    fields = [(TYPES[kind], n, *c) for n, c in zip((number ^ 1, number, number ^ 2), counts, strict=True)]
    data = b"".join(frame(name, kind, n, 20, c) for (_, n, *_), c in zip(fields, counts, strict=True))
    decoder = new_decoder(FORMATS[name], kind in TO_DEVICE)
    return decoder, np.frombuffer(bytearray(data), np.uint8), np.array(fields)


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(("name", "kind"), EVERY_TYPE)
def test_a_frame_with_any_one_two_or_three_bits_flipped_is_refused_and_its_neighbours_are_not(
    name: str, kind: str, figures: Any
) -> None:
    for number, word in FIELDS:
        decoder, stream, fields = _line(name, kind, number, word)
        length = stream.size // 3
        for flips in (1, 2, 3):
            tried, misread = _flip_every(decoder, stream, length, 2 * length, flips, fields[[0, 2]])
            assert (tried, misread) == (comb(8 * length, flips), 0)
            figures.count("patterns of one, two or three flipped bits, none taken for a sound frame", tried)


def test_the_instrument_sees_a_frame_that_comes_through() -> None:
    decoder, stream, fields = _line("armed_1", "force", 5, 6)
    assert _reads_as(decoder, stream, fields)
    assert not _reads_as(decoder, stream, fields[[0, 2]])
    assert _flip_every(decoder, stream, 0, stream.size, 1, fields) == (8 * stream.size, 8 * stream.size)


words = st.one_of(st.integers(-(2**31), 2**31 - 1), st.sampled_from([0, 1, -1, 256, 0x01010101, 0x80, -(2**31)]))


@st.composite
def lines(draw: st.DrawFn) -> tuple[Format, bool, list[bytes], list[Frame]]:
    """Three frames of any format, direction, type and content."""
    name = draw(st.sampled_from(sorted(FORMATS)))
    to_device = draw(st.booleans())
    kinds = [kind for kind in TYPES if (kind in TO_DEVICE) == to_device]
    data, frames = [], []
    for _ in range(3):
        kind, number, argument = (
            draw(st.sampled_from(kinds)),
            draw(st.integers(0, 4095)),
            draw(st.integers(0, 255)) if to_device else 0,
        )
        counts = draw(st.lists(words, min_size=words_in(name, kind), max_size=words_in(name, kind)))
        data.append(frame(name, kind, number, argument, counts))
        frames.append(Frame(TYPES[kind], number, argument, tuple(counts)))
    return FORMATS[name], to_device, data, frames


@settings(max_examples=80, deadline=None)
@given(lines(), st.data())
def test_up_to_five_flips_anywhere_in_a_frame_of_any_format_are_refused(
    line: tuple[Format, bool, list[bytes], list[Frame]], data: st.DataObject
) -> None:
    wire, to_device, (before, hit, after), frames = line
    bits = data.draw(st.sets(st.integers(0, 8 * len(hit) - 1), min_size=1, max_size=5))
    damaged = _with_flips(hit, sum(1 << bit for bit in bits))
    assert frames_in(new_decoder(wire, to_device), before + damaged + after) == [frames[0], frames[2]]


@settings(max_examples=80, deadline=None)
@given(lines(), st.data())
def test_a_burst_as_long_as_the_check_is_refused(
    line: tuple[Format, bool, list[bytes], list[Frame]], data: st.DataObject
) -> None:
    wire, to_device, (before, hit, after), frames = line
    longest = 32 if wire.long_check else 16
    pattern = data.draw(st.integers(1, 2**longest - 1))
    start = data.draw(st.integers(0, 8 * len(hit) - pattern.bit_length()))
    damaged = _with_flips(hit, pattern << start)
    assert frames_in(new_decoder(wire, to_device), before + damaged + after) == [frames[0], frames[2]]


def _with_flips(data: bytes, flips: int) -> bytes:
    return bytes(byte ^ (flips >> 8 * i & 0xFF) for i, byte in enumerate(data))
