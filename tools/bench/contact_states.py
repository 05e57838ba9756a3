"""Stability of every contact state of random scenes: the theory's answer against simulation.

    tools/bench/contact_states [--scenes 500] [--first 0]

Each scene has a hand, one to three masses or cells, and one to four buffers, plectra, detents and tables. Within each
state (at most six per scene, none that a snap leaves) 20 small pushes are simulated for 20 seconds, to see whether a
motion grows. Then come 20 pushes of up to 0.3 m/s from anywhere within 2 cm, which open and close contacts. The bench
counts those whose energy in the last second is four times that of the first.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np

import hapsim
from hapsim.scene import Scene
from tests.contact_scenes import begun, contact_scene, growths_within, judged_unstable, unsnapped_states

SAMPLES = 20_000
BARELY = 1e-4  # growth a sample, which that many samples hardly show


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    states: Counter[str] = Counter()
    pushes: Counter[tuple[str, str]] = Counter()
    for seed in range(options.first, options.first + options.scenes):
        scene = contact_scene(seed)
        prediction = hapsim.predict(scene, with_margins=False)
        kept = unsnapped_states(prediction)
        for state, growth in zip(kept, growths_within(scene, kept, SAMPLES, 20), strict=True):
            unstable = judged_unstable(prediction, state)
            if not unstable and not prediction.stable_as_taken:
                states["beside what is unstable as it is taken"] += 1
            elif unstable and growth < 1.0:
                states["falsely unstable"] += 1
                print(f"seed {seed}: falsely unstable, {growth:.6g} a sample: {_words(state)}")
            elif not unstable and growth > 1.0 + BARELY:
                states["falsely stable"] += 1
                print(f"seed {seed}: falsely stable, {growth:.6g} a sample: {_words(state)}")
            else:
                states["unstable, and grows" if unstable else "stable, and does not grow"] += 1
        verdict = "stable" if prediction.stable else "refused" if prediction.judge.shaking else "at the limit"
        pushes[verdict, "grew" if _grew(scene, seed) else "did not grow"] += 1
    print(f"{options.scenes} scenes; states: {dict(states)}")
    print("scenes by verdict and whether one of 20 pushes grew:", {", ".join(k): n for k, n in sorted(pushes.items())})


def _words(state: dict[str, Any]) -> str:
    return ", ".join(f"{name} is {option.state}" for name, option in state.items())


def _grew(scene: Scene, seed: int) -> bool:
    motion = begun(scene, np.random.default_rng(seed), 20)
    with np.errstate(all="ignore"):
        early = motion.most_energy(1000)
        motion.most_energy(SAMPLES - 2000)
        return bool((~(motion.most_energy(1000) <= 4.0 * early + 1e-9)).any())


if __name__ == "__main__":
    main()
