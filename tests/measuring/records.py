"""Records made from arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from firmware_protocol.compiled import new_record
from hapsim.loop.histogram import HISTOGRAM, histogram_of
from hapsim.recording.trace import Report, Statistics, Trace

QUANTUM = 1e-9


def trace_of(position: np.ndarray, asked: np.ndarray, rate: float = 1000.0) -> Trace:
    """A trace of one channel, rounded to counts of a nanometre; every force as asked."""
    n = position.size
    nothing = histogram_of(new_record(HISTOGRAM))
    statistics = Statistics(nothing, nothing, nothing)
    spreads = (nothing.spread(),) * 3
    report = Report("done", n / rate, rate, rate, *spreads, virtual_time=True, ticks=n)
    force_scale = 1e-8
    counts = np.rint(position / QUANTUM).astype(np.int32)[:, None]
    return Trace(
        rate=rate,
        sample=np.arange(n),
        time_ns=np.arange(n),
        flags=np.zeros(n, np.uint8),
        position_counts=counts,
        force_counts=np.rint(asked / force_scale).astype(np.int32)[:, None],
        asked_force=asked[:, None],
        position_scale=np.array([QUANTUM]),
        force_scale=np.array([force_scale]),
        statistics=statistics,
        report=report,
    )


def held_by_a_hand(hand_kg: float, stiffness: float, damping: float, noise: float = 0.0) -> Trace:
    """A handle of 0.2 kg with 1 N·s/m on a simulated spring of 2000 N/m and damper of 5 N·s/m, a sample late, and a
    hand that holds it by a spring and damper: flicked, and after a second pushed to one side and the other."""
    n, rate, mass, push = 2048, 1000.0, 0.2, 2.5
    moving = np.zeros((5, 5))
    moving[0, 1] = moving[2, 3] = 1.0
    moving[1] = [-stiffness / mass, -(1.0 + damping) / mass, stiffness / mass, damping / mass, 1.0 / mass]
    moving[3, :4] = np.array([stiffness, damping, -stiffness, -damping]) / hand_kg
    step = expm(moving / rate)
    state, rng = np.array([0.0, 0.1, 0.0, 0.0, 0.0]), np.random.default_rng(7)
    position, asked, force = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        position[i] = np.rint((state[0] + noise * rng.normal()) / QUANTUM) * QUANTUM
        asked[i] = -2000.0 * position[i] - 5.0 * rate * (position[i] - (position[i - 1] if i else 0.0))
        turn, within = divmod(i - n // 2, 32)
        force[i] = asked[i] + (push * (-1.0) ** turn if turn >= 0 and within < 8 else 0.0)
        state[4] = force[i - 1] if i else 0.0
        state = step @ state
    trace = trace_of(position, asked)
    return replace(trace, force_counts=np.rint(force / trace.force_scale).astype(np.int32)[:, None])
