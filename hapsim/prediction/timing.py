"""How long an exchange takes on the wire, and how long the device holds a force when the host is silent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from firmware_protocol import schema
from firmware_protocol.wire_time import HOST_WORK_S, WireTime, wire_time
from hapsim.prediction.linear import with_device
from hapsim.scene import Scene

WireOf = Literal["port", "mock", "none"]


def wire_of(scene: Scene) -> WireOf:
    """The wire that the times are of: the port's, if it is a UART; the mock's simulated one; or none, where the mock
    has none and the times are those of a UART at `device.baud`."""
    if scene.device.port is not None:
        return "port"
    mock = scene.mock_device
    return "mock" if mock.baud is not None or mock.turnaround > 0.0 else "none"


def wire_time_of(scene: Scene) -> WireTime:
    """The duration of an exchange without a USB converter's latency. In virtual time the host's work takes none."""
    mock = scene.mock_device
    simulated = wire_of(scene) == "mock"
    host_work_s = 0.0 if simulated and scene.device.clock == "lockstep" else HOST_WORK_S
    baud = mock.baud if simulated else scene.device.baud
    return wire_time(scene.channels, bool(scene.sensed_links), scene.rate, baud, mock.turnaround, host_work_s)


def with_wire_delay(scene: Scene) -> Scene | None:
    """The scene with the delay that results from the wire; None where that is the one sample of `device.delay`, or no
    delay results."""
    samples = wire_time_of(scene).delay_samples
    return None if samples in (None, 1) else with_device(scene, delay=scene.device.delay + samples - 1)


_LIVES_S, _LEAST_LIVES = 0.02, 2  # enough to bridge a lost frame or two
_WATCHDOG_S, _LEAST_WATCHDOG = 0.1, 10


def time_to_live_samples(rate: float) -> int:
    """How long each force may act without being replaced, at `rate` Hz: a fiftieth of a second."""
    return min(max(round(_LIVES_S * rate), _LEAST_LIVES), schema.MAX_TIME_TO_LIVE_SAMPLES)


def watchdog_samples(rate: float, most: int = schema.MAX_WATCHDOG_SAMPLES) -> int:
    """How long the host may be silent, at `rate` Hz: a tenth of a second, at most the device's own `most`."""
    return min(max(round(_WATCHDOG_S * rate), _LEAST_WATCHDOG), most)


@dataclass(frozen=True)
class HostSilence:
    """The end of the force when the host dies."""

    time_to_live_samples: int
    watchdog_samples: int
    zero_force_after_s: float
    """After the last force began to act: its time to live and one sample period."""
    latched_after_s: float
    """After the sample in which the last force came."""


def host_silence(rate: float, most: int = schema.MAX_WATCHDOG_SAMPLES) -> HostSilence:
    """The request of a run at `rate` Hz, to a device that allows a watchdog of `most` samples."""
    lives, watchdog = time_to_live_samples(rate), watchdog_samples(rate, most)
    return HostSilence(lives, watchdog, (lives + 1) / rate, (watchdog + 1) / rate)
