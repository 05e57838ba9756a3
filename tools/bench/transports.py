"""A serial line of a pseudo-terminal, TCP and UDP on one machine: how fast, how punctual, and what a hand feels.

    tools/bench/transports [--seconds 5] [--rates 1000 4000 10000 50000]

`hapsim mock` serves the device in a process of its own. Each transport

* exchanges as fast as it can, in virtual time: exchanges per second, and the time of one;
* runs in real time, paced by the mock's clock, at each rate: the share of forces that came late. The highest rate with
  one in a thousand at most is looked for among RATES;
* is measured at each rate: k and b of 2000 N/m and 5 N·s/m, beside the predicted ones.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import hapsim
from hapsim.errors import HapsimError

TRANSPORTS = ("pty", "tcp", "udp")
RATES = (500, 1000, 2000, 3000, 4000, 6000, 8000, 10_000, 15_000, 20_000, 30_000, 50_000)
MOST_LATE = 1e-3
SCENE = """version: 1
rate: {rate}
device: {{mass: 0.2, friction: 1, clock: {clock}{port}}}
mock: {{noise: 1e-8}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}}
"""


@contextlib.contextmanager
def served(kind: str, rate: int, folder: Path, clock: str = "device") -> Iterator[hapsim.Scene]:
    """Yields the scene at the port, or the address, of a mock in another process."""
    file = folder / "scene.yaml"
    file.write_text(SCENE.format(rate=rate, clock=clock, port=""))
    listen = [] if kind == "pty" else ["--listen", f"{kind}://127.0.0.1:0", "--peer", "127.0.0.1"]
    command = [sys.executable, "-m", "hapsim", "mock", str(file), *listen]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            yield hapsim.parse_scene(SCENE.format(rate=rate, clock=clock, port=f", port: '{port}'"), kind)
        finally:
            process.send_signal(signal.SIGTERM)


def exchanges(kind: str, folder: Path, samples: int = 50_000) -> str:
    """Returns the row of exchanges in virtual time."""
    with served(kind, 1000, folder, "lockstep") as scene:
        trace = hapsim.run(scene, duration=samples / scene.rate)
    took = np.diff(trace.time_ns) * 1e-3
    p50, p99 = np.quantile(took, (0.5, 0.99))
    return f"| {kind} | {1e6 / took.mean():.0f} | {p50:.0f} | {p99:.0f} |"


def late_share(kind: str, rate: int, folder: Path, seconds: float) -> float:
    """Returns the share of deadline misses in a run; 1 if the device or a guard ended it."""
    with served(kind, rate, folder) as scene:
        try:
            report = hapsim.run(scene, duration=seconds).report
        except HapsimError:
            return 1.0
    return (report.deadline_misses + report.stale_positions) / max(report.ticks + report.stale_positions, 1)


def felt(kind: str, rate: int, folder: Path, seconds: float) -> str:
    """Returns the row of a rate: late forces, felt k and b, and the predicted ones."""
    late = late_share(kind, rate, folder, seconds)
    with served(kind, rate, folder) as scene:
        predicted = hapsim.predict(scene).parts[0].felt
        try:
            found = hapsim.measure(scene)
            pair = f"{found.k:.1f} ± {found.k_uncertainty:.1f} | {found.b:.3f} ± {found.b_uncertainty:.3f}"
        except HapsimError as error:
            pair = f"– | – ({type(error).__name__})"
    return f"| {kind} | {rate} | {100 * late:.2f} % | {pair} | {predicted.k[0, 0]:.1f}, {predicted.b[0, 0]:.3f} |"


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rates", type=int, nargs="+", default=[1000, 4000, 10_000, 50_000])
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("| transport | exchanges/s | p50 µs | p99 µs |\n|---|---|---|---|")
        for kind in TRANSPORTS:
            print(exchanges(kind, folder), flush=True)
        print("\n| transport | rate Hz | late | k N/m | b N·s/m | predicted |\n|---|---|---|---|---|---|")
        for rate in asked.rates:
            for kind in TRANSPORTS:
                print(felt(kind, rate, folder, asked.seconds), flush=True)
        print("\n| transport | highest rate with 0.1 % late |\n|---|---|")
        for kind in TRANSPORTS:
            highest = 0
            for rate in RATES:
                if min(late_share(kind, rate, folder, asked.seconds) for _ in range(2)) > MOST_LATE:
                    break
                highest = rate
            print(f"| {kind} | {f'{highest} Hz' if highest else f'below {RATES[0]} Hz'} |", flush=True)


if __name__ == "__main__":
    main()
