"""Which share of the springs and dampers that a scene may ask for is felt within 5 %, by sample rate and delay.

    python felt_by_rate_and_delay.py [--jobs 2]

A hand of 0.2 kg, K from 10 to 10 000 N/m and damping ratios from 0.05 to 1, each step counting alike. Predicted only:
`--check` on the command line.
"""

import argparse

import numpy as np

import hapsim

WITHIN = 0.05
MASS, FRICTION = 0.2, 0.0
SCENE = f"""
version: 1
rate: 1000
device: {{mass: {MASS}, friction: {FRICTION}, clock: lockstep}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 100, damping: 1}}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    jobs = parser.parse_args().jobs
    points = [
        {"rate": rate, "device.delay": delay, "touch.stiffness": k, "touch.damping": 2.0 * ratio * np.sqrt(k * MASS)}
        for rate in (500.0, 1000.0, 2000.0, 5000.0, 20000.0)
        for delay in (0.0, 0.5, 1.0, 2.0)
        for k in np.geomspace(10.0, 10000.0, 24)
        for ratio in np.linspace(0.05, 1.0, 12)
    ]
    found = hapsim.sweep(hapsim.parse_scene(SCENE), points, quantities=("predicted",), jobs=jobs)
    k = abs(found["predicted_k"] / found["touch.stiffness"] - 1.0)
    b = abs(found["predicted_b"] / (found["touch.damping"] + FRICTION) - 1.0)
    found["felt"] = ((k < WITHIN) & (b < WITHIN) & (found["stable"] > 0)).astype(float)
    frame = found[["rate", "device.delay", "felt"]].to_dataframe()
    shares = frame.pivot_table(values="felt", index="rate", columns="device.delay", aggfunc="mean")
    print(f"Share felt within {WITHIN:.0%}, by rate (Hz, down) and delay (samples, across):")
    print(shares.round(2).to_string())


if __name__ == "__main__":
    main()
