"""Felt k and b of hands that move masses or each other, against simulation.

    tools/bench/felt_pairs [--scenes 600] [--first 0]

The random scenes take turns: a hand with masses, a chain, two and three linked hands, masses that are nearly rigid, and
scenes that nothing holds. Each hand is flicked in the mock. The positions are compared with those of a real mass on the
stated k and b until all have fallen to a hundredth. A pair is right if they differ by at most a tenth of the largest
position (rms). A right pair is lost if `check` states none although its motions give it.
"""

from __future__ import annotations

import argparse
from collections import Counter

from tests.pair_scenes import FAMILIES, judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=600)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    found: Counter[tuple[str, str]] = Counter()
    for seed in range(options.first, options.first + options.scenes):
        one = judged(seed)
        if one is not None:
            found[FAMILIES[seed % len(FAMILIES)], one.result] += 1
            if one.result in ("false", "lost"):
                print(f"seed {seed}: {one.result}, off by {one.off:.3f}")
    words = ("right", "none", "false", "lost")
    print("| |", " | ".join(words), "|\n|---|" + "---|" * len(words))
    for family in (*FAMILIES, "all"):
        counts = (sum(n for key, n in found.items() if family in (key[0], "all") and key[1] == word) for word in words)
        print(f"| {family} |", " | ".join(map(str, counts)), "|")


if __name__ == "__main__":
    main()
