"""Timing: the duration of an exchange on the wire, its delay, and the end of the force after the host's last."""

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
from hapsim.scene.choices import PREDICTS

WireOf = Literal["port", "unknown", "mock", "none"]
PACED = ("port", "mock")
"""Wires with times that are known before the device runs."""

FIRST_SAMPLES = 64
"""Samples after arming in which the device reports how late its forces are."""

_UARTS = re.compile(r"tty(S|USB|AMA|THS|mxc|O|PS|SC|UL)\d+|(cu|tty)\.usbserial.*")
"""Names of ports with a UART. USB of a board's own (ttyACM), a pseudo-terminal or a COM may ignore the baud rate."""


def wire_of(scene: Scene) -> WireOf:
    """Returns the kind of wire: `port`, the port's UART; `unknown`, a port that may ignore its baud rate; `mock`, the
    mock's simulated one; or `none`, a mock without one: the times are then those of a UART at `device.baud`."""
    if (port := scene.device.port) is not None:
        return "port" if _UARTS.fullmatch(os.path.basename(os.path.realpath(port))) else "unknown"
    mock = scene.mock_device
    return "mock" if mock.baud is not None or mock.turnaround > 0.0 else "none"


def wire_time_of(scene: Scene) -> WireTime:
    """Duration of an exchange without a USB converter's latency. In virtual time the host's work takes none."""
    mock = scene.mock_device
    simulated = wire_of(scene) == "mock"
    host_work_s = 0.0 if simulated and scene.device.clock == "lockstep" else HOST_WORK_S
    baud = mock.baud if simulated else scene.device.baud
    return wire_time(scene.channels, parts_on_wire(scene), scene.rate, baud, mock.turnaround, host_work_s)


def parts_on_wire(scene: Scene) -> int:
    """Returns ARM's bits of what the frames of a scene carry behind positions and forces."""
    words = schema.WITH_WORDS if scene.has_words else 0
    line = schema.WITH_LINE if scene.device.law == "board" else 0
    commands = schema.WITH_COMMANDS if scene.device.is_admittance else 0
    return schema.parts_of(scene.sensed) | line | commands | words


def samples_on_wire(scene: Scene) -> int:
    """Samples from a position to the force that answers it: 1 if it is in time, or if the wire is not known before the
    device runs. If frames queue up, the delay grows to a force's time to live: the next force would never act."""
    if wire_of(scene) not in PACED:
        return 1
    oldest = time_to_live_samples(scene.rate) + 1
    return min(wire_time_of(scene).delay_samples or oldest, oldest)


def least_late_samples(scene: Scene, round_trip_s: float) -> int:
    """Least number of samples from a position to its force, on a wire on which forces are late. `round_trip_s`: the
    shortest time from a question to its answer before arming, in which a device may have waited for its next tick."""
    measured = 0.0 if scene.device.clock == "lockstep" else round_trip_s * scene.rate
    return max(2, samples_on_wire(scene), min(math.floor(measured), time_to_live_samples(scene.rate) + 1))


def on_wire(scene: Scene) -> Scene:
    """Returns the scene with the delay of its run: `device.delay`, that of its wire and, for a predictor, that by which
    its motors lag."""
    samples = samples_on_wire(scene)
    scene = scene if samples == 1 else with_wire_delay(scene, samples)
    if not (lag := lag_as_delay(scene)):
        return scene
    device = scene.device.model_copy(update={"delay": scene.device.delay + lag, "motor_lag": 0.0})
    return scene.model_copy(update={"device": device})


def lag_as_delay(scene: Scene) -> float:
    """Returns the delay, in sample periods, as which a predictor takes the lag of the scene's motors."""
    predicts = scene.device.correction in PREDICTS
    return max((one.lag for one in scene.device.drives(scene.channels)), default=0.0) * scene.rate * predicts


def with_wire_delay(scene: Scene, samples: int) -> Scene:
    """Returns the scene on a wire that takes this number of samples, which is then part of `device.delay`."""
    device = scene.device.model_copy(update={"delay": scene.device.delay + samples - 1, "port": None})
    mock = scene.mock and scene.mock.model_copy(update={"baud": None, "turnaround": 0.0})
    return scene.model_copy(update={"device": device, "mock": mock})


def wire_delay(scene: Scene) -> str:
    """Sentence on the declared delay and the one on the scene's wire, with the parts of its time, without a full stop;
    "" if the wire adds none."""
    samples, declared = samples_on_wire(scene), scene.device.delay
    if samples == 1:
        return ""
    budget = wire_time_of(scene)
    return (
        f"delay: {declared:g} sample{'' if declared == 1.0 else 's'} declared, {declared + samples - 1:g} on this wire "
        f"({wire_parts(budget)}; {wire_remedies(budget)})"
    )


def lateness_sentences(scene: Scene, samples: int, round_trip_s: float) -> str:
    """Sentences on `least_late_samples` and possible causes."""
    why = f"{samples} samples or more. Before arming, a question and its answer took {duration(round_trip_s)}."
    name = os.path.basename(os.path.realpath(scene.device.port or ""))
    with contextlib.suppress(OSError, ValueError):
        if (timer := int(Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text("ascii"))) > 1:
            why += f" The latency timer of {name} is {timer} ms, at any baud rate: see `hapsim doctor`."
    return why


def wire_parts(budget: WireTime) -> str:
    """Phrase that lists the parts of an exchange's time."""
    parts = {
        f"{budget.bytes_to_host} + {budget.bytes_to_device} bytes at {budget.baud} baud": budget.seconds,
        "the device's turnaround": budget.turnaround_s,
        "the host's work": budget.host_work_s,
    }
    return " and ".join(f"{duration(seconds)} for {part}" for part, seconds in parts.items() if seconds > 0.0)


def wire_remedies(budget: WireTime) -> str:
    """Phrase on remedies for an exchange that does not fit into a sample."""
    if budget.least_baud is None and budget.turnaround_s > 0.0:
        return (
            "no baud rate shortens the turnaround, such as an FTDI's latency timer of 16 ms: use a lower rate, or make "
            "the device answer sooner"
        )
    return "use a higher baud rate or a lower rate"


_LIVES_S, _LEAST_LIVES = 0.02, 2  # enough to bridge a lost frame or two
_WATCHDOG_S, _LEAST_WATCHDOG = 0.1, 10


def time_to_live_samples(rate: float) -> int:
    """Time to live of a force, in samples, at `rate` Hz: a fiftieth of a second."""
    return min(max(round(_LIVES_S * rate), _LEAST_LIVES), schema.MAX_TIME_TO_LIVE_SAMPLES)


def watchdog_samples(rate: float, most: int = schema.MAX_WATCHDOG_SAMPLES) -> int:
    """Longest silence of the host at `rate` Hz, in samples: a tenth of a second, at most the device's own `most`."""
    return min(max(round(_WATCHDOG_S * rate), _LEAST_WATCHDOG), most)


@dataclass(frozen=True)
class HostSilence:
    """End of the force when the host dies."""

    time_to_live_samples: int
    watchdog_samples: int
    zero_force_after_s: float
    """Time after the last force began to act: its time to live and one sample period."""
    latched_after_s: float
    """Time after the sample in which the last force came."""


def host_silence(rate: float, most: int = schema.MAX_WATCHDOG_SAMPLES) -> HostSilence:
    """Returns the times of a run at `rate` Hz, on a device that allows a watchdog of `most` samples."""
    lives, watchdog = time_to_live_samples(rate), watchdog_samples(rate, most)
    return HostSilence(lives, watchdog, (lives + 1) / rate, (watchdog + 1) / rate)
