"""A sound card and a device in virtual time, each with its own clock and jitter, around the compiled callback."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.loop.sound import SOUND_RING, SoundRing, publish, push
from hapsim.sound.resample import Player, play

BLOCK = 128
_START_NS = 10**12


@entry
def push_all(ring, frames, time_ns):
    """The steps of a sample: (steps, channels)."""
    for i in range(frames.shape[0]):
        push(ring, frames[i])
    publish(ring, time_ns)


class SimulatedCard:
    """A device that samples at `device_hz`, a scene with `substeps`, and a card of `card_hz`. `device_ppm`, `card_ppm`:
    what their clocks are off by; `jitter_s`: positions and callbacks are late by up to so much."""

    def __init__(
        self,
        signal: Callable[[NDArray[np.float64]], NDArray[np.float64]],
        *,
        device_hz: float = 1000.0,
        substeps: int = 48,
        card_hz: float = 44100.0,
        device_ppm: float = 0.0,
        card_ppm: float = 0.0,
        jitter_s: float = 0.0,
        latency_s: float = 0.01,
        channels: int = 1,
        outputs: int = 1,
        seed: int = 1,
    ) -> None:
        """`signal`: of the time in s by the device's clock, one channel for each row."""
        self._signal, self._substeps = signal, substeps
        self._device_hz, self._card_hz = device_hz * (1.0 + 1e-6 * device_ppm), card_hz * (1.0 + 1e-6 * card_ppm)
        self._nominal_hz, self._jitter_s, self._outputs = device_hz, jitter_s, outputs
        self._random = np.random.default_rng(seed)
        self.true_ratio = substeps * self._device_hz / self._card_hz
        self.ring = SoundRing(new_record(SOUND_RING), channels, 1 << 16)
        rates = device_hz * substeps, card_hz
        self.player = Player(self.ring, rates, burst=substeps, outputs=outputs, latency_s=latency_s, volume=1.0)
        self.record: Any = self.player.record
        self.record.output_s = 0.002
        self._sample = self._block = 0
        self._arrives_s = self._late(1.0 / self._device_hz)
        self.skipped: set[int] = set()
        """Samples of the device that the loop is not given in time, but with the one after."""
        self._kept_back = 0

    def _late(self, time_s: float) -> float:
        return time_s + self._jitter_s * self._random.random()

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> NDArray[np.float32]:
        """Returns what the card plays from now on, (frames, outputs). `each`: called after each block."""
        out = np.empty((round(seconds * self._card_hz / BLOCK), BLOCK, self._outputs), np.float32)
        for block in out:
            now = self._late(self._block * BLOCK / self._card_hz)
            self._bring_samples(now)
            self.record.simulated_ns = _START_NS + round(1e9 * now)
            play(0, block.ctypes.data, BLOCK, 0, 0, self.record.address)
            self._block += 1
            if each is not None:
                each()
        return out.reshape(-1, self._outputs)

    def _bring_samples(self, now: float) -> None:
        """Everything that has arrived by now."""
        while self._arrives_s <= now:
            self._sample += 1
            self._kept_back += 1
            if self._sample not in self.skipped:
                count = self._kept_back * self._substeps
                steps = np.arange(self._sample * self._substeps - count, self._sample * self._substeps) + 1
                frames = self._signal(steps / (self._substeps * self._nominal_hz))
                push_all(
                    self.ring.record,
                    np.float32(frames).reshape(len(steps), -1),
                    _START_NS + round(1e9 * self._arrives_s),
                )
                self._kept_back = 0
            self._arrives_s = max(self._arrives_s, self._late((self._sample + 1) / self._device_hz))


def sinad_db(values: NDArray[Any], frequency: float) -> float:
    """Returns signal to noise and distortion of a sine of about this frequency (cycles per value), fitted to it."""
    n = np.arange(len(values)) - 0.5 * (len(values) - 1)
    for _ in range(6):
        columns = np.column_stack([np.cos(2 * np.pi * frequency * n), np.sin(2 * np.pi * frequency * n)])
        a, b = np.linalg.lstsq(columns, values, rcond=None)[0]
        slope = 2 * np.pi * n * (b * columns[:, 0] - a * columns[:, 1])
        *_, change = np.linalg.lstsq(np.column_stack([columns, slope]), values, rcond=None)[0]
        frequency += change
    rest = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(20 * np.log10(np.hypot(a, b) / np.sqrt(2) / np.sqrt(np.mean(rest**2))))
