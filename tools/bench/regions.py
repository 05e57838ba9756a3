"""k and b in every stable region of random piecewise-linear scenes, predicted and measured in virtual time.

    tools/bench/regions [--scenes 200] [--first 0] [--worst 5]

Each scene has one hand on one to four of: a spring, two stops, a table, a click, detents, dry friction. Each stable
region is measured at its place, friction stuck. Regions that `measure` refuses are counted, with the reason.
"""

from __future__ import annotations

import argparse
import math
import re
from collections import Counter

import numpy as np

import hapsim
from hapsim.errors import HapsimError
from tests.piecewise_scenes import as_scene, random_scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--worst", type=int, default=5, help="how many of the worst regions to print")
    options = parser.parse_args()
    rows: list[tuple[float, float, float, float, int, str]] = []
    refused: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    for seed in range(options.first, options.first + options.scenes):
        scene = as_scene(random_scene(seed, clock="lockstep"))
        regions = hapsim.predict(scene, with_margins=False).regions.get("hand", ())
        for region in (one for one in regions if not one.piece.sliding):
            kinds[region.kind if region.is_stable else "unstable"] += 1
            if region.kind != "held" or not region.is_stable or not region.felt.dominant:
                continue
            piece = region.piece
            where = f"{1e3 * piece.low:.4g} to {1e3 * piece.high:.4g} mm"
            try:
                measured = hapsim.measure(scene, at=piece.place)
            except HapsimError as error:
                refused[re.sub(r"-?[0-9][0-9.e-]*", "#", str(error))[:150]] += 1
                continue
            felt, mass = region.felt, region.felt.configuration.mass
            off_k, off_b = abs(measured.k / felt.k - 1.0), abs(measured.b - felt.b)
            of_critical = off_b / max(abs(felt.b), 0.1 * math.sqrt(felt.k * mass))  # as `felt_error` counts
            apart = abs(measured.k - felt.k) / measured.k_uncertainty
            rows.append((of_critical, off_k, off_b / abs(felt.b), apart, seed, where))
    columns = list(zip(*rows, strict=True))
    print(
        f"{options.scenes} scenes, {sum(kinds.values())} regions: {dict(kinds)}; {len(rows)} measured, "
        f"{refused.total()} refused"
    )
    names = "b, of itself or a twentieth of the critical damping", "k", "b, of itself"
    for name, values in zip(names, map(np.array, columns[:3]), strict=True):
        print(
            f"{name} within 1e-5 in {np.mean(values <= 1e-5):.1%}; median {np.median(values):.1e}, "
            f"99 % {np.quantile(values, 0.99):.1e}, most {values.max():.1e}"
        )
    print(f"k within 3 stated uncertainties in {np.mean(np.array(columns[3]) <= 3.0):.1%}")
    for _, off_k, off_b, apart, seed, where in sorted(rows, reverse=True)[: options.worst]:
        print(f"  scene {seed}, {where}: b off by {off_b:.1e}, k by {off_k:.1e}, {apart:.1f} uncertainties")
    for reason, count in refused.most_common():
        print(f"  refused {count}: {reason}")


if __name__ == "__main__":
    main()
