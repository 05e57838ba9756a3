"""Cost of a point of a sweep, and the gain from more processes and workers.

    tools/bench/sweep [--points 2000] [--rounds 5] [--only point,jobs,cluster,memory]

* point: ms for a prediction, and for a measurement of half a second at 1 kHz, in a sweep on one processor beside
  `hapsim.predict` with margins and `hapsim.measure`, which opens a session: the same scenes, taking turns.
* jobs: the same sweep with one and with two processes, taking turns; the ratio of their times.
* cluster: with one and with two workers of dask.distributed on this machine.
* memory: the most memory of a sweep of 100 000 predictions and measurements on two processes, beside one of 1000.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import hapsim

DURATION = 0.5


def scene_of() -> hapsim.Scene:
    """The first scene, in virtual time."""
    scene = hapsim.load_scene("first_touch")
    return scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})


def stiffnesses(count: int) -> list[float]:
    return np.geomspace(200.0, 5000.0, count).tolist()


def swept(count: int, **options: Any) -> float:
    """Seconds that a sweep takes."""
    begun = time.perf_counter()
    found = hapsim.sweep(scene_of(), {"touch.stiffness": stiffnesses(count)}, duration=DURATION, **options)
    took = time.perf_counter() - begun
    assert not found["error"].values.any()
    return took


def alone(count: int, one: Callable[[hapsim.Scene], Any]) -> float:
    """Seconds that the same scenes take one by one."""
    text = Path(hapsim.__file__).parent.joinpath("configs/first_touch.yaml").read_text("utf-8")
    text = text.replace("clock: device", "clock: lockstep")
    scenes = [hapsim.parse_scene(text.replace("stiffness: 2000", f"stiffness: {k!r}")) for k in stiffnesses(count)]
    begun = time.perf_counter()
    for scene in scenes:
        one(scene)
    return time.perf_counter() - begun


def point(count: int, rounds: int) -> None:
    """Prints what a point costs."""
    ways: dict[str, Callable[[], float]] = {
        "predicted, in a sweep": lambda: swept(count, quantities=("predicted",)),
        "predicted, hapsim.predict": lambda: alone(count, hapsim.predict),
        "measured, in a sweep": lambda: swept(count, quantities=("measured",)),
        "measured, hapsim.measure": lambda: alone(count, lambda scene: hapsim.measure(scene, duration=DURATION)),
    }
    took: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            took[name].append(1e3 * way() / count)
    print(f"| {count} points, {rounds} rounds | ms a point |\n|---|---|")
    for name, values in took.items():
        print(f"| {name} | {spread(values)} |")


def compared(name: str, count: int, rounds: int, of: dict[int, Callable[[], float]]) -> None:
    """Prints how much quicker two are than one, taking turns."""
    took = {number: [] for number in of}
    for _ in range(rounds):
        for number, way in of.items():
            took[number].append(way())
    ratios = [one / two for one, two in zip(took[1], took[2], strict=True)]
    print(f"{count} points: one {name} {spread(took[1])} s, two {spread(took[2])} s: {spread(ratios)} times as fast")


def cluster(count: int, rounds: int) -> None:
    """Prints what a second worker of dask.distributed brings."""
    from distributed import LocalCluster

    def on(workers: int) -> float:
        options = {"threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1", "silence_logs": 50}
        with LocalCluster(n_workers=workers, **options) as found:
            swept(100, scheduler=found.scheduler_address)  # every worker has compiled
            return swept(count, scheduler=found.scheduler_address)

    compared("worker", count, rounds, {1: lambda: on(1), 2: lambda: on(2)})


def memory() -> None:
    """Prints the most memory of a sweep of many points."""
    for count in (1000, 100_000):
        command = [sys.executable, __file__, "--only", "one", "--points", str(count)]
        begun = time.perf_counter()
        printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        took, (own, of_worker) = time.perf_counter() - begun, (int(one) / 1024 for one in printed)
        print(f"{count} points in {took:.0f} s: {own:.0f} MB at most, a worker {of_worker:.0f} MB")


def spread(values: list[float]) -> str:
    """Median, and the range in brackets."""
    return f"{statistics.median(values):.3g} [{min(values):.3g}, {max(values):.3g}]"


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/sweep", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="point,jobs,cluster,memory")
    arguments = parser.parse_args()
    count, rounds = arguments.points, arguments.rounds
    swept(10)  # compiles
    for name in arguments.only.split(","):
        if name == "point":
            point(count // 10, rounds)
        elif name == "jobs":
            compared("process", count, rounds, {jobs: lambda jobs=jobs: swept(count, jobs=jobs) for jobs in (1, 2)})
        elif name == "cluster":
            cluster(count, rounds)
        elif name == "memory":
            memory()
        elif name == "one":
            swept(count, jobs=2)
            print(*(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


if __name__ == "__main__":
    main()
