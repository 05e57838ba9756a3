"""Scenes with two coordinates for tests of the kernel: hands that are moved along paths, and the forces on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import Program, compile_scene
from hapsim.scene import Scene

Floats = NDArray[np.float64]

RATE = 1000.0


def scene_of(modules: Mapping[str, Any], **more: Any) -> Scene:
    """A hand, a post at (0, 0), and these modules. A link without `between` joins hand and post."""
    ends = {"between": ["hand", "post"]}
    points = ("mass", "ground", "device")
    links = {name: (one if one["type"] in points else ends | dict(one)) for name, one in modules.items()}
    always = {"hand": {"type": "device", "channels": [0, 1]}, "post": {"type": "ground"}}
    document = {"version": 1, "rate": RATE, "space": 2, "device": {"mass": 0.2}, "modules": always | links}
    return Scene.model_validate(document | more)


def shape(form: Mapping[str, Any], stiffness: float = 2000.0, **more: Any) -> dict[str, Any]:
    return {"type": "shape", "form": form, "stiffness": stiffness, **more}


def moved(program: Program, path: Floats, begin: bool = True) -> Floats:
    """Forces on the hands along a path, (samples, channels) m and N."""
    forces = np.zeros_like(path)
    if begin:
        start(program, path[0])
    ticks(program, path, np.zeros_like(path), forces, len(path))
    return forces


def forces(modules: Mapping[str, Any], path: Any, **more: Any) -> Floats:
    return moved(compile_scene(scene_of(modules, **more)), np.asarray(path, float))


def line(begin: Any, end: Any, steps: int) -> Floats:
    """A path straight from place to place, (steps + 1, 2) m."""
    return np.asarray(begin, float) + np.linspace(0.0, 1.0, steps + 1)[:, None] * (np.asarray(end, float) - begin)


def turned(points: Any, angle: float) -> Floats:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points, float) @ np.array([[c, s], [-s, c]])


def noisy(path: Floats, size: float = 1e-6, seed: int = 0) -> Floats:
    return path + np.random.default_rng(seed).normal(0.0, size, path.shape)
