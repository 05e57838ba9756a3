"""Compares what `hapsim identify --transmission` finds of random mocks, in virtual time, with what they are.

0.05 to 0.5 kg at 1 kHz; a belt with a resonance of 40 to 400 Hz and a damping ratio of 0.01 to 0.08, a motor of 10 to
60 % of the mass, none or up to 0.5 ms of motor lag; noise up to 2 µm rms, counts of 1 to 10 µm, dry friction up to 5 %
of the push. The scene declares another mass and friction, and no belt.

Three kinds, of which the last two are fewer: the sensor at the motor; at the handle, with the declared motor mass; one
mass without a belt. A test draws from here, too.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import hapsim
from hapsim.errors import HapsimError

PUSH, TRAVEL, SECONDS = 5.0, 0.02, 49.0
KINDS = {"motor": 2, "handle": 2, "none": 1}
"""The side of the sensor, or no belt; and the number of masses."""


class Device(NamedTuple):
    """A mock; SI units."""

    mass: float
    motor_mass: float
    resonance_hz: float
    damping_ratio: float
    friction: float
    lag: float
    coulomb: float
    noise: float
    quantum: float
    seed: int

    @property
    def pair(self) -> float:
        """Mass with which motor and handle swing against each other."""
        return self.motor_mass * (self.mass - self.motor_mass) / self.mass

    @property
    def stiffness(self) -> float:
        """Stiffness of the belt."""
        return self.pair * (2.0 * math.pi * self.resonance_hz) ** 2

    @property
    def damping(self) -> float:
        """Damping of the belt."""
        return 2.0 * self.damping_ratio * math.sqrt(self.stiffness * self.pair)

    def scene(self, kind: str, **more: Any) -> hapsim.Scene:
        """It, with its mass declared a fifth too large, as with a hand. `more`: keys of the mock."""
        device: dict[str, Any] = {"clock": "lockstep", "mass": 1.2 * self.mass, "friction": 0.5, "delay": 1}
        names = ("mass", "friction", "coulomb", "noise", "quantum", "seed")
        mock = {name: getattr(self, name) for name in names} | {"motor_lag": self.lag}
        belt = {"stiffness": self.stiffness, "damping": self.damping, "motor_mass": self.motor_mass, "sensor": kind}
        if kind != "none":
            mock["transmission"] = belt
        if kind == "handle":
            device["transmission"] = {"stiffness": 1e4, "motor_mass": self.motor_mass, "sensor": kind}
        modules = {"hand": {"type": "device", "channel": 0}}
        return hapsim.Scene.model_validate(
            {"version": 1, "rate": 1000, "device": device, "mock": mock | more, "modules": modules}
        )


def random_device(seed: int) -> Device:
    """The same for the same seed."""
    rng = np.random.default_rng(seed)
    mass = 10.0 ** rng.uniform(math.log10(0.05), math.log10(0.5))
    share, resonance = rng.uniform(0.1, 0.6), math.exp(rng.uniform(math.log(40.0), math.log(400.0)))
    values = mass, share * mass, resonance, rng.uniform(0.01, 0.08), rng.uniform(0.0, 2.0)
    lag, coulomb = rng.choice([0.0, rng.uniform(0.0, 5e-4)]), rng.uniform(0.0, 0.05) * PUSH
    return Device(*map(float, (*values, lag, coulomb, rng.uniform(0.0, 2e-6), rng.uniform(1e-6, 1e-5))), seed)


def identified(device: Device, kind: str, seconds: float = SECONDS) -> hapsim.TransmissionIdentification:
    """Returns what is found of it."""
    options: dict[str, Any] = {"force": PUSH, "travel": TRAVEL, "duration": seconds, "transport": "loopback"}
    return hapsim.identify_transmission(device.scene(kind), **options)


class Errors(NamedTuple):
    """Found less what it is: the stiffness as a share of it, the lag in s; the same in stated uncertainties."""

    stiffness: float
    lag: float
    stiffness_scaled: float
    lag_scaled: float


def errors(device: Device, found: hapsim.TransmissionIdentification) -> Errors:
    """Returns the errors of one device; NaN for the stiffness of one mass."""
    plant, unsure = found.fit.best.plant, found.fit.best.uncertainty
    stiffness, lag = plant.belt / device.stiffness - 1.0 if plant.motor else math.nan, plant.lag - device.lag
    scaled = stiffness * device.stiffness / unsure.belt if plant.motor else math.nan
    return Errors(stiffness, lag, scaled, lag / unsure.lag)


def compare(kind: str, seeds: range, identify: Callable[[Device, str], hapsim.TransmissionIdentification]) -> None:
    """Prints one row for the devices of one kind, and a line for each that is not found well."""
    found: list[Errors] = []
    wrong, undecided, outliers = 0, 0, list[str]()
    for seed in seeds:
        device = random_device(seed)
        try:
            one = identify(device, kind)
        except HapsimError as error:
            undecided += 1
            outliers.append(f"  {seed}: {error}")
            continue
        wrong += one.fit.masses == 3 - KINDS[kind]
        undecided += one.fit.masses == 0
        off = errors(device, one)
        if one.fit.masses == KINDS[kind]:
            found.append(off)
        if abs(off.stiffness) > 0.03 or abs(off.lag) > 1e-5 or one.fit.masses != KINDS[kind]:
            words = f"stiffness {off.stiffness:+.2%}, lag {1e6 * off.lag:+.1f} ({off.lag_scaled:+.1f} uncertainties)"
            outliers.append(f"  {seed}: {one.fit.masses} masses, {words}; {device}")
    table = np.abs(np.array(found))
    stiffness = "–" if kind == "none" else f"{np.max(table[:, 0]):.2%}, {np.median(table[:, 0]):.2%}"
    within = [int(np.count_nonzero(table[:, 1] < limit)) for limit in (1e-5, 2e-5)]
    lag = f"{1e6 * np.max(table[:, 1]):.1f}, {1e6 * np.median(table[:, 1]):.1f} | {within[0]}, {within[1]}"
    rms = ", ".join(f"{np.sqrt(np.mean(table[:, column] ** 2)):.2f}" for column in (2, 3))
    print(
        f"| {kind} | {len(seeds)} | {wrong} | {undecided} | {stiffness} | {lag} | {rms} |",
        *outliers,
        sep="\n",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/transmissions", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--devices", type=int, default=60, help="with the sensor at the motor; a third as many others")
    parser.add_argument("--first", type=int, default=0, help="seed of the first device")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    arguments = parser.parse_args()
    print(
        "| sensor | devices | wrong | undecided | stiffness: most, median | lag, µs | in 10, 20 | rms / uncertainty |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind in KINDS:
        count = arguments.devices if kind == "motor" else max(arguments.devices // 3, 1)
        seeds = range(arguments.first, arguments.first + count)
        compare(kind, seeds, lambda device, kind: identified(device, kind, arguments.seconds))


if __name__ == "__main__":
    main()
