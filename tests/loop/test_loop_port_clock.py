"""The clock of a port: when a device sampled, from the arrivals of its positions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.loop.port_clock import PORT_CLOCK, RESTART_S, advance_clock, set_clock

USB_S = 125e-6  # positions come on a grid of that on USB, so late by up to that

Floats = NDArray[np.float64]


def new_clock(rate: float = 1000.0, **options: Any) -> Any:
    clock = new_record(PORT_CLOCK)
    set_clock(clock, rate_hz=rate, **{"follows": True} | options)
    return clock


def times(clock: Any, arrivals_s: Iterable[float], gaps: Iterable[int] | None = None) -> Floats:
    """The clock's times (s) of positions that arrive at these times."""
    arrivals_s = list(arrivals_s)
    found = []
    for arrival, gap in zip(arrivals_s, gaps or [1] * len(arrivals_s), strict=True):
        advance_clock(clock, round(arrival * 1e9), gap)
        found.append(1e-9 * float(clock.time_ns))
    return np.array(found)


def sampled(ppm: float = 0.0, count: int = 4000, rate: float = 1000.0) -> Floats:
    return 5.0 + np.arange(count) / rate / (1.0 + 1e-6 * ppm)


def jittered(of: Floats, jitter_s: float = USB_S) -> Floats:
    return of + np.random.default_rng(1).uniform(0.0, jitter_s, of.size)


@pytest.mark.parametrize("rate", [1000.0, 4000.0])
@pytest.mark.parametrize("ppm", [-1000.0, 1000.0])
def test_jitter_of_usb_hardly_reaches_the_ages(ppm: float, rate: float) -> None:
    of = sampled(ppm, 4000, rate)
    off = (times(new_clock(rate), jittered(of)) - of)[2000:] - USB_S / 2
    assert np.sqrt(np.mean(off**2)) < 4e-6  # of arrivals: 36e-6
    assert np.std(np.diff(off)) < 0.3e-6  # from tick to tick, where a damper takes it; of arrivals: 51e-6


def test_period_is_that_of_the_device() -> None:
    clock = new_clock()
    times(clock, jittered(sampled(700.0)))
    assert clock.period_ns == pytest.approx(1e6 / 1.0007, rel=2e-6)


def test_first_arrivals_make_no_wild_period() -> None:
    clock = new_clock()
    for arrival in jittered(sampled(count=50)):
        times(clock, [arrival])
        assert abs(clock.period_ns - 1e6) <= 1500.0


def test_stalls_of_the_machine_leave_the_ages_as_they_are() -> None:
    of = sampled(count=4000)
    arrivals = of + USB_S / 2
    for stall in range(1000, 4000, 500):
        arrivals[stall : stall + 20] = np.maximum(arrivals[stall : stall + 20], of[stall + 20])
    off = times(new_clock(), arrivals) - of - USB_S / 2
    assert np.abs(off[1000:]).max() < 12e-6


def test_line_begins_anew_where_the_device_was_held_up() -> None:
    of = sampled(300.0)
    of[2000:] += 3e-3
    clock = new_clock()
    found = times(clock, of)
    assert np.abs(found - of)[2000:2040].max() > 2e-3  # it may have been the machine
    assert np.abs(found - of)[2000 + round(RESTART_S * 1000) + 2 :].max() < 1e-6
    assert clock.period_ns == pytest.approx(1e6 / 1.0003, rel=2e-6)  # its crystal is the same


def test_lost_positions_are_bridged() -> None:
    of = sampled(500.0)
    seen = np.flatnonzero(np.random.default_rng(2).random(of.size) > 0.2)
    gaps = np.diff(seen, prepend=seen[0] - 1).tolist()
    assert np.abs(times(new_clock(), of[seen], gaps) - of[seen])[1000:].max() < 1e-7


def test_virtual_time_is_exact() -> None:
    clock = new_clock(follows=False, first_ns=250e3, ppm=1000.0)
    found = times(clock, np.zeros(1000))
    np.testing.assert_allclose(found, 250e-6 + np.arange(1000) * 1e-3 / 1.001, rtol=0, atol=1e-12)
