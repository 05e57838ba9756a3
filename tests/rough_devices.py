"""Random hands on one spring and damper, on devices that are not quite as declared; and what `measure` says of them."""

from __future__ import annotations

import math
import re
from io import StringIO
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

import hapsim
from hapsim.cli.measure_command import show_measurement
from hapsim.errors import UsageError
from hapsim.holds import HOLDS

DAMPERS = ("backward", "centred", "filtered", "sensed")
FAR, TOO_FAR = 3.0, 5.0  # stated uncertainties
_TRIES = 200


class RoughDevice(NamedTuple):
    """A scene, what is wrong with its device, and the k that `measure` should state."""

    scene: hapsim.Scene
    wrong_mass: bool
    wrong_friction: bool
    k: float
    """N/m, of the declared mass."""

    @property
    def dry(self) -> bool:
        """True if the device has dry friction."""
        return self.scene.mock_device.coulomb > 0.0


class Measured(NamedTuple):
    """Report of `measure` on a rough device."""

    apart: float
    """Distance of k to what it is, in stated uncertainties; NaN where no spring and damper was found."""
    off: float
    """The same, relative."""
    words: tuple[str, ...]
    """Reported remarks: "mass", "device", "mode", "dry", "limits", "nothing"."""
    wrong: str
    """The cause among them that is not there; "" where there is none."""


def rough_device(seed: int) -> RoughDevice:
    """The same for the same seed: stable, and felt as a spring and damper."""
    random = np.random.default_rng([seed, 49])
    for _ in range(_TRIES):
        document = _document(random, seed)
        scene, true = hapsim.Scene.model_validate(document), hapsim.Scene.model_validate(_as_it_is(document))
        felt = hapsim.predict(true, with_margins=False)
        if felt.stable and felt.felt[0].dominant and felt.felt[0].k > 0.0 and max(map(abs, felt.poles)) < 0.9995:
            declared, real = scene.device.masses(1)[0], scene.mock_device.mass[0]
            friction = scene.device.frictions(1)[0] != scene.mock_device.friction[0]
            return RoughDevice(scene, declared != real, friction, felt.felt[0].k * declared / real)
    raise AssertionError(f"no stable device of {_TRIES} for the seed {seed}")


def _document(random: np.random.Generator, seed: int) -> dict[str, Any]:
    def between(least: float, most: float) -> float:
        return float(math.exp(random.uniform(math.log(least), math.log(most))))

    rate = float(random.choice([500.0, 1000.0, 1000.0, 2000.0, 4000.0]))
    mass, damper = between(0.05, 0.5), str(random.choice(DAMPERS))
    stiffness = mass * rate**2 * between(3e-5, 0.1)
    damping = 2.0 * random.uniform(0.02, 0.8) * math.sqrt(stiffness * mass)
    device: dict[str, Any] = {
        "clock": "lockstep",
        "mass": mass,
        "friction": float(random.uniform(0.0, 2.0)),
        "delay": float(random.choice([0.0, 0.5, 1.0, 1.0, 2.0])),
        "hold": str(random.choice(list(HOLDS))),
    }
    mock: dict[str, Any] = {
        "seed": seed,
        "quantum": between(1e-9, 24e-6),
        "noise": float(random.choice([0.0, 0.0, between(1e-7, 1e-5)])),
        "initial": {"position": float(random.uniform(0.001, 0.01)) * min(1.0, 2000.0 / stiffness)},
    }
    if random.random() < 0.4:
        mock["coulomb"] = between(0.005, 0.5)
    if random.random() < 0.25:
        mock["mass"] = mass * float(random.choice([between(0.5, 0.9), between(1.1, 2.0)]))
    if random.random() < 0.15:
        mock["friction"] = device["friction"] * float(random.choice([0.999, 1.001, 1.5]))
    if random.random() < 0.4:
        device |= {"soft_start": between(0.005, 0.05), "slew_limit": between(2e3, 2e4)}
    if random.random() < 0.15:
        mock["misses"] = between(1e-4, 5e-3)
    touch = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": stiffness, "damping": damping}
    touch |= {"damper": damper} | ({"cutoff": rate * float(random.uniform(0.05, 0.2))} if damper == "filtered" else {})
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": touch}
    return {"version": 1, "rate": rate, "device": device, "mock": mock, "modules": modules}


def _as_it_is(document: dict[str, Any]) -> dict[str, Any]:
    """The scene that declares what its mock is."""
    mock = document["mock"]
    real = {name: mock[name] for name in ("mass", "friction") if name in mock}
    return document | {"device": document["device"] | real}


def measured(device: RoughDevice) -> Measured:
    """Measures it, and reads what `hapsim measure` prints."""
    scene, prediction = device.scene, hapsim.predict(device.scene, with_margins=False)
    try:
        found = hapsim.measure(scene)
    except UsageError:
        return Measured(math.nan, math.nan, ("nothing",), "")
    out = Console(file=StringIO(), width=10_000, force_terminal=False)
    show_measurement(out, scene, prediction, found)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    named = re.search(r"The mass is probably .* one, (\S+) kg", text)
    mass = None if named is None else float(named[1])
    says = {
        "mode": "Something swings along" in text,
        "mass": mass is not None,
        "device": "further apart" in text,
        "dry": "The device has dry friction" in text,
        "limits": "k and b hold for motions" in text,
        "nothing": not found.dominant,
    }
    true_mass = scene.mock_device.mass[0]
    wrong = {
        "mode": says["mode"] and not device.dry,  # it names dry friction as the other cause
        "mass": mass is not None and (not device.wrong_mass or abs(mass / true_mass - 1.0) > 0.1),
        "device": says["device"] and not (device.wrong_mass or device.wrong_friction or device.dry),
        "dry": "The device has dry friction" in text and not device.dry,
    }
    apart = abs(found.k - device.k) / found.k_uncertainty if found.dominant else math.nan
    words = tuple(name for name, said in says.items() if said)
    return Measured(apart, found.k / device.k - 1.0, words, ", ".join(name for name, is_so in wrong.items() if is_so))
