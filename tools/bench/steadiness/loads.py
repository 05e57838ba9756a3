"""Loads on a loop's process: a Python thread that computes, or one that collects garbage."""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from steadiness.record import BUSY, GARBAGE, NO_LOAD

_OBJECTS = 400_000


@dataclass
class Load:
    """A load while it runs, and what it did."""

    stop: bool = False
    turns: int = 0
    """Collections, or thousands of multiplications."""
    seconds: float = 0.0
    """Spent in them."""
    ready: threading.Event = field(default_factory=threading.Event)
    """Everything it needs is there."""
    go: threading.Event = field(default_factory=threading.Event)

    def summary(self) -> dict[str, float]:
        """Returns the number of turns, and the duration of each in ms."""
        return {"load_turns": self.turns, "load_turn_ms": 1e3 * self.seconds / max(self.turns, 1)}


@contextlib.contextmanager
def loaded(kind: str) -> Iterator[Load]:
    """Runs a load of that kind in a thread of this process, at work from `go` to `stop`."""
    load = Load()
    thread = threading.Thread(target=_LOADS[kind], args=(load,), name=kind)
    thread.start()
    load.ready.wait()
    try:
        yield load
    finally:
        load.stop = True
        load.go.set()
        thread.join()


def serve_load(kind: str) -> dict[str, float]:
    """A process that is nothing but a load: says when it is at work, ends at SIGTERM. What it did."""
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda _number, _frame: stopping.set())
    with loaded(kind) as load:
        load.go.set()
        print("ready", flush=True)
        while not stopping.is_set():
            stopping.wait(0.05)
    return load.summary()


def _idle(load: Load) -> None:
    load.ready.set()


def _multiply(load: Load) -> None:
    x = 1.0
    load.ready.set()
    load.go.wait()
    while not load.stop:
        begin = time.perf_counter()
        for _ in range(1000):
            x = x * 1.0000001 + 1e-9
        _count(load, begin)


def _collect(load: Load) -> None:
    heap, frozen = _chain(), gc.get_freeze_count()
    load.ready.set()
    load.go.wait()
    while not load.stop:
        begin = time.perf_counter()
        gc.collect()
        _count(load, begin)
        if gc.get_freeze_count() > frozen:
            # A loop that freezes the heap has taken this one out of the collector's sight; a program goes on making
            # objects, so here are new ones.
            heap, frozen = _chain(), gc.get_freeze_count()
    del heap


def _count(load: Load, begin: float) -> None:
    load.turns += 1
    load.seconds += time.perf_counter() - begin


def _chain() -> list[list[object]]:
    """Lists that refer to each other, in no order that a cache could guess."""
    heap: list[list[object]] = [[] for _ in range(_OBJECTS)]
    for i, one in enumerate(heap):
        one.append(heap[(i * 7919) % _OBJECTS])
    return heap


_LOADS: dict[str, Callable[[Load], None]] = {NO_LOAD: _idle, BUSY: _multiply, GARBAGE: _collect}
