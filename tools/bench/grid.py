"""A grid of a million points through `simulated` and `equivalent`, beside a loop over numpy.roots for ten thousand.

    tools/bench/grid [--rounds 5]

The grid covers the stable part of each configuration's plane and its surroundings. The three take turns, so that a
machine that slows down slows all; ratios are below 1 where the grid is done first.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from hapsim.theory import Configuration

POINTS, ROOTS = 1_000_000, 10_000
CASES = {
    "6.1 no delay": Configuration(mass=1.0, rate=1.0, delay=0.0, hold="impulse"),
    "6.2 delay 1": Configuration(mass=1.0, rate=1.0, delay=1.0, hold="impulse"),
    "6.3 real damping": Configuration(mass=1.0, rate=1.0, friction=0.5, delay=1.0, hold="impulse"),
    "zero-order hold, delay 1": Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=1.0),
    "its filtered damper": Configuration(mass=0.2, rate=1000.0, friction=1.0, damper="filtered", cutoff=100.0),
    "its sensed damper": Configuration(mass=0.2, rate=1000.0, friction=1.0, damper="sensed"),
    "averaged, delay 1.5": Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=1.5, sampling="average"),
}


def seconds(work: Callable[[], object]) -> float:
    """Returns the duration of a call, s."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def plane(c: Configuration) -> tuple[np.ndarray, np.ndarray]:
    """K from nothing to a fifth above the largest that is stable, B likewise."""
    B = np.linspace(-1.0, 2.0, 200) * c.damping_unit
    most_K = np.nanmax(np.append(c.stable_stiffness(B)[1], 0.0))
    most_B = np.nanmax(np.append(c.stable_damping(1e-3 * most_K)[1], 0.0))
    side = int(np.sqrt(POINTS))
    K, B = np.meshgrid(np.linspace(0.0, 1.2 * most_K, side), np.linspace(0.0, 1.2 * most_B, side))
    return K, B


def spread(values: list[float]) -> str:
    """Median, and the range in brackets."""
    return f"{statistics.median(values):.2f} [{min(values):.2f}, {max(values):.2f}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print(
        f"{os.cpu_count()} cores, {platform.system()} {platform.release()}, Python {platform.python_version()}, ",
        end="",
    )
    print(f"NumPy {np.__version__}; {arguments.rounds} rounds: median [least, most]\n")
    print("| configuration | numpy.roots, 1e4, s | simulated, 1e6, s | ratio | equivalent, 1e6, s | ratio |")
    print("|---|---|---|---|---|---|")
    for name, c in CASES.items():
        print(name, file=sys.stderr)
        K, B = plane(c)
        some = np.random.default_rng(1).integers(K.size, size=ROOTS)
        polynomials = c.characteristic(K.ravel()[some], B.ravel()[some])
        times: dict[str, list[float]] = {"roots": [], "simulated": [], "equivalent": []}
        for round_number in range(arguments.rounds + 1):
            taken = {
                "roots": seconds(lambda rows=polynomials: [np.roots(row) for row in rows]),
                "simulated": seconds(lambda c=c, k=K, b=B: c.simulated(k, b)),
                "equivalent": seconds(lambda c=c, k=K, b=B: c.equivalent(k, b)),
            }
            for what, value in taken.items():
                if round_number:  # the first warms up
                    times[what].append(value)
        cells = [name, spread(times["roots"])]
        for what in ("simulated", "equivalent"):
            ratios = [one / other for one, other in zip(times[what], times["roots"], strict=True)]
            cells += [spread(times[what]), spread(ratios)]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
