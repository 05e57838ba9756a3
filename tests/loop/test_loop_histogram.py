"""The histogram that the loop fills: nothing is lost, nothing is reported too small."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.compiled import new_record
from hapsim.loop.histogram import HISTOGRAM, Histogram, Spread, histogram_of, note


def counted(*values: int, unit: float = 1.0) -> Histogram:
    record = new_record(HISTOGRAM)
    for value in values:
        note(record, value)
    return histogram_of(record, unit)


@given(st.integers(0, 2**62))
def test_every_value_falls_into_the_bin_that_holds_it(value: int) -> None:
    histogram = counted(value)
    (i,) = np.flatnonzero(histogram.counts)
    edges = histogram.edges
    assert edges[i] <= value
    assert value < edges[i + 1] or i == histogram.counts.size - 1
    assert histogram.maximum == float(value)


@pytest.mark.parametrize("unit", [1.0, 1e-9])
@pytest.mark.parametrize("value", range(32))
def test_whole_numbers_below_32_have_bins_of_their_own(value: int, unit: float) -> None:
    histogram = counted(*range(64))
    assert histogram.counts[histogram.edges[:-1] == value] == [1]
    assert counted(value, 100, unit=unit).quantile(0.5) == value * unit


def test_a_bin_is_at_most_a_sixteenth_wide() -> None:
    edges = counted().edges[1:]
    assert np.all(np.diff(edges) <= edges[:-1] / 16)
    assert edges[-1] > 1e12


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=50), st.floats(0.01, 1.0))
def test_a_quantile_is_never_too_small_and_at_most_a_sixteenth_too_large(values: list[int], share: float) -> None:
    exact = sorted(values)[math.ceil(share * len(values)) - 1]
    told = counted(*values).quantile(share)
    assert exact <= told <= exact * (1.0 + 1.0 / 16)


def test_a_negative_lateness_counts_as_none_and_nothing_has_no_quantiles() -> None:
    assert counted(-5, -(2**60)).spread().max == 0.0
    assert counted().spread() == Spread(0, None, None, None, None)


def test_nanoseconds_are_reported_in_seconds() -> None:
    histogram = counted(*[1000] * 99, 5_000_000, unit=1e-9)
    assert histogram.quantile(0.5) == pytest.approx(1e-6, rel=1 / 16)
    assert histogram.maximum == pytest.approx(5e-3)
    assert histogram.share_above(1e-3) == 0.01
    assert histogram.total == 100


@pytest.mark.parametrize("share", [-0.1, 1.5, float("nan")])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="a share of all is 0 to 1"):
        counted(1).quantile(share)


def test_a_histogram_comes_back_from_its_row() -> None:
    histogram = counted(3, 7, 10**9, unit=1e-9)
    assert Histogram.from_row(histogram.as_row()) == histogram
    assert Histogram.from_row(histogram.as_row()) != counted(3, 7, 10**9)
