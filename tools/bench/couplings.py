"""Virtual couplings for a hand of known mass: random devices, and passive things behind the coupling.

    tools/bench/couplings [--devices 1000] [--first 0]

Each device gets the stiffest coupling that `couple` finds for its mass. Behind that come 122 springs and masses without
losses, and 40 random springs, dampers, masses and contacts. The spectral radius of each loop, written out in
tests/coupled_devices.py, must be at most 1. The bench names the devices with which it is larger.
"""

from __future__ import annotations

import argparse

from tests.coupled_devices import judged

RANDOM = 40
ROUNDING = 1e-11


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    radii = []
    for seed in range(options.first, options.first + options.devices):
        hand, found, most = judged(seed, RANDOM)
        radii.append(most)
        if radii[-1] > 1.0 + ROUNDING:
            print(f"seed {seed}: radius {radii[-1]:.12f}: {hand}, {found}")
    shaken = sum(one > 1.0 + ROUNDING for one in radii)
    print(f"{len(radii)} devices, {shaken} of them unstable; largest radius {max(radii):.13f}")


if __name__ == "__main__":
    main()
