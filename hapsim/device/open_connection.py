"""Opening the connection to a scene's device: behind a serial port, on a pseudo-terminal, or in memory."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Literal

from hapsim.device.connection import Connection
from hapsim.device.ports import open_portable_port, open_serial_port, require_fine_clock
from hapsim.errors import UsageError
from hapsim.loop.system import missing_calls
from hapsim.loop.transport import PythonTransport
from hapsim.prediction.linear import with_device
from hapsim.scene import Scene

TransportKind = Literal["auto", "mock", "loopback", "paced", "terminal"]
"""Choice of the device. auto: the scene's port, or the mock if the scene names none. mock: always the mock, in memory
in virtual time and on a pseudo-terminal in real time. loopback, terminal: the mock in memory, on a pseudo-terminal.
paced: the mock in memory, in real time whatever the scene's clock. It samples when the loop gives it a force, on the
grid of this machine, so that a late sample delays the simulation and changes nothing in it."""

Between = Callable[[PythonTransport], PythonTransport]
"""Function that wraps the host's transport to a device."""

Place = Literal["port", "terminal", "loopback"]
"""Place of a device: behind a port; or the mock on a pseudo-terminal, or in memory."""


def on_device(scene: Scene, kind: TransportKind) -> Scene:
    """Returns the scene as it runs on this device: the mock has no port, nor the wire of one, and in memory no clock of
    its own."""
    if kind == "auto":
        return scene
    return with_device(scene, port=None, **({"clock": "lockstep"} if kind == "paced" else {}))


def place_of_device(scene: Scene, kind: TransportKind = "auto") -> Place:
    """Returns the place of the scene's device. Raises UsageError for an impossible place."""
    if kind == "auto" and scene.device.port is not None:
        return "port"
    virtual = scene.device.clock == "lockstep"
    if kind == "loopback" and not virtual:
        raise UsageError(
            f"the loopback takes clock: lockstep, found {scene.device.clock}: expected paced for real time"
        )
    return "loopback" if kind == "paced" or (kind != "terminal" and virtual) else "terminal"


def transport_here(scene: Scene, kind: TransportKind) -> TransportKind:
    """Returns the choice on this system: without pseudo-terminals the mock is in memory, in real time too."""
    if place_of_device(scene, kind) != "terminal" or not missing_calls():
        return kind
    return "loopback" if scene.device.clock == "lockstep" else "paced"


@contextlib.contextmanager
def open_connection(
    scene: Scene,
    kind: TransportKind = "auto",
    *,
    portable: bool = False,
    realtime: bool = False,
    between: Between | None = None,
) -> Iterator[Connection]:
    """Yields the connection to the scene's device, open inside the with-block.

    Args:
        scene: names the port, or the mock.
        kind: choice of the device.
        portable: for the loop in Python, which systems without Linux's calls take by themselves.
        realtime: runs a mock in real time before other programs, if the system grants that.
        between: wraps the transport.
    """
    elsewhere = bool(missing_calls())
    open_port = open_portable_port if portable or elsewhere else open_serial_port
    place = place_of_device(scene, kind)
    if kind == "paced" and elsewhere:
        require_fine_clock()
    with contextlib.ExitStack() as stack:
        mock, port = None, scene.device.port or ""
        if place != "port":
            from hapsim.device.mock.assemble_mock import assemble_mock

            mock = assemble_mock(scene)
        if place == "loopback":
            from hapsim.device.mock.wire import loopback_transport

            connection = Connection(loopback_transport(mock), "mock in memory", close=lambda: None, mock=mock)
        else:
            if place == "terminal":
                from hapsim.device.mock.terminal import serving

                port = stack.enter_context(serving(mock, realtime and scene.device.clock != "lockstep"))
            connection = stack.enter_context(contextlib.closing(open_port(port, scene.device.baud)))
            connection.behind_port, connection.mock = place == "port", mock
        if between is not None:
            connection.transport = between(connection.transport)
        yield connection
