"""Scenes that every scheme can move, and a run of their tick."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import yaml

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, positions_of
from hapsim.scene import Scene, parse_scene

RATE = 1000.0
T = 1.0 / RATE
SAMPLES = 3_000


def scene_of(scheme: str, modules: Mapping[str, Any], rate: float = RATE, precision: str = "double") -> Scene:
    document = {"version": 1, "rate": rate, "precision": precision, "scheme": scheme, "device": {"mass": 0.2}}
    return parse_scene(yaml.safe_dump(document | {"modules": dict(modules)}, sort_keys=False))


def link(first: str, second: str, stiffness: float, damping: float = 0.0, **more: Any) -> dict[str, Any]:
    between = {"type": "viscoelastic", "between": [first, second]}
    return between | {"stiffness": float(stiffness), "damping": float(damping)} | more


def by_the_tick(scene: Scene, measured: np.ndarray, points: list[str]) -> tuple[np.ndarray, np.ndarray]:
    program = compile_scene(scene)
    start(program, measured[0])
    numbers = numbers_of(scene)
    places = [numbers[name] for name in points]
    forces, positions = np.zeros_like(measured), np.zeros((len(measured), len(points)))
    for n in range(len(measured)):
        tick(program, measured[n], np.zeros(measured.shape[1]), forces[n])
        positions[n] = positions_of(program)[0][places]
    return forces, positions


def strokes(channels: int, seed: int) -> np.ndarray:
    steps = np.random.default_rng(seed).normal(0.0, 2e-3, (SAMPLES, channels))
    return 0.03 * np.sin(np.cumsum(steps, axis=0) + np.arange(channels))


def network(seed: int, share: float | None = None) -> dict[str, Any]:
    """Masses, two strings, a ground and two hands, joined at random; `share`: damping for each stiffness, in s."""
    random = np.random.default_rng(seed)

    def damping(stiffness: float) -> float:
        return float(random.uniform(0.02, 0.5) if share is None else share * stiffness)

    modules: dict[str, Any] = {"left": {"type": "device", "channel": 0}, "right": {"type": "device", "channel": 1}}
    modules["wall"] = {"type": "ground", "position": float(random.uniform(-0.02, 0.02))}
    for i in range(5):
        position, velocity = random.uniform(-0.02, 0.02), random.uniform(-0.2, 0.2)
        mass = random.uniform(0.05, 0.5)
        modules[f"m{i}"] = {"type": "mass", "mass": mass, "position": float(position), "velocity": float(velocity)}
    for name, ends in (("s", ["fixed", "free"]), ("t", ["fixed", "fixed"])):
        stiffness = float(random.uniform(200, 2000))
        friction = float(random.uniform(0, 0.05)) if share is None else 0.0
        modules[name] = {
            "type": "string",
            "masses": int(random.integers(4, 12)),
            "mass": float(random.uniform(0.02, 0.1)),
            "stiffness": stiffness,
            "damping": damping(stiffness),
            "friction": friction,
            "ends": ends,
            "position": float(random.uniform(-0.02, 0.02)),
        }
    points = ["wall", *(f"m{i}" for i in range(5)), "s.1", "s.3", "t.0", "t.2"]
    for i in range(12):
        first, second = random.choice(points, 2, replace=False)
        stiffness = float(random.uniform(10, 1000))
        modules[f"l{i}"] = link(str(first), str(second), stiffness, damping(stiffness))
    modules["touch"] = link("left", "m0", 300.0, 0.3)
    modules["pluck"] = link("s.2", "right", 200.0, 0.2)
    stop = {"type": "buffer", "stiffness": 400.0, "damping": 0.2}
    return modules | {"stop": stop | {"between": ["m1", "t.1"], "distance": 0.001}}


def numbers_in(scene: Scene) -> set[type]:
    """Returns the number types of a scene's program."""
    return {type(part.numbers) for part in compile_scene(scene).parts}


def chain(scheme: str, state: np.ndarray, stiffness: float, damping: float, rate: float = RATE) -> Scene:
    """Masses between two grounds, at (x, v), each held by a link that does nothing."""
    count = state.size // 2
    row = ["wall", *(f"m{i}" for i in range(count)), "rock"]
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules["rock"] = {"type": "ground"}
    for i in range(count):
        x, v = float(state[i]), float(state[count + i])
        modules[f"m{i}"] = {"type": "mass", "mass": 0.1 * (1 + i % 2), "position": x, "velocity": v}
    modules |= {f"l{a}": link(a, b, stiffness, damping) for a, b in pairwise(row)}
    return scene_of(scheme, modules | {f"h{i}": link("hand", f"m{i}", 0.0) for i in range(count)}, rate)
