"""Made-up machines, histograms and runs: what a doctor says is tested without waiting for a clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.loop.histogram import HISTOGRAM, Histogram, histogram_of
from hapsim.system_files import SystemFiles


def counted(values: dict[float, int]) -> Histogram:
    """A histogram of durations in s, by how often each came."""
    record = new_record(HISTOGRAM)
    empty = histogram_of(record, 1e-9)
    for value, times in values.items():
        record.counts[np.searchsorted(empty.edges, value, side="right") - 1] += times
        record.maximum = max(int(record.maximum), round(value * 1e9))
    return histogram_of(record, 1e-9)


@pytest.fixture
def histogram() -> Callable[[dict[float, int]], Histogram]:
    return counted


@dataclass(frozen=True)
class Report:
    """Fields of a report that the doctor reads."""

    ticks: int = 1000
    deadline_misses: int = 0
    lost_frames: int = 0
    duration_s: float = 0.999
    nominal_rate_hz: float = 1000.0

    @property
    def rate_hz(self) -> float:
        return (self.ticks - 1) / self.duration_s


@pytest.fixture
def report() -> Callable[..., Any]:
    return Report


@pytest.fixture
def fake_run() -> Callable[..., Any]:
    """Stands for hapsim.run: keeps every rate, the faster the more is late; notes what it was asked to run."""

    class Fake:
        def __init__(self) -> None:
            self.scenes: list[Any] = []
            self.options: list[dict[str, Any]] = []
            self.error: Exception | None = None

        def __call__(self, scene: Any, **options: Any) -> Any:
            self.scenes.append(scene)
            self.options.append(options)
            if self.error is not None:
                raise self.error
            late = {1000.0: 0, 2000.0: 1}.get(scene.rate, 300)
            report = Report(deadline_misses=late, duration_s=999 / scene.rate, nominal_rate_hz=scene.rate)
            times = counted({20e-6: 990, 80e-6: 9, 3e-3: 1})
            return SimpleNamespace(report=report, statistics=SimpleNamespace(lateness=times, exchange=times))

    return Fake


@pytest.fixture
def tree(tmp_path: Path) -> Callable[..., SystemFiles]:
    """A system made of the files given, by their paths with a slash before; without any, it says nothing of itself."""

    def make(files: dict[str, str] | None = None) -> SystemFiles:
        root = tmp_path / "root"
        root.mkdir(exist_ok=True)
        for path, text in (files or {}).items():
            file = root / path.lstrip("/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        return SystemFiles(root)

    return make
