"""The events and the trials of a record as tables of tabs (`events.tsv`, `trials.tsv`), with the columns of the Brain
Imaging Data Structure: onset and duration in s since the first row, `n/a` where there is no value."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.recording.stream import StreamReader
from hapsim.recording.times import Timeline
from hapsim.running.live_parameters import OUTPUTS
from hapsim.scene.varied import by_path

NAMES = ("events", "trials")
"""Endings of the names of such files, before `.tsv`."""

_NONE = "n/a"
_OF_ALL = ("onset", "duration", "trial_type", "value", "sample", "code")
_OF_TRIALS = ("onset", "duration", "trial", "sample", "settled", "restart")
_PLACES = ("tick", "sample", "over", "at", "restart")  # keys of a note that do not name what it is

Note = Mapping[str, Any]


def table_of(out: Path) -> str:
    """Returns which table the name of a file asks for: an entry of NAMES. Raises UsageError."""
    for name in NAMES:
        if out.stem.endswith(name):
            return name
    raise UsageError(f"{out}: found a .tsv of another name, expected one that ends with events.tsv or trials.tsv")


def write_table(file: Path, table: str, reader: StreamReader, timeline: Timeline) -> None:
    """Writes the table of a record that was read. OSError where it cannot be written."""
    each = [(rows["sample"], timeline.of(rows["sample"], rows["time_ns"])) for rows in reader.rows()]
    sample, time_s = (np.concatenate(one) for one in zip(*each, strict=True))
    noted = sorted(_placed(reader, sample), key=lambda one: one[0])
    rows = np.searchsorted(sample, [at for at, _ in noted]).clip(max=sample.size - 1)
    onset, end = time_s[rows].round(9).tolist(), float(time_s[-1]) + 1.0 / reader.head.rate_hz
    lines = [*(_events if table == "events" else _trials)(noted, onset, end)]
    columns = dict.fromkeys((*(_OF_ALL if table == "events" else _OF_TRIALS), *(key for line in lines for key in line)))
    with file.open("w", encoding="utf-8", newline="") as text:
        writer = csv.DictWriter(text, [*columns], restval=_NONE, delimiter="\t", lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def _placed(reader: StreamReader, sample: NDArray[np.int64]) -> Iterator[tuple[int, Note]]:
    """Yields the notes with the sample of each; in records of earlier versions only its tick is there."""
    first = int((reader.head.run or {}).get("first_tick", 0))
    for note in reader.notes:
        if "sample" in note:
            yield int(note["sample"]), note
        elif "tick" in note and note["tick"] - first < sample.size:
            yield int(sample[note["tick"] - first]), note


def _events(noted: list[tuple[int, Note]], onset: list[float], end: float) -> Iterator[dict[str, Any]]:
    for (sample, note), at, lasts in zip(noted, onset, _durations(noted, onset, end), strict=True):
        kind = next(key for key in note if key not in _PLACES)
        value = note["name"] + "=" + str(note["place"]) if kind == "name" else note[kind]
        line = {"onset": at, "duration": lasts, "trial_type": "place" if kind == "name" else kind, "sample": sample}
        codes = note["set"].get(OUTPUTS, {}) if kind in ("set", "trial") else {}
        code = {"code": next(iter(codes.values())) if len(codes) == 1 else json.dumps(codes)} if codes else {}
        yield line | code | {"value": value if isinstance(value, int | str) else json.dumps(value)}


def _trials(noted: list[tuple[int, Note]], onset: list[float], end: float) -> Iterator[dict[str, Any]]:
    lines = list[dict[str, Any]]()
    for (sample, note), at, lasts in zip(noted, onset, _durations(noted, onset, end), strict=True):
        if "settled" in note and lines:
            lines[-1]["settled"] = sample
        if "trial" in note:
            own = {"onset": at, "duration": lasts, "trial": note["trial"], "sample": sample}
            restart = {"restart": " ".join(note["restart"])} if note["restart"] else {}
            lines.append(own | restart | dict(by_path(note["set"], lambda _: False)))
    return iter(lines)


def _durations(noted: list[tuple[int, Note]], onset: list[float], end: float) -> list[float]:
    """Returns how long each lasts, s: a trial until the next one or the end of the record, anything else no time."""
    lasts, following = [0.0] * len(noted), end
    for i in reversed(range(len(noted))):
        if "trial" in noted[i][1]:
            lasts[i], following = round(following - onset[i], 9), onset[i]
    return lasts
