"""A run in numbers, and how files hold them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from hapsim.loop.counts import Counts
from hapsim.loop.histogram import Histogram, Spread
from hapsim.units import Motion, Units, Written

NO_RECORD = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""Exceptions that reading a foreign or damaged document raises."""

NOT_FINISHED = "not finished"
"""First words of the `ending` of a record whose run did not finish it."""


@dataclass(frozen=True)
class Report(Counts):
    """A run in numbers."""

    ending: str
    """Cause of the end: done, stopped, …"""
    duration_s: float
    """Time from the first position to the last, s: wall-clock or virtual time."""
    rate_hz: float
    """Positions per second of that duration."""
    nominal_rate_hz: float
    """Rate of the scene."""
    lateness_s: Spread
    """Lateness, s. Host's clock: of the loop's wake-up, after the tick was due. Device's clock: of a position, relative
    to the earliest recent arrivals, by the device's sample numbers. Empty in virtual time."""
    exchange_s: Spread
    """Time of an exchange, s: from a position's arrival until its force has left. With the host's clock: from the
    wake-up for the tick, through sending the force, to the arrival of the position."""
    age_samples: Spread
    """Age of the acting force, samples: from its position to the force's change; 1 if in time. For a late force it is
    an upper bound, because the device reports no more. A force acts for its time to live and one sample at most; one
    that may be zero already counts as two more."""
    virtual_time: bool
    rejected_by_device: int | None = None
    """Frames of the host that the device rejected since it was armed (register 9); if it stopped by itself, the last
    one, which disarms, is among them. None if it did not say."""
    released: bool | None = None
    """True if the device confirmed that it released the last force; None if unknown."""
    beyond_limit: str = ""
    """Sentence about a hand on which the scene asked for far more than the force limit when the run ended."""
    timed_by_device: bool = False
    """True if the device's own timer paced the positions: their arrival then shows its rate."""
    motion: tuple[Motion, ...] = ()
    """Kind of each channel's motion; () in a record of an earlier version: linear."""
    written: tuple[Written, ...] = ()
    """Units of the scene's file other than SI units: reports show them."""
    in_plane: tuple[tuple[int, int], ...] = ()
    """Channels of x and y of each hand, in a scene with space: 2."""

    def units_of(self, channel: int | None = None) -> Units:
        """Returns the units of a channel; None: of all together."""
        return Units.of(self.motion if channel is None else self.motion[channel : channel + 1], self.written)

    @property
    def knows_ticks(self) -> bool:
        """True if `ticks` counts the whole run, not only the readable part of its record."""
        return not self.ending.startswith(NOT_FINISHED)


@dataclass(frozen=True)
class Statistics:
    """The histograms whose quantiles a report has: s, s and samples."""

    lateness: Histogram
    exchange: Histogram
    age: Histogram


@dataclass(frozen=True)
class _Sparse:
    """A histogram in a file: the bins with counts, and the counts."""

    unit: float
    maximum: float
    bins: Annotated[int, Field(ge=1, le=1 << 16)]
    counted: tuple[list[int], list[int]]


_adapter = cache(TypeAdapter)


def validated(kind: Any, value: Any) -> Any:
    """Returns a `kind` from its JSON value. Raises ValueError, in one line, if it is none."""
    try:
        return _adapter(kind).validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            raise ValueError(f"found no {where}, expected one") from error
        raise ValueError(f"{where}: found {first['input']!r:.40}: {first['msg']}") from error


def report_from(values: dict[str, Any]) -> Report:
    """Returns the report from its JSON object. Raises ValueError if it is none."""
    report: Report = validated(Report, values)
    return report


def summary_document(report: Report, statistics: Statistics, finished: bool) -> dict[str, Any]:
    """Returns the summary of a run in a stream, for JSON: report and histograms (only bins with counts)."""
    return {
        "finished": finished,
        "report": asdict(report),
        "histograms": {name: _sparse(histogram) for name, histogram in vars(statistics).items()},
    }


def read_summary(document: dict[str, Any]) -> tuple[Report, Statistics]:
    """Returns report and histograms of a summary. Raises an error of `NO_RECORD` if it is none."""
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
