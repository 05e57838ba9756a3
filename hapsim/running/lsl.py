"""Streams of a run for Lab Streaming Layer: its samples and its events, each with its time.

LSL's own clock is the monotonic one on Linux. It is compared all the same, so that stamps are right on every system.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hapsim.errors import UsageError
from hapsim.recording.recorder import Stream
from hapsim.recording.times import offset_of
from hapsim.scene import Scene
from hapsim.units import Units

_INSTALL = "pip install 'hapsim[lsl]'"
_EVENTS = "events"


def require_lsl() -> Any:
    """Returns the package pylsl. Raises UsageError if it, or LSL's library, is missing."""
    try:
        import pylsl
    except ImportError as error:
        raise UsageError(f"LSL: found no Python package pylsl, expected it: {_INSTALL}") from error
    except RuntimeError as error:  # a wheel without the library
        raise UsageError(
            "LSL: found pylsl without its library liblsl. Install it (conda install -c conda-forge liblsl, or a "
            "package from github.com/sccn/liblsl/releases), or name its file in PYLSL_LIB"
        ) from error
    return pylsl


class Outlets:
    """Two streams: NAME has positions and forces of all channels, "NAME events" the events as texts."""

    def __init__(self, name: str, scene: Scene, place: str, stream: Stream, warn: Callable[[str], None]) -> None:
        """Opens the streams. `place`: of the device; a receiver finds the streams again by it after a reconnection.
        `stream`: where the samples come from. `warn`: called once if they can no longer be sent."""
        lsl = require_lsl()
        offset_ns, uncertainty_ns = offset_of(lambda: round(lsl.local_clock() * 1e9))
        self._offset_ns = offset_ns if abs(offset_ns) > uncertainty_ns else 0  # it is the same clock
        self._stream: Stream | None = stream
        self._warn, self._lock = warn, threading.Lock()
        units = [Units.of([motion]) for motion in scene.device.motions(scene.channels)]
        columns = [
            (what, c, one.name(unit))
            for what, unit in (("position", "m"), ("force", "N"))
            for c, one in enumerate(units)
        ]
        samples = lsl.StreamInfo(name, "Haptics", len(columns), scene.rate, lsl.cf_double64, f"hapsim {name} {place}")
        described = samples.desc().append_child("channels")
        for what, c, unit in columns:
            channel = described.append_child("channel")
            for key, value in (("label", f"{what}_{c}"), ("unit", unit), ("type", what)):
                channel.append_child_value(key, value)
        events = lsl.StreamInfo(
            f"{name} {_EVENTS}", "Markers", 1, 0.0, lsl.cf_string, f"hapsim {name} {place} {_EVENTS}"
        )
        self._samples, self._events = lsl.StreamOutlet(samples), lsl.StreamOutlet(events)

    def send_samples(self) -> None:
        """Sends the samples since the last call, each with the time at which its position arrived."""
        if self._stream is None:
            return
        try:
            samples = self._stream.take()
            if samples is not None:
                stamps = (samples.time_ns + self._offset_ns) * 1e-9
                self._samples.push_chunk(np.hstack([samples.position, samples.force]), stamps.tolist())
        except Exception as error:  # the run goes on
            self._stream = None
            self._warn(f"LSL: from here on no samples are sent ({error})")

    def send_event(self, kind: str, sentence: str, values: Mapping[str, Any], time_ns: int) -> None:
        """Sends an event of that monotonic time; from any thread. A marker is its text, another event its kind with its
        values as JSON, or with its sentence if it has none."""
        about = json.dumps(values, default=str) if values else sentence
        text = sentence if kind == "marker" else f"{kind} {about}".strip()
        with self._lock:
            self._events.push_sample([text], (time_ns + self._offset_ns) * 1e-9)
