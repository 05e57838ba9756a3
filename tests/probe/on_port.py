"""Serves a device of device.py, in real time, at a pseudo-terminal: `python on_port.py '{"faults": ["frozen"]}'`.

Prints the port's name, and after SIGTERM what happened to the device, as JSON. Imports the standard library alone.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from device import Device


class Served:
    """A device in another process. `port`: its name; `seen`: after its end, what happened to it."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        self._process, self.port = process, process.stdout.readline().strip()
        self.seen: dict[str, float] = {}

    def end(self) -> dict[str, float]:
        """Stops it. Returns the farthest place, m, the highest speed, m/s, and the largest force asked for, N."""
        if not self.seen:
            self._process.send_signal(signal.SIGTERM)
            self.seen = json.loads(self._process.communicate()[0])
        return self.seen


@contextlib.contextmanager
def device_on_port(**options: Any) -> Iterator[Served]:
    """Yields a device of these options, which runs in real time until it is left."""
    command = [sys.executable, __file__, json.dumps(options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        served = Served(process)
        try:
            yield served
        finally:
            served.end()


def serve(options: dict[str, Any]) -> None:
    near, far = os.openpty()
    for end in (near, far):
        tty.setraw(end)
    os.set_blocking(near, False)

    def put(data: bytes) -> int:
        with contextlib.suppress(BlockingIOError):
            return os.write(near, data)
        return 0

    device = Device(put, time.monotonic, options)
    ends: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ends.append(number))
    print(os.ttyname(far), flush=True)
    while not ends:
        if select.select([near], [], [], device.wait())[0]:
            with contextlib.suppress(BlockingIOError):
                device.take(os.read(near, 4096))
        device.look()
    print(json.dumps({name: getattr(device, name) for name in ("farthest", "fastest", "largest")}))


if __name__ == "__main__":
    serve(json.loads(sys.argv[1]))
