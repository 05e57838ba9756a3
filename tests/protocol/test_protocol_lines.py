"""Lines: words and counts of a force's line, and the law in integers, against Python's unbounded integers."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol import schema
from firmware_protocol.compiled import entry
from firmware_protocol.description import Description, from_registers, registers_of_a_description, to_registers
from firmware_protocol.lines import (
    SHIFTS,
    as_sent,
    bound_in_force_counts,
    line_counts,
    line_force,
    line_units,
    lines_of,
    pack_line,
    unpack_line,
)


@entry
def _line_force(*arguments):
    return line_force(*arguments)


@entry
def _line_counts(*arguments):
    return line_counts(*arguments)


@entry
def _round_trip(k, b, low, high):
    return unpack_line(*pack_line(k, b, low, high))


LEAST, MOST = -(2**31), 2**31 - 1
signed_16, unsigned_16 = (st.integers(-32768, 32767), st.integers(0, 65535))
words = st.one_of(st.integers(LEAST, MOST), st.sampled_from([LEAST, MOST, 0, 1, -1]))
shifts = st.integers(SHIFTS[0], SHIFTS[-1])
differences = st.one_of(words, st.integers(2 * LEAST, -2 * LEAST))


def saturated(value: int) -> int:
    return min(max(value, LEAST), MOST)


@settings(max_examples=200, deadline=None)
@given(signed_16, unsigned_16, signed_16, signed_16)
def test_a_line_comes_back_from_its_words(k: int, b: int, low: int, high: int) -> None:
    first, second = pack_line(k, b, low, high)
    assert LEAST <= min(first, second) <= max(first, second) <= MOST
    assert unpack_line(first, second) == _round_trip(k, b, low, high) == (k, b, low, high)


@settings(max_examples=400, deadline=None)
@given(words, signed_16, unsigned_16, words, words, differences, differences, shifts, shifts)
@example(LEAST, -32768, 65535, LEAST, MOST, 2 * LEAST, -2 * LEAST, -15, -15)
@example(MOST, 32767, 65535, LEAST, MOST, -2 * LEAST, 2 * LEAST, -15, -15)
def test_the_law_is_the_document_s_at_the_ends_of_every_range(
    f: int, k: int, b: int, one: int, other: int, ahead: int, moved: int, s_k: int, s_b: int
) -> None:
    low, high = sorted((one, other))
    u = f - saturated(math.floor(Fraction(k * saturated(ahead)) / Fraction(2) ** s_k))
    damped = u - saturated(math.floor(Fraction(b * saturated(moved)) / Fraction(2) ** s_b))
    expected = high if u >= high else low if u <= low else min(max(damped, low), high)
    arguments = (f, k, b, low, high, ahead, moved, (s_k, s_b))
    assert line_force(*arguments) == _line_force(*arguments) == expected


def test_a_contact_never_pulls_and_no_damping_acts_beyond_a_bound() -> None:
    wall = {"k": 100, "b": 50, "low": 0, "high": 10**9}
    for ahead in range(-20, 20):
        for moved in range(-100, 100, 7):
            force = line_force(0, wall["k"], wall["b"], wall["low"], wall["high"], ahead, moved, (0, 0))
            assert force == (0 if ahead >= 0 else max(0, -100 * ahead - 50 * moved))


@pytest.mark.parametrize("limit", [1, 32767, 10**9, MOST])
def test_a_bound_is_0_or_the_limit_exactly(limit: int) -> None:
    assert [bound_in_force_counts(bound, limit) for bound in (-32767, 0, 32767)] == [-limit, 0, limit]
    for bound in (1, 2, 3, 16384, 32766):
        assert bound_in_force_counts(bound, limit) == bound * limit // 32767 == -bound_in_force_counts(-bound, limit)


SCALES = (2.5, 0.01, 2.5 * 30000, 0.01 * 60000)
sizes = st.one_of(st.floats(-1e6, 1e6), st.floats(-1e-3, 1e-3), st.sampled_from([0.0, 2.5, 75000.0, 1e300, -1e300]))


@settings(max_examples=300, deadline=None)
@given(sizes, sizes, st.one_of(sizes, st.just(-math.inf)), st.one_of(sizes, st.just(math.inf)))
def test_k_and_b_are_rounded_and_saturate_and_bounds_go_outward(k: float, b: float, low: float, high: float) -> None:
    counts = line_counts(k, b, low, high, SCALES, 10.0)
    assert _line_counts(k, b, low, high, SCALES, 10.0) == counts
    fits_k, fits_b = abs(round(k / 2.5)) <= 30000, 0 <= round(b / 0.01) <= 60000
    assert counts[4] == (fits_k and fits_b)
    assert counts[0] == (round(k / 2.5) if fits_k else math.copysign(30000, k))
    assert counts[1] == (round(b / 0.01) if fits_b else 60000 * (b > 0))
    unit = 10.0 / 32767
    assert -32767 <= counts[2] <= 32767
    assert -32767 <= counts[3] <= 32767
    assert counts[2] * unit <= max(low, -10.0) + 1e-9
    assert counts[3] * unit >= min(high, 10.0) - 1e-9
    if abs(low) <= 10.0:
        assert low - counts[2] * unit <= unit * (1.0 + 1e-9)
    assert low != 0.0 or counts[2] == 0
    assert high != 0.0 or counts[3] == 0


def follower(channels: int = 2) -> Description:
    plain = Description("stick", 1000.0, 1, 100, (1e-6,) * channels, (1e-3,) * channels, (5.0,) * channels)
    units = [line_units(1e-3 / 1e-6, 4 / 4000.0)] * channels
    lines = lines_of((4, 1, 4, 16), units, [(3, -2)] * channels, [(32767, 65535)] * channels)
    return replace(plain, sensors=schema.FOLLOWS_LINES, lines=lines)


def test_lines_come_back_from_their_registers_which_are_those_that_a_host_reads() -> None:
    description = follower()
    every = to_registers(description)
    assert [int(every[n]) for n in (20, 21, 22, 23, 162, 163, 178)] == [4, 1, 4, 16, 0xFE03, 0x7FFFFFFF, 0xFE03]
    asked = np.zeros_like(every)
    for register in (0, 1, 2, 15, *registers_of_a_description(2, schema.FOLLOWS_LINES)):
        asked[register] = every[register]
    assert from_registers(asked) == description
    lines = description.lines
    assert lines is not None
    assert lines.stiffness_scale == pytest.approx((125.0, 125.0), rel=1e-15)  # 1000 N/m / 2^3
    assert lines.damping_scale == pytest.approx((4.0, 4.0), rel=1e-15)  # 1000 N/m × 1 ms × 2^2
    assert lines.largest_stiffness == pytest.approx((125.0 * 32767,) * 2, rel=1e-15)
    assert as_sent(1000.0, 9.0, lines, 0) == pytest.approx((1000.0, 8.0), rel=1e-15)
    with pytest.raises(ValueError, match="expected at most"):
        as_sent(5e6, 0.0, lines, 1)
    with pytest.raises(ValueError, match="from 0 to"):
        as_sent(0.0, -8.0, lines, 1)


@pytest.mark.parametrize(("register", "value"), [(15, 7), (20, 0), (22, 0), (23, 0), (162, 32), (162, 0x8000), (4, 0)])
def test_what_describes_no_lines_is_none(register: int, value: int) -> None:
    registers: Any = to_registers(follower())
    registers[register] = value
    if register == 4:
        registers[4:6] = 0
    assert from_registers(registers).lines is None


def test_a_scale_that_no_shift_gives_is_an_error() -> None:
    description = follower()
    assert description.lines is not None
    lines = replace(description.lines, stiffness_scale=(1e9, 1e9))
    with pytest.raises(ValueError, match="shifts"):
        to_registers(replace(description, lines=lines))
