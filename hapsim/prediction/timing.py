"""How long an exchange takes on the wire, what delay that makes, and how long a force lasts when the host is silent."""

from __future__ import annotations

import contextlib
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from firmware_protocol import schema
from firmware_protocol.schema import HOST_WORK_S, WireTime, wire_time
from hapsim.number_format import duration
from hapsim.scene import Scene

WireOf = Literal["port", "unknown", "mock", "none"]
PACED = ("port", "mock")
"""Wires whose times are known before the device runs."""

FIRST_SAMPLES = 64
"""After arming, in which the device says how late its forces are."""

_UARTS = re.compile(r"tty(S|USB|AMA|THS|mxc|O|PS|SC|UL)\d+|(cu|tty)\.usbserial.*")
"""Names of ports with a UART. USB of a board's own (ttyACM), a pseudo-terminal or a COM may ignore the baud rate."""


def wire_of(scene: Scene) -> WireOf:
    """The wire that the times are of: the port's UART; `unknown`, where the port may ignore its baud rate; the mock's
    simulated one; or none, where the mock has none and the times are those of a UART at `device.baud`."""
    if (port := scene.device.port) is not None:
        return "port" if _UARTS.fullmatch(os.path.basename(os.path.realpath(port))) else "unknown"
    mock = scene.mock_device
    return "mock" if mock.baud is not None or mock.turnaround > 0.0 else "none"


def wire_time_of(scene: Scene) -> WireTime:
    """The duration of an exchange without a USB converter's latency. In virtual time the host's work takes none."""
    mock = scene.mock_device
    simulated = wire_of(scene) == "mock"
    host_work_s = 0.0 if simulated and scene.device.clock == "lockstep" else HOST_WORK_S
    baud = mock.baud if simulated else scene.device.baud
    return wire_time(scene.channels, bool(scene.sensed_links), scene.rate, baud, mock.turnaround, host_work_s)


def samples_on_wire(scene: Scene) -> int:
    """From a position to the force that answers it: 1 where that is in time, or is not known before the device runs.

    Frames that queue up make every delay in turn, up to a force's time to live: the next force would never act."""
    if wire_of(scene) not in PACED:
        return 1
    oldest = time_to_live_samples(scene.rate) + 1
    return min(wire_time_of(scene).delay_samples or oldest, oldest)


def samples_if_late(scene: Scene, round_trip_s: float) -> int:
    """From a position to its force at least, on a wire on which forces are late. `round_trip_s`: the shortest time from
    a question to its answer before arming, in which a device may have waited for its next tick."""
    measured = 0.0 if scene.device.clock == "lockstep" else round_trip_s * scene.rate
    return max(2, samples_on_wire(scene), min(math.floor(measured), time_to_live_samples(scene.rate) + 1))


def on_wire(scene: Scene) -> Scene:
    """The scene with the delay with which it runs: `device.delay`, and what its wire adds."""
    samples = samples_on_wire(scene)
    return scene if samples == 1 else with_wire_delay(scene, samples)


def with_wire_delay(scene: Scene, samples: int) -> Scene:
    """The scene on a wire that takes this number of samples, which is then part of `device.delay`."""
    device = scene.device.model_copy(update={"delay": scene.device.delay + samples - 1, "port": None})
    mock = scene.mock and scene.mock.model_copy(update={"baud": None, "turnaround": 0.0})
    return scene.model_copy(update={"device": device, "mock": mock})


def wire_delay(scene: Scene) -> str:
    """What the declared delay is on the scene's wire, and what costs the time: a sentence without a full stop; "" where
    the wire adds nothing."""
    samples, declared = samples_on_wire(scene), scene.device.delay
    if samples == 1:
        return ""
    budget = wire_time_of(scene)
    return (
        f"delay: {declared:g} sample{'' if declared == 1.0 else 's'} declared, {declared + samples - 1:g} on this wire "
        f"({wire_parts(budget)}; {what_helps(budget)})"
    )


def why_late(scene: Scene, samples: int, round_trip_s: float) -> str:
    """`samples_if_late`, and what may cost the time, in sentences."""
    why = f"{samples} samples or more. Before arming, a question and its answer took {duration(round_trip_s)}."
    name = os.path.basename(os.path.realpath(scene.device.port or ""))
    with contextlib.suppress(OSError, ValueError):
        if (timer := int(Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text("ascii"))) > 1:
            why += f" The latency timer of {name} is {timer} ms, whatever the baud rate: see `hapsim doctor`."
    return why


def wire_parts(budget: WireTime) -> str:
    """What an exchange consists of."""
    parts = {
        f"{budget.bytes_to_host} + {budget.bytes_to_device} bytes at {budget.baud} baud": budget.seconds,
        "the device's turnaround": budget.turnaround_s,
        "the host's work": budget.host_work_s,
    }
    return " and ".join(f"{duration(seconds)} for {part}" for part, seconds in parts.items() if seconds > 0.0)


def what_helps(budget: WireTime) -> str:
    """What would shorten an exchange that does not fit into a sample."""
    if budget.least_baud is None and budget.turnaround_s > 0.0:
        return (
            "no baud rate shortens the turnaround, such as an FTDI's latency timer of 16 ms: use a lower rate, or let "
            "the device answer sooner"
        )
    return "use a higher baud rate or a lower rate"


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
