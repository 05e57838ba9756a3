"""The peers at hand, and how each is asked to do something, under the same conditions."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from steadiness.machine import share_out_processors
from steadiness.mock import scene_with_clock
from steadiness.processes import PeerError, end, json_of, python, running
from steadiness.record import COMPILED, CYCLICTEST, NO_LOAD, PORTABLE, C
from steadiness.wakeups import Quantiles, c_lateness, compiled_lateness, cyclictest_lateness, has_cyclictest

_COMPILING_S = 240.0
_READY_S = 60.0


@dataclass
class Bench:
    """Directories and participants of a bench."""

    directory: Path
    """Temporary directory of the bench."""
    program: Path | None
    """The C loop."""
    without: dict[str, str] = field(default_factory=dict)
    """Peer -> why it does not take part."""

    def __post_init__(self) -> None:
        self.device_cpus, self.loop_cpus = share_out_processors()
        self.cpu = max(self.loop_cpus)  # that of the sleeper; the first one has the interrupts
        self.scenes = {clock: scene_with_clock(clock, self.directory) for clock in ("lockstep", "device")}
        # numba keeps the type of every port that a loop was compiled for; hapsim could not load the in-memory port's.
        self._cache = {"XDG_CACHE_HOME": str(self.directory / "cache")}
        if not has_cyclictest():
            self.without[CYCLICTEST] = "cyclictest is not installed (Debian: apt install rt-tests): it is not measured."

    def log(self, what: str) -> None:
        """A sign of life."""
        print(what, file=sys.stderr, flush=True)

    def leave_out(self, peer: str, why: str) -> None:
        """Excludes a peer from now on."""
        self.without[peer] = why
        self.log(why)

    def peers(self, *wanted: str) -> list[str]:
        """Returns the peers that take part."""
        return [peer for peer in wanted if peer not in self.without]

    def compute(self, peer: str, exchanges: int, amplitude: float = 0.004) -> dict[str, Any]:
        """So many exchanges in memory."""
        if peer == C:
            return json_of([str(self.program), "--amplitude", str(amplitude), "compute", str(exchanges)], _COMPILING_S)
        job = {"do": "compute", "exchanges": exchanges, "amplitude": amplitude}
        return json_of(python(job), _COMPILING_S, environment=self._cache)

    def run(self, peer: str, clock: str, port: str, load: str, ticks: int = 0, seconds: float = 0.0) -> dict[str, Any]:
        """Against a device, beside a load: for hapsim's loops in their own process, for the C loop in another one."""
        if peer == C:
            limit = ["--seconds", str(seconds)] if seconds else []
            with self._external_load(load) as summary:
                command = [str(self.program), *limit, "port", port, str(ticks), clock]
                document = json_of(command, seconds + _COMPILING_S, cpus=self.loop_cpus)
            return document | summary
        job = {"do": "run", "scene": str(self.scenes[clock]), "port": port, "load": load, "portable": peer == PORTABLE}
        command = python(job | {"ticks": ticks, "seconds": seconds})
        return json_of(command, seconds + _COMPILING_S, cpus=self.loop_cpus)

    def lateness(self, peer: str, rate_hz: int, seconds: float, fifo: bool) -> Quantiles:
        """Returns the quantiles of wake-up latency."""
        if peer == C:
            assert self.program is not None
            return c_lateness(self.program, rate_hz, seconds, fifo, self.cpu)
        if peer == COMPILED:
            return compiled_lateness(rate_hz, seconds, fifo, self.cpu)
        return cyclictest_lateness(rate_hz, seconds, fifo, self.cpu, self.directory)

    @contextlib.contextmanager
    def _external_load(self, load: str) -> Iterator[dict[str, Any]]:
        """A load in a process of its own; its summary is filled in when the block is left."""
        summary: dict[str, Any] = {}
        if load == NO_LOAD:
            yield summary
            return
        with running(python({"do": "load", "kind": load}), cpus=self.loop_cpus) as process:
            assert process.stdout is not None
            if process.stdout.readline().strip() != "ready":
                raise PeerError(f"the load did not begin: {end(process)[1]}")
            yield summary
            summary.update(json.loads(end(process)[0].strip().splitlines()[-1]))


def numbers_of(document: dict[str, Any]) -> dict[str, float | None]:
    """Returns the numbers that a loop reports of a run against a device, by the records' names."""
    exchange, age = document["exchange_ns"] or {}, document["age_samples"] or {}
    names = ("exchanges_per_second", "ticks", "late", "lost", "stale", "load_turns", "load_turn_ms")
    numbers: dict[str, float | None] = {name: document.get(name) for name in names}
    numbers |= {f"exchange_{name}_us": 1e-3 * exchange[name] if exchange else None for name in ("p50", "p99", "max")}
    numbers["late_percent"] = 100.0 * document["late"] / max(document["ticks"], 1)
    numbers["oldest_force_samples"] = age.get("max")
    numbers["ended_early"] = float(document["ending"] not in ("done", "stopped"))
    return numbers
