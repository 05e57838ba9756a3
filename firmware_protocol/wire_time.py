"""The time that one exchange, a position and the force that answers it, takes on a UART (PROTOCOL.md, section 11)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from firmware_protocol import schema

BITS_PER_BYTE = 10  # start, eight, stop
HOST_WORK_S = 5e-5
"""From a position's last byte to a force's first, on a host that is not held up."""

_ROUNDING = 1.0 + 1e-12  # an exchange that lasts as long as a sample ends too late


@dataclass(frozen=True)
class WireTime:
    """One exchange, and the share of the wire in it."""

    bytes_to_host: int
    bytes_to_device: int
    seconds: float
    """Of both frames on the wire."""
    period: float
    """s, the sample period."""
    baud: int | None
    """Bit/s; None where bytes take no time."""
    turnaround_s: float
    """The device's: from its sample to the position's first byte, and from the force's last byte until it counts."""
    host_work_s: float

    @property
    def exchange_s(self) -> float:
        """From a sample until the force that answers it counts for the device's next tick."""
        return self.turnaround_s + self.seconds + self.host_work_s

    @property
    def is_saturated(self) -> bool:
        """Whether the frames of one direction take longer than a sample and so queue up without end."""
        longest = max(self.bytes_to_host, self.bytes_to_device) / (self.bytes_to_host + self.bytes_to_device)
        return longest * self.seconds > self.period * _ROUNDING

    @property
    def delay_samples(self) -> int | None:
        """From a position's sample to the tick at which its force begins to act, at least 1; None if saturated."""
        return None if self.is_saturated else 1 + math.floor(self.exchange_s / self.period * _ROUNDING)

    @property
    def fits(self) -> bool:
        """Whether every force is in time for the tick after its position."""
        return self.delay_samples == 1

    @property
    def highest_rate_hz(self) -> float:
        """The rate below which an exchange takes less than a sample; infinity where it takes no time."""
        return 1.0 / self.exchange_s if self.exchange_s > 0.0 else math.inf

    @property
    def least_baud(self) -> float | None:
        """The speed above which an exchange takes less than a sample at this rate; None where no speed is enough."""
        left = self.period - self.turnaround_s - self.host_work_s
        return (self.bytes_to_host + self.bytes_to_device) * BITS_PER_BYTE / left if left > 0.0 else None


def wire_time(
    channels: int, velocity: bool, rate: float, baud: int | None, turnaround_s: float, host_work_s: float = HOST_WORK_S
) -> WireTime:
    """Returns the times of an armed device at `rate` Hz, which sends velocities too where `velocity`."""
    to_host = schema.frame_bytes(channels, to_device=False, velocity=velocity)
    to_device = schema.frame_bytes(channels, to_device=True, velocity=velocity)
    seconds = 0.0 if baud is None else (to_host + to_device) * BITS_PER_BYTE / baud
    return WireTime(to_host, to_device, seconds, 1.0 / rate, baud, turnaround_s, host_work_s)
