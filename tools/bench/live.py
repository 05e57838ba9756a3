"""Deadline misses of a running loop while its scene's structure changes, and without changes.

    tools/bench/live [--rounds 4] [--changes 20]

Mock and loop run in this process at 1 kHz over a pseudo-terminal. Runs without changes alternate with runs in which
masses, a string, a cell, a buffer and friction come and go beside the wall that the hand touches.
"""

from __future__ import annotations

import argparse
import statistics
import time

import hapsim

_WALL = """\
version: 1
rate: 1000
device: {mass: 0.2, clock: device, friction: 1.0}
mock: {initial: {velocity: 0.1}}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground, position: 0.0}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 3}
"""
_WITH_STRING = """\
  bob: {type: mass, mass: 0.05}
  rod: {type: viscoelastic, between: [hand, bob], stiffness: 200, damping: 0.5}
  gut: {type: string, masses: 30, mass: 0.001, stiffness: 500}
  tie: {type: spring, between: [bob, gut.4], stiffness: 100}
"""
_WITH_CELL = """\
  bell: {type: cell, mass: 0.05, stiffness: 100, damping: 0.1}
  stop: {type: buffer, between: [hand, bell], stiffness: 200, damping: 0.5, distance: 0.001}
  rub:  {type: friction, between: [hand, wall], force: 0.2, stiffness: 300, damping: 0.1}
"""
_PAUSE_S = 0.2  # between two changes
_OVER_S = 0.05


def run_once(changes: int, changing: bool) -> tuple[int, int, list[float]]:
    """(deadline misses, ticks, seconds that each change took from its call)"""
    wall, string, cell = (hapsim.parse_scene(_WALL + more, "live") for more in ("", _WITH_STRING, _WITH_CELL))
    took = []
    with hapsim.start(wall, transport="terminal") as session:
        for number in range(changes):
            time.sleep(_PAUSE_S)
            if changing:
                begin = time.perf_counter()
                session.adopt((string, wall, cell, wall)[number % 4], over=_OVER_S)
                took.append(time.perf_counter() - begin)
        time.sleep(_PAUSE_S)
        session.stop()
    return session.trace.report.deadline_misses, session.trace.report.ticks, took


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/live", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--changes", type=int, default=20)
    arguments = parser.parse_args()
    for number in range(arguments.rounds):
        for changing in (False, True):
            misses, ticks, took = run_once(arguments.changes, changing)
            what = f"{arguments.changes} changes" if changing else "no change"
            line = f"round {number + 1}, {what}: {misses} deadline misses in {ticks} ticks"
            if took:
                median, mean = 1e3 * statistics.median(took), 1e3 * statistics.mean(took)
                line += f", {median:.0f} ms a change (median; {mean:.0f} on the average)"
            print(line, flush=True)


if __name__ == "__main__":
    main()
