"""Ten seconds of first_touch at 1 kHz in real time over a pseudo-terminal: rate, deadline misses, k and b by clock.

    tools/bench/realtime [--seconds 10] [--rounds 3]

The clocks take turns, so that a machine that slows down slows both.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path

import hapsim
from hapsim.prediction import Felt

SCENE = Path(__file__).resolve().parents[2] / "configs" / "first_touch.yaml"


@dataclass(frozen=True)
class Round:
    """One run."""

    rate_hz: float
    missed_share: float
    max_age_samples: int
    max_lateness_ms: float
    k_error: float
    b_error: float


def run_once(clock: str, seconds: float, felt: Felt) -> Round:
    """One measurement with this clock."""
    scene = hapsim.load_scene(SCENE)
    scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": clock})})
    measurement = hapsim.measure(scene, duration=seconds, transport="terminal")
    report = measurement.trace.report
    return Round(
        report.rate_hz,
        report.deadline_misses / report.ticks,
        int(report.age_samples.max or 0),
        1e3 * (report.lateness_s.max or 0.0),
        measurement.k / felt.k - 1.0,
        measurement.b / felt.b - 1.0,
    )


def spread(values: list[float], form: str) -> str:
    """Median, and the range in brackets."""
    return f"{statistics.median(values):{form}} [{min(values):{form}}, {max(values):{form}}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    felt = hapsim.predict(hapsim.load_scene(SCENE)).felt[0]
    rounds: dict[str, list[Round]] = {"device": [], "host": []}
    for clock in rounds:
        run_once(clock, 1.0, felt)  # compiles, and is not counted
    for i in range(arguments.rounds):
        for clock, results in rounds.items():
            print(f"round {i + 1} of {arguments.rounds}, clock: {clock}", file=sys.stderr)
            results.append(run_once(clock, arguments.seconds, felt))
    print(f"{os.cpu_count()} cores, {platform.system()} {platform.release()}, Python {platform.python_version()};")
    print(f"1 kHz, {arguments.seconds:g} s, {arguments.rounds} rounds: median [least, most]\n")
    print("| clock | rate Hz | deadline misses | oldest force, samples | latest, ms | k off by | b off by |")
    print("|---|---|---|---|---|---|---|")
    for clock, results in rounds.items():
        cells = [
            clock,
            spread([r.rate_hz for r in results], ".2f"),
            spread([100 * r.missed_share for r in results], ".2f") + " %",
            spread([r.max_age_samples for r in results], ".0f"),
            spread([r.max_lateness_ms for r in results], ".2f"),
            spread([r.k_error for r in results], "+.1e"),
            spread([r.b_error for r in results], "+.1e"),
        ]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
