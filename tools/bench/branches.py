"""Curves with two branches: the energy that closed paths take, and k predicted and measured, stuck and sliding.

    tools/bench/branches [--curves 200] [--paths 5] [--measured 50] [--seed 1]

Prints the least energy that one of the paths took, all in all and beside what is stored in the end; then each measured
curve, and how many of its uncertainties k is off.
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.branch_scenes import Kernel, branch_scene, compared, lost_on, random_curve, random_paths


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--curves", type=int, default=200)
    parser.add_argument("--paths", type=int, default=5)
    parser.add_argument("--measured", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng, lost = np.random.default_rng(options.seed), []
    for _ in range(options.curves):
        curve = random_curve(rng)
        kernel = Kernel(branch_scene(curve))
        lost += [lost_on(kernel, curve, path) for path in random_paths(rng, curve, options.paths)]
    if lost:
        least, beside = np.min(lost, axis=0)
        print(f"{len(lost)} closed paths took at least {least:.3g} J; beside what is stored {beside:.3g} J")
    each: list[tuple[str, float, float]] = []
    done = number = 0
    while done < options.measured:
        found = [*compared(np.random.default_rng([options.seed, number]))]
        for one in found:
            each.append((one.branch, one.off, one.measured / one.predicted - 1.0))
            values = f"predicted {one.predicted:10.3f} N/m, measured {one.measured:10.3f} ± {one.uncertainty:.2g}"
            print(f"{number:4d} {one.branch:8s} {values}: {one.off:.2f} uncertainties", flush=True)
        done, number = done + bool(found), number + 1
    for branch in ("stuck", "press", "release"):
        off = [(how, ratio) for name, how, ratio in each if name == branch]
        if off:
            how, ratio = np.abs(np.array(off)).T
            by = f"off by {np.median(ratio):.2g} in the median and {ratio.max():.2g} at most"
            shares = f"{how.max():.2f} uncertainties at most, rms {np.sqrt(np.mean(how**2)):.2f}"
            print(f"{branch}: {len(off)} of {options.measured} curves measured; {by}; {shares}")


if __name__ == "__main__":
    main()
