"""How long `hapsim run` takes until the device is armed: the first time, when it compiles, and from then on.

    tools/bench/start [--first-runs 3] [--rounds 10]

A mock outside the command's process tells when it is armed: the time is from the start of the command to that moment. A
first run begins with an empty cache, a directory of its own. Beside the later ones, in turn, `hapsim --help`.
"""

from __future__ import annotations

import argparse
import os
import pty
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import tty
from pathlib import Path

import numpy as np

from firmware_protocol import schema
from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.mock.firmware import take_bytes
from hapsim.scene import load_scene

SCENE = Path(__file__).resolve().parents[2] / "configs" / "first_touch.yaml"


class Listener:
    """A device on a pseudo-terminal that notes when it is armed."""

    def __init__(self) -> None:
        self._near, self._far = pty.openpty()
        for end in (self._near, self._far):
            tty.setraw(end)
        self.path = os.ttyname(self._far)
        self.armed_at: float | None = None
        self._mock = assemble_mock(load_scene(SCENE))
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while data := os.read(self._near, 4096):
            take_bytes(self._mock, np.frombuffer(data, np.uint8).copy(), len(data), time.monotonic_ns())
            if self._mock.board["state"] == schema.ARMED and self.armed_at is None:
                self.armed_at = time.perf_counter()
            waiting = int(self._mock.board["out"])
            os.write(self._near, self._mock.outbox[:waiting].tobytes())
            self._mock.board["out"] = 0


def seconds_of(*words: str) -> float:
    """The whole of a command."""
    begin = time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begin


def seconds_to_armed(listener: Listener, **environment: str) -> float:
    """From the start of a run to the device's being armed."""
    listener.armed_at = None
    begin = time.perf_counter()
    words = ["hapsim", "run", str(SCENE), "--port", listener.path, "--duration", "0.001", "--json"]
    subprocess.run(
        words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, **environment}
    )
    if listener.armed_at is None:
        sys.exit("the device was never armed")
    return listener.armed_at - begin


def seconds_to_armed_at_first(listener: Listener) -> float:
    """The same where nothing was ever compiled."""
    with tempfile.TemporaryDirectory() as empty:
        return seconds_to_armed(listener, XDG_CACHE_HOME=empty)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-runs", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=10)
    arguments = parser.parse_args()
    listener = Listener()
    seconds_to_armed(listener)  # compiles, this process too, and is not counted
    found: dict[str, list[float]] = {"hapsim run, to armed, first": [], "hapsim --help": [], "hapsim run, to armed": []}
    for i in range(arguments.first_runs):
        print(f"first run {i + 1} of {arguments.first_runs}", file=sys.stderr)
        found["hapsim run, to armed, first"].append(seconds_to_armed_at_first(listener))
    for i in range(arguments.rounds):
        print(f"round {i + 1} of {arguments.rounds}", file=sys.stderr)
        found["hapsim --help"].append(seconds_of("hapsim", "--help"))
        found["hapsim run, to armed"].append(seconds_to_armed(listener))
    for what, seconds in found.items():
        if not seconds:
            continue
        print(f"{what}: {statistics.median(seconds):.2f} s [{min(seconds):.2f}, {max(seconds):.2f}]")


if __name__ == "__main__":
    main()
