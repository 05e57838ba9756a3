"""Verdicts on random scenes of the kinds that are hard to judge, beside the mock that is pushed in virtual time.

    tools/bench/verdicts [--scenes 300] [--first 0] [--pushes 12] [--kind KIND]

Kinds: see tests/verdict_scenes.py. A scene is shaken if, after one of the pushes, a guard ends the run or the swing
does not die away. The bench prints each scene that is called stable and is shaken, and each one that is refused and
rests after every push. Without --kind it also compares states and regions of random hands that move nothing else, four
for each three scenes.
"""

from __future__ import annotations

import argparse
from collections import Counter
from itertools import islice

import hapsim
from hapsim.errors import UsageError
from tests.piecewise_scenes import as_scene as piecewise_scene
from tests.piecewise_scenes import random_scene, springs_in_regions, springs_in_states
from tests.verdict_scenes import KINDS, as_scene, is_shaken, pushes, verdict_scene

MORE = 8  # times the pushes, to find one that shakes a scene that is refused
REFUSED = "refused", "swings on"  # by the start of a run, or by `check` alone


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pushes", type=int, default=12)
    parser.add_argument("--kind", choices=KINDS)
    options = parser.parse_args()
    if not options.kind:
        hands = [piecewise_scene(random_scene(seed)) for seed in range(options.scenes * 4 // 3)]
        alike = sum(springs_in_states(hand) == springs_in_regions(hand) for hand in hands)
        print(f"{alike} of {len(hands)} hands have the springs and dampers of their regions as states", flush=True)
    for kind in (options.kind,) if options.kind else KINDS:
        found: Counter[tuple[str, str]] = Counter()
        for seed in range(options.first, options.first + options.scenes):
            document = verdict_scene(kind, seed)
            prediction = hapsim.predict(as_scene(document), with_margins=False)
            shaking = prediction.judge.shaking
            verdict = prediction.verdict if shaking is None else "refused"
            tried = pushes(seed, options.pushes * (1 if verdict == "stable" else MORE))
            shaken = (push for push in tried if is_shaken(document, push))
            try:
                shaken = list(islice(shaken, None if verdict == "stable" else 1))
            except UsageError:  # stiffer than the device's board takes
                found[verdict, "not run"] += 1
                continue
            found[verdict, "shaken" if shaken else "rests"] += 1
            if shaken and verdict not in REFUSED:
                where = f"{len(shaken)} of {options.pushes} pushes, such as {shaken[0]}"
                print(f"{kind} {seed}: {verdict}, but shaken by {where}", flush=True)
            if not shaken and verdict in REFUSED:
                what = f"{shaking.growth:.6g} of {shaking.module} while {shaking.state}" if shaking else "knocked"
                print(f"{kind} {seed}: {verdict} ({what}), but rests", flush=True)
        print(f"{kind}: {options.scenes} scenes; {dict(found)}", flush=True)


if __name__ == "__main__":
    main()
