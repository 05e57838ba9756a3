"""Two reference firmwares tied over two ports, in real time.

    tools/bench/ports [--minutes 10] [--no-ends]

Two Linux boards hold a hand each, of 0.2 kg, on one spring of 2000 N/m and 5 N·s/m; a heavy mass that swings draws both
along. First the run: exchanges of each port, what came late, and how far the ports' clocks were off their arrivals.
Then each board is unplugged (the terminal between closes), killed and stopped. In the table: from that moment until the
other board has zero force, by that board's clock, and what is stated: the other port is released within a force's time
to live, 20 ms, after the first failed; a device that only goes quiet has failed after 0.25 s.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from kills import Board

import hapsim
from hapsim.errors import HapsimError
from hapsim.scene import Scene

SCENE = """\
version: 1
rate: 1000
devices:
  left:  {{port: {left}, mass: 0.2, friction: 1}}
  right: {{port: {right}, mass: 0.2, friction: 1}}
modules:
  a: {{type: device, of: left, channel: 0}}
  b: {{type: device, of: right, channel: 0}}
  tie: {{type: viscoelastic, between: [a, b], stiffness: 2000, damping: 5}}
  wall: {{type: ground}}
  heavy: {{type: mass, mass: 10, velocity: 0.5}}
  swing: {{type: viscoelastic, between: [heavy, wall], stiffness: 1000, damping: 0}}
  draw: {{type: viscoelastic, between: [a, heavy], stiffness: 100, damping: 1}}
  rest: {{type: viscoelastic, between: [b, wall], stiffness: 100, damping: 1}}
"""
STATED_MS = {"unplugged": 20.0, "killed": 20.0, "stopped": 270.0}
NAMES = ("left", "right")
RUN_UP_S = 2.0


class Relay:
    """A terminal in front of a board's, which can be unplugged: the board goes on."""

    def __init__(self, port: str) -> None:
        self._host, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave, self._board = slave, os.open(port, os.O_RDWR | os.O_NOCTTY)
        self._ends, self._end = os.pipe()
        threading.Thread(target=self._pass_on, daemon=True).start()

    def _pass_on(self) -> None:
        ways = {self._host: self._board, self._board: self._host}
        while True:
            ready = select.select([*ways, self._ends], [], [])[0]
            if self._ends in ready:
                break
            for one in ready:
                with contextlib.suppress(OSError):
                    os.write(ways[one], os.read(one, 4096))
        for one in (self._host, self._slave, self._board):
            os.close(one)

    def unplug(self) -> None:
        os.write(self._end, b"x")


@contextlib.contextmanager
def two_boards(place: Path) -> Iterator[dict[str, Board]]:
    boards = {name: Board(place / name) for name in NAMES}
    try:
        yield boards
    finally:
        for one in boards.values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(one.process.pid, signal.SIGCONT)
            one.process.kill()
            one.process.wait()


def scene_of(ports: dict[str, str]) -> Scene:
    return hapsim.parse_scene(SCENE.format(**ports))


def run_for(minutes: float) -> None:
    with tempfile.TemporaryDirectory() as place, two_boards(Path(place)) as boards:
        scene = scene_of({name: one.port for name, one in boards.items()})
        with hapsim.start(scene, duration=60.0 * minutes, keep=False, realtime=True) as session:
            while not session.wait(1.0):
                pass
        print(
            f"{minutes:g} min\n\n| port | exchanges | deadline misses | stale | lost | lateness p99 | force limited |"
        )
        print("|---|---|---|---|---|---|---|")
        for name, trace in session.traces.items():
            report, late = trace.report, trace.statistics.lateness
            cells = (report.ticks, report.deadline_misses, report.stale_positions, report.lost_frames)
            late_us = f"{1e6 * late.quantile(0.99):.0f} µs"
            print(f"| {name} | {' | '.join(map(str, cells))} | {late_us} | {report.limited_ticks} |")
        print({name: trace.report.ending for name, trace in session.traces.items()}, flush=True)


def end_of(how: str, name: str) -> list[Any] | None:
    """Returns the row of a case; None if a busy machine ended the run before."""
    other = NAMES[1 - NAMES.index(name)]
    with tempfile.TemporaryDirectory() as place, two_boards(Path(place)) as boards:
        relay = Relay(boards[name].port) if how == "unplugged" else None
        ports = {one: board.port for one, board in boards.items()} | ({name: relay.port} if relay else {})
        ends: dict[str, Callable[[], object]] = {
            "unplugged": lambda: relay and relay.unplug(),
            "killed": boards[name].process.kill,
            "stopped": lambda: os.kill(boards[name].process.pid, signal.SIGSTOP),
        }
        try:
            with hapsim.start(scene_of(ports), realtime=True) as session:
                if session.wait(RUN_UP_S):
                    return None
                before = boards[other].put_out()
                ends[how]()
                session.wait(5.0)
            sentence = "no error"
        except HapsimError as error:
            sentence = str(error)
        if "before" not in locals():
            return None
        time.sleep(0.3)
        forces = boards[other].put_out()
        last = max(i for i, (_, counts) in enumerate(forces) if counts)
        zero_ms = 1e-3 * (forces[min(last + 1, len(forces) - 1)][0] - before[-1][0])
        is_named = sentence.startswith(f"{name}:") or name in sentence.split(". ")[0]
        return [name, how, f"{zero_ms:.1f}", f"{STATED_MS[how]:.0f}", "yes" if is_named else "no", sentence[:110]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--no-ends", action="store_true")
    options = parser.parse_args()
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    if options.minutes:
        run_for(options.minutes)
    if options.no_ends:
        return
    print("\n| board | how | other at zero after, ms | stated | named | the user read |\n|---|---|---|---|---|---|")
    for name in NAMES:
        for how in STATED_MS:
            row = next((found for _ in range(5) if (found := end_of(how, name))), None)
            print(f"| {' | '.join(row)} |" if row else f"| {name} | {how} | the machine was too busy |", flush=True)


if __name__ == "__main__":
    main()
