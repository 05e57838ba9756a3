"""Boards that follow a line wrongly, before a whole host with its guards: how far the hand gets, and what ends the run.

    tools/bench/board_faults [--seconds 2] [--stiffness 2000,30000] [--also frozen,leaps,late]

A simulated device of 0.2 kg and 1 N·s/m on a spring of 5 N·s/m and 10 N, at 10 kHz behind a host at 1 kHz. It is
released 1 mm off the rest of the spring, or pushed by 2 N for half a second, with the soft start of a port and a travel
of 5 cm. The device's own force limit is twice the scene's. `--also`: its sensor freezes or leaps by 5 mm after 0.3 s,
or three of ten answers are late.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "loop"))

from board_device import BoardDevice, Line, force_of, scene_with
from test_loop_board_exchange import MOST, EndedError, Host, lines

from firmware_protocol import schema
from hapsim.loop.guards import GUARDS
from hapsim.running.session_options import RunOptions

NAMES = {guard.code: guard.name for guard in GUARDS if guard.code is not None}


def but(**factors: float) -> Callable[[Line, float, float], float]:
    """Returns the force of a board that multiplies numbers of a line, or f itself, by these factors."""

    def follows(line: Line, ahead: float, speed: float) -> float:
        force, k, b = (n * factors.get(name, 1.0) for n, name in zip(line, "Fkb", strict=False))
        low, high = (-MOST, MOST) if "free" in factors else (n * factors.get("bounds", 1.0) for n in line[3:])
        found = factors.get("f", 1.0) * force_of((force, k, b, low, high), ahead, speed)
        return min(max(found, -MOST), MOST)

    return follows


FAULTS: dict[str, dict[str, Any]] = {
    "none": {},
    "f reversed": {"follows": but(f=-1.0)},
    "f times 0.1": {"follows": but(f=0.1)},
    "f times 10": {"follows": but(f=10.0)},
    "F reversed": {"follows": but(F=-1.0)},
    "k reversed": {"follows": but(k=-1.0)},
    "k times 0.1": {"follows": but(k=0.1)},
    "k times 10": {"follows": but(k=10.0)},
    "k ignored": {"follows": but(k=0.0)},
    "b reversed": {"follows": but(b=-1.0)},
    "b times 10": {"follows": but(b=10.0)},
    "b ignored": {"follows": but(b=0.0)},
    "bounds ignored": {"follows": but(free=1.0)},
    "bounds times 0.1": {"follows": but(bounds=0.1)},
    "bounds times 10": {"follows": but(bounds=10.0)},
    "x_n ignored": {"later": 99},
    "x_n a sample later": {"later": 1},
    "x_n a sample earlier": {"later": -1},
    "x_n ten samples earlier": {"later": -10},
}


class Sensor:
    """Reading of a place, m: right, until it stands still or is off."""

    def __init__(self) -> None:
        self.off, self.stuck = 0.0, math.nan

    def __call__(self, x: float) -> float:
        return x + self.off if math.isnan(self.stuck) else self.stuck


class Found(NamedTuple):
    """The hand's way, m, after 20 ms and at most; the largest force, N, and the last sample with one; the guard that
    ended the run, at a sample."""

    early: float
    most: float
    force: float
    last: int
    guard: str
    sample: int


def tried(
    fault: str, stiffness: float, delay: int, pushed: bool, samples: int = 2000, also: str = "", **device: Any
) -> Found:
    """Returns what a board with this fault does, released off the spring's rest or pushed. `also`: a second fault."""
    link = {"type": "viscoelastic", "stiffness": stiffness, "damping": 5}
    more = {"friction": 1.0, "delay": delay, "clock": "device", "travel": [-0.05, 0.05]} | device
    scene = scene_with({"touch": link}, device=more)
    host = Host(scene, RunOptions(judges_energy=True, judges_sign=True, unstable=True), is_port=True, lines=lines())
    sensor, late = Sensor(), np.random.default_rng(0).random(samples) < (0.3 if also == "late" else 0.0)
    start = 0.0 if pushed else 1e-3
    board = BoardDevice(start, 0.0, friction=1.0, delay=delay, reads=sensor, **FAULTS[fault])
    early, most, force, last = 0.0, 0.0, 0.0, 0
    for n in range(samples):
        if pushed and n < 500:
            board.v += 2.0 / 0.2 * 1e-3
        if n == 300 and also in ("frozen", "leaps"):
            sensor.stuck, sensor.off = (board.x, 0.0) if also == "frozen" else (math.nan, 5e-3)
        kind = schema.POSITION_HELD if n > delay and late[n - 1 - delay] else schema.POSITION
        try:
            board.sample(partial(host.answer, kind=kind), late=bool(late[n]))
        except EndedError as ended:
            code = int(ended.args[0])
            return Found(early, most, force, last, NAMES.get(code, str(code)), n)
        acted = abs(float(host.row["acted_force"][0]))
        most, force, last = max(most, abs(board.x)), max(force, acted), n if acted > 0.01 else last
        early = most if n < 20 else early
    return Found(early, most, force, last, "", samples)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--stiffness", default="2000,30000")
    parser.add_argument("--soft-start", type=float, default=None)
    parser.add_argument("--also", default="", help="a second fault of each: frozen, leaps, late")
    parser.add_argument("--faults", default=",".join(FAULTS))
    options = parser.parse_args()
    more = {} if options.soft_start is None else {"soft_start": options.soft_start}
    for fault, also in itertools.product(options.faults.split(","), options.also.split(",")):
        for stiffness in map(float, options.stiffness.split(",")):
            for pushed in (False, True):
                cells = []
                for delay in (1, 5):
                    one = tried(fault, stiffness, delay, pushed, round(1000.0 * options.seconds), also, **more)
                    ended = f"{one.guard} at {one.sample}" if one.guard else f"force until {one.last}"
                    cells.append(f"{one.early * 1e3:6.2f} {one.most * 1e3:7.2f} mm {one.force:5.2f} N {ended}")
                words = f"{fault}{also and ', ' + also}, {stiffness:g} N/m, {'pushed' if pushed else 'released'}"
                print(f"{words:36} delay 1: {cells[0]:45} delay 5: {cells[1]}", flush=True)


if __name__ == "__main__":
    main()
