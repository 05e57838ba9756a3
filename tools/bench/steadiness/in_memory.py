"""The compiled loop without a line: frames of a sine come from memory, answers go there. What is left is what a tick
costs. The C loop's `compute` is the same: same frames, same room for the answers, same reader.
"""

from __future__ import annotations

import math
import time
import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import hapsim
from firmware_protocol import schema
from firmware_protocol.decoder import use_format
from firmware_protocol.frames import armed_format, frame_to_host
from firmware_protocol.unsigned import copy
from hapsim.compiled import compile_for, inlined
from hapsim.device.line import Line
from hapsim.device.mock.assemble import describe_mock
from hapsim.loop import endings
from hapsim.loop.paced_by_device import run_paced_by_device
from hapsim.loop.port import transport
from hapsim.running.assemble import assemble_loop
from steadiness.mock import FIRST_TOUCH

_FRAMES = 4096
_ANSWER_BYTES = 12
_PERIODS = 63  # of the sine in all frames: no two of them are alike


class MemoryPort(NamedTuple):
    """Frames to be handed out in turn, answers in turn, and how many there were of either."""

    frames: NDArray[np.uint8]
    answers: NDArray[np.uint8]
    counts: NDArray[np.uint64]


@inlined
def _receive(port, buffer, start, timeout_ns):  # noqa: ARG001
    frame = port.frames[port.counts[0] & np.uint64(_FRAMES - 1)]
    port.counts[0] += np.uint64(1)
    copy(frame, 0, buffer, start, frame.size)
    return frame.size


@inlined
def _send(port, buffer, stop):
    answer = port.answers[port.counts[1] & np.uint64(_FRAMES - 1)]
    port.counts[1] += np.uint64(1)
    copy(buffer, 0, answer, 0, stop)
    return 0


transport(MemoryPort, _receive, _send)


def measure_in_memory(exchanges: int, amplitude: float) -> dict[str, Any]:
    """ns for each exchange, and checksums over what came and went. `amplitude`: of the motion, in m."""
    scene = hapsim.load_scene(FIRST_TOUCH)
    frames = _frames(amplitude)
    answers = np.zeros((_FRAMES, _ANSWER_BYTES), np.uint8)
    port = MemoryPort(frames, answers, np.zeros(2, np.uint64))
    line = Line(port=port, name="memory", close=lambda: None)
    loop = assemble_loop(scene, line, describe_mock(scene), None, exchanges / scene.rate)
    use_format(line.decoder, loop.wire)
    loop.control["period_ns"] = 0  # so that every position is a little late, and lateness is counted like any number
    loop.ring.cursor["waits"] = 1
    compile_for(run_paced_by_device, loop)
    begin = time.perf_counter_ns()
    while run_paced_by_device(loop) == endings.RING_FULL:
        loop.ring.cursor["tail"] = loop.ring.cursor["head"]
    taken = time.perf_counter_ns() - begin
    return {
        "exchanges": int(loop.state["ticks"]),
        "ns_per_exchange": taken / exchanges,
        "answers_crc32": zlib.crc32(answers.tobytes()),
        "frames_crc32": zlib.crc32(frames.tobytes()),
        "limited": int(loop.state["limited_ticks"]),
    }


def _frames(amplitude: float) -> NDArray[np.uint8]:
    """(frames, bytes)"""
    wire = armed_format(1)
    angles = [2.0 * math.pi * _PERIODS * i / _FRAMES for i in range(_FRAMES)]
    counts = [math.floor(amplitude * 1e9 * math.sin(angle) + 0.5) for angle in angles]
    frames = [frame_to_host(wire, schema.POSITION, i, [count]) for i, count in enumerate(counts)]
    return np.frombuffer(b"".join(frames), np.uint8).reshape(_FRAMES, -1).copy()
