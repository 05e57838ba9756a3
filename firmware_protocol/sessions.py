"""Sessions of a device: the steps of sessions.yaml with their frames as bytes.

Nothing here is worked out by a device: what is expected stands beside what is done. `make_vectors` writes the sessions
to sessions.json; PROTOCOL.md ("Test vectors") explains the entries.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from firmware_protocol import schema
from firmware_protocol.frames import frame_to_device
from firmware_protocol.vectors import FORMATS, TYPES, Entry, frame, words_in

LIMIT = 1_000_000_000  # counts: 10 N of 1e-8 N
DEVICES: dict[str, dict[str, Any]] = {
    "plain": {"channels": 1, "pacings": 3, "max_watchdog": 2047, "velocity": True, "impulse": False},
    "bare": {"channels": 1, "pacings": 1, "max_watchdog": 100, "velocity": False, "impulse": False},
    "four": {"channels": 4, "pacings": 3, "max_watchdog": 2047, "velocity": True, "impulse": False},
    "impulse": {"channels": 1, "pacings": 3, "max_watchdog": 2047, "velocity": True, "impulse": True},
}
STATES = ("idle", "armed", "latched")

_SOURCE = Path(__file__).with_suffix(".yaml")
_OF_SETUP = ("describe", "description", "arm", "status")  # unless a frame names another format


def sessions() -> Entry:
    """All of sessions.json."""
    return {
        "about": "Sessions of a device, step by step; PROTOCOL.md explains them. Bytes are hexadecimal.",
        "version": schema.VERSION,
        "schema_hash": schema.SCHEMA_HASH,
        "devices": [{"name": name} | device for name, device in DEVICES.items()],
        "sessions": [_session(**written) for written in yaml.safe_load(_SOURCE.read_text("utf-8"))],
    }


def steps_of(device: str, written: list[Entry]) -> list[Entry]:
    """The steps of a session of sessions.json, from those of sessions.yaml."""
    session = _Session(DEVICES[device]["channels"])
    return [session.step(**step) for step in written]


def _session(section: int, says: str, steps: list[Entry], device: str = "plain") -> Entry:
    return {"section": str(section), "says": says, "device": device, "steps": steps_of(device, steps)}


class _Session:
    """What a session has come to: the format of the frames, and what is measured, put out and expected."""

    def __init__(self, channels: int) -> None:
        self.channels, self.wire = channels, "setup"
        self.force, self.state = [0] * channels, "idle"
        self.positions, self.velocities = [0] * channels, [0] * channels

    def step(
        self,
        out: list[str] | None = None,
        force: list[int] | None = None,
        state: str | None = None,
        registers: dict[str, int] | None = None,
        wire: str | None = None,
        **action: Any,
    ) -> Entry:
        """One step of sessions.json."""
        self.wire = wire or self.wire
        if "arm" in action:
            bytes_of_host, said = self._arm(**action.pop("arm"))
            force, state, action = [0] * self.channels, "armed", {"bytes": bytes_of_host.hex()}
        else:
            if "host" in action:
                action = {"bytes": self._bytes(action["host"]).hex()}
            said = self._bytes(out or [])
        self.positions = action.get("position", self.positions)
        self.velocities = action.get("velocity", self.velocities)
        self.force, self.state = force or self.force, state or self.state
        expected: Entry = {"out": said.hex(), "force": self.force, "state": self.state}
        if registers is not None:
            expected["registers"] = {str(getattr(schema, f"REG_{name.upper()}")): registers[name] for name in registers}
        return action | expected

    def _arm(self, watchdog: int = 100, pacing: int = 0, velocity: bool = False) -> tuple[bytes, bytes]:
        argument = pacing | (schema.WITH_VELOCITY if velocity else 0)
        host = self._bytes([f"arm {watchdog} hash argument={argument}"])
        self.wire = f"{'velocity' if velocity else 'armed'}_{self.channels}"
        return host, self._bytes(["status 0 armed", "position 0"])

    def _bytes(self, written: list[str]) -> bytes:
        return b"".join(map(self._frame, written))

    def _frame(self, written: str) -> bytes:
        head, first, *rest = written.split()
        if head == "hex":
            return bytes.fromhex(first)
        wire, _, kind = head.rpartition("/")
        wire = wire or ("setup" if kind in _OF_SETUP else self.wire)
        options = dict(option.split("=") for option in rest if "=" in option)
        words = [_word(word) for word in rest if "=" not in word]
        number, argument = int(first), int(options.get("argument", 0))
        if kind == "latched":  # the last frame in the armed format
            kind, words, self.wire = "status", [schema.LATCHED, *words], "setup"
        if kind == "status":
            words = [words[0] | sum(words[1:]) << 8]
        if kind in ("position", "held"):
            kind = "position_held" if kind == "held" else kind
            words = self.positions + (self.velocities if wire.startswith("velocity") else [])
        if kind in TYPES:
            words = (words + [0] * schema.MAX_WORDS)[: words_in(wire, kind)]
            whole = frame(wire, kind, number % schema.SAMPLE_MODULUS, argument, words)
        else:
            whole = frame_to_device(FORMATS[wire], int(kind.removeprefix("type_")), number, argument, [0])
        return whole[int(options.get("from", 0)) : int(options.get("until", len(whole)))]


def _word(written: str) -> int:
    """A word of a payload, as a signed number of 32 bits."""
    if written in STATES:
        return STATES.index(written)
    word = {"hash": schema.SCHEMA_HASH, "hash^1": schema.SCHEMA_HASH ^ 1}.get(written)
    word = int(written) if word is None else word
    return word - (word >> 31 << 32) if word > 0 else word
