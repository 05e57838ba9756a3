"""Clients that come and go for an hour: does the memory of a served run stay what it is?

    tools/bench/clients [--minutes 60] [--rate 1000]

`hapsim run --realtime` with its WebSocket, OSC and OSCQuery. All the time some clients subscribe, read for a while and
leave, in good order or without a word; some subscribe and never read; some ask OSCQuery, listen there, or leave a
request half sent; OSC sets a parameter fifty times a second. Every 10 s the memory of the run is read (RSS), and at the
end set against a straight line.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import random
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from panel import HELD, STIFFNESS, origin_of, osc_message, paced, served
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

EVERY_S = 10.0
WARM_UP_S = 120.0  # until the history is full: it has 60 s
SUBSCRIBED = json.dumps({"type": "subscribe", "rate": 60, "history": 60, "modules": ["hand"]})


def viewer(url: str, choose: random.Random) -> str:
    """Reads for some seconds."""
    with connect(url, origin=origin_of(url), max_size=None, open_timeout=30) as client:
        client.send(SUBSCRIBED)
        leave = time.monotonic() + choose.uniform(0.1, 8.0)
        while time.monotonic() < leave:
            with contextlib.suppress(TimeoutError):
                client.recv(timeout=1.0)
        if choose.random() < 0.5:
            client.socket.shutdown(socket.SHUT_RDWR)
            return "viewers that vanished"
    return "viewers"


def slow_reader(url: str, choose: random.Random) -> str:
    """Subscribes to every sample, and reads nothing until it is dropped."""
    with connect(url, origin=origin_of(url), max_queue=1, open_timeout=30) as client:
        client.send(SUBSCRIBED.replace('"rate": 60', '"rate": 0'))
        time.sleep(choose.uniform(1.0, 20.0))
    return "slow readers"


def asker(osc: int, choose: random.Random) -> str:
    """Asks OSCQuery, or leaves in the middle of a request."""
    if choose.random() < 0.3:
        with socket.create_connection(("127.0.0.1", osc), timeout=10) as half:
            half.sendall(b"GET /hapsim HT")
            time.sleep(choose.uniform(0.0, 3.0))
        return "half requests"
    asking = http.client.HTTPConnection("127.0.0.1", osc, timeout=30)
    with contextlib.closing(asking):
        for path in ("/?HOST_INFO", "/", "/hapsim/wall/position?VALUE"):
            asking.request("GET", path)
            asking.getresponse().read()
    return "queries"


def listener(osc: int, choose: random.Random) -> str:
    """Listens to a parameter over OSCQuery's WebSocket."""
    with connect(f"ws://127.0.0.1:{osc}/", open_timeout=30) as client:
        client.send(json.dumps({"COMMAND": "LISTEN", "DATA": "/hapsim/wall/position"}))
        leave = time.monotonic() + choose.uniform(0.5, 5.0)
        while time.monotonic() < leave:
            with contextlib.suppress(TimeoutError):
                client.recv(timeout=0.5)
    return "listeners"


def again_and_again(one: Callable[[], str], until: float, done: Counter[str]) -> threading.Thread:
    """A thread in which one client follows the other."""

    def go_on() -> None:
        while time.monotonic() < until:
            try:
                done[one()] += 1
            except (OSError, WebSocketException, http.client.HTTPException) as error:
                done[f"refused: {type(error).__name__}"] += 1
                time.sleep(0.5)

    thread = threading.Thread(target=go_on, daemon=True)
    thread.start()
    return thread


def memory_mb(process: int) -> float | None:
    """RSS; None where the process has ended."""
    lines = Path(f"/proc/{process}/status").read_text("utf-8").splitlines()
    found = next((line for line in lines if line.startswith("VmRSS")), None)
    return None if found is None else int(found.split()[1]) / 1024.0


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/clients", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=int, default=1000, help="Hz")
    arguments = parser.parse_args()
    done: Counter[str] = Counter()
    times, memory = [], []
    scene = HELD.replace("rate: 1000", f"rate: {arguments.rate}")
    if arguments.rate < 1000:  # what is stable there
        scene = scene.replace(f"stiffness: {STIFFNESS}", "stiffness: 2").replace("stiffness: 10,", "stiffness: 1,")
    with tempfile.TemporaryDirectory() as directory, served(Path(directory), "--realtime", scene=scene) as run:
        (url, osc, report, process), begun = run, time.monotonic()
        until = begun + 60.0 * arguments.minutes
        kinds = [
            *(partial(viewer, url),) * 4,
            *(partial(slow_reader, url),) * 2,
            partial(asker, osc),
            partial(listener, osc),
        ]
        for number, kind in enumerate(kinds):
            again_and_again(partial(kind, random.Random(number)), until, done)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for i in paced(50.0, 60.0 * arguments.minutes):
                with contextlib.suppress(ConnectionRefusedError):
                    out.sendto(osc_message("/hapsim/wall/position", 1e-4 * np.sin(0.01 * i)), ("127.0.0.1", osc))
                if i % round(50 * EVERY_S) == 0:
                    if (now := memory_mb(process)) is None:
                        break
                    times.append(time.monotonic() - begun)
                    memory.append(now)
                    clients = f"{sum(done.values())} clients"
                    print(f"\r{times[-1] / 60:.1f} min, {memory[-1]:.1f} MB, {clients}", end="", flush=True)
    result = report[0]
    ended = result.get("error") or result["ending"]
    print(f"\n{ended}: {result['ticks']} ticks, {result['deadline_misses']} deadline misses")
    print(", ".join(f"{number} {name}" for name, number in sorted(done.items())))
    later = np.array(times) > WARM_UP_S
    if later.sum() > 2:
        slope, _ = np.polyfit(np.array(times)[later] / 60.0, 1024.0 * np.array(memory)[later], 1)
        least, most = np.min(np.array(memory)[later]), np.max(np.array(memory)[later])
        print(f"after {WARM_UP_S / 60:.0f} min: {least:.1f} to {most:.1f} MB, {slope:+.1f} kB a minute")


if __name__ == "__main__":
    main()
