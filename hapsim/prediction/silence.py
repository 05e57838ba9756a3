"""What bounds the force once the host is silent: the time to live of a force, and the device's watchdog.

A run asks the device for these two, whoever paces the loop (PROTOCOL.md, sections 6 and 7).
"""

from __future__ import annotations

from dataclasses import dataclass

from firmware_protocol import schema

_LIVES_S, _LEAST_LIVES = 0.02, 2  # enough to bridge a lost frame or two
_WATCHDOG_S, _LEAST_WATCHDOG = 0.1, 10


def time_to_live_samples(rate: float) -> int:
    """How long each force may act without being replaced, at `rate` Hz: a fiftieth of a second."""
    return min(max(round(_LIVES_S * rate), _LEAST_LIVES), schema.MAX_TIME_TO_LIVE_SAMPLES)


def watchdog_samples(rate: float, most: int = schema.MAX_WATCHDOG_SAMPLES) -> int:
    """How long the host may be silent, at `rate` Hz: a tenth of a second, as far as the device lets us: `most`."""
    return min(max(round(_WATCHDOG_S * rate), _LEAST_WATCHDOG), most)


@dataclass(frozen=True)
class HostSilence:
    """What becomes of the force when the host dies."""

    time_to_live_samples: int
    watchdog_samples: int
    zero_force_after_s: float
    """After the last force began to act: its time to live and one sample period."""
    latched_after_s: float
    """After the sample in which the last force came."""


def host_silence(rate: float, most: int = schema.MAX_WATCHDOG_SAMPLES) -> HostSilence:
    """What a run at `rate` Hz asks of a device that allows a watchdog of `most` samples. The times hold for
    clock: device and clock: host alike."""
    lives, watchdog = time_to_live_samples(rate), watchdog_samples(rate, most)
    return HostSilence(lives, watchdog, (lives + 1) / rate, (watchdog + 1) / rate)
