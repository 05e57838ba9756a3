"""The velocities that the mock measures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol import schema


@pytest.mark.parametrize(("delay", "seen"), [(0.0, 1), (0.5, 1), (1.0, 2), (1.5, 2), (2.0, 3)])
def test_an_impulse_at_the_instant_of_a_sample_is_not_in_that_sample_s_velocity_but_in_the_next(
    new_host: Callable[..., Any], exchange: Callable, delay: float, seen: int
) -> None:
    host = new_host(device={"mass": 1.0, "delay": delay, "hold": "impulse", "force_limit": 10.0})
    heard = exchange(host, [[2**30], *[[0]] * 5], velocity=True)
    sensed = [frame.counts[1] for frame in heard if frame.type == schema.POSITION]
    assert sensed == [0] * seen + [5000] * (7 - seen)  # 5 N for a millisecond: 5 mm/s in steps of 1 um/s


def test_the_mean_velocity_is_the_way_that_was_gone_over_the_time_that_the_sample_really_lasted(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(
        device={"sampling": "average", "mass": 0.01, "friction": 20.0, "delay": 0},
        mock={"initial": {"velocity": 0.5}, "quantum": 1e-9},
    )
    host.arm(schema.PACED_BY_HOST, now=0, velocity=True)
    edges = [0, 1_000_000, 1_300_000, 5_300_000]
    for n, (start, stop) in enumerate(itertools.pairwise(edges)):
        (position,) = host.force(n, now=stop)
        gone = -0.5 * 5e-4 * math.exp(-start / 5e5) * math.expm1((start - stop) / 5e5)
        assert position.counts[1] * 1e-6 == pytest.approx(gone / (stop - start) * 1e9, abs=0.51e-6)


@pytest.mark.parametrize("sampling", ["ideal", "average"])
def test_the_first_velocity_is_the_body_s_and_arming_again_measures_from_the_start(
    new_host: Callable[..., Any], exchange: Callable, sampling: str
) -> None:
    host = new_host(device={"sampling": sampling}, mock={"initial": {"position": 0.1, "velocity": -0.25}})
    for _ in range(2):
        heard = exchange(host, [[0]] * 3, velocity=True)
        assert [frame.counts[1] for frame in heard if frame.type == schema.POSITION] == [-250_000] * 4
        host.disarm()


@pytest.mark.parametrize("channels", [1, 2, 3, 16])
def test_velocities_of_all_channels_stand_behind_the_positions_of_all_channels(
    new_host: Callable[..., Any], channels: int
) -> None:
    initial = {
        "position": [0.001 * (c + 1) for c in range(channels)],
        "velocity": [0.25 * (c + 1) for c in range(channels)],
    }
    host = new_host(channels, mock={"initial": initial, "quantum": 1e-6})
    _, position = host.arm(velocity=True)
    assert position.counts[:channels] == tuple(1000 * (c + 1) for c in range(channels))
    assert position.counts[channels:] == tuple(250 * (c + 1) for c in range(channels))
    host.disarm()
    assert len(host.arm()[1].counts) == channels
    assert host.misread == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_a_velocity_beyond_its_scale_stops_at_the_end_of_it_and_is_no_fault(
    new_host: Callable[..., Any], direction: int
) -> None:
    host = new_host(rate=500.0, mock={"quantum": 1e-12, "initial": {"velocity": 1.5 * direction}})  # scale: 1.07 m/s
    _, position = host.arm(velocity=True)
    assert position.counts == (0, direction * 2147483647)
    assert host.state == schema.ARMED


def test_a_device_that_latches_while_it_sends_velocities_says_so_in_their_format(
    new_host: Callable[..., Any],
) -> None:
    host = new_host(3)
    host.arm(schema.PACED_BY_DEVICE, watchdog=1, velocity=True)
    for _ in range(3):
        host.sample_passes()
    (status,) = host.look_at_watchdog()
    assert status.counts == (schema.LATCHED | schema.HOST_QUIET << 8, 0, 0, 0, 0, 0)
    assert host.register(schema.REG_FAULT) == schema.HOST_QUIET
    assert host.misread == 0
