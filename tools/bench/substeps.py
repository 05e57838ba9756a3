"""k and b of random scenes with substeps, predicted and measured in virtual time; and the stiffness that shakes each.

    tools/bench/substeps [--scenes 200] [--first 0] [--worst 5]

A hand on a link, on a mass or on a string, or two hands on a mass; 1 to 64 substeps, either decimation, every scheme,
hold and sampling, delays of 0, 0.37, 1 and 2 samples, dampers that are backward, filtered or sensed. `measure` has the
word on links and masses where it is sure; otherwise the poles of a ring-down, in position and force, are compared.
With 0.999 of the stiffness that a margin allows the slowest motion of a ring-down has to die away, and with 1.001 to
grow.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

import hapsim
from tests.substep_scenes import KINDS, errors, growth, random_scene, with_factor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--worst", type=int, default=5, help="how many of the worst scenes to print")
    options = parser.parse_args()
    rows: list[tuple[float, float, int]] = []
    limits: Counter[str] = Counter()
    for seed in range(options.first, options.first + options.scenes):
        scene = random_scene(seed)
        off_k, off_b = errors(scene)
        rows.append((max(off_k, off_b), off_k, seed))
        margin = next(one for one in hapsim.predict(scene).margins if one.name == "touch").stiffness_factor
        if not 1.0 < margin < 1e3:
            limits["without one below a thousand"] += 1
            continue
        below, above = (growth(with_factor(scene, "touch", by * margin)) for by in (0.999, 1.001))
        is_straddled = below[0] < 0.0 < above[0] and below[1] < 0.0 < above[1]
        limits["straddled" if is_straddled else "not straddled"] += 1
        if not is_straddled:
            print(
                f"  scene {seed}: at 0.999 and 1.001 of {margin:.6g} it grows by {below}, {above} (measured, predicted)"
            )
    for kind, name in enumerate(KINDS):
        off = np.array([row[0] for row in rows if row[2] % len(KINDS) == kind])
        if off.size:
            print(f"{name}: {off.size} scenes, k and b within {off.max():.1e}; median {np.median(off):.1e}")
    off = np.array([row[0] for row in rows])
    print(f"{off.size} scenes: {np.mean(off <= 1e-6):.1%} within 1e-6, most {off.max():.1e}")
    for worst, _, seed in sorted(rows, reverse=True)[: options.worst]:
        print(f"  scene {seed}: off by {worst:.1e}")
    print(f"the touch's gain margin: {dict(limits)}")


if __name__ == "__main__":
    main()
