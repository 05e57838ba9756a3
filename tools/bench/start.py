"""Duration and processor time of a start: of the first, which compiles, and of later ones.

    tools/bench/start [--rounds 5] [--random 40] [--only PART ...] [--json FILE]

first   `hapsim run configs/first_touch.yaml` with an empty cache, to its first tick: loop and mock, and the process
        that compiles one of them in parallel
armed   the same with a full cache, until the device is armed, as a mock of this process reports; in turn with
        `hapsim --help`, which is Python and the command line alone
scenes  after a first start of first_touch: each shipped scene, then random scenes of every module, scheme,
        precision, clock and number of channels, in one cache; the extra time of each one's first run over its second

Processor seconds are those of all processes that a command started.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from random_scenes import random_scenes

import hapsim
from firmware_protocol import schema
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.firmware import prepare, take_bytes

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SCENE = CONFIGS / "first_touch.yaml"
_SEED = 1


class CommandFailed(SystemExit):
    """A command of hapsim's that did not end with status 0."""


@dataclass(frozen=True)
class Took:
    """Seconds."""

    wall: float
    processor: float


def run(*words: str, cache: str | None = None) -> Took:
    """The whole of a command."""
    environment = os.environ | ({} if cache is None else {"XDG_CACHE_HOME": cache})
    begin = time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    took = Took(time.perf_counter() - begin, usage.ru_utime + usage.ru_stime)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise CommandFailed(f"{' '.join(words)}: exit status {process.returncode}")
    return took


def run_scene(path: Path, cache: str) -> Took:
    return run("hapsim", "run", str(path), "--duration", "0.001", cache=cache)


class Listener:
    """A device on a pseudo-terminal that notes when it is armed."""

    def __init__(self) -> None:
        self._near, self._far = pty.openpty()
        for end in (self._near, self._far):
            tty.setraw(end)
        self.path = os.ttyname(self._far)
        self.armed_at: float | None = None
        self._mock = assemble_mock(hapsim.load_scene(SCENE))
        prepare(self._mock)
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while data := os.read(self._near, 4096):
            take_bytes(self._mock, np.frombuffer(data, np.uint8).copy(), len(data), time.monotonic_ns())
            if self._mock.board.state == schema.ARMED and self.armed_at is None:
                self.armed_at = time.perf_counter()
            waiting = int(self._mock.board.out)
            os.write(self._near, self._mock.outbox[:waiting].tobytes())
            self._mock.board.out = 0

    def seconds_to_armed(self) -> float:
        """Returns the time from the start of a run until the device is armed."""
        self.armed_at = None
        begin = time.perf_counter()
        run("hapsim", "run", str(SCENE), "--port", self.path, "--duration", "0.001", "--json")
        if self.armed_at is None:
            raise SystemExit("the device was never armed")
        return self.armed_at - begin


def measure_first(rounds: int) -> dict[str, Any]:
    found = []
    for number in range(rounds):
        log(f"first start {number + 1} of {rounds}")
        with tempfile.TemporaryDirectory() as empty:
            found.append(run_scene(SCENE, empty))
    return {"first": [asdict(took) for took in found]}


def measure_armed(rounds: int) -> dict[str, Any]:
    listener = Listener()
    listener.seconds_to_armed()  # compiles, where that was never done, and is not counted
    found: dict[str, list[float]] = {"armed": [], "help": []}
    for number in range(rounds):
        log(f"later start {number + 1} of {rounds}")
        found["help"].append(run("hapsim", "--help").wall)
        found["armed"].append(listener.seconds_to_armed())
    return found


def measure_scenes(random: int) -> dict[str, Any]:
    rows = []
    with tempfile.TemporaryDirectory() as place:
        shipped = sorted(CONFIGS.glob("*.yaml"))
        paths = list(shipped)
        for number, text in enumerate(random_scenes(random, _SEED)):
            paths.append(Path(place) / f"random_{number}.yaml")
            paths[-1].write_text(text, encoding="utf-8")
        run_scene(SCENE, place)
        for number, path in enumerate(paths):
            log(f"scene {number + 1} of {len(paths)}")
            try:
                first, second = run_scene(path, place), run_scene(path, place)
            except CommandFailed as error:  # on a busy machine a device may fall silent
                log(f"skipped: {error}")
                continue
            more = {"wall": first.wall - second.wall, "processor": first.processor - second.processor}
            row = {"scene": path.stem, "by_chance": path not in shipped, "more": more}
            rows.append(row | {"first": asdict(first), "second": asdict(second)})
    return {"scenes": rows}


def report(found: dict[str, Any]) -> None:
    if "first" in found:
        for what in ("wall", "processor"):
            print(f"first start, {what}: {spread([took[what] for took in found['first']])}")
    if "armed" in found:
        print(f"later starts, to armed: {spread(found['armed'])}; hapsim --help: {spread(found['help'])}")
    for row in found.get("scenes", ()):
        more, second = row["more"], row["second"]
        print(
            f"{row['scene']}: {more['wall']:+.2f} s and {more['processor']:+.2f} s of processor time "
            f"more than the second time, which took {second['wall']:.2f} s"
        )
    for kind, chosen in (("shipped", False), ("random", True)):
        mores = [row["more"] for row in found.get("scenes", ()) if row["by_chance"] is chosen]
        for what in ("wall", "processor") if mores else ():
            more = [one[what] for one in mores]
            print(f"{len(more)} {kind} scenes, more {what}: {statistics.median(more):.2f} s, {max(more):.2f} s at most")


def spread(seconds: list[float]) -> str:
    return f"{statistics.median(seconds):.2f} s [{min(seconds):.2f}, {max(seconds):.2f}]"


def log(words: str) -> None:
    """A sign of life."""
    print(words, file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/start", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--random", type=int, default=40, metavar="N", help="number of random scenes")
    parts: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
        "first": lambda arguments: measure_first(arguments.rounds),
        "armed": lambda arguments: measure_armed(arguments.rounds),
        "scenes": lambda arguments: measure_scenes(arguments.random),
    }
    parser.add_argument("--only", nargs="+", choices=parts, default=list(parts), metavar="PART")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every number")
    arguments = parser.parse_args()
    found: dict[str, Any] = {}
    for part in arguments.only:
        found |= parts[part](arguments)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    report(found)


if __name__ == "__main__":
    main()
