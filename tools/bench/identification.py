"""What is identified of random devices, beside what they are: how far off, and whether the uncertainties hold.

    tools/bench/identification [--devices 50] [--wrong 3] [--picture FILE]

Mocks in memory at a micrometre per count: mass 0.02 to 2 kg, friction 0 to 5 N·s/m, delay 0 to 3 samples, rate 500 to
5000 Hz; half of them without friction, half with dry friction up to 0.5 N, half with a spring up to 200 N/m.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import hapsim

NAMES = ("mass", "friction", "stiffness", "delay", "coulomb")
FORCE, TRAVEL, SECONDS = 5.0, 0.02, 12.0


@dataclass(frozen=True)
class Device:
    """What a mock is; SI units, delay in sample periods."""

    rate: float
    mass: float
    friction: float
    stiffness: float
    delay: float
    coulomb: float

    def scene(self, wrong: float = 1.0, hold: str = "zoh", sampling: str = "ideal") -> hapsim.Scene:
        """It, with mass, friction and delay declared `wrong` times too large."""
        return hapsim.parse_scene(
            f"""
version: 1
rate: {self.rate!r}
device: {{clock: lockstep, mass: {wrong * self.mass!r}, friction: {wrong * self.friction!r},
         delay: {wrong * self.delay!r}, hold: {hold}, sampling: {sampling}}}
mock: {{mass: {self.mass!r}, friction: {self.friction!r}, stiffness: {self.stiffness!r}, delay: {self.delay!r},
       coulomb: {self.coulomb!r}, quantum: 1.0e-6}}
modules:
  hand: {{type: device, channel: 0}}
"""
        )


def random_device(seed: int) -> Device:
    """The same for the same seed."""
    rng = np.random.default_rng(seed)
    mass = 10.0 ** rng.uniform(math.log10(0.02), math.log10(2.0))
    friction, delay = rng.choice([0.0, rng.uniform(0.0, 5.0)]), rng.uniform(0.0, 3.0)
    coulomb, stiffness = rng.choice([0.0, rng.uniform(0.0, 0.5)]), rng.choice([0.0, rng.uniform(0.0, 200.0)])
    return Device(*map(float, (rng.uniform(500.0, 5000.0), mass, friction, stiffness, delay, coulomb)))


def errors(device: Device, found: hapsim.DeviceIdentification) -> tuple[list[float], list[float]]:
    """(found less what it is, the same in stated uncertainties), in the order of NAMES."""
    off = [getattr(found, name).value - getattr(device, name) for name in NAMES]
    return off, [one / getattr(found, name).uncertainty for one, name in zip(off, NAMES, strict=True)]


def draw(scaled: np.ndarray, path: Path) -> None:
    """Errors in stated uncertainties: the share that lies within so many, beside the normal distribution's."""
    from matplotlib.figure import Figure
    from scipy.special import erf

    figure = Figure(figsize=(5.2, 4.2), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    within = np.linspace(0.0, 3.5, 200)
    expected = erf(within / math.sqrt(2.0))
    spread = 2.0 * np.sqrt(expected * (1.0 - expected) / len(scaled))
    band = f"normal distribution, and what 95 % of {len(scaled)} draws keep to"
    axes.fill_between(within, expected - spread, np.minimum(expected + spread, 1.0), color="0.88", lw=0)
    axes.plot(within, expected, color="black", linewidth=1.0, label=band)
    for name, column in zip(NAMES, np.abs(scaled).T, strict=True):
        label = "dry friction" if name == "coulomb" else name
        axes.step(np.sort(column), np.arange(1, len(column) + 1) / len(column), where="post", lw=1.2, label=label)
    axes.set(xlim=(0.0, 3.5), ylim=(0.0, 1.02))
    axes.set_xlabel("error / stated uncertainty")
    axes.set_ylabel("share of the devices within it")
    axes.legend(frameon=False, loc="lower right", fontsize=8)
    figure.savefig(path, metadata={"Software": None} if path.suffix == ".png" else None)


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/identification", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--devices", type=int, default=50)
    parser.add_argument("--wrong", type=float, default=1.0, help="times that mass, friction and delay are declared")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    off, scaled, shares = [], [], []
    for seed in range(arguments.devices):
        device = random_device(seed)
        found = hapsim.identify_device(
            device.scene(arguments.wrong), force=FORCE, travel=TRAVEL, duration=SECONDS, transport="loopback"
        )
        one, in_uncertainties = errors(device, found)
        off.append(one)
        scaled.append(in_uncertainties)
        shares.append((one[0] / device.mass, one[1] / device.friction if device.friction else math.nan))
    largest = np.max(np.abs(off), axis=0)
    relative = np.nanmax(np.abs(shares), axis=0)
    z = np.abs(scaled)
    print("| | off by, at most | within 1 uncertainty | within 1.96 | rms, in uncertainties |\n|---|---|---|---|---|")
    for i, name in enumerate(NAMES):
        told = f"{largest[i]:.1e}" + (f" ({relative[i]:.1e} of it)" if i < 2 else "")
        cells = [told, f"{np.mean(z[:, i] < 1.0):.0%}", f"{np.mean(z[:, i] < 1.96):.0%}"]
        print("| " + " | ".join([name, *cells, f"{np.sqrt(np.mean(z[:, i] ** 2)):.2f}"]) + " |")
    print(f"all: {np.mean(z < 1.0):.1%} within 1, {np.mean(z < 1.96):.1%} within 1.96; largest {np.max(z):.2f}")
    if arguments.picture is not None:
        draw(np.array(scaled), arguments.picture)


if __name__ == "__main__":
    main()
