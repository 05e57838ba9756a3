"""Errors of random measurements of k and b, in their stated uncertainties.

    tools/bench/measured_uncertainties [--measurements 500] [--first 0]

In virtual time, of linear scenes whose k and b are known exactly: three tenths each of lone hands with every correction
and hold, without noise and with up to 2 µm rms; the rest linked hands and hands in the plane, in equal parts, without
and with noise. Counts are 1 nm to 0.1 µm, in the plane 10 pm to 1 nm. Some ten minutes.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from tests.measured_scenes import KINDS, compared, random_scene

SHARES = dict(zip(KINDS, (0.3, 0.3, 0.1, 0.1, 0.1, 0.1), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measurements", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="seed of the first of each kind")
    options = parser.parse_args()
    print("| scenes | number | said to be unknown | rms | more than 3 | more than 6 | most | off by, at most |")
    print("|---|---|---|---|---|---|---|---|")
    every, largest, unknown = [], [], 0
    for kind, share in SHARES.items():
        number, found = round(share * options.measurements), []
        for seed in range(options.first, options.first + number):
            one = compared(kind, *random_scene(kind, seed))
            if one is None:
                continue
            found.append(one)
            if np.abs(one.apart).max() > 3.0:
                print(f"{kind}, seed {seed}: {np.abs(one.apart).max():.1f}", file=sys.stderr, flush=True)
        most = [float(np.abs(one.apart).max()) for one in found]
        apart = np.concatenate([one.apart for one in found])
        print(row(kind, number, number - len(found), apart, most, max(one.off for one in found)), flush=True)
        every.append(apart)
        largest += most
        unknown += number - len(found)
    print(row("all", len(largest) + unknown, unknown, np.concatenate(every), largest, float("nan")))


def row(kind: str, number: int, unknown: int, apart: np.ndarray, most: list[float], off: float) -> str:
    """A row of the table. `apart`: every error; `most`: the largest of each measurement, in uncertainties."""
    over = [str(sum(one > limit for one in most)) for limit in (3.0, 6.0)]
    rms = f"{np.sqrt(np.mean(apart**2)):.2f}"
    return "| " + " | ".join([kind, str(number), str(unknown), rms, *over, f"{max(most):.1f}", f"{off:.0e}"]) + " |"


if __name__ == "__main__":
    main()
