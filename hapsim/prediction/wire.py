"""What the wire makes of the delay: how long an exchange takes, and the delay in samples that follows."""

from __future__ import annotations

from typing import Literal

from firmware_protocol.wire_time import HOST_WORK_S, WireTime, wire_time
from hapsim.scene import Scene

WireOf = Literal["port", "mock", "none"]


def wire_of(scene: Scene) -> WireOf:
    """Whose wire the times are of: the port's, if it is a UART; the one that the mock simulates; or, of a mock without
    one, that of a UART at the scene's `device.baud`, which nothing of this scene waits for."""
    if scene.device.port is not None:
        return "port"
    mock = scene.mock_device
    return "mock" if mock.baud is not None or mock.turnaround > 0.0 else "none"


def wire_time_of(scene: Scene) -> WireTime:
    """What an exchange takes. In virtual time the host's work takes none; a USB converter's latency is not counted."""
    mock = scene.mock_device
    simulated = wire_of(scene) == "mock"
    host_work_s = 0.0 if simulated and scene.device.clock == "lockstep" else HOST_WORK_S
    baud = mock.baud if simulated else scene.device.baud
    return wire_time(scene.channels, bool(scene.sensed_links), scene.rate, baud, mock.turnaround, host_work_s)


def with_wire_delay(scene: Scene) -> Scene | None:
    """The scene with the delay that results where the wire costs more than the one sample that `device.delay` is
    declared with; None where it costs no more, or no delay results."""
    samples = wire_time_of(scene).delay_samples
    if samples is None or samples == 1:
        return None
    return scene.model_copy(
        update={"device": scene.device.model_copy(update={"delay": scene.device.delay + samples - 1})}
    )
