"""What every step has at hand: the wire, what the device said of itself, what the user allows, what was found."""

from __future__ import annotations

from dataclasses import dataclass, field

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.bringup.probe.checks import Findings
from hapsim.bringup.probe.session import Session, arm
from hapsim.bringup.probe.wire import Wire, told


@dataclass(frozen=True)
class Leave:
    """The user's leave to push, on one channel."""

    force: float
    """N at most, to either side."""
    travel: float
    """m at most, from where the pushing began."""
    channel: int = 0
    mass: float | None = None
    """kg, with the hand, where the user knows it."""


@dataclass
class Probing:
    """A device that is being judged."""

    wire: Wire
    findings: Findings = field(default_factory=Findings)
    description: Description | None = None
    leave: Leave | None = None
    steady: bool = True
    """Whether the device kept its rate while the host did not read, as far as that can be seen."""
    response: float | None = None
    """m/s² per N, as the pushes found it."""

    @property
    def device(self) -> Description:
        """What the device said of itself, once that is known to make sense."""
        assert self.description is not None, "no step that arms comes before the registers"
        return self.description

    @property
    def longest_watchdog(self) -> int:
        return self.device.max_watchdog_samples

    def periods(self, samples: float) -> float:
        """In s."""
        return samples / self.device.rate_hz

    def samples_in(self, seconds: float, least: int, most: int) -> int:
        return min(max(round(seconds * self.device.rate_hz), least), most)

    def arm(self, pacing: int, watchdog: int, *, velocity: bool = False) -> Session | None:
        """None, and not armed, where the device did not take it."""
        session = arm(self.wire, self.device.rate_hz, pacing, watchdog, velocity=velocity)
        if session.status is not None and session.status.state == schema.ARMED:
            return session
        self.wire.release()
        return None

    def arm_by_device(self, step: str, watchdog: int, *, velocity: bool = False) -> Session | None:
        """Armed and paced by itself; else nothing of this step is seen."""
        if not self.device.paces(schema.PACED_BY_DEVICE):
            self.findings.leave(step, "the device does not declare that it paces (bit 0 of register 3)")
            return None
        session = self.arm(schema.PACED_BY_DEVICE, watchdog, velocity=velocity)
        if session is None:
            self.findings.leave(step, "the device did not arm")
        return session


def status_found(session: Session | None) -> str:
    return told(session.status if session is not None else None)
