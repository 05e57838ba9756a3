"""The emulated Hapkit in virtual time: k and b of random scenes beside the prediction, with everything that its plant
has wrong switched off but one; and the highest rate at each baud at which no force is late."""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import hapsim
from hapsim.errors import HapsimError
from hapsim.scene import Scene

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware_protocol/firmware"
PERFECT = ("coulomb=0", "noise=0", "friction=0.5", "emf=0")
PLANTS = {
    "10 bits and 8 bits of duty": PERFECT,
    "and noise of half a count": (*PERFECT, "noise=0.5"),
    "and a back-EMF of 0.4 N·s/m, declared as friction": (*PERFECT, "friction=0.1", "emf=0.4"),
    "and a back-EMF of 0.4 N·s/m, not declared": (*PERFECT, "emf=0.4"),
    "and dry friction of 0.05 N": (*PERFECT, "coulomb=0.05"),
    "as it is: noise, back-EMF declared, dry friction": ("friction=0.1",),
}
RATES = (400, 500, 625, 800, 1000, 1250, 1600, 2000)
BAUDS = (115200, 250000, 500000, 1000000, 2000000)


@contextlib.contextmanager
def board(*properties: str, built: Path | None = None) -> Iterator[str]:
    """The port of an emulated Hapkit with these properties, in virtual time."""
    environment = os.environ | ({} if built is None else {"HAPSIM_FIRMWARE": str(built)})
    command = [FIRMWARE / "board", "hapkit", "/dev/null", "lockstep=1", *properties]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as running:
        assert running.stdout is not None
        try:
            yield running.stdout.readline().strip()
        finally:
            running.terminate()


def scene_of(port: str | None, stiffness: float, damping: float, rate: float = 1000.0) -> Scene:
    """A spring and damper around where the handle is found; without a port on the mock with the sensor's counts."""
    device = {"clock": "lockstep", "mass": 0.1, "friction": 0.5, "force_limit": 4.0, "origin": "here"}
    touch = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": stiffness, "damping": damping}
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": touch}
    behind = {"mock": {"quantum": 17.2e-6}} if port is None else {}
    return Scene.model_validate(
        {"version": 1, "rate": rate, "device": device | ({"port": port} if port else {}), "modules": modules} | behind
    )


def pairs(count: int) -> list[tuple[float, float]]:
    """Random (K, B), N/m and N·s/m, of which the hand feels a swing that dies away."""
    random, found = np.random.default_rng(37), []
    while len(found) < count:
        stiffness, damping = float(np.exp(random.uniform(np.log(50), np.log(800)))), float(random.uniform(0.2, 3.0))
        predicted = hapsim.predict(scene_of(None, stiffness, damping))
        if predicted.stable and 0.03 < predicted.felt[0].damping_ratio < 0.4:
            found.append((stiffness, damping))
    return found


def row(name: str, port: str | None, scenes: list[tuple[float, float]]) -> str:
    """Returns a row of the table: the deviation of k and b from the prediction, in per cent."""
    off, unsure, failed = [], [], 0
    for pair in scenes:
        scene = scene_of(port, *pair)
        predicted = hapsim.predict(scene)
        try:
            measured = hapsim.measure(scene)
        except HapsimError:
            failed += 1
            continue
        if not measured.dominant:
            failed += 1
            continue
        off.append((measured.k / predicted.k - 1.0, measured.b / predicted.b - 1.0))
        unsure.append((measured.k_uncertainty / predicted.k, measured.b_uncertainty / predicted.b))
    if not off:
        return f"| {name} | {len(scenes)} | – | – | – | {failed} |"
    cells = [f"{np.median(column):+.2g}, {np.max(np.abs(column)):.2g}" for column in 100.0 * np.array(off).T]
    within = np.mean(np.abs(off) <= np.array(unsure), axis=0)
    return f"| {name} | {len(scenes)} | {' | '.join(cells)} | {within[0]:.0%}, {within[1]:.0%} | {failed} |"


def highest_rate(baud: int) -> int | None:
    """Hz: the highest of RATES at which an emulated Hapkit that is built for this baud gets every force in time."""
    for rate in reversed(RATES):
        with tempfile.TemporaryDirectory() as to:
            defines = {"DEFINES": f"-DHAPSIM_BAUD={baud}ul -DRATE={rate}"}
            subprocess.run([FIRMWARE / "build", to], env=os.environ | defines, capture_output=True, check=False)
            if not (Path(to) / "run_hapkit").exists():
                continue  # the exchange alone takes longer than a sample
            with board(*PERFECT, built=Path(to)) as port:
                if hapsim.run(scene_of(port, 100.0, 0.5, rate), duration=0.3).report.deadline_misses <= 1:
                    return rate
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=50, help="of the first plant (50); of the others a quarter")
    parser.add_argument("--no-rates", action="store_true", help="leave out the rates, which build anew each time")
    options = parser.parse_args()
    scenes = pairs(options.scenes)
    few = scenes[: max(1, options.scenes // 4)]
    print("| plant | scenes | k off by: median, most, % | b | within the stated uncertainty: k, b | not identified |")
    print("|---|---|---|---|---|---|")
    print(row("the built-in mock, with the sensor's counts", None, few), flush=True)
    for name, properties in PLANTS.items():
        with board(*properties) as port:
            print(row(name, port, scenes if properties == PERFECT else few), flush=True)
    if not options.no_rates:
        print("\n| baud | highest rate, Hz |\n|---|---|")
        for baud in BAUDS:
            print(f"| {baud} | {highest_rate(baud)} |", flush=True)


if __name__ == "__main__":
    main()
