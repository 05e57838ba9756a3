"""One session of a device as written by hand: what happens to it, and what it must say and do.

Nothing here is worked out by a device: what is expected stands beside what is done.
"""

from __future__ import annotations

from typing import Any

from firmware_protocol import schema
from firmware_protocol.vectors import frame

LIMIT = 1_000_000_000  # counts: 10 N of 1e-8 N
DEVICES: dict[str, dict[str, Any]] = {
    "plain": {"channels": 1, "pacings": 3, "max_watchdog": 2047, "velocity": True, "impulse": False},
    "bare": {"channels": 1, "pacings": 1, "max_watchdog": 100, "velocity": False, "impulse": False},
    "four": {"channels": 4, "pacings": 3, "max_watchdog": 2047, "velocity": True, "impulse": False},
    "impulse": {"channels": 1, "pacings": 3, "max_watchdog": 2047, "velocity": True, "impulse": True},
}
STATES = ("idle", "armed", "latched")
DEVICE, HOST, LOCKSTEP = schema.PACED_BY_DEVICE, schema.PACED_BY_HOST, schema.LOCKSTEP
PERIOD = 1000  # the clock of a session counts thousandths of a sample period

Entry = dict[str, Any]


class Story:
    """One session, written by hand: each call is a step, with what comes of it. Force and state are those of the step
    before where nothing else is said. `wire`: the format that the device is in."""

    def __init__(self, section: str, says: str, device: str = "plain") -> None:
        self.section, self.says, self.device = section, says, device
        self.channels = DEVICES[device]["channels"]
        self.wire, self.force, self.state = "setup", [0] * self.channels, "idle"
        self.positions = [0] * self.channels
        self.velocities = [0] * self.channels
        self.steps: list[Entry] = []

    def _step(self, action: Entry, out: bytes, force: list[int] | None, state: str | None) -> Story:
        self.force, self.state = force or self.force, state or self.state
        self.steps.append(action | {"out": out.hex(), "force": self.force, "state": self.state})
        return self

    # What is done.

    def host(self, *said: bytes, out: bytes = b"", force: list[int] | None = None, state: str | None = None) -> Story:
        return self._step({"bytes": b"".join(said).hex()}, out, force, state)

    def tick(self, out: bytes = b"", force: list[int] | None = None, state: str | None = None, times: int = 1) -> Story:
        return self._step({"tick": times}, out, force, state)

    def passes(self, thousandths: int, out: bytes = b"", force: list[int] | None = None, state: str = "") -> Story:
        return self._step({"pass": thousandths}, out, force, state or None)

    def measures(self, *positions: int, velocities: list[int] | None = None) -> Story:
        self.positions, self.velocities = list(positions), velocities or self.velocities
        return self._step({"position": self.positions, "velocity": self.velocities}, b"", None, None)

    def finds(self, fault: int) -> Story:
        return self._step({"finds": fault}, b"", None, None)

    def room(self, there_is: bool) -> Story:
        return self._step({"room": int(there_is)}, b"", None, None)

    def registers(self, **values: int) -> Story:
        self.steps[-1]["registers"] = {str(getattr(schema, f"REG_{name.upper()}")): v for name, v in values.items()}
        return self

    # What the host says.

    def describe(self, register: int) -> bytes:
        return frame("setup", "describe", register, 0, [0])

    def arm_frame(self, watchdog: int = 100, argument: int = DEVICE, word: int = schema.SCHEMA_HASH) -> bytes:
        return frame("setup", "arm", watchdog, argument, [word - (word >> 31 << 32)])

    def answer(self, number: int, *counts: int, lives: int = 0) -> bytes:
        """A FORCE."""
        return frame(self.wire, "force", number % 4096, lives, self._padded(counts))

    def disarm(self, wire: str | None = None) -> bytes:
        wire = wire or self.wire
        return frame(wire, "disarm", 0, 0, [0] if wire == "setup" else [0] * self.channels)

    # What the device says.

    def description(self, register: int, value: int) -> bytes:
        return frame("setup", "description", register, 0, [value - (value >> 31 << 32)])

    def position(self, number: int, kind: str = "position") -> bytes:
        both = self.positions + (self.velocities if self.wire.startswith("velocity") else [])
        return frame(self.wire, kind, number % 4096, 0, both)

    def held(self, number: int) -> bytes:
        return self.position(number, "position_held")

    def status(self, number: int, state: str, fault: int = 0, wire: str = "setup") -> bytes:
        word = STATES.index(state) | fault << 8
        words = 1 if wire == "setup" else self.channels * (2 if wire.startswith("velocity") else 1)
        return frame(wire, "status", number % 4096, 0, [word, *[0] * (words - 1)])

    # What often happens.

    def arms(self, watchdog: int = 100, pacing: int = DEVICE, velocity: bool = False) -> Story:
        before = self.status(0, "armed")
        self.wire = f"{'velocity' if velocity else 'armed'}_{self.channels}"
        argument = pacing | (schema.WITH_VELOCITY if velocity else 0)
        self.host(self.arm_frame(watchdog, argument), out=before + self.position(0), force=[0] * self.channels)
        self.steps[-1]["state"] = self.state = "armed"
        return self

    def latches(self, number: int, fault: int) -> bytes:
        """The last frame in the armed format; from here on the session goes on in the set-up format."""
        said = self.status(number, "latched", fault, self.wire)
        self.wire = "setup"
        return said

    def _padded(self, counts: tuple[int, ...]) -> list[int]:
        return [*counts, *[0] * self.channels][: self.channels]

    def entry(self) -> Entry:
        return {"section": self.section, "says": self.says, "device": self.device, "steps": self.steps}
