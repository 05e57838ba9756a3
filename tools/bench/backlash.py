"""Swings in the play of a transmission: as predicted, and as the mock moves, in random scenes.

    tools/bench/backlash [--cases 50] [--seed 0]

Prints each case with a swing, and how many predictions are within 20 % of the mock, with the largest difference; and
of the cases in which the mock comes to rest, how many are predicted to.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np

from tests.backlash_scenes import backlash_scene, compared

WITHIN = 0.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    ratios: list[float] = []
    rests: list[bool] = []
    for number in itertools.count():
        if len(ratios) == options.cases:
            break
        case = compared(backlash_scene(np.random.default_rng([options.seed, number])))
        if case is None:
            continue
        if case.simulated == 0.0:
            rests.append(case.predicted == 0.0)
            continue
        ratios.append(case.predicted / case.simulated)
        print(f"{number:4d}  mock {case.simulated * 1e3:8.4f} mm  predicted / mock {ratios[-1]:.4f}", flush=True)
    off = np.abs(np.array(ratios) - 1.0)
    print(f"within {WITHIN:.0%}: {(off <= WITHIN).sum()} of {len(ratios)}; largest difference {off.max():.2%}")
    print(f"at rest, and predicted to be: {sum(rests)} of {len(rests)}")


if __name__ == "__main__":
    main()
