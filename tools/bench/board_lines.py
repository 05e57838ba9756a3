"""Walls and detents with the law on the board, beside the host's law: rebound, and energy that a launched hand gains.

    tools/bench/board_lines [--phases 50] [--hands 6]

A simulated device of 0.2 kg follows the lines of the kernel, at 10 kHz behind a host at 1 kHz. Its mass moves exactly
between its steps, and nothing is rounded. The host's law is a force that is held; it acts a local period later, as the
board's force does.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "loop"))

from board_device import BoardDevice, Rig, board_line, host_line, scene_with

DELAYS, SPEEDS, PITCH, DEPTH = (1, 2, 5), (0.0517, 0.2071, 0.5137, 0.98), 1e-3, 0.32
DETENTS: dict[str, dict[str, Any]] = {
    "sine": {"shape": "sine"},
    "snap, 2": {"shape": "snap"},
    "snap, 20": {"shape": "snap", "sharpness": 20},
    "saw": {"shape": "snap", "sharpness": 1e6},
    "notch, 3": {"shape": "notch", "sharpness": 3},
}


def rebounds(stiffness: float, delay: int, phases: int) -> tuple[list[float], list[float]]:
    """Returns rebound over impact on a wall hit at 0.3 m/s, by the host's law and by lines, one for each phase."""
    rig = Rig(scene_with({"wall_": {"type": "buffer", "stiffness": stiffness}}), delay)
    found: tuple[list[float], list[float]] = ([], [])
    for phase in np.arange(phases) / phases:
        for kind, answer in enumerate((host_line(lambda x: max(0.0, -stiffness * x)), board_line(rig))):
            device = BoardDevice(3e-4 * (20.0 + phase), -0.3, delay=delay, window=1)
            for _ in range(300):
                device.sample(answer)
            found[kind].append(device.v / 0.3)
    return found


def gained(detent: dict[str, Any], speed: float, delay: int, hands: int) -> list[float]:
    """Returns the most energy, J, that a hand launched from any of `hands` places gains in a second, by the host's law
    and by lines."""
    scene = scene_with({"detents": {"type": "detent", "pitch": PITCH, "depth": DEPTH} | detent})
    law, places = scene.links["detents"].law(), np.linspace(0.0, PITCH, 20001)
    forces = -law.tension(places)
    stored = np.append(0.0, -np.cumsum(0.5 * (forces[1:] + forces[:-1]))) * places[1]
    rig, most = Rig(scene, delay), [0.0, 0.0]
    for begin in np.arange(hands) / hands * PITCH:
        held = host_line(lambda x: float(np.interp(x % PITCH, places, forces)))
        for kind, answer in enumerate((held, board_line(rig))):
            device = BoardDevice(begin, speed, friction=1.0, delay=delay)
            for _ in range(1000):
                device.sample(answer)
                rise = np.interp([device.x % PITCH, begin], places, stored)
                most[kind] = max(most[kind], device.work + float(rise[0] - rise[1]))
    return most


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--phases", type=int, default=50)
    parser.add_argument("--hands", type=int, default=6)
    options = parser.parse_args()
    for stiffness in (2000.0, 10000.0):
        for delay in DELAYS:
            host, lines = rebounds(stiffness, delay, options.phases)
            print(f"wall {stiffness:g} N/m, delay {delay}: host {min(host):.4f} to {max(host):.4f}, ", end="")
            print(f"lines {min(lines):.5f} to {max(lines):.5f} of the impact", flush=True)
    for name, detent in DETENTS.items():
        for speed in SPEEDS:
            pairs = [gained(detent, speed, delay, options.hands) for delay in DELAYS]
            row = "; ".join(f"{host * 1e6:5.0f} {lines * 1e6:5.0f}" for host, lines in pairs)
            print(f"{name:9} {speed:6.4f} m/s, gained by host's law and lines, µJ, delays 1, 2, 5: {row}", flush=True)


if __name__ == "__main__":
    main()
