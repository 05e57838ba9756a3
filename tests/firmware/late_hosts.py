"""Transports in Python that spoil the answers of a host in lockstep with a board: for `between` of `hapsim.run`.

A delimiter of no frame takes the place of an answer, so that the board's time goes on."""

from __future__ import annotations

import random
from typing import Any

from firmware_protocol import schema

_NOTHING = b"\0"


class _Between:
    def __init__(self, transport: Any) -> None:
        self._transport, self._chance = transport, random.Random(7)
        self._waiting: list[bytes] = []
        self.missed = 0

    def receive(self, buffer: Any, timeout_ns: int) -> Any:
        return self._transport.receive(buffer, timeout_ns)

    def send(self, frame: bytes) -> Any:
        """Sends a frame, or what is sent in its place. Returns the transport's code."""
        is_force = frame[1] >> 4 == schema.FORCE
        return self._transport.send(self._instead(frame) if is_force else frame)

    def _instead(self, frame: bytes) -> bytes:
        raise NotImplementedError


class MissesThird(_Between):
    """A host that is late with a third of its answers, and then answers the next position."""

    def _instead(self, frame: bytes) -> bytes:
        is_missed = self._chance.random() < 1.0 / 3.0
        self.missed += is_missed
        return _NOTHING if is_missed else frame


class FarAway(_Between):
    """A wire on which an answer takes 14 samples longer."""

    def _instead(self, frame: bytes) -> bytes:
        self._waiting.append(frame)
        return self._waiting.pop(0) if len(self._waiting) > 14 else _NOTHING
