"""Positions that are lost, torn, doubled, out of order, stale or late, sent by a scripted device."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from loop_rig import frame, scene_of, scripted

from firmware_protocol import schema
from firmware_protocol.frames import armed_format, frame_to_host
from hapsim.errors import DeviceError
from hapsim.loop.ring import BRIDGED, LATE_FORCE, UNSENT
from hapsim.recording.trace import Trace
from hapsim.running import PeriodicExcitation, run

RATE, K, B = 1000.0, 1000.0, 2.0


def spring_force(x: np.ndarray) -> np.ndarray:
    """The force of the scene's spring along a path, one position (m) per sample, at rest before it."""
    return -K * x - B * RATE * np.diff(x, prepend=x[0])


def play(script: list[bytes | None], ticks: int, **differences: Any) -> tuple[Trace, Any]:
    with scripted(script, **differences) as (scene, device):
        trace = run(scene, duration=ticks / RATE)
    return trace, device


def test_a_force_names_the_position_that_it_answers() -> None:
    trace, device = play([frame(n, 10 * n) for n in range(5)], 5)
    assert [heard.number for heard in device.forces] == [0, 1, 2, 3, 4]
    assert {heard.argument for heard in device.forces} == {20}  # samples that a force lives at 1 kHz
    assert [heard.counts[0] for heard in device.forces] == trace.force_counts[:, 0].tolist()
    np.testing.assert_allclose(trace.asked_force[:, 0], spring_force(np.arange(5) * 10e-6), rtol=1e-12)
    assert device.disarmed >= 1
    assert not device.armed


def test_a_lost_position_is_bridged_along_a_straight_line_and_counted() -> None:
    path = [0, 100, 200, 500, 600]  # samples 0, 1, 2, 5, 6
    numbers = [0, 1, 2, 5, 6]
    trace, _ = play([frame(n, x) for n, x in zip(numbers, path, strict=True)], 7)
    assert trace.sample.tolist() == numbers
    assert trace.report.lost_frames == 2
    assert trace.flags.tolist() == [0, 0, 0, BRIDGED, 0]
    whole = spring_force(np.arange(7) * 100e-6)  # as if nothing were lost: the true path is straight
    np.testing.assert_allclose(trace.asked_force[:, 0], whole[numbers], rtol=1e-9)


def test_lost_positions_do_not_shift_a_periodic_excitation() -> None:
    forces, numbers = np.array([0.5, -0.25, 0.125]), [0, 1, 4, 5, 7]
    with scripted([frame(n, 0) for n in numbers]) as (scene, _):
        trace = run(scene, duration=8 / RATE, excitation=PeriodicExcitation(0, forces))
    assert trace.sample.tolist() == numbers
    np.testing.assert_allclose(trace.force[:, 0], forces[[n % 3 for n in numbers]], rtol=0, atol=1e-12)


def test_the_first_position_may_be_the_one_that_is_lost() -> None:
    trace, _ = play([frame(3, 50), frame(4, 50)], 2)
    assert trace.sample.tolist() == [3, 4]
    assert trace.report.lost_frames == 0
    np.testing.assert_allclose(trace.asked_force[:, 0], -K * 50e-6, rtol=1e-12)


def test_a_corrupted_position_is_counted_and_taken_for_lost() -> None:
    torn = bytearray(frame(1, 100))
    torn[4] ^= 0x10
    script = [frame(0, 0), bytes(torn) + frame(2, 200), frame(3, 300)]
    trace, _ = play(script, 4)
    assert trace.report.crc_errors == 1
    assert trace.report.lost_frames == 1
    assert trace.sample.tolist() == [0, 2, 3]


@pytest.mark.parametrize(
    "garbage", [b"\x00", b"\x00\x00\x00", b"boot: ok\r\n\x00", b"\xff" * 300 + b"\x00", b"\x01\x02\x00" * 7]
)
def test_garbage_between_positions_loses_none(garbage: bytes) -> None:
    trace, _ = play([garbage + frame(n, n) + garbage for n in range(6)], 6)
    assert trace.sample.tolist() == list(range(6))
    assert trace.report.lost_frames == 0


def test_of_several_positions_the_newest_is_answered_and_the_others_are_counted() -> None:
    script = [frame(0, 0), frame(1, 100) + frame(2, 200) + frame(3, 300), frame(4, 400)]
    trace, device = play(script, 5)
    assert [heard.number for heard in device.forces] == [0, 3, 4]
    assert trace.report.stale_positions == 2
    assert trace.flags.tolist() == [0, UNSENT, UNSENT, 0, 0]
    # The scene moved by every one of them: its velocities are the true ones.
    np.testing.assert_allclose(trace.asked_force[:, 0], spring_force(np.arange(5) * 100e-6), rtol=1e-9)


def test_a_position_that_comes_twice_moves_the_scene_once() -> None:
    script = [frame(0, 0), frame(1, 100) + frame(1, 100), frame(2, 200), frame(2, 200) + frame(3, 300)]
    trace, _ = play(script, 4)
    assert trace.sample.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(trace.asked_force[:, 0], spring_force(np.arange(4) * 100e-6), rtol=1e-9)
    assert trace.report.stale_positions == 2
    assert trace.report.lost_frames == 0


def test_a_position_older_than_the_last_is_passed_over_and_counted() -> None:
    script = [frame(0, 0), frame(2, 200) + frame(1, 100), frame(3, 300), frame(4, 400)]
    trace, _ = play(script, 5)
    assert trace.sample.tolist() == [0, 2, 3, 4]
    assert trace.report.lost_frames == 1
    assert trace.report.stale_positions == 1
    np.testing.assert_allclose(trace.asked_force[:, 0], spring_force(np.arange(5) * 100e-6)[[0, 2, 3, 4]], rtol=1e-9)


def test_numbers_wrap_at_twelve_bits_with_losses_across_the_wrap() -> None:
    numbers = [*range(4000, 4094), 4097, *range(4098, 4120)]
    trace, device = play([frame(n, n) for n in numbers], len(numbers) + 3)
    assert trace.sample.tolist() == numbers
    assert trace.report.lost_frames == 3
    assert [heard.number for heard in device.forces] == [n % 4096 for n in numbers]


def test_what_the_device_held_is_counted_as_late_and_ages_the_force() -> None:
    kinds = [schema.POSITION] * 2 + [schema.POSITION_HELD] * 3 + [schema.POSITION]
    trace, _ = play([frame(n, 0, kind=kind) for n, kind in enumerate(kinds)], 6)
    assert trace.report.deadline_misses == 3
    assert trace.report.age_samples.max == 4
    assert trace.flags.tolist() == [0, 0, LATE_FORCE, LATE_FORCE, LATE_FORCE, 0]


def test_where_every_force_is_late_none_is_reported_older_than_one_can_act() -> None:
    kinds = [schema.POSITION] + [schema.POSITION_HELD] * 60
    trace, device = play([frame(n, 0, kind=kind) for n, kind in enumerate(kinds)], 61)
    assert trace.report.deadline_misses == 60
    assert trace.report.age_samples.max == device.forces[0].argument + 2


def test_a_frame_that_is_no_position_moves_nothing() -> None:
    stray = frame_to_host(armed_format(1), schema.DESCRIPTION, 7, [123456])
    trace, _ = play([frame(0, 0), stray + frame(1, 10), frame(2, 20)], 3)
    assert trace.position_counts[:, 0].tolist() == [0, 10, 20]
    assert trace.sample.tolist() == [0, 1, 2]


def test_a_frame_that_arrives_in_two_pieces_is_read() -> None:
    """The line may tear a frame anywhere: each piece here ends within the next frame."""
    frames = b"".join(frame(n, n) for n in range(8))
    length = len(frames) // 8
    cuts = [0, *(length * n + n for n in range(1, 8)), len(frames)]
    trace, _ = play([frames[start:stop] for start, stop in pairwise(cuts)], 8)
    assert trace.sample.tolist() == list(range(8))


@pytest.mark.parametrize("babble", [b"boot 1.0 ready\r\n", b"\x00", b"\x07\x00"])
def test_a_device_that_babbles_instead_of_positions_is_silent_to_the_loop(babble: bytes) -> None:
    """Bytes without end must not hold the loop: it ends, and the force is zero."""
    import threading

    scene = scene_of(device={"clock": "device"})
    with scripted([frame(0, 0), frame(1, 0)], scene=scene) as (there, device):
        over = threading.Event()

        def talk() -> None:
            while not over.wait(0.0005):
                if len(device.forces) >= 2:
                    device.write(babble)

        talker = threading.Thread(target=talk)
        talker.start()
        try:
            with pytest.raises(DeviceError, match=r"silent for|no usable position came") as caught:
                run(there, duration=10.0)
        finally:
            over.set()
            talker.join()
    assert caught.value.trace.report.ticks == 2
