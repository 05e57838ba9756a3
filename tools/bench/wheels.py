"""Random wheels and knobs for tools/bench/energy_guard, of 1e-5 to 0.1 kg·m² and 5 mN·m to 20 N·m.

The passive ones are wound up by up to a turn and released, or flicked at up to 60 rad/s: springs, stops,
detents, tables and clicks; on encoders of 1e-6 rad to 1024 counts a turn. Some have a
travel of several turns. The unstable ones begin with a small flick, or a little off the middle of a detent.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import hapsim
from hapsim.scales import SCALES
from hapsim.scene import Scene, parse_scene

PASSIVE = ("spring", "spring", "stops", "detent", "table", "click")
UNSTABLE = ("spring", "damper", "stops", "inner wheel", "detent")
TURN = 2.0 * math.pi


class Drawn(NamedTuple):
    """A scene, and what was drawn of it."""

    kind: str
    scene: Scene
    mass: float
    speed: float
    duration: float


def passive_wheels(number: int, seed: int) -> Iterator[Drawn]:
    """`number` wheels with the 1.02 to 2 times the friction that their steepest slope needs."""
    chance = random.Random(seed)
    for _ in range(number):
        yield _passive(chance)


def unstable_wheels(number: int, seed: int, least: float = 1.002, most: float = 1.5) -> Iterator[Drawn]:
    """`number` wheels with a spectral radius within these bounds."""
    chance, found = random.Random(seed), 0
    while found < number:
        drawn = _unstable(chance)
        if least <= hapsim.predict(drawn.scene, with_margins=False).spectral_radius <= most:
            found += 1
            yield drawn


def _device(chance: random.Random) -> tuple[dict[str, Any], float]:
    inertia = _log_uniform(chance, 1e-5, 0.1)
    limit = min(max(inertia * _log_uniform(chance, 50.0, 2000.0), 5e-3), 20.0)
    delay = chance.choice((0.0, 1.0, 0.37, 2.0))
    return {"motion": "rotary", "mass": inertia, "force_limit": limit, "delay": delay}, limit


def _passive(chance: random.Random) -> Drawn:
    rate, kind = chance.choice((500.0, 1000.0, 1000.0, 4000.0)), chance.choice(PASSIVE)
    device, limit = _device(chance)
    inertia, late = device["mass"], (0.5 + device["delay"]) / rate
    steepest, modules = _held(chance, kind, limit, inertia, rate)
    damping = chance.choice((0.0, 0.3)) * steepest * late
    if kind in ("spring", "detent"):
        modules["held"]["damping"] = damping
    else:
        damping = 0.0
    device["friction"] = chance.choice((1.02, chance.uniform(1.0, 2.0))) * (steepest * late + damping)
    turns = 1.0
    if kind == "spring" and chance.random() < 0.3:
        turns = chance.uniform(1.0, 4.0)
        device |= {"travel": [-turns * TURN, turns * TURN], "travel_margin": 2.0 * TURN}
    # Both together are a motion within the turn, or the travel, for which a scene has credit.
    share = chance.choice((0.0, 0.5, 0.9))
    wound = share * turns * TURN * chance.uniform(-1.0, 1.0)
    flick = math.sqrt(2.0 * (0.9 - share) * SCALES["rotary"].credit * limit / inertia)
    speed = min(60.0, flick) * chance.uniform(-1.0, 1.0)
    mock = {"initial": {"position": wound, "velocity": speed}}
    if quantum := chance.choice((None, 1e-6, 1e-5, TURN / 65536, TURN / 4096, TURN / 1024)):
        mock["quantum"] = quantum
    return Drawn(kind, _scene(rate, device, mock, modules), inertia, speed, 4.0)


def _held(chance: random.Random, kind: str, limit: float, inertia: float, rate: float) -> tuple[float, dict[str, Any]]:
    """(the steepest slope, N·m/rad, the modules)."""
    most = inertia * rate**2
    link: dict[str, Any] = {"between": ["knob", "frame"]}
    stiffness = min(limit / chance.uniform(0.1, 2.0 * TURN), 0.1 * most)
    if kind == "stops":
        stiffness = min(limit / chance.uniform(0.01, 0.3), 0.1 * most)
        wall = link | {"type": "buffer", "stiffness": stiffness, "distance": -chance.uniform(0.2, TURN)}
        return stiffness, {"low": wall, "high": wall | {"between": ["frame", "knob"]}}
    if kind == "detent":
        pitch, shape = TURN / chance.choice((2, 6, 12, 24)), chance.choice(("sine", "snap", "notch"))
        depth = min(chance.uniform(0.05, 1.0) * limit, 0.1 * most * pitch / 16.0)
        held = link | {"type": "detent", "pitch": pitch, "depth": depth, "shape": shape}
        narrowest = pitch / 4.0
        if shape != "sine":
            held["sharpness"] = 3.0 if shape == "snap" else 2.0
            narrowest = 0.5 * pitch / 4.0 if shape == "snap" else 0.25 * pitch / 2.0
        return max(depth / narrowest, TURN * depth / pitch), {"held": held}
    if kind == "table":
        at = sorted(chance.uniform(-0.3, 0.3) * TURN for _ in range(5))
        points = [[one, _sign(one) * chance.uniform(0.05, 1.0) * limit] for one in at]
        points = [[at[0] - 0.1 * TURN, -limit], *points, [at[-1] + 0.1 * TURN, limit]]
        slopes = [abs((b[1] - a[1]) / max(b[0] - a[0], 1e-3)) for a, b in pairwise(points)]
        scale = min(1.0, 0.1 * most / max(slopes))
        held = link | {"type": "nonlinear", "force_over_distance": [[x, f * scale] for x, f in points]}
        return max(slopes) * scale, {"held": held}
    if kind == "click":
        travel = chance.uniform(0.1, 1.0)
        peak = min(0.5 * limit, 0.01 * most * travel)
        bottom = 8.0 * peak / travel
        held = link | {"type": "click", "travel": travel, "peak": peak, "drop": 0.6 * peak, "bottom": bottom}
        return bottom, {"held": held}
    return stiffness, {"held": link | {"type": "viscoelastic", "stiffness": stiffness, "damping": 0.0}}


def _unstable(chance: random.Random) -> Drawn:
    rate, kind = chance.choice((500.0, 1000.0, 1000.0, 2000.0)), chance.choice(UNSTABLE)
    device, limit = _device(chance)
    inertia = device["mass"]
    device |= {
        "friction": chance.choice((0.0, 1e-3)) * inertia * rate,
        "hold": chance.choice(("zoh", "zoh", "impulse")),
    }
    stiffness = inertia * rate**2 * _log_uniform(chance, 1e-3, 2.0)
    damping = inertia * rate * _log_uniform(chance, 1e-4, 1.5) if kind == "damper" else 0.0
    link = {"type": "viscoelastic", "between": ["knob", "frame"], "stiffness": stiffness, "damping": damping}
    modules: dict[str, Any] = {"held": link}
    if kind == "stops":
        # The device's own spring presses the knob on it.
        device["stiffness"] = 0.05 * stiffness
        pressed = chance.uniform(0.05, 0.3) * limit
        modules = {"held": link | {"type": "buffer", "distance": pressed / device["stiffness"]}}
    elif kind == "inner wheel":
        modules = {
            "ball": {"type": "mass", "mass": inertia * chance.uniform(0.2, 2.0)},
            "touch": link | {"between": ["knob", "ball"]},
            "held": link | {"between": ["ball", "frame"], "stiffness": 0.1 * stiffness},
        }
    elif kind == "detent":
        depth, pitch = chance.uniform(0.3, 3.0) * limit, TURN / chance.choice((2, 6, 12, 24))
        modules = {"held": {"type": "detent", "between": ["knob", "frame"], "pitch": pitch, "depth": depth}}
    speed = chance.choice((-1.0, 1.0)) * chance.uniform(0.05, 1.0)
    return Drawn(kind, _scene(rate, device, {"initial": {"velocity": speed}}, modules), inertia, speed, 30.0)


def _scene(rate: float, device: dict[str, Any], mock: dict[str, Any], modules: dict[str, Any]) -> Scene:
    document = {
        "version": 1,
        "rate": rate,
        "device": {"clock": "lockstep", **device},
        "mock": mock,
        "modules": {"knob": {"type": "device", "channel": 0}, "frame": {"type": "ground"}, **modules},
    }
    return parse_scene(json.dumps(document), "random wheel")


def _sign(value: float) -> float:
    return math.copysign(1.0, value)


def _log_uniform(chance: random.Random, least: float, most: float) -> float:
    return math.exp(chance.uniform(math.log(least), math.log(most)))
