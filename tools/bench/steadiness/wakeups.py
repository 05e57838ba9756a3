"""The wake-up latency of a program that sleeps on a grid: the compiled loop's own sleep, the C loop's, cyclictest's."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

from steadiness.processes import PeerError, answer_of, json_of, python

PRIORITY = 50  # of SCHED_FIFO, for every peer
_LONGEST_US = 200_000  # cyclictest counts what is longer, and does not tell how long it was

Quantiles = dict[str, float | None]


def compiled_lateness(rate_hz: int, seconds: float, fifo: bool, cpu: int) -> Quantiles:
    """Returns the wake-up latency of hapsim's own sleep, in a process of its own."""
    job = {"do": "wakeups", "rate_hz": rate_hz, "seconds": seconds, "priority": PRIORITY if fifo else 0, "cpu": cpu}
    return _in_us(json_of(python(job), seconds))


def c_lateness(program: Path, rate_hz: int, seconds: float, fifo: bool, cpu: int) -> Quantiles:
    """Returns the wake-up latency of the C loop's sleep."""
    options = ["--fifo", str(PRIORITY)] if fifo else []
    return _in_us(json_of([str(program), *options, "sleep", str(rate_hz), str(seconds)], seconds, cpus={cpu}))


def cyclictest_lateness(rate_hz: int, seconds: float, fifo: bool, cpu: int, directory: Path) -> Quantiles:
    """Returns the wake-up latency that cyclictest reports, in whole µs. A bin counts as its upper end, as for the
    others.

    Its options give it the conditions of its peers: it sleeps to an absolute time of the monotonic clock, holds
    /dev/cpu_dma_latency at 0, keeps its thread on one processor and locks no memory.
    """
    file = directory / "cyclictest.json"
    # It takes whole seconds only; so many wake-ups are as long as the time.
    command = ["cyclictest", "-q", "-t", "1", "-a", str(cpu), "-i", str(round(1e6 / rate_hz))]
    command += ["-l", str(round(rate_hz * seconds)), "-h", str(_LONGEST_US), f"--json={file}"]
    command += ["-p", str(PRIORITY)] if fifo else ["--policy=other"]
    answer_of(command, seconds)
    thread = json.loads(file.read_text(encoding="utf-8"))["thread"]["0"]
    if not thread["cycles"]:
        raise PeerError("cyclictest: it reports no wake-up")
    counts = {int(us): count for us, count in thread["histogram"].items()}
    return {f"p{share * 100:g}_us": _quantile(counts, share, thread) for share in (0.5, 0.99)} | {
        "max_us": float(thread["max"])
    }


def has_cyclictest() -> bool:
    """Returns whether cyclictest is installed."""
    return shutil.which("cyclictest") is not None


def sleep_here(rate_hz: int, seconds: float, priority: int, cpu: int) -> dict[str, Any]:
    """The compiled loop's sleep, in this process."""
    from hapsim.doctor.exchanges import wake_up_latency

    wake_up_latency(1000.0, 0.01)  # compiles
    everywhere = os.sched_getaffinity(0)
    # The thread that sleeps is made by this one, and is as this one is.
    os.sched_setaffinity(0, {cpu})
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))

    def step_aside(_elapsed: float, _name: str) -> None:
        """This thread only looks on, and shall not hold the other one up."""
        os.sched_setaffinity(0, everywhere)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

    spread = wake_up_latency(float(rate_hz), seconds, step_aside).spread()
    quantiles = {"p50": spread.p50, "p99": spread.p99, "max": spread.max}
    return {"lateness_ns": {name: 1e9 * (value or 0.0) for name, value in quantiles.items()}}


def _in_us(document: dict[str, Any]) -> Quantiles:
    lateness = document["lateness_ns"]
    return {f"{name}_us": 1e-3 * lateness[name] for name in ("p50", "p99", "max")}


def _quantile(counts: dict[int, int], share: float, thread: dict[str, Any]) -> float:
    needed, so_far = share * thread["cycles"], 0
    for us in sorted(counts):
        so_far += counts[us]
        if so_far >= needed:
            return float(min(us + 1, thread["max"]))
    return float(thread["max"])
