"""Walls that meet: random mazes on a grid with exact joints, against a place that follows the hand over their bodies.

    tools/bench/joints [--mazes 2000] [--first 0]

In each maze a hand is pressed for six seconds, is given work on closed ways within the walls, and is thrown at the
walls of a closed room by up to 0.9 of their thickness in a sample. The bench counts hands whose force at rest is not
K times the way to the referee's place, within K times 0.1 um; that shake in the sixth second, by 1 um or more, where
the referee's hand rests and the prediction calls the place stable; that gain more than 1e-9 J; and that leave a room.
"""

from __future__ import annotations

import argparse
from collections import Counter

import hapsim
from tests.plane_mazes import LOOP_J, OFF_M, OUT_M, SWING_M, pressed, thrown, worked


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mazes", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    worst = {"force off by, um": 0.0, "work, J": 0.0, "out of a room, m": -1.0}
    for seed in range(options.first, options.first + options.mazes):
        faults, press = list[str](), pressed(seed)
        if press is not None and not press.leaves:
            rests = press.own_swing < SWING_M
            counts["pressed"] += 1
            counts["pressed, and the referee's hand rests"] += rests
            if rests and press.swing < SWING_M:
                worst["force off by, um"] = max(worst["force off by, um"], 1e6 * press.off)
                faults += [f"force off by K times {1e6 * press.off:.3g} um"] * (press.off > OFF_M)
            elif rests and hapsim.predict(press.scene, with_margins=False, at=press.end).stable_as_taken:
                faults.append(f"shakes by {1e6 * press.swing:.3g} um, {1e6 * press.own_swing:.3g} of the referee's")
            elif rests:
                counts["shakes, and is called unstable"] += 1
        for work in worked(seed):
            counts["closed ways"] += 1
            worst["work, J"] = max(worst["work, J"], work)
            faults += [f"gains {work:.3g} J"] * (work > LOOP_J)
        out = thrown(seed)
        counts["thrown"] += 1
        worst["out of a room, m"] = max(worst["out of a room, m"], out)
        faults += [f"leaves its room by {out:.3g} m"] * (out > OUT_M)
        counts["faults"] += len(faults)
        for fault in faults:
            print(f"seed {seed}: {fault}", flush=True)
    print(
        f"{options.mazes} mazes: {dict(counts)}; most: { {name: float(f'{one:.3g}') for name, one in worst.items()} }"
    )


if __name__ == "__main__":
    main()
