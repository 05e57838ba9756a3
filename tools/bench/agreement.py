"""Predicted and measured, of every shipped scene whose hand is on a linear system of its own, over a pseudo-terminal.

    tools/bench/agreement [--rounds 5]

Those in virtual time give the same numbers in every round, and are measured once.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import hapsim

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def is_linear(scene: hapsim.Scene) -> bool:
    """Whether a hand on its own spring and damper is what the scene is, with nothing assumed."""
    prediction = hapsim.predict(scene)
    return bool(prediction.felt) and not prediction.coupled and not prediction.assumptions


def errors(scene: hapsim.Scene) -> tuple[float, float, float, float]:
    """(how far off the pole is, its stated uncertainty, k and b off by, relative)"""
    felt, measured = hapsim.predict(scene).felt[0], hapsim.measure(scene, transport="terminal")
    off = min(abs(measured.pole - pole) for pole in felt.poles)
    return off, measured.pole_uncertainty, measured.k / felt.k - 1.0, measured.b / felt.b - 1.0


def spread(values: list[float], form: str) -> str:
    """Median, and the range in brackets where there is one."""
    middle = f"{statistics.median(values):{form}}"
    return middle if len(values) == 1 else f"{middle} [{min(values):{form}}, {max(values):{form}}]"


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/agreement", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="of the scenes that run in real time")
    arguments = parser.parse_args()
    print("| scene | pole off by | its stated uncertainty | k off by | b off by |")
    print("|---|---|---|---|---|")
    for path in sorted(CONFIGS.glob("*.yaml")):
        scene = hapsim.load_scene(path)
        if is_linear(scene):
            virtual = scene.device.clock == "lockstep"
            rows = [errors(scene) for _ in range(1 if virtual else arguments.rounds)]
            off, stated, k, b = (list(column) for column in zip(*rows, strict=True))
            cells = [spread(off, ".0e"), spread(stated, ".0e"), spread(k, "+.0e"), spread(b, "+.0e")]
            print("| " + " | ".join([path.stem, *cells]) + " |", flush=True)


if __name__ == "__main__":
    main()
