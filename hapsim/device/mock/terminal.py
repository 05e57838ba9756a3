"""The mock on a pseudo-terminal: a port that any program opens like a serial device's.

The terminal is raw before anybody can open it, and a descriptor of its far end stays open: otherwise the first bytes
would be echoed, and every close of the host would read as a hang-up.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from hapsim.compiling.entries import compile_for
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.mock.firmware import prepare
from hapsim.device.mock.serve import new_service, serve
from hapsim.device.mock.wire import transmitter_transport, uart_transport
from hapsim.device.port_name import free_name, give_name, take_name
from hapsim.errors import DeviceError
from hapsim.loop.realtime.scheduling import no_timer_slack, scheduled_fifo
from hapsim.loop.system import require_linux
from hapsim.loop.transport import Transport
from hapsim.progress import Progress
from hapsim.scene import Scene


def require_pseudo_terminal() -> None:
    """UsageError where the system is not Linux."""
    require_linux(
        "the mock on a pseudo-terminal", "with clock: lockstep it runs in memory; a device runs with --portable"
    )


@contextlib.contextmanager
def serving(mock: Any, as_hardware: bool = False) -> Iterator[str]:
    """Serves `mock`, a MOCK, from a thread of its own while open; its port's path. DeviceError where there is none,
    UsageError where the system is not Linux.

    `as_hardware`: before every program of this machine, where the system grants that: a device's timer waits for none.
    """
    require_pseudo_terminal()
    import tty

    try:
        near, far = os.openpty()
    except OSError as error:
        raise DeviceError(f"no pseudo-terminal is to be had for the mock: {error}") from error
    try:
        for end in (near, far):
            tty.setraw(end)
            os.set_blocking(end, False)
        # Compiled before anybody can knock: a host does not wait for as long as the first compilation takes.
        prepare(mock)
        transport = _transport(near, mock)
        service = new_service(transport)
        compile_for(serve, mock, service)
        # A daemon: the program's end would else wait for it before it ends the session that it serves.
        thread = threading.Thread(target=_serve, args=(mock, service), name="mock device", daemon=True)
        thread.start()
        try:
            with scheduled_fifo(thread.native_id or 0) if as_hardware else contextlib.nullcontext():
                yield os.ttyname(far)
        finally:
            service.stop = 1
            thread.join()
    finally:
        os.close(near)
        os.close(far)


def _transport(near: int, mock: Any) -> Transport:
    """With the times of a UART where the mock has them."""
    if not mock.byte_ns and not mock.turnaround_ns:
        return transmitter_transport(near)
    return uart_transport(near, mock)


def _serve(*arguments: Any) -> None:
    no_timer_slack()
    serve(*arguments)


def serve_until_stopped(
    scene: Scene,
    link: Path | None,
    announce: Callable[[str], None],
    tell: Callable[[Progress], None],
    as_hardware: bool = False,
) -> None:
    """Serves the scene's mock; `announce(path)` once it answers. SIGINT, SIGTERM and SIGHUP end it in good order.

    `link`: a further name for the port, made as a symbolic link and taken away at the end. UsageError where that name
    is taken. `as_hardware`: before every other program, where the system grants that.
    """
    require_pseudo_terminal()  # before anything is changed
    free_name(link)
    # A queue, and not an event: a handler that sets one while it is waited for may wait for the event's own lock.
    stops: SimpleQueue[None] = SimpleQueue()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda _number, _frame: stops.put(None))
    with (
        on_compilation(Counted(lambda name, share: tell(Progress("compiling", name, share=share))).add),
        serving(assemble_mock(scene), as_hardware) as path,
        _linked(link, path) as name,
    ):
        if not stops.empty():
            raise KeyboardInterrupt  # before it was announced: nobody shall take it for a port that answers
        announce(name)
        tell(Progress("serving", name))
        stops.get()


@contextlib.contextmanager
def _linked(link: Path | None, path: str) -> Iterator[str]:
    if link is None:
        yield path
        return
    give_name(link, path)
    try:
        yield str(link)
    finally:
        take_name(link, path)
