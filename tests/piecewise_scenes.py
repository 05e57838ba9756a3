"""Random scenes of one hand on piecewise-linear links, and the force and damping of each link once more, by formula."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from hapsim.prediction import predict, states
from hapsim.prediction.linear import links_of
from hapsim.scene import Scene, parse_scene

Floats = NDArray[np.float64]
TRAVEL = (-0.02, 0.02)


def random_scene(seed: int, *, clock: str = "device") -> dict[str, Any]:
    """A scene's document: one hand on a spring, and on one to three of stops, tables, clicks, detents, friction."""
    draw = np.random.default_rng(seed)
    mass, rate = float(draw.choice([0.05, 0.1, 0.3])), float(draw.choice([1000.0, 2000.0, 4000.0]))
    soft = mass * rate**2 * 0.003  # a stiffness that every one of these loops renders
    stiff = float(draw.uniform(0.1, 1.0) * soft)
    damping = float(draw.uniform(0.2, 1.0) * 0.01 * mass * rate)
    makers = [_stop, _table, _click, _detent, _friction]
    chosen = draw.choice(len(makers), size=int(draw.integers(1, 4)), replace=False)
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "frame": {"type": "ground"}}
    if draw.random() < 0.7:
        spring = {"type": "viscoelastic", "between": ["hand", "frame"], "stiffness": 0.3 * stiff, "damping": damping}
        modules["spring"] = spring
    for which in chosen:
        makers[which](draw, modules, stiff, damping)
    return {
        "version": 1,
        "rate": rate,
        "device": {
            "clock": clock,
            "mass": mass,
            "friction": float(draw.uniform(0.1, 0.5) * 0.01 * mass * rate),
            "delay": float(draw.choice([0.0, 1.0])),
            "force_limit": 1000.0,
            "travel": list(TRAVEL),
            "travel_margin": 2.0,
        },
        "modules": modules,
    }


def as_scene(document: dict[str, Any]) -> Scene:
    return parse_scene(json.dumps(document))  # JSON is YAML


def _place(draw: np.random.Generator) -> float:
    return float(draw.integers(-140, 140)) * 1e-4


def _stop(draw: np.random.Generator, modules: dict[str, Any], stiff: float, damping: float) -> None:
    low, high = _place(draw), 0.016
    modules |= {"low": {"type": "ground", "position": low}, "high": {"type": "ground", "position": high}}
    both = {"type": "buffer", "stiffness": stiff, "damping": damping}
    modules["stop"] = both | {"between": ["hand", "low"], "distance": 0.0003}
    modules["cover"] = both | {"between": ["high", "hand"]}


def _table(draw: np.random.Generator, modules: dict[str, Any], stiff: float, _damping: float) -> None:
    at = np.sort(draw.choice(np.arange(-150, 150, 7), size=int(draw.integers(2, 7)), replace=False)) * 1e-4
    force = np.cumsum(draw.uniform(-0.5, 1.0, at.size) * stiff * 0.003)
    points = [[float(x), float(f)] for x, f in zip(at, force, strict=True)]
    modules["table"] = {"type": "nonlinear", "between": ["frame", "hand"], "force_over_distance": points}


def _click(draw: np.random.Generator, modules: dict[str, Any], stiff: float, damping: float) -> None:
    travel = float(draw.uniform(0.002, 0.006))
    peak = stiff * travel * float(draw.uniform(0.2, 0.45))
    modules["base"] = {"type": "ground", "position": _place(draw)}
    modules["click"] = {"type": "click", "between": ["hand", "base"], "travel": travel, "peak": peak,
                        "drop": peak * float(draw.uniform(0.3, 0.9)), "bottom": stiff, "damping": damping}  # fmt: skip


def _detent(draw: np.random.Generator, modules: dict[str, Any], stiff: float, damping: float) -> None:
    pitch, shape = float(draw.uniform(0.006, 0.015)), str(draw.choice(["snap", "notch"]))
    sharpness = float(draw.choice([1.0, 1.5, 3.0]))
    depth = stiff * pitch * float(draw.uniform(0.05, 0.08)) / sharpness
    modules["detent"] = {"type": "detent", "between": ["hand", "frame"], "pitch": pitch, "depth": depth,
                         "shape": shape, "sharpness": sharpness, "damping": damping}  # fmt: skip


def _friction(draw: np.random.Generator, modules: dict[str, Any], stiff: float, damping: float) -> None:
    force = stiff * float(draw.uniform(0.5, 2.0)) * 1e-3
    modules["rub"] = {"type": "friction", "between": ["hand", "frame"], "force": force, "stiffness": 0.5 * stiff,
                      "static": force * float(draw.choice([1.0, 1.4])), "damping": damping}  # fmt: skip


def formulas(document: dict[str, Any], x: Floats, *, sticks: bool) -> tuple[Floats, Floats]:
    """(N, N·s/m) with which the hand pushes to rest at each x (m), and the damping it feels there; friction sticks
    about x, with the slope of its bristle added as if it were bent from 0."""
    modules = document["modules"]
    force, damping = np.zeros(x.size), np.zeros(x.size)
    for module in modules.values():
        if "between" not in module:
            continue
        first, second = module["between"]
        sign = 1.0 if first == "hand" else -1.0
        fixed = modules[second if first == "hand" else first].get("position", 0.0)
        tension, damped = _FORMULAS[module["type"]](module, sign * (x - fixed))
        if module["type"] != "friction" or sticks:
            force, damping = force + sign * tension, damping + module.get("damping", 0.0) * damped
    return force, damping


def _buffer(module: dict[str, Any], d: Floats) -> tuple[Floats, Floats]:
    deep = module.get("distance", 0.0) - d
    return -module["stiffness"] * np.maximum(deep, 0.0), (deep > 0.0).astype(float)


def _pressed(module: dict[str, Any], d: Floats) -> tuple[Floats, Floats]:
    t, peak, drop = module["travel"], module["peak"], module["drop"]
    slope, p = 2.0 * peak / t, -d
    rising = np.where(p <= 0.5 * t, slope * p, peak - drop * (p - 0.5 * t) / (0.25 * t))
    deeper = peak - drop + slope * (np.minimum(p, t) - 0.75 * t) + module["bottom"] * np.maximum(p - t, 0.0)
    return -np.where(p <= 0.0, 0.0, np.where(p <= 0.75 * t, rising, deeper)), (p > 0.0).astype(float)


def _notches(module: dict[str, Any], d: Floats) -> tuple[Floats, Floats]:
    pitch, s = module["pitch"], module["sharpness"]
    u = np.remainder(d + 0.5 * pitch, pitch) - 0.5 * pitch
    if module["shape"] == "snap":
        rise = 0.5 * pitch * s / (s + 1.0)
        shape = np.where(np.abs(u) <= rise, np.abs(u) / rise, (0.5 * pitch - np.abs(u)) / (0.5 * pitch - rise))
    else:
        shape = np.maximum(1.0 - np.abs(np.abs(u) - 0.25 * pitch / s) / (0.25 * pitch / s), 0.0)
    return module["depth"] * np.sign(u) * shape, np.ones(d.size)


_FORMULAS: dict[str, Callable[[dict[str, Any], Floats], tuple[Floats, Floats]]] = {
    "viscoelastic": lambda module, d: (module["stiffness"] * d, np.ones(d.size)),
    "buffer": _buffer,
    "nonlinear": lambda module, d: (np.interp(d, *zip(*module["force_over_distance"], strict=True)), 0.0 * d),
    "click": _pressed,
    "detent": _notches,
    "friction": lambda module, d: (module["stiffness"] * d, np.ones(d.size)),
}


def springs_in_regions(scene: Scene) -> set[tuple[float, float]]:
    """N/m and N·s/m of all links together in each region of the hand."""
    (regions,) = predict(scene, with_margins=False).judge.regions.values()
    return {(round(one.felt.stiffness, 6), round(one.felt.damping, 6)) for one in regions}


def springs_in_states(scene: Scene) -> set[tuple[float, float]]:
    """The same in each state of its contacts, as of a hand that moves more than itself."""
    with mock.patch.object(states, "needs_network", return_value=True):
        prediction = predict(scene, with_margins=False)
    links = links_of(prediction._linear, "hand")
    (every,) = prediction.states.parts
    found = [[state[name].linear if name in state else one for name, one in links.items()] for state in every]
    sums = ((sum(one.stiffness for one in here), sum(one.damping for one in here)) for here in found)
    return {(round(stiffness, 6), round(damping, 6)) for stiffness, damping in sums}
