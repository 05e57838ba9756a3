"""How much dry friction a wall needs so that it does not buzz, by the resolution of the encoder.

    python friction_for_quiet_wall.py [--jobs 2]

Rounding of the position to counts of Δ makes the force of a wall K jump by K Δ, which can feed a motion of some counts
for ever. Diolaiti and others (IEEE Transactions on Robotics 22, 2006) find a spring passive where the dry friction is
at least K Δ/2, for any hand. A damper, whose velocity jumps by Δ/T, and a delay ask for more: measured here.

Hands of several masses, which lean on a wall of 2000 N/m with several forces, are released on the mock, in virtual
time. A hand rests if its position stays on one count in the last second of six.
"""

import argparse
import itertools

import numpy as np

import hapsim

STIFFNESS = 2000.0
QUANTA = (3e-6, 1e-5, 3e-5, 1e-4, 3e-4)  # m
SHARES = np.linspace(0.0, 2.0, 41)  # of K Δ/2
MASSES = (0.08, 0.2, 0.5, 1.2)  # kg
LEANS = (0.0, 10.25, 10.5)  # counts by which the hand's own steady push deflects the wall: 10.5 is between two counts
SCENE = f"""
version: 1
rate: 1000
device: {{mass: 0.2, friction: 0.1, delay: 1, clock: lockstep}}
mock: {{initial: {{position: 0.002}}, force_quantum: 1.0e-6}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {STIFFNESS}, damping: 10}}
"""


def buzzing(scene: hapsim.Scene) -> dict[str, float]:
    """By how many counts the hand still moves, and the force's root mean square in N about its mean."""
    trace = hapsim.run(scene, duration=6.0, transport="loopback")
    last = trace.position_counts[-1000:, 0]
    return {"counts": float(np.ptp(last)), "force": float(np.std(trace.force[-1000:, 0]))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    jobs = parser.parse_args().jobs
    points = [
        {
            "mock.quantum": q,
            "mock.coulomb": share * STIFFNESS * q / 2.0,
            "device.mass": m,
            "mock.hand.force": lean * STIFFNESS * q,
        }
        for q, share, m, lean in itertools.product(QUANTA, SHARES, MASSES, LEANS)
    ]
    found = hapsim.sweep(hapsim.parse_scene(SCENE), points, quantities=(), function=buzzing, jobs=jobs)
    shape = len(QUANTA), SHARES.size, len(MASSES) * len(LEANS)
    moves = np.any(found["counts"].values.reshape(shape) > 0, axis=2)
    force = found["force"].values.reshape(shape).max(axis=2)
    print("count, µm   buzz without friction, N rms   every hand rests from, N   K Δ/2, N")
    for q, one, buzz in zip(QUANTA, moves, force, strict=True):
        most = STIFFNESS * q / 2.0
        above = np.flatnonzero(one)
        least = 0.0 if not above.size else SHARES[min(int(above[-1]) + 1, SHARES.size - 1)] * most
        print(f"{1e6 * q:9.0f}   {buzz[0]:28.4f}   {least:24.5f}   {most:8.4f}")


if __name__ == "__main__":
    main()
