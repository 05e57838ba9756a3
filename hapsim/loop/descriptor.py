"""The transport over a file descriptor: a serial port or a pseudo-terminal, opened and configured by somebody else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.loop.port import transport
from hapsim.loop.system import read_some, write_all

_SEND_TIMEOUT_NS = 100_000_000  # a line that takes nothing for this long is not a line


class DescriptorPort(NamedTuple):
    """An open, raw, non-blocking descriptor, and the scratch space of its system calls."""

    descriptor: int
    scratch: NDArray[np.int64]


def descriptor_port(descriptor: int) -> DescriptorPort:
    """A port on an open descriptor, which stays the caller's to close."""
    return DescriptorPort(descriptor, np.zeros(4, np.int64))


@inlined
def _receive(port, buffer, start, timeout_ns):
    return read_some(port.descriptor, buffer, start, timeout_ns, port.scratch)


@inlined
def _send(port, buffer, stop):
    return write_all(port.descriptor, buffer, stop, _SEND_TIMEOUT_NS, port.scratch)


transport(DescriptorPort, _receive, _send)
