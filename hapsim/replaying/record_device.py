"""A record as a device on a pseudo-terminal: `hapsim replay --device`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from hapsim.device.mock.recorded import RecordedDevice
from hapsim.errors import UsageError
from hapsim.loop.ring import VELOCITY
from hapsim.recording.stream import StreamReader, open_record, reading
from hapsim.running.recorded_run import read_run
from hapsim.scene import parse_scene


def device_of(path: Path) -> RecordedDevice:
    """Returns the device of a record: it describes itself as the recorded one did, and sends the positions that it
    sent, at its rate. UsageError where the record does not have that."""
    with reading(path):
        return _device_of(path, open_record(path))


def _device_of(path: Path, reader: StreamReader) -> RecordedDevice:
    run, report = reader.head.run, reader.summary["report"]
    if run is None:
        raise UsageError(f"{path}: an older hapsim recorded it, without its device: it cannot be served")
    samples, time_ns = (np.concatenate([piece[name] for piece in reader.rows()]) for name in ("sample", "time_ns"))
    has_velocity = VELOCITY in (reader.head.rows.names or ())
    words = ["position_counts", *[VELOCITY] * has_velocity]
    counts = np.concatenate([np.hstack([piece[name] for name in words]) for piece in reader.rows()])
    description = read_run(run, reader.head.channels).description
    scene = parse_scene(json.dumps(run["scene"]), str(path))
    for c, origin in enumerate(scene.device.origins(scene.channels)):  # rows count from there
        counts[:, c] += round((origin or 0.0) / description.position_scale[c])
    if not has_velocity:
        description = replace(description, velocity_scale=())
    samples -= samples[0] if run["first_tick"] else 0
    period = 1.0 / description.rate_hz
    if report["timed_by_device"] and len(samples) > 1:
        period = 1e-9 * float(time_ns[-1] - time_ns[0]) / float(samples[-1] - samples[0])
    return RecordedDevice(description, samples, counts, period)
