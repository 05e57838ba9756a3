"""The ring between the loop and the readers of its sound: whole samples, in order, and lost frames are counted."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.loop.sound import SOUND_RING, SoundRing, add_frame, publish, push

CHANNELS, CAPACITY = 2, 8


@entry
def push_frame(ring, left, right):
    push(ring, (left, right))


@entry
def publish_frames(ring, time_ns):
    publish(ring, time_ns)


@pytest.fixture
def ring() -> SoundRing:
    return SoundRing(new_record(SOUND_RING), CHANNELS, CAPACITY)


def push_numbers(ring: SoundRing, first: int, count: int) -> None:
    for number in range(first, first + count):
        push_frame(ring.record, float(number), -float(number))


def test_a_reader_sees_the_frames_of_a_sample_together_with_its_time(ring: SoundRing) -> None:
    push_numbers(ring, 0, 3)
    assert ring.record.written == 0
    assert ring.drain().shape == (0, CHANNELS)
    publish_frames(ring.record, 77)
    assert (ring.record.written, ring.record.time_ns, ring.record.version % 2) == (3, 77, 0)
    assert ring.drain().tolist() == [[0, 0], [1, -1], [2, -2]]
    publish_frames(ring.record, 99)
    assert ring.record.time_ns == 77  # no frame is newer


def test_a_scene_that_diverges_leaves_numbers(ring: SoundRing) -> None:
    """A high-pass adds what is finite to more than a number holds."""
    add = ctypes.CFUNCTYPE(None, *[ctypes.c_uint64] * 3, ctypes.c_double)(add_frame.address())
    ring.record.keeps[:CHANNELS] = 0.999
    for value in (1.7e308, -1.7e308, -1.7e308, np.inf, np.nan, 0.0):
        heard = np.array([value, 0.0])
        add(ring.record.address, heard.ctypes.data, 0, 0.0)
    publish_frames(ring.record, 0)
    assert np.isfinite(ring.drain()).all()
    assert np.isfinite(ring.record.peak).all()


def test_frames_come_in_order_across_the_end_of_the_ring(ring: SoundRing) -> None:
    taken = []
    for first in range(0, 60, 6):
        push_numbers(ring, first, 6)
        publish_frames(ring.record, first)
        taken.append(ring.drain())
    assert np.concatenate(taken)[:, 0].tolist() == list(range(60))
    assert ring.lost == 0


def test_a_late_reader_goes_on_with_the_newest_frames_and_counts_the_others(ring: SoundRing) -> None:
    push_numbers(ring, 0, 20)
    publish_frames(ring.record, 0)
    # The oldest place is the one that the loop writes next.
    assert ring.drain()[:, 0].tolist() == list(range(13, 20))
    assert ring.lost == 13
