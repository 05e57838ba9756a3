"""Random linear scenes whose k and b are known exactly, and the errors of what `measure` says of them.

The truth is the prediction: on these scenes its matrices are exact. A measurement never sees it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import hapsim
from hapsim.errors import UsageError
from hapsim.holds import HOLDS
from hapsim.measuring.measure_hands import measure_hands
from hapsim.prediction import Prediction
from hapsim.scene import Scene

KINDS = ("line", "line, noisy", "hands", "hands, noisy", "plane", "plane, noisy")
PREDICTOR = {"correction": "predictor"}
SENSED = {"correction": "sensed", "sensors": ["velocity", "acceleration"]}
KAPPA, RATIO = tuple(1e-4 * (2.0 / 1e-4) ** (i / 5) for i in range(6)), (0.0, 0.5, 1.0, 1.5)
"""K T²/m and damping ratios of the plane of fast motions."""
_MASS, _RATE, _TRIES = 0.2, 1000.0, 200


class Compared(NamedTuple):
    """Errors of a measurement: in its uncertainties, (values,), and the largest relative to the largest value."""

    apart: np.ndarray
    off: float


def fast_scene(kappa: float, ratio: float, device: dict[str, Any], mock: dict[str, Any]) -> Scene:
    """A hand of 0.2 kg and 0.3 N·s/m at 1 kHz, delay 1, on one spring and damper."""
    k = kappa * _MASS * _RATE**2
    b = max(2.0 * ratio * math.sqrt(k * _MASS) - 0.3, 0.0)
    declared = {"clock": "lockstep", "mass": _MASS, "friction": 0.3, "delay": 1, "force_limit": 17464.8}
    return _scene({"touch": _link("hand", "wall", k, b)}, declared | device, {"quantum": 1e-9} | mock)


def _link(first: str, second: str, stiffness: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping} | more


def _scene(modules: dict[str, Any], device: dict[str, Any], mock: dict[str, Any], hands: int = 1, **more: Any) -> Scene:
    names = ["hand"] if hands == 1 else [f"hand_{i}" for i in range(hands)]
    points = {name: {"type": "device", "channel": i} for i, name in enumerate(names)}
    document = {"version": 1, "rate": _RATE, "device": {"clock": "lockstep"} | device, "mock": mock}
    return Scene.model_validate(document | {"modules": points | {"wall": {"type": "ground"}} | modules} | more)


def random_scene(kind: str, seed: int) -> tuple[Scene, Prediction]:
    """The same for the same seed: stable, decaying, and felt as springs and dampers; with its prediction."""
    random = np.random.default_rng([seed, KINDS.index(kind)])
    what, _, noisy = kind.partition(", ")
    make = {"line": _line, "hands": _hands, "plane": _plane}[what]
    for _ in range(_TRIES):
        scene = make(random, bool(noisy), seed)
        found = hapsim.predict(scene, with_margins=False, at=(0.0, 0.0) if what == "plane" else None)
        felt = found.parts[0].felt if len(found.parts) == 1 else None
        lone = what != "line" or bool(found.felt and found.felt[0].dominant and found.felt[0].k > 0.0)
        if found.stable and felt is not None and not felt.reason and lone and max(map(abs, found.poles)) < 0.9995:
            return scene, found
    raise AssertionError(f"no scene of {_TRIES} for the seed {seed}")


def _between(random: np.random.Generator, least: float, most: float) -> float:
    return float(math.exp(random.uniform(math.log(least), math.log(most))))


def _mock(random: np.random.Generator, noisy: bool, seed: int, finest: float) -> dict[str, Any]:
    if not noisy:
        return {"quantum": _between(random, finest, 100.0 * finest)}
    return {"quantum": 1e-9, "noise": _between(random, 1e-8, 2e-6), "seed": seed}


def _line(random: np.random.Generator, noisy: bool, seed: int) -> Scene:
    """Every correction and hold, delays to three samples."""
    stiffness = _MASS * _RATE**2 * _between(random, 1e-4, 1.0)
    damping = 2.0 * random.uniform(0.02, 1.2) * math.sqrt(stiffness * _MASS)
    corrections: tuple[dict[str, Any], ...] = ({}, {}, {"correction": "poles"}, PREDICTOR, PREDICTOR, SENSED)
    correction = dict(corrections[int(random.integers(len(corrections)))])
    device = {"mass": _MASS, "friction": float(random.uniform(0.0, 2.0)), "force_limit": 1000.0}
    device |= {
        "delay": float(random.choice([0.0, 0.37, 1.0, 1.0, 1.6, 2.0, 3.0])),
        "hold": str(random.choice([*HOLDS])),
    }
    start = {"initial": {"velocity": float(random.choice([0.0, _between(random, 0.01, 1.0)]))}}
    if correction == SENSED:
        device["hold"] = "zoh"
    return _scene(
        {"touch": _link("hand", "wall", stiffness, damping)},
        device | correction,
        start | _mock(random, noisy, seed, 1e-9),
    )


def _hands(random: np.random.Generator, noisy: bool, seed: int) -> Scene:
    """Two or three hands in a row, and one or two links to a wall."""
    hands = int(random.integers(2, 4))
    ends = [(f"hand_{i}", f"hand_{i + 1}") for i in range(hands - 1)]
    ends += [(f"hand_{int(random.integers(hands))}", "wall") for _ in range(int(random.integers(1, 3)))]
    links = {
        f"link_{i}": _link(*pair, 10.0 ** random.uniform(2.0, 3.5), 10.0 ** random.uniform(-0.3, 0.9))
        for i, pair in enumerate(ends)
    }
    device = {"mass": (10.0 ** random.uniform(-1.2, 0.0, hands)).tolist(), "delay": float(random.choice([0.5, 1.0]))}
    device |= {"friction": (10.0 ** random.uniform(-0.3, 0.5, hands)).tolist()}
    return _scene(links, device, _mock(random, noisy, seed, 1e-9), hands)


def _plane(random: np.random.Generator, noisy: bool, seed: int) -> Scene:
    """A hand that two or three springs hold in the plane."""
    links, angle = {}, random.uniform(0.0, math.pi)
    grounds = {}
    for i in range(int(random.integers(2, 4))):
        angle += random.uniform(0.5, 1.5)
        far = random.uniform(0.03, 0.08)
        grounds[f"post_{i}"] = {"type": "ground", "position": [far * math.cos(angle), far * math.sin(angle)]}
        links[f"link_{i}"] = _link(
            "hand", f"post_{i}", 10.0 ** random.uniform(2.5, 3.3), 10.0 ** random.uniform(0.0, 0.9), length=float(far)
        )
    device = {"mass": 0.2, "friction": float(random.uniform(0.5, 2.0)), "delay": float(random.choice([0.5, 1.0]))}
    document = {
        "version": 1, "rate": _RATE, "space": 2, "device": {"clock": "lockstep"} | device,
        "mock": _mock(random, noisy, seed, 1e-11),
        "modules": {"hand": {"type": "device", "channels": [0, 1]}} | grounds | links,
    }  # fmt: skip
    return Scene.model_validate(document)


def compared(kind: str, scene: Scene, prediction: Prediction) -> Compared | None:
    """Measures it; None if hapsim says that it cannot, or cannot well."""
    part = prediction.parts[0]
    try:
        if kind.startswith("hands"):
            found: Any = measure_hands(scene, channels=part.channels)
        else:
            found = hapsim.measure(scene, at=(0.0, 0.0) if kind.startswith("plane") else None)
    except UsageError:
        return None
    lone = kind.startswith("line")
    if lone and (not found.dominant or found.too_fast):
        return None
    felt = prediction.felt[0] if lone else part.felt
    apart, off = [], []
    for name in ("k", "b"):
        true = np.atleast_1d(getattr(felt, name))
        error = np.atleast_1d(getattr(found, name)) - true
        apart.append((error / getattr(found, f"{name}_uncertainty")).ravel())
        off.append(float(np.max(np.abs(error)) / np.max(np.abs(true))))
    return Compared(np.concatenate(apart), max(off))
