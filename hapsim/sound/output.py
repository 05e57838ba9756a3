"""Where a session's sound goes: to a card, to a file, or to both."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from hapsim.loop.histogram import histogram_of
from hapsim.loop.sound import SoundRing
from hapsim.sound.play import Playback
from hapsim.sound.wav import WavFile


class SoundOutput:
    """The readers of a ring. `file`, `playback`: set where there is one."""

    def __init__(self, ring: SoundRing, in_file: Sequence[int] | None = None) -> None:
        """`in_file`: which pick-ups the file gets [default: all]."""
        self._ring, self._lock = ring, threading.Lock()
        self._in_file = slice(None) if in_file is None else list(in_file)
        self.file: WavFile | None = None
        self.playback: Playback | None = None
        self._is_over = False

    def collect(self) -> None:
        """Empties the ring into the file, and looks after the card; from any thread."""
        with self._lock:
            if self.file is not None and (frames := self._ring.drain()).size:
                self.file.put(frames[:, self._in_file], patient=bool(self._ring.record.waits))
        if self.playback is not None:
            self.playback.look()

    def fade(self) -> None:
        """Has the sound fade out: no more frames come."""
        if self.playback is not None:
            self.playback.fade()

    def close(self) -> None:
        """Closes card and file, which then has every frame."""
        if self.playback is not None:
            self.playback.close()
        if self.file is not None:
            self.collect()
            self.file.finish()
        self._is_over = True

    def counts(self) -> dict[str, Any]:
        """Returns what Progress and Report say of the sound, by the names of their fields."""
        ring, lost = self._ring.record, 0
        if self.file is not None:
            lost = self._ring.lost + (self.file.unwritten if self._is_over else 0)
        counts = {"sound_frames": int(ring.written), "clipped_sound_values": int(ring.clipped)}
        if self.playback is None:
            return counts | {"lost_sound_frames": lost}
        player = self.playback.record
        latency = histogram_of(player.latency, 1e-9)
        return counts | {
            "lost_sound_frames": lost + int(player.lost),
            "underruns": int(player.underruns + player.card_underruns),
            "resampling_ppm": self.playback.ratio_ppm if latency.total else None,
            "sound_latency_s": (latency.quantile(0.5), latency.quantile(0.99)) if latency.total else None,
        }
