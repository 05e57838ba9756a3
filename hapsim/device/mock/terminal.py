"""The mock on a pseudo-terminal: a port that any program opens like a serial device's.

The terminal is raw before anybody can open it, and a descriptor of its far end stays open: otherwise the first bytes
would be echoed, and every close of the host would read as a hang-up.
"""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Iterator
from typing import Any

import numpy as np

from hapsim.compiled import compile_for
from hapsim.device.mock.firmware import Mock
from hapsim.device.mock.serve import SERVICE, input_buffer, serve
from hapsim.errors import DeviceError
from hapsim.loop.descriptor import descriptor_port
from hapsim.realtime.scheduling import fifo
from hapsim.realtime.slack import no_timer_slack


@contextlib.contextmanager
def serving(mock: Mock, as_hardware: bool = False) -> Iterator[str]:
    """Serves `mock` from a thread of its own while open; the path of its port. DeviceError where none is to be had.

    `as_hardware`: before every program of this machine, where the system grants that: a device's timer waits for none.
    """
    try:
        near, far = os.openpty()
    except OSError as error:
        raise DeviceError(f"no pseudo-terminal is to be had for the mock: {error}") from error
    try:
        for end in (near, far):
            tty.setraw(end)
            os.set_blocking(end, False)
        service = np.zeros(1, SERVICE)[0]
        arguments = (descriptor_port(near), mock, service, input_buffer(), np.zeros(4, np.int64))
        # Compiled before anybody can knock: a host does not wait for as long as the first compilation takes.
        compile_for(serve, *arguments)
        thread = threading.Thread(target=_serve, args=arguments, name="mock device")
        thread.start()
        try:
            with fifo(thread.native_id or 0) if as_hardware else contextlib.nullcontext():
                yield os.ttyname(far)
        finally:
            service["stop"] = 1
            thread.join()
    finally:
        os.close(near)
        os.close(far)


def _serve(*arguments: Any) -> None:
    no_timer_slack()
    serve(*arguments)
