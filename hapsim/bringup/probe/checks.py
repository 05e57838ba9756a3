"""What is checked of a device (`checks.yaml`), what was found so far, and what the user allows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import yaml

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.bringup.probe.wire import Session, Wire, arm
from hapsim.units import Units

Result = Literal["pass", "FAIL", "not seen"]


@dataclass(frozen=True)
class Check:
    """A check, and what was found."""

    name: str
    step: str
    section: str
    title: str
    """Of the section."""
    expected: str
    look_at: str = ""
    """What to look at; empty in a result if nothing is wrong."""
    result: Result = "not seen"
    found: str = "not reached"


_TABLE = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))

SECTIONS: dict[str, str] = _TABLE["sections"]
"""The titles of PROTOCOL.md's sections, by number."""

STEPS: tuple[str, ...] = tuple(_TABLE["steps"])

CHECKS = tuple(
    Check(name, step, title=SECTIONS[keys["section"]], **keys)
    for step, checks in _TABLE["steps"].items()
    for name, keys in checks.items()
)

_DECLARED = {check.name: check for check in CHECKS}


@dataclass(frozen=True)
class Leave:
    """The user's permission to push, on one channel."""

    force: float
    """N at most, to either side."""
    travel: float
    """m at most, from where the pushing began; 0: what is usual for the device's motion."""
    channel: int = 0
    mass: float | None = None
    """kg, with the hand; None if it is unknown."""


class Probing:
    """A device that is being judged: its wire, its description, what the user allows, and what was found."""

    def __init__(self, wire: Wire, leave: Leave | None = None) -> None:
        self.wire, self.leave = wire, leave
        self.results: dict[str, Check] = {}
        """What was found so far, by the check's name."""
        self.description: Description | None = None
        self.response: float | None = None
        """m/s² per N, as the pushes found it."""

    def judge(self, name: str, kept: bool, found: str, look_at: str = "") -> bool:
        """Notes that a check passed or failed, by `kept`, and returns that. The first failure of a check stays: what
        comes after it may follow from it. `look_at`: in place of the advice of the table."""
        if not self.has_failed(name):
            advice = "" if kept else look_at or _DECLARED[name].look_at
            self._note(name, "pass" if kept else "FAIL", found, advice)
        return kept

    def not_seen(self, name: str, why: str, look_at: str = "") -> None:
        """Notes that a check could not run, unless it has a result."""
        if name not in self.results:
            self._note(name, "not seen", why, look_at)

    def leave_out(self, step: str, why: str) -> None:
        """Notes that the checks of a step that have no result could not run."""
        for name in _TABLE["steps"][step]:
            self.not_seen(name, why)

    def fail_next(self, step: str, found: str, look_at: str) -> None:
        """Notes that the first check of a step that has no result failed."""
        for name in [name for name in _TABLE["steps"][step] if name not in self.results][:1]:
            self.judge(name, False, found, look_at)

    def has_failed(self, name: str) -> bool:
        """Returns whether a check has failed so far."""
        return name in self.results and self.results[name].result == "FAIL"

    def _note(self, name: str, result: Result, found: str, look_at: str) -> None:
        self.results[name] = replace(_DECLARED[name], result=result, found=found, look_at=look_at)

    @property
    def units(self) -> Units:
        """The units of the device's channels, as far as it said so."""
        return Units(() if self.description is None else self.description.motions)

    def units_of(self, channel: int) -> Units:
        """The units of one of the device's channels."""
        return Units(self.device.motions[channel : channel + 1])

    @property
    def device(self) -> Description:
        """What the device said of itself, once that is known to make sense."""
        assert self.description is not None, "no step that arms comes before the registers"
        return self.description

    def periods(self, samples: float) -> float:
        """Returns how long this many samples take, in s."""
        return samples / self.device.rate_hz

    def samples_in(self, seconds: float, least: int, most: int) -> int:
        """Returns how many samples a time has, within bounds."""
        return min(max(round(seconds * self.device.rate_hz), least), most)

    def arm(self, pacing: int, watchdog: int, *, velocity: bool = False) -> Session | None:
        """Arms the device; returns None, and releases it, if it did not arm."""
        session = arm(self.wire, self.device, pacing, watchdog, velocity=velocity)
        if session.status is not None and session.status.state == schema.ARMED:
            return session
        self.wire.release()
        return None

    def arm_by_device(self, step: str, watchdog: int, *, velocity: bool = False) -> Session | None:
        """Arms the device, paced by itself; returns None, and leaves out the step, if it did not arm."""
        session = None
        if not self.device.paces(schema.PACED_BY_DEVICE):
            self.leave_out(step, "the device does not declare that it paces (bit 0 of register 3)")
        elif (session := self.arm(schema.PACED_BY_DEVICE, watchdog, velocity=velocity)) is None:
            self.leave_out(step, "the device did not arm")
        return session
