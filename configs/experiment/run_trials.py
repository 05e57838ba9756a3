"""Runs 60 trials of stiffness discrimination: is this spring stiffer than 1000 N/m?

    python run_trials.py answers.trace [--person]

Without --person a simulated observer answers. It takes the stiffness that it felt, force over position, with an error
of its own. Its just noticeable difference is known, so fit.py has to find it again.
"""

from __future__ import annotations

import argparse
import math
import random
from pathlib import Path

import numpy as np

import hapsim
from hapsim.errors import HapsimError

HERE = Path(__file__).parent
REFERENCE = 1000.0  # N/m
JND = 0.10  # of the simulated observer: it finds a spring that is stiffer by this share to be so in 75 % of trials
LOOKS = 600  # samples, after which it answers: the spring has come to rest


def felt_stiffness(session: hapsim.Session, first: int) -> float:
    """Returns the stiffness, N/m, that the hand feels at rest, `LOOKS` samples after the one in which a trial began."""
    for samples in session.stream():
        if samples.sample[-1] > first + LOOKS:
            break
    return -float(np.mean(samples.force[-50:]) / np.mean(samples.position[-50:]))


def is_answered_stiffer(stiffness: float, chance: random.Random) -> bool:
    """Returns the simulated observer's answer."""
    error = chance.gauss(0.0, math.log(1.0 + JND) / 0.6745)  # 0.6745: where a normal distribution has 75 %
    return math.log(stiffness / REFERENCE) + error > 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", type=Path, help="the record to write, a .trace")
    parser.add_argument("--scene", type=Path, default=HERE / "discrimination.yaml")
    parser.add_argument("--conditions", type=Path, default=HERE / "conditions.csv")
    parser.add_argument("--seed", type=int, default=1, help="of the order, and of the simulated observer")
    parser.add_argument("--person", action="store_true", help="ask at the keyboard")
    options = parser.parse_args()
    if options.record.exists():
        raise SystemExit(f"{options.record}: the file exists, expected a new one: it may be somebody's answers")
    chance = random.Random(options.seed)
    try:
        trials = hapsim.Trials(
            options.conditions, seed=options.seed, repetitions=10, order="blocked", scene=options.scene
        )
        if options.person and hapsim.load_scene(options.scene).device.clock == "lockstep":
            raise SystemExit(
                f"{options.scene}: clock: lockstep is virtual time, expected none for a person: leave it out"
            )
        with hapsim.start(options.scene, record=options.record) as session:
            for trial in trials:
                begun = session.trial(*trial)
                if options.person:
                    is_stiffer = input(f"{trial.number} of {len(trials)}: stiffer? y or n: ").strip().lower() == "y"
                else:
                    is_stiffer = is_answered_stiffer(felt_stiffness(session, begun.sample), chance)
                session.mark(f"answer {int(is_stiffer)}")
    except HapsimError as error:
        raise SystemExit(f"run_trials.py: {error}") from None
    print(f"{options.record}: {len(trials)} trials")


if __name__ == "__main__":
    main()
