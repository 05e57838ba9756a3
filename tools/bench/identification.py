"""Accuracy of identification on random devices: its errors, and the coverage of its uncertainties.

    tools/bench/identification [--devices 50] [--first 0] [--wrong 3] [--rough] [--picture FILE]

Mocks in memory at a micrometre per count: mass 0.02 to 2 kg, friction 0 to 5 N·s/m, delay 0 to 3 samples, rate 500 to
5000 Hz; half of them without friction, half with dry friction up to 0.5 N, half with a spring up to 200 N/m.
`--rough`: half of them with sensor noise up to 10 µm rms, and counts of 1 nm to 24 µm.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import hapsim
from hapsim.errors import HapsimError, RunError
from hapsim.measuring import identify_device

NAMES = ("mass", "friction", "stiffness", "delay", "coulomb")
FORCE, TRAVEL, SECONDS = 5.0, 0.02, 12.0


@dataclass(frozen=True)
class Device:
    """Parameters of a mock; SI units, delay in sample periods."""

    rate: float
    mass: float
    friction: float
    stiffness: float
    delay: float
    coulomb: float
    noise: float = 0.0
    """m rms, of the sensor."""
    quantum: float = 1e-6
    """m per count."""
    seed: int = 0
    """Seed of the noise."""

    def scene(self, wrong: float = 1.0, hold: str = "zoh", sampling: str = "ideal") -> hapsim.Scene:
        """It, with mass, friction and delay declared `wrong` times too large."""
        return hapsim.parse_scene(
            f"""
version: 1
rate: {self.rate!r}
device: {{clock: lockstep, mass: {wrong * self.mass!r}, friction: {wrong * self.friction!r},
         delay: {wrong * self.delay!r}, hold: {hold}, sampling: {sampling}}}
mock: {{mass: {self.mass!r}, friction: {self.friction!r}, stiffness: {self.stiffness!r}, delay: {self.delay!r},
       coulomb: {self.coulomb!r}, quantum: {self.quantum!r}, noise: {self.noise!r}, seed: {self.seed}}}
modules:
  hand: {{type: device, channel: 0}}
"""
        )


def random_device(seed: int, rough: bool = False) -> Device:
    """The same for the same seed; `rough` adds noise and other counts to it."""
    rng = np.random.default_rng(seed)
    mass = 10.0 ** rng.uniform(math.log10(0.02), math.log10(2.0))
    friction, delay = rng.choice([0.0, rng.uniform(0.0, 5.0)]), rng.uniform(0.0, 3.0)
    coulomb, stiffness = rng.choice([0.0, rng.uniform(0.0, 0.5)]), rng.choice([0.0, rng.uniform(0.0, 200.0)])
    device = Device(*map(float, (rng.uniform(500.0, 5000.0), mass, friction, stiffness, delay, coulomb)))
    if not rough:
        return device
    noise, quantum = rng.choice([0.0, rng.uniform(0.0, 1e-5)]), 10.0 ** rng.uniform(-9.0, math.log10(2.4e-5))
    return replace(device, noise=float(noise), quantum=float(quantum), seed=seed)


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


def farthest_of_runs(identify: Callable[[], hapsim.DeviceIdentification], noise: float) -> tuple[object, float]:
    """(what is found, or the error; m from where the device was found, in any run, less four times the noise). A
    result keeps the runs of its fit only: those before it, and those of an error, are seen as they are run."""
    as_it_is, runs = identify_device.run, []

    def run(*given: object, **options: object) -> hapsim.Trace:
        try:
            trace = as_it_is(*given, **options)  # type: ignore[arg-type]
        except RunError as error:
            if error.trace is not None:
                runs.append(error.trace)
            raise
        runs.append(trace)
        return trace

    identify_device.run = run  # type: ignore[assignment]
    try:
        found: object = identify()
    except HapsimError as error:
        found = error
    finally:
        identify_device.run = as_it_is
    home = float(np.median(runs[0].position[:, 0]))
    return found, max(float(np.max(np.abs(trace.position[:, 0] - home))) for trace in runs) - 4.0 * noise


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/identification", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--devices", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first device")
    parser.add_argument("--wrong", type=float, default=1.0, help="times that mass, friction and delay are declared")
    parser.add_argument("--rough", action="store_true", help="with sensor noise, and counts of any size")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    off, scaled, shares, farthest, rejected = [], [], [], 0.0, []
    for seed in range(arguments.first, arguments.first + arguments.devices):
        device = random_device(seed, arguments.rough)
        identify = partial(
            hapsim.identify_device,
            device.scene(arguments.wrong),
            force=FORCE,
            travel=TRAVEL,
            duration=SECONDS,
            transport="loopback",
        )
        found, far = farthest_of_runs(identify, device.noise)
        farthest = max(farthest, far)
        if not isinstance(found, hapsim.DeviceIdentification):
            rejected.append(f"{device}: {found}")
            continue
        one, in_uncertainties = errors(device, found)
        off.append(one)
        scaled.append(in_uncertainties)
        shares.append((one[0] / device.mass, one[1] / device.friction if device.friction else math.nan))
    largest = np.max(np.abs(off), axis=0)
    relative = np.nanmax(np.abs(shares), axis=0)
    z = np.abs(scaled)
    print("| | off by, at most | within 1 uncertainty | within 1.96 | rms, in uncertainties |\n|---|---|---|---|---|")
    for i, name in enumerate(NAMES):
        worst = f"{largest[i]:.1e}" + (f" ({relative[i]:.1e} of it)" if i < 2 else "")
        cells = [worst, f"{np.mean(z[:, i] < 1.0):.0%}", f"{np.mean(z[:, i] < 1.96):.0%}"]
        print("| " + " | ".join([name, *cells, f"{np.sqrt(np.mean(z[:, i] ** 2)):.2f}"]) + " |")
    within = ", ".join(f"{np.mean(z < limit):.1%} within {limit:g}" for limit in (1.0, 1.96, 2.0, 3.0))
    print(f"all: {within}; largest {np.max(z):.2f}")
    print(f"farthest: {1e3 * farthest:.4g} mm of {1e3 * TRAVEL:g} mm; rejected: {len(rejected)}", *rejected, sep="\n")
    if arguments.picture is not None:
        draw(np.array(scaled), arguments.picture)


if __name__ == "__main__":
    main()
