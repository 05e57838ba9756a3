"""What became of a run whose device came and went: one report of all its sessions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from hapsim.errors import HapsimError
from hapsim.loop.histogram import Histogram
from hapsim.recording.trace import Report, Statistics

_SUMMED = (
    "ticks",
    "duration_s",
    "deadline_misses",
    "lost_frames",
    "crc_errors",
    "stale_positions",
    "limited_ticks",
    "slewed_ticks",
    "faded_ticks",
    "slowed_ticks",
    "withheld_forces",
    "sign_tests",
    "unrecorded_rows",
    "dropped_rows",
    "parameter_changes",
    "garbage_bytes",
)


class Run(NamedTuple):
    """What is kept of one session, from arming to disarming."""

    report: Report
    statistics: Statistics


@dataclass(frozen=True)
class Interruption:
    """The device was lost, and waited for."""

    why: str
    """What happened, in a sentence."""
    at: str
    """When it was noticed: UTC, ISO 8601."""
    waited_s: float
    came_back: bool = True


@dataclass(frozen=True)
class Lifetime:
    """A run from the first arming to the end."""

    report: Report
    """Of all sessions: counts and durations together, quantiles of every tick; how it ended is the last one's."""
    failure: HapsimError | None
    """Why it did not end as asked."""
    interruptions: tuple[Interruption, ...]
    records: tuple[Path, ...] = ()
    """Where its sessions were recorded, of those that were."""

    @property
    def reconnections(self) -> int:
        """How many times the device came back."""
        return sum(one.came_back for one in self.interruptions)


def lifetime_of(
    runs: Sequence[Run],
    failure: HapsimError | None,
    interruptions: Sequence[Interruption] = (),
    records: Sequence[Path] = (),
) -> Lifetime:
    """Of one session or more."""
    return Lifetime(_together(runs), failure, tuple(interruptions), tuple(records))


def _together(runs: Sequence[Run]) -> Report:
    last = runs[-1].report
    if len(runs) == 1:
        return last
    reports = [run.report for run in runs]
    summed = {name: sum(getattr(report, name) for report in reports) for name in _SUMMED}
    samples = sum(report.rate_hz * report.duration_s for report in reports)
    rejected = [report.rejected_by_device for report in reports if report.rejected_by_device is not None]
    return replace(
        last,
        **summed,
        rate_hz=samples / summed["duration_s"] if summed["duration_s"] > 0 else 0.0,
        rejected_by_device=sum(rejected) if rejected else None,
        lateness_s=_sum([run.statistics.lateness for run in runs]).spread(),
        exchange_s=_sum([run.statistics.exchange for run in runs]).spread(),
        age_samples=_sum([run.statistics.age for run in runs]).spread(),
    )


def _sum(histograms: Sequence[Histogram]) -> Histogram:
    counts = sum(one.counts for one in histograms)
    return Histogram(counts, max(one.maximum for one in histograms), histograms[0].unit)  # type: ignore[arg-type]
