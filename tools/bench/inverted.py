"""Travel and speed of a hand on a motor with the wrong sign until a guard ends the run, in virtual time.

    tools/bench/inverted [--travel 0.05] [--masses 0.05,0.2,1] [--limits 2,10,40]

The scene is first_touch on the mock, with its forces inverted on the wire. The hand is otherwise free and starts at 0
with a flick of 0.1 m/s. The run has the energy guard alone, as in `hapsim run`, or a travel of `--travel` metres to
either side as well.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import hapsim
from hapsim.bringup.faults import Injector, parse_script
from hapsim.bringup.faults.in_memory import in_memory
from hapsim.errors import RunError
from hapsim.running import run
from hapsim.scene import Scene

INVERTED = "version: 1\nfaults:\n  - {kind: invert, direction: to_device, at: 0.0}\n"


def thrown(scene: Scene) -> tuple[float, float, float, str]:
    """(m it went at most, m/s it had at the end, s until then, why it ended)."""
    try:
        between = in_memory(Injector(parse_script(INVERTED)), scene.period)
        trace = run(scene, duration=5.0, between=between, judges_energy=True)
    except RunError as error:
        if error.trace is None:
            raise
        trace = error.trace
    position = trace.position[:, 0]
    speed = float(abs(np.diff(position)[-1])) * scene.rate
    return float(np.abs(position).max()), speed, trace.report.duration_s, trace.report.ending


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--travel", type=float, default=0.05)
    parser.add_argument("--masses", default="0.05,0.2,1")
    parser.add_argument("--limits", default="2,10,40")
    given = parser.parse_args()
    half, within = given.travel, True
    print("mass kg  limit N   without a travel                          with one")
    for mass in map(float, given.masses.split(",")):
        for limit in map(float, given.limits.split(",")):
            cells = []
            for travel in (None, (-half, half)):
                scene = hapsim.load_scene("configs/first_touch.yaml")
                changes = {"clock": "lockstep", "mass": mass, "force_limit": limit, "travel": travel}
                scene = scene.model_copy(update={"device": scene.device.model_copy(update=changes)})
                far, speed, after, why = thrown(scene)
                cells.append(f"{1e3 * far:7.1f} mm {speed:5.2f} m/s {1e3 * after:5.0f} ms {why:15s}")
                within = within and (travel is None or far < 1.4 * half)
            print(f"{mass:7g} {limit:8g}   {'  '.join(cells)}")
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
