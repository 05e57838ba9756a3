"""A run in numbers, and how files hold them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from hapsim.loop.counts import Counts
from hapsim.loop.histogram import Histogram, Spread
from hapsim.units import Motion, Units

NO_RECORD = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""Exceptions that reading a foreign or damaged document raises."""

NOT_FINISHED = "not finished"
"""How the `ending` begins of a record that does not say how its run ended."""


@dataclass(frozen=True)
class Report(Counts):
    """A run in numbers."""

    ending: str
    """Why it ended: done, stopped, …"""
    duration_s: float
    """From the first position to the last: by the clock on the wall, or in virtual time."""
    rate_hz: float
    """Positions per second of that duration."""
    nominal_rate_hz: float
    """What the scene asks for."""
    lateness_s: Spread
    """With the host's clock: of the loop's wake-up, after the tick was due. With the device's: of its position, after
    the earliest recent arrivals, by its own count of samples. Nothing in virtual time."""
    exchange_s: Spread
    """From a position's arrival until its force has left; with the host's clock, from waking up for the tick until the
    position has arrived, the force sent in between."""
    age_samples: Spread
    """From the position that the acting force answers to the force's change: 1 in time; for a late force an upper
    bound, since the device reports no more. No force acts for longer than its time to live and one sample more; that
    the force may be zero already counts as two more."""
    virtual_time: bool
    rejected_by_device: int | None = None
    """Frames of the host that the device rejected since it was armed (register 9); if it stopped by itself, the last
    one, which disarms, is among them. None if it did not say."""
    released: bool | None = None
    """Whether the device confirmed, after the last force, that it released it; None if the record does not tell."""
    timed_by_device: bool = False
    """Whether a timer of the device's own paced the positions: then their arrival shows its rate."""
    motion: tuple[Motion, ...] = ()
    """Of each channel; () in a record of an earlier version: linear."""
    in_degrees: bool = False
    """Whether the scene writes angles in degrees: people read them so."""

    def units_of(self, channel: int | None = None) -> Units:
        """Returns the units of a channel; None: of all together."""
        return Units.of(self.motion if channel is None else self.motion[channel : channel + 1], self.in_degrees)

    @property
    def knows_ticks(self) -> bool:
        """Whether `ticks` are the run's, and not just those that could be read of its record."""
        return not self.ending.startswith(NOT_FINISHED)


@dataclass(frozen=True)
class Statistics:
    """The histograms whose quantiles a report has: s, s and samples."""

    lateness: Histogram
    exchange: Histogram
    age: Histogram


@dataclass(frozen=True)
class _Sparse:
    """A histogram in a file: the bins in which there is a count, and the counts."""

    unit: float
    maximum: float
    bins: Annotated[int, Field(ge=1, le=1 << 16)]
    counted: tuple[list[int], list[int]]


_adapter = cache(TypeAdapter)


def validated(kind: Any, value: Any) -> Any:
    """Returns what JSON made of a `kind` as one again. ValueError, in one line, where it is none."""
    try:
        return _adapter(kind).validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            raise ValueError(f"found no {where}, expected one") from error
        raise ValueError(f"{where}: found {first['input']!r:.40}: {first['msg']}") from error


def report_from(values: dict[str, Any]) -> Report:
    """What `asdict` made of a report, after JSON. ValueError where it is none."""
    report: Report = validated(Report, values)
    return report


def summary_document(report: Report, statistics: Statistics, finished: bool) -> dict[str, Any]:
    """What a stream holds of a run beside its rows, for JSON: of each histogram the bins in which there is a count."""
    return {
        "finished": finished,
        "report": asdict(report),
        "histograms": {name: _sparse(histogram) for name, histogram in vars(statistics).items()},
    }


def read_summary(document: dict[str, Any]) -> tuple[Report, Statistics]:
    """What `summary_document` made a document of. An error of `NO_RECORD` where it is none."""
    histograms = {name: _whole(one) for name, one in document["histograms"].items()}
    return report_from(document["report"]), Statistics(**histograms)


def _sparse(histogram: Histogram) -> dict[str, Any]:
    bins = np.flatnonzero(histogram.counts)
    counted = [bins.tolist(), histogram.counts[bins].tolist()]
    return {"unit": histogram.unit, "maximum": histogram.maximum, "bins": histogram.counts.size, "counted": counted}


def _whole(sparse: dict[str, Any]) -> Histogram:
    found: _Sparse = validated(_Sparse, sparse)
    counts = np.zeros(found.bins, np.int64)
    bins, counted = found.counted
    counts[np.array(bins, np.int64)] = counted
    return Histogram(counts, found.maximum, found.unit)
