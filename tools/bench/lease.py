"""Clients that hold a lease and are killed, stopped, cut off or hang at random moments: when does the fallback begin?

One scene runs on the mock in real time and is served. One client after the other begins a lease of 50 to 200 ms and
renews it every third of that: over the WebSocket or OSC in a process of its own, or from a thread of this program. At
a random moment it is killed (SIGKILL) or stopped (SIGSTOP), what passes its messages on ceases to (neither end learns
of it), its thread hangs, or a call into C hangs that holds Python's lock.

The record has the tick that took each renewal, the sample at which each lease ran out, and the arrival of every
position. From these, not from the loop's own count, follows how late the fallback began after the lease's end, and
whether a tick before it was due already.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import os
import random
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import hapsim
from hapsim.errors import UsageError
from hapsim.live.access import address_of
from hapsim.live.hub import Hub
from hapsim.live.osc import OscView
from hapsim.live.server import Server
from hapsim.live.web import WebView
from hapsim.recording.stream import open_record

WAYS = [*(f"{wire} {end}" for wire in ("websocket", "osc") for end in ("killed", "stopped", "cut off"))]
WAYS += ["thread hangs", "thread hangs with Python's lock"]
SCENE = """
version: 1
rate: 1000
device: {clock: host, mass: 0.2, friction: 1.0, force_limit: 10}
mock: {hand: {position: 0.01, stiffness: 500, damping: 5}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 300, damping: 3}
"""
CLIENT = r"""
import json, os, socket, struct, sys, time
wire, port, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
if wire == "osc":
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.connect(("127.0.0.1", port))
    data = b"/hapsim/lease\0\0\0,f\0\0" + struct.pack(">f", seconds)
else:
    s = socket.create_connection(("127.0.0.1", port))
    host = sys.argv[4]
    words = f"GET /live HTTP/1.1|Host: {host}|Origin: http://{host}|Upgrade: websocket|Connection: Upgrade|"
    words += "Sec-WebSocket-Version: 13|Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==||"
    s.sendall(words.replace("|", "\r\n").encode())
    head = b""
    while b"\r\n\r\n" not in head: head += s.recv(4096) or sys.exit("refused")
    text = json.dumps({"type": "lease", "seconds": seconds}).encode()
    data = bytes([0x81, 0x80 | len(text)]) + bytes(4) + text
    s.setblocking(False)
while True:
    s.send(data)
    time.sleep(seconds / 3)
    try:
        if wire != "osc": s.recv(1 << 16)
    except BlockingIOError: pass
"""


class Proxy:
    """Passes on what comes to its port, until `cut`."""

    def __init__(self, wire: str, port: int) -> None:
        kind = socket.SOCK_DGRAM if wire == "osc" else socket.SOCK_STREAM
        self._near, self._to, self.cut = socket.socket(socket.AF_INET, kind), ("127.0.0.1", port), threading.Event()
        self._near.bind(("127.0.0.1", 0))
        self.port = self._near.getsockname()[1]
        self._open = [self._near]
        if wire != "osc":
            self._near.listen()
        threading.Thread(target=self._pass_on, args=(wire,), daemon=True).start()

    def _pass_on(self, wire: str) -> None:
        with contextlib.suppress(OSError):
            here = self._near if wire == "osc" else self._near.accept()[0]
            there = socket.socket(socket.AF_INET, self._near.type)
            self._open += [here, there]
            there.connect(self._to)
            pairs = {here: there} if wire == "osc" else {here: there, there: here}
            while not self.cut.is_set():
                for one in select.select(list(pairs), [], [], 0.01)[0]:
                    pairs[one].sendall(one.recv(1 << 16))

    def close(self) -> None:
        self.cut.set()
        for one in self._open:
            one.close()


@contextlib.contextmanager
def client(way: str, seconds: float, ports: dict[str, int]) -> Iterator[Callable[[], None]]:
    """A client that renews a lease; yields what makes it cease."""
    wire, _, end = way.partition(" ")
    proxy = Proxy(wire, ports[wire])
    port = proxy.port if end == "cut off" else ports[wire]
    host = f"127.0.0.1:{ports[wire]}"
    process = subprocess.Popen([sys.executable, "-S", "-E", "-c", CLIENT, wire, str(port), str(seconds), host])
    try:
        if end == "cut off":
            yield proxy.cut.set
        else:
            yield lambda: os.kill(process.pid, signal.SIGKILL if end == "killed" else signal.SIGSTOP)
    finally:
        process.kill()
        process.wait()
        proxy.close()


@contextlib.contextmanager
def thread(way: str, seconds: float, session: hapsim.Session) -> Iterator[Callable[[], None]]:
    """The same in a thread of this program."""
    hangs, over = threading.Event(), threading.Event()

    def renew() -> None:
        while not hangs.wait(seconds / 3):
            session.lease(seconds, owner=way)
        if "lock" in way:
            ctypes.PyDLL(None).usleep(int(2e6 * seconds))
        over.wait()

    while True:  # the last request of a client before may still be under way, and is granted then
        with contextlib.suppress(UsageError):
            session.lease(seconds, owner=way)
            break
        time.sleep(1e-3)
    one = threading.Thread(target=renew, daemon=True)
    one.start()
    try:
        yield hangs.set
    finally:
        over.set()
        one.join()


class Found(NamedTuple):
    """One lease that ran out."""

    late_ms: float
    """From the end of the lease to the position with whose force the fallback began."""
    missed: int
    """Positions before that at which it was over already."""


def found_in(record: Path) -> list[Found]:
    """Reads when each lease ran out, from the rows and notes of a record."""
    reader = open_record(record)
    rows = [np.array(piece[["sample", "time_ns"]]) for piece in reader.rows()]
    sample, arrived = (np.concatenate([piece[name] for piece in rows]) for name in ("sample", "time_ns"))
    asked = [note for note in reader.notes if "lease" in note]
    found = []
    for end in (note["lease_ran_out"] for note in reader.notes if "lease_ran_out" in note):
        last = max((note for note in asked if note["sample"] < end), key=lambda note: note["tick"])
        due, at = arrived[last["tick"]] + round(last["lease"] * 1e9), int(np.searchsorted(sample, end))
        found.append(Found((arrived[at] - due) * 1e-6, int(np.sum(arrived[last["tick"] : at] >= due))))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    chance, scene = random.Random(arguments.seed), hapsim.parse_scene(SCENE)
    hub, ways = Hub(scene, name="lease"), dict.fromkeys(WAYS, 0)
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "run.trace"
        session = hapsim.start(scene, transport="paced", record=record, keep=False, unstable=False, **hub.options)
        hub.observer.started(session)
        web = WebView(hub, address_of("--serve-at", None, 0), print)
        osc = OscView(hub, address_of("--osc-at", None, 0), (), print)
        server = Server([web, osc], print)
        server.start()
        ports: dict[str, int] = {"websocket": web.address.port, "osc": osc.address.port}
        session.lease(0.05)
        for number in range(arguments.moments):
            while not session.lease_state["out"]:
                time.sleep(1e-3)
            way, seconds = WAYS[number % len(WAYS)], chance.uniform(0.05, 0.2)
            holder = client(way, seconds, ports) if way.split()[0] in ports else thread(way, seconds, session)
            with holder as cease:
                while session.lease_state["out"]:
                    time.sleep(1e-3)
                time.sleep(chance.uniform(0.0, 0.25))
                is_kept = not session.lease_state["out"]
                cease()
                ways[way] += is_kept
                while not session.lease_state["out"]:
                    time.sleep(1e-3)
        server.close()
        session.close()
        found, late = found_in(record), session.trace.report.deadline_misses
    print(f"{sum(ways.values())} clients ceased while they held a lease: {ways}")
    print(
        f"{len(found)} leases ran out; of these, with a position after the end that was not answered by it: "
        f"{sum(one.missed > 0 for one in found)}"
    )
    print(
        f"from the lease's end to that position: p50 {np.median([one.late_ms for one in found]):.3f} ms, most "
        f"{max(one.late_ms for one in found):.3f} ms; the scene's period is 1 ms, {late} deadline misses"
    )
    return int(any(one.missed for one in found))


if __name__ == "__main__":
    sys.exit(main())
