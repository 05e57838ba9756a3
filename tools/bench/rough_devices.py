"""Errors and false causes in reports of `measure`, on random devices that differ from their declaration.

    tools/bench/rough_devices [--scenes 500] [--first 0] [--every]

Each device has a hand on one spring and damper in virtual time: every damper and hold, any delay, counts of 1 nm to
24 µm, noise, dry friction to 0.5 N, masses and frictions that differ from the declared ones, soft starts and slew
limits, late forces.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

from tests.rough_devices import FAR, TOO_FAR, measured, rough_device


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--every", action="store_true", help="print each device")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    for seed in range(options.first, options.first + options.scenes):
        device = rough_device(seed)
        result = measured(device)
        named = [word for word in result.words if word != "limits"]
        notes = [
            *(["no k"] if "nothing" in named else []),
            *([f"k off by more than {FAR:g} u"] if result.apart > FAR else []),
            *([f"k off by more than {TOO_FAR:g} u"] if result.apart > TOO_FAR else []),
            *([f"k off by more than {TOO_FAR:g} u without a word"] if result.apart > TOO_FAR and not named else []),
            *([f"wrong cause: {result.wrong}"] if result.wrong else []),
            *(["another mass, named"] if device.wrong_mass and "mass" in named else []),
            *(["another mass, another cause or none"] if device.wrong_mass and "mass" not in named else []),
        ]
        counts.update(notes)
        if options.every or any("without a word" in note or "wrong" in note for note in notes):
            touch, mock = device.scene.links["touch"], device.scene.mock_device
            print(
                f"{seed}: {'; '.join(notes)}; off by {result.off:.1e}, {result.apart:.1f} u; reported {result.words}; "
                f"{touch.damper}, {device.scene.device.hold}, dry {mock.coulomb:.3g} N, count {mock.quantum[0]:.1e} m, "
                f"noise {mock.noise:.1e} m, mass {device.wrong_mass}, friction {device.wrong_friction}"
            )
        if (done := seed - options.first + 1) % 50 == 0:
            print(f"{done} of {options.scenes} done", file=sys.stderr, flush=True)
    for note, count in sorted(counts.items()):
        print(f"{note}: {count} of {options.scenes}")


if __name__ == "__main__":
    main()
