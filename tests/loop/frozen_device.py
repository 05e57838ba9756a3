"""A device whose position sensor dies, or is refreshed too rarely: between the loop and the mock in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from firmware_protocol.frames import SETUP, armed_format, frame_to_host
from hapsim.loop.transport import PythonTransport


class FrozenDevice:
    """Repeats the counts of some channels from sample `at` on; refreshes them every `refresh` samples, where that is
    not 0, and until sample `until`. Drops the positions of samples for which `lost` is true."""

    def __init__(
        self,
        at: Callable[[int, list[tuple[int, ...]]], bool],
        *,
        channels: int = 1,
        frozen: Sequence[int] = (0,),
        refresh: int = 0,
        until: int = 1 << 40,
    ) -> None:
        """`at`: whether the sensor dies, by the sample's number and all true counts so far."""
        self._at, self._frozen, self._refresh, self._until = at, frozen, refresh, until
        self._wire = armed_format(channels)
        self._setup, self._armed = new_decoder(SETUP, to_device=False), new_decoder(self._wire, to_device=False)
        self._is_armed, self._kept = False, ()
        self.true: list[tuple[int, ...]] = []
        """The counts of every sample, as the sensor would have had them."""
        self.died: int | None = None
        """The sample in which the sensor died."""

    def __call__(self, device: PythonTransport) -> FrozenDevice:
        """Wraps a device; for `between` of `start` and `run`."""
        self._device = device
        return self

    def send(self, frame: bytes) -> int:
        return self._device.send(frame)

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        count = self._device.receive(buffer, timeout_ns)
        if count <= 0:
            return count
        *whole, rest = bytes(buffer[:count]).split(b"\0")
        out = b"".join(self._passed(one + b"\0") for one in whole) + rest
        buffer[: len(out)] = np.frombuffer(out, np.uint8)
        return len(out)

    def _passed(self, data: bytes) -> bytes:
        if not self._is_armed:
            said = [one for one in frames_in(self._setup, data) if one.type == schema.STATUS]
            self._is_armed = any(one.counts[0] & 0xFF == schema.ARMED for one in said)
            return data
        positions = [one for one in frames_in(self._armed, data) if one.type != schema.STATUS]
        return b"".join(map(self._answer, positions)) if positions else data

    def _answer(self, frame: Frame) -> bytes:
        self.true.append(frame.counts)
        n = len(self.true) - 1
        if self.died is None and self._at(n, self.true):
            self.died = n
        counts = list(frame.counts)
        if self.died is not None and n < self._until:
            if n == self.died or (self._refresh and (n - self.died) % self._refresh == 0):
                self._kept = frame.counts
            for c in self._frozen:
                counts[c] = self._kept[c]
        return frame_to_host(self._wire, frame.type, frame.number, counts)

    def way(self, scale: float, channel: int = 0) -> NDArray[np.float64]:
        """m from where the sensor died, of every later sample."""
        assert self.died is not None
        true = np.array(self.true, dtype=np.float64)[self.died :, channel]
        return (true - true[0]) * scale


def after(sample: int) -> Callable[[int, Any], bool]:
    return lambda n, _: n >= sample
