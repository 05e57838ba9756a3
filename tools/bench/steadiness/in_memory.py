"""The compiled loop without a wire: frames of a sine come from memory, answers go there. What is left is what a tick
costs. The C loop's `compute` is the same: same frames, same room for the answers, same reader.
"""

from __future__ import annotations

import math
import time
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hapsim
from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.frames import armed_format, frame_to_host
from hapsim.compiling.kept import compile_for
from hapsim.compiling.native import array_at, record_at
from hapsim.device.connection import Connection
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.loop import endings
from hapsim.loop.compiled_loop import run_loop
from hapsim.loop.transport import Transport, receiver, sender
from hapsim.running.assemble_loop import assemble_loop
from hapsim.running.session_options import RunOptions
from steadiness.mock import FIRST_TOUCH

_FRAMES = 4096
_FRAME_BYTES, _ANSWER_BYTES = 11, 12
_PERIODS = 63  # of the sine in all frames: no two of them are alike

MEMORY = np.dtype(
    [
        ("frames", np.uint8, (_FRAMES, _FRAME_BYTES)),
        ("answers", np.uint8, (_FRAMES, _ANSWER_BYTES)),
        ("received", np.uint64),
        ("sent", np.uint64),
    ],
    align=True,
)
"""Frames to be handed out in turn, answers in turn, and how many there were of either."""

_memory_at, _bytes_at = record_at(MEMORY), array_at(np.uint8)


@receiver
def receive(context, buffer, room, timeout_ns):  # type: ignore[no-untyped-def]  # noqa: ARG001
    memory, buffer = _memory_at(context), _bytes_at(buffer, room)
    frame = memory.received & np.uint64(_FRAMES - 1)
    memory.received += np.uint64(1)
    for i in range(np.uint64(_FRAME_BYTES)):
        buffer[i] = memory.frames[frame, i]
    return _FRAME_BYTES


@sender
def send(context, buffer, stop):  # type: ignore[no-untyped-def]
    memory, buffer = _memory_at(context), _bytes_at(buffer, stop)
    answer = memory.sent & np.uint64(_FRAMES - 1)
    memory.sent += np.uint64(1)
    for i in range(np.uint64(stop)):
        memory.answers[answer, i] = buffer[i]
    return 0


def measure_in_memory(exchanges: int, amplitude: float) -> dict[str, Any]:
    """ns for each exchange, and checksums over what came and went. `amplitude`: of the motion, in m."""
    scene = hapsim.load_scene(FIRST_TOUCH)
    memory = new_record(MEMORY)
    memory.frames[:] = _frames(amplitude)
    connection = Connection(transport=Transport(receive, send, memory), name="memory", close=lambda: None)
    loop = assemble_loop(scene, connection, describe_mock(scene), RunOptions(duration=exchanges / scene.rate))
    connection.use_format(loop.wire)
    loop.control.period_ns = 0  # so that every position is a little late, and lateness is counted like any number
    loop.record.ring.waits = 1
    compile_for(run_loop, loop.record)
    begin = time.perf_counter_ns()
    while run_loop(loop.record) == endings.RING_FULL:
        loop.record.ring.tail = loop.record.ring.head
    taken = time.perf_counter_ns() - begin
    return {
        "exchanges": int(loop.state.ticks),
        "ns_per_exchange": taken / exchanges,
        "answers_crc32": zlib.crc32(memory.answers.tobytes()),
        "frames_crc32": zlib.crc32(memory.frames.tobytes()),
        "limited": int(loop.state.limited_ticks),
    }


def _frames(amplitude: float) -> NDArray[np.uint8]:
    """(frames, bytes)"""
    wire = armed_format(1)
    angles = [2.0 * math.pi * _PERIODS * i / _FRAMES for i in range(_FRAMES)]
    counts = [math.floor(amplitude * 1e9 * math.sin(angle) + 0.5) for angle in angles]
    frames = [frame_to_host(wire, schema.POSITION, i, [count]) for i, count in enumerate(counts)]
    return np.frombuffer(b"".join(frames), np.uint8).reshape(_FRAMES, -1).copy()
