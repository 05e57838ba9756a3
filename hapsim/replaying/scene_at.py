"""The scene of a record as it was at a time: `hapsim export --scene-at`."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hapsim.errors import SceneError, UsageError
from hapsim.recording.stream import open_record, reading
from hapsim.replaying.notes import KINDS, kind_of
from hapsim.running.recorded_run import read_run
from hapsim.running.saving import ALL_VALUES, all_values, whole_text
from hapsim.scene.load import parse_scene, recorded_scene


class SceneAt(NamedTuple):
    """The scene of a record at a time."""

    text: str
    changes: int
    """Changes of the scene until then."""
    is_as_written: bool
    """True if the text is that of the scene's file, with its comments and units; else it is all values in SI units."""


def scene_at(path: Path, time_s: float) -> SceneAt:
    """Returns the scene of a record with every change that began until `time_s`, in s since its first row as in the
    column `time`. Raises UsageError if the record has no scene, or no row at that time."""
    reader = open_record(path)
    if (run := reader.head.run) is None:
        raise UsageError(f"{path}: recorded by an older hapsim, without its scene")
    with reading(path):
        recorded = read_run(run, reader.head.channels)
        timeline = reader.timeline()
        times = np.concatenate([timeline.of(rows["sample"], rows["time_ns"]) for rows in reader.rows()])
        if not times[0] <= time_s <= times[-1]:
            raise UsageError(f"--scene-at: found {time_s:g} s, expected {times[0]:g} s to {times[-1]:g} s, as recorded")
        last = recorded.first_tick + int(np.searchsorted(times, time_s, side="right")) - 1
        changes = [note for note in reader.notes if note.get("tick", last + 1) <= last]
        scene = recorded_scene(recorded.scene, str(path), reader.summary["report"].get("written", ()))
        for change in changes:
            scene = KINDS[kind_of(change)].scene_after(scene, change)
    try:
        origin = parse_scene(recorded.text or "").origin
        text = whole_text(scene.read_from(None, origin), None)
    except SceneError:
        text = all_values(scene)
    return SceneAt(text, len(changes), not text.startswith(ALL_VALUES))
