"""Devices with a transmission or a lagging motor: what is predicted, beside their loop written out.

    tools/bench/drives [--devices 300] [--first 0]

Each device is a scene with a belt of 30 to 1000 Hz, a lag of 10 µs to 2 ms, or both, on a random wall. Spectral radius,
k and b are compared with those of the loop in tests/driven_devices.py. A device without a k and b has a reason.
"""

from __future__ import annotations

import argparse

from hapsim.prediction import predict
from hapsim.prediction.prediction import Prediction
from hapsim.scene import parse_scene
from tests.driven_devices import Device, largest_errors


def _prediction_of(device: Device) -> Prediction:
    return predict(parse_scene(device.yaml), with_margins=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.devices)
    (radius, k, b), without = largest_errors(seeds, _prediction_of)
    print(f"{len(seeds)} devices, off by at most: spectral radius {radius:.0e}, k {k:.0e}, b {b:.0e}")
    print(f"{without} of them without a k and b, each with a reason")


if __name__ == "__main__":
    main()
