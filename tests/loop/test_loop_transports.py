"""In virtual time nothing depends on the transport, on the machine, or on what ran before."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hapsim.device.mock.firmware import Mock
from hapsim.loop.ring import UNSENT
from hapsim.loop.trace import Trace
from hapsim.running import Excitation, run
from hapsim.scene import Scene

COLUMNS = ("sample", "flags", "position_counts", "force_counts", "asked_force")
DEVICES: list[dict[str, Any]] = [
    {"delay": 1, "hold": "zoh", "sampling": "ideal"},
    {"delay": 0, "hold": "impulse", "sampling": "ideal"},
    {"delay": 2.4, "hold": "zoh", "sampling": "average", "force_limit": 0.5},
]

Served = Callable[[Scene], contextlib.AbstractContextManager[tuple[Scene, Mock]]]


def require_same(one: Trace, other: Trace) -> None:
    for name in COLUMNS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.parametrize("channels", [1, 2, 4, 16])
@pytest.mark.parametrize("device", DEVICES)
def test_loopback_and_pseudo_terminal_give_the_same_trace_bit_for_bit(
    scene_of: Callable[..., Scene], channels: int, device: dict[str, Any]
) -> None:
    scene = scene_of(channels, device=device, mock={"noise": 1e-7, "seed": 3})
    in_memory = run(scene, duration=0.3, line="loopback")
    on_terminal = run(scene, duration=0.3, line="terminal")
    assert in_memory.sample.tolist() == list(range(300))
    assert np.any(in_memory.force_counts[-1] != 0)
    require_same(in_memory, on_terminal)


def test_a_run_is_reproducible(scene_of: Callable[..., Scene]) -> None:
    scene = scene_of(2, mock={"noise": 1e-6})
    require_same(run(scene, duration=0.5), run(scene, duration=0.5))


def test_another_seed_gives_another_run(scene_of: Callable[..., Scene]) -> None:
    one, other = (run(scene_of(mock={"noise": 1e-6, "seed": seed}), duration=0.1) for seed in (1, 2))
    assert np.any(one.position_counts != other.position_counts)


def test_a_second_run_on_the_same_served_mock_gives_the_same_trace(
    scene_of: Callable[..., Scene], served: Served
) -> None:
    with served(scene_of(2, mock={"noise": 1e-6})) as (scene, _):
        first, second, third = (run(scene, duration=0.2) for _ in range(3))
    require_same(first, second)
    require_same(first, third)
    require_same(first, run(scene_of(2, mock={"noise": 1e-6}), duration=0.2))


def test_sample_numbers_go_on_beyond_the_twelve_bits_of_the_wire(scene_of: Callable[..., Scene]) -> None:
    trace = run(scene_of(), duration=10.0, line="terminal")
    assert trace.sample.tolist() == list(range(10_000))
    assert (trace.report.lost_frames, trace.report.late_ticks, trace.report.stale_positions) == (0, 0, 0)


def test_in_virtual_time_no_row_is_lost_however_long_the_run(scene_of: Callable[..., Scene]) -> None:
    """More rows than the ring holds: the loop waits for its reader."""
    trace = run(scene_of(), duration=150.0)
    assert trace.sample.tolist() == list(range(150_000))
    assert trace.report.ticks == 150_000
    assert trace.report.dropped_rows == 0
    assert not np.any(trace.flags & UNSENT)


def test_a_run_that_is_not_kept_has_a_report_and_no_rows(scene_of: Callable[..., Scene]) -> None:
    trace = run(scene_of(), duration=1.0, keep=False)
    assert trace.report.ticks == 1000
    assert trace.sample.size == 0
    assert trace.force.shape == (0, 1)


def test_the_answer_is_what_the_scene_asks_for_rounded_to_a_count(scene_of: Callable[..., Scene]) -> None:
    trace = run(scene_of(3), duration=0.2)
    np.testing.assert_allclose(trace.force, trace.asked_force, rtol=0, atol=0.5 * trace.force_scale.max())
    displaced = trace.position - 0.0
    expected = -1000.0 * displaced[1:, 0] - 2.0 * 1000.0 * np.diff(displaced[:, 0])
    np.testing.assert_allclose(trace.asked_force[1:, 0], expected, rtol=0, atol=1e-12)


def test_an_excitation_adds_to_its_channel_only_and_not_to_what_the_scene_asked(scene_of: Callable[..., Scene]) -> None:
    pushes = Excitation(channel=1, force=2.0, ticks=3, every=50, start=100, first=True)
    scene = scene_of(2, stiffness=0.0, damping=0.0)
    trace = run(scene, duration=0.2, excitation=pushes)
    pushed = trace.force[:, 1]
    assert np.flatnonzero(pushed).tolist() == [0, 1, 2, 100, 101, 102, 150, 151, 152]
    np.testing.assert_allclose(pushed[:3], 2.0, atol=1e-8)
    assert pushed[100] * pushed[150] < 0
    assert np.all(np.abs(pushed[100:]) <= 2.0 + trace.force_scale[1])
    assert not trace.force[:, 0].any()
    assert not trace.asked_force.any()


@pytest.mark.parametrize("clock", ["device", "host"])
def test_both_real_clocks_run_to_the_end(scene_of: Callable[..., Scene], clock: str) -> None:
    """In real time, on a machine that may be busy: only what holds however late it is."""
    trace = run(scene_of(device={"clock": clock}), duration=0.2)
    assert trace.report.ending == "done"
    assert trace.report.ticks >= 200
    assert trace.report.ticks == trace.sample.size + trace.report.dropped_rows
    assert not trace.report.virtual_time
    assert np.all(np.diff(trace.sample) >= 1)
    assert np.all(np.diff(trace.time_ns) >= 0)
