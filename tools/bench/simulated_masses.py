"""Simulated masses whose position a device follows: what is predicted and measured, beside their loop written out.

    tools/bench/simulated_masses [--loops 300] [--first 0]

Free masses, walls, springs and chains in random hands, with delays of 0 to 3 samples, half of them behind a servo.
Spectral radius, m and b are compared with those of the loop in tests/admittance_loops.py. Where the loop is stable and
has a pair, `measure` pushes the mock, in virtual time.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

import hapsim
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.scene import parse_scene
from tests.admittance_loops import PRESSED, Loop, largest_errors, random_loop

PUSH = 0.25  # of the force with which a hand presses a wall: it does not leave it


def predicted(loop: Loop) -> tuple[float, float, float]:
    """Returns the spectral radius, and the felt m and b."""
    prediction = predict(parse_scene(loop.yaml), with_margins=False)
    (felt,) = prediction.felt_masses
    return prediction.spectral_radius_here, felt.m, felt.b


def measured(loop: Loop) -> tuple[float, float] | str:
    """Returns how far the measured m and b are off, relative to m and to all damping; or why there is none."""
    _, m, b = loop.pair()
    push = PUSH * PRESSED * loop.links[0][1] if loop.kind == "wall" else None
    try:
        found = hapsim.measure(parse_scene(loop.yaml), push=push)
    except UsageError as error:
        return str(error)
    if not found.dominant:
        return str(found.motion.reason)
    return abs(found.m / m - 1.0), abs(found.b - b) / (loop.damping + loop.hand_damping)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.loops)
    (radius, m, b), pairs, unstable = largest_errors(seeds, predicted)
    print(f"{len(seeds)} loops, {unstable} unstable, {pairs} with a pair")
    print(f"predicted, off by at most: spectral radius {radius:.0e}, m {m:.0e}, b {b:.0e}")
    loops = [loop for loop in map(random_loop, seeds) if loop.pair()[0] < 1.0 and not math.isnan(loop.pair()[1])]
    answers = [measured(loop) for loop in loops]
    off = np.array([one for one in answers if not isinstance(one, str)])
    print(f"measured in {len(off)} of {len(loops)}, off by: m {_spread(off[:, 0])}, b {_spread(off[:, 1])}")
    for reason in sorted({one for one in answers if isinstance(one, str)}):
        print(f"  {answers.count(reason)} without a measurement: {reason}")


def _spread(off: np.ndarray) -> str:
    return f"{np.median(off):.0e} in the median, {np.quantile(off, 0.95):.0e} in 95 %, at most {off.max():.0e}"


if __name__ == "__main__":
    main()
