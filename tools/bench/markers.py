"""Lateness of markers, and errors of the times of rows: in real time, on the mock.

    tools/bench/markers [--markers 600]

Each way to set a marker is tried some hundred times at random moments. The marker's text is the monotonic time just
before it was set, so that the record itself shows by how much the arrival of the marked row differs. The mock of
`hapsim mock` is a process of its own whose timer paces: its samples lie on a grid, from which arrivals and `time_s` are
off. Run it where nothing else runs, or with real-time priority (chrt -f 30).
"""

from __future__ import annotations

import argparse
import contextlib
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from panel import ask, connect_here, origin_of, served
from pythonosc.udp_client import SimpleUDPClient

import hapsim
from hapsim.running import Trace
from hapsim.scene import parse_scene

SCENE = """
version: 1
rate: 1000
device: {{clock: device, mass: 0.2{}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 500, damping: 5}}
"""


def set_all(mark: Callable[[str], object], count: int) -> None:
    """Sets markers at random moments, with the time of each as its text."""
    time.sleep(0.5)
    for _ in range(count):
        time.sleep(random.uniform(0.002, 0.004))
        mark(str(time.monotonic_ns()))
    time.sleep(0.2)


def show(name: str, trace: Trace) -> None:
    """Prints by how much the marked rows arrived before their markers were set."""
    if not trace.markers:
        print(f"{name}: no marker arrived")
        return
    rows = np.searchsorted(trace.sample, [one.sample for one in trace.markers])
    set_ns = np.array([int(one.text) for one in trace.markers])
    early = np.sort(1e-3 * (set_ns - trace.time_ns[rows]))
    within = np.mean(np.abs(early) < 1e6 / trace.rate)
    print(
        f"{name}: {early.size} markers; the row arrived before by {np.median(early):.0f} µs (median; from "
        f"{early[0]:.0f} to {early[-1]:.0f}); {100 * within:.1f} % within a sample period",
        flush=True,
    )


def show_times(trace: Trace) -> None:
    """Prints how far arrivals and `time_s` are off an even grid, in the median half second: a mock that is held up
    begins its own grid anew."""
    grid = (trace.sample - trace.sample[0]) / trace.rate
    for name, times in (("arrivals", 1e-9 * (trace.time_ns - trace.time_ns[0])), ("time_s", trace.time_s)):
        off = [1e6 * (one - np.median(one)) for one in np.array_split(times - grid, max(int(2 * grid[-1]), 1))]
        rms, most = np.median([(np.std(one), np.abs(one).max()) for one in off], axis=0)
        print(f"{name}: off the device's grid by {rms:.1f} µs rms, {most:.1f} at most")


@contextlib.contextmanager
def mock_of_its_own(directory: Path) -> Iterator[Path]:
    """`hapsim mock` behind a port, the path of which is yielded."""
    (directory / "mock.yaml").write_text(SCENE.format(""), encoding="utf-8")
    link = directory / "port"
    command = [sys.executable, "-m", "hapsim", "mock", str(directory / "mock.yaml"), "--link", str(link)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while not link.exists():
            time.sleep(0.05)
        try:
            yield link
        finally:
            process.terminate()


def main() -> None:
    """Tries each way, and prints what it found."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--markers", type=int, default=600)
    count = options.parse_args().markers
    with tempfile.TemporaryDirectory() as place:
        directory = Path(place)
        with mock_of_its_own(directory) as port:
            with hapsim.start(parse_scene(SCENE.format(f", port: {port}"))) as session:
                set_all(session.mark, count)
            show("Session.mark", session.trace)
            show_times(session.trace)
        for name in ("WebSocket", "OSC"):
            record = directory / f"{name}.trace"
            with served(directory, "--record", str(record), scene=SCENE.format("")) as (url, osc, *_):
                if name == "OSC":
                    client = SimpleUDPClient("127.0.0.1", osc)
                    set_all(lambda text, client=client: client.send_message("/hapsim/marker", text), count)
                else:
                    with connect_here(url, origin=origin_of(url)) as live:
                        set_all(lambda text, live=live: ask(live, {"type": "marker", "text": text}), count)
            show(name, hapsim.load_trace(record))


if __name__ == "__main__":
    main()
