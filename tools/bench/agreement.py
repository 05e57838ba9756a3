"""Predicted and measured, of every shipped scene whose hand is on a linear system of its own, over a pseudo-terminal.

    tools/bench/agreement [--rounds 5]
    tools/bench/agreement --impedance

With --impedance: the driving-point impedance of every shipped scene that is linear, with masses and several hands too,
in virtual time. Those in virtual time give the same numbers in every round, and are measured once.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import hapsim
from hapsim.prediction import predict_impedance

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def is_linear(scene: hapsim.Scene) -> bool:
    """Returns whether every hand of a scene feels one spring and damper, without assumptions."""
    prediction = hapsim.predict(scene)
    return bool(prediction.felt) and not (prediction.coupled or prediction.assumptions or prediction.regions)


def errors(scene: hapsim.Scene) -> tuple[float, float, float, float]:
    """(how far off the pole is, its stated uncertainty, k and b off by, relative)"""
    felt, measured = hapsim.predict(scene).felt[0], hapsim.measure(scene, transport="terminal")
    off = min(abs(measured.pole - pole) for pole in felt.poles)
    return off, measured.pole_uncertainty, measured.k / felt.k - 1.0, measured.b / felt.b - 1.0


def spread(values: list[float], form: str) -> str:
    """Median, and the range in brackets where there is one."""
    middle = f"{statistics.median(values):{form}}"
    return middle if len(values) == 1 else f"{middle} [{min(values):{form}}, {max(values):{form}}]"


def impedances() -> Iterator[str]:
    """Yields a row per linear scene: the largest ratio of error to uncertainty, and the median relative uncertainty,
    over the frequencies of the impedances."""
    yield "| scene | hands | frequencies | device | its uncertainty | rendered | its uncertainty | closed loop |"
    yield "|---|---|---|---|---|---|---|---|"
    for path in sorted(CONFIGS.glob("*.yaml")):
        scene = hapsim.load_scene(path)
        prediction = hapsim.predict(scene, with_margins=False)
        if prediction.assumptions or prediction.regions:
            continue
        scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
        measured = hapsim.measure_impedance(scene)
        predicted = predict_impedance(scene, measured.frequency)
        apart, wide = {}, {}
        for kind in ("device", "rendered", "closed_loop"):
            value, uncertainty = getattr(measured, kind)
            off = np.abs(value - getattr(predicted, kind))
            apart[kind] = float(np.max(np.divide(off, uncertainty, out=np.zeros_like(off), where=off > 0.0)))
            own = np.arange(len(measured.channels))
            wide[kind] = float(np.median(uncertainty[:, own, own] / np.abs(value[:, own, own])))
        cells = [path.stem, f"{len(measured.channels)}", f"{measured.frequency.size}"]
        cells += [f"{apart['device']:.2f}", f"{wide['device']:.0e}"]
        cells += [f"{apart['rendered']:.2f}", f"{wide['rendered']:.0e}", f"{apart['closed_loop']:.2f}"]
        yield "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/agreement", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="of the scenes that run in real time")
    parser.add_argument("--impedance", action="store_true", help="over frequency, in place of k and b")
    arguments = parser.parse_args()
    if arguments.impedance:
        for row in impedances():
            print(row, flush=True)
        return
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
