"""Time and memory of `hapsim check` on a string of many masses with a hand on one of them, part by part.

    tools/bench/string [--masses 10000] [--write FILE]

`--write` saves the scene.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import hapsim


def scene_of(masses: int) -> str:
    """A string of 1 g masses on springs of 20 kN/m at 10 kHz between two grounds; the hand holds a third of the way."""
    lines = [
        "version: 1",
        "rate: 10000",
        "device: {clock: lockstep, mass: 0.2, friction: 1.0, delay: 1}",
        "modules:",
        "  hand: {type: device, channel: 0}",
        "  left: {type: ground}",
        "  right: {type: ground}",
    ]
    points = ["left", *(f"m{i}" for i in range(masses)), "right"]
    lines += [f"  {name}: {{type: mass, mass: 0.001}}" for name in points[1:-1]]
    for i in range(masses + 1):
        ends = f"[{points[i]}, {points[i + 1]}]"
        lines.append(f"  s{i}: {{type: viscoelastic, between: {ends}, stiffness: 20000, damping: 0.1}}")
    lines.append(f"  touch: {{type: viscoelastic, between: [hand, m{masses // 3}], stiffness: 2000, damping: 2}}")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--masses", type=int, default=10_000)
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = arguments.write or Path(folder) / "string.yaml"
        path.write_text(scene_of(arguments.masses), encoding="utf-8")
        megabytes = path.stat().st_size / 1e6
        start = time.perf_counter()
        scene = hapsim.load_scene(path)
    loaded = time.perf_counter()
    hapsim.predict(scene, with_margins=False)
    poles = time.perf_counter()
    prediction = hapsim.predict(scene)
    end = time.perf_counter()
    print(f"{arguments.masses} masses: {prediction.poles_in_all} poles, {len(prediction.poles)} worked out")
    print(f"{'stable' if prediction.stable else 'unstable'}, spectral radius {prediction.spectral_radius:.12g}")
    print(
        f"{loaded - start:.1f} s to read the {megabytes:.1f} MB of the scene, {poles - loaded:.1f} s for the poles, ",
        end="",
    )
    print(f"{(end - poles) - (poles - loaded):.1f} s for the margins")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB at the most")


if __name__ == "__main__":
    main()
