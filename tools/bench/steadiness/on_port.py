"""hapsim's own loop on a port, beside a load in the same process."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import hapsim
from hapsim.errors import RunError
from steadiness.loads import loaded


def run_on_port(
    scene: str, port: str, load: str, portable: bool, ticks: int = 0, seconds: float = 0.0
) -> dict[str, Any]:
    """`ticks` samples, or 0: as many as there are in so many `seconds`."""
    loaded_scene = hapsim.load_scene(Path(scene))
    device = loaded_scene.device.model_copy(update={"port": port})
    loaded_scene = loaded_scene.model_copy(update={"device": device})
    duration = ticks / loaded_scene.rate if ticks else None
    with loaded(load) as at_work:
        try:
            with hapsim.start(loaded_scene, duration=duration, portable=portable) as session:
                at_work.go.set()
                session.wait(None if ticks else seconds)
                session.stop()
                # What is measured is the loop, not how hapsim says goodbye to the device beside a load.
                at_work.stop = True
            trace = session.trace
        except RunError as error:  # the device released, or went silent: that is a result
            if error.trace is None:
                raise
            trace = error.trace
    return _result(trace) | at_work.summary()


def _result(trace: hapsim.Trace) -> dict[str, Any]:
    report = trace.report
    # The report tells of virtual time; here the clock on the wall counts.
    taken = 1e-9 * float(trace.time_ns[-1] - trace.time_ns[0]) if trace.time_ns.size > 1 else 0.0
    return {
        "ending": report.ending,
        "ticks": report.ticks,
        "seconds": taken,
        "exchanges_per_second": (trace.time_ns.size - 1) / taken if taken else 0.0,
        "late": report.deadline_misses,
        "lost": report.lost_frames,
        "stale": report.stale_positions,
        "exchange_ns": _in_ns(report.exchange_s),
        "lateness_ns": _in_ns(report.lateness_s),
        "age_samples": vars(report.age_samples),
        "forces_crc32": zlib.crc32(trace.force_counts.tobytes()),
        "positions_crc32": zlib.crc32(trace.position_counts.tobytes()),
    }


def _in_ns(spread: Any) -> dict[str, float] | None:
    if not spread.count:
        return None
    return {name: 1e9 * getattr(spread, name) for name in ("p50", "p99", "p999", "max")}
