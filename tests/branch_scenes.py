"""Curves with two branches: random ones, their force and work on a way as a second description says, and as the kernel
does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import hapsim as package
from firmware_protocol.compiled import new_record
from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import Program, compile_scene, positions_of
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
from hapsim.errors import UsageError
from hapsim.measuring.branch import on_branch
from hapsim.scene import Scene

BUTTON = {
    "press": [[0.0, 0.0], [0.6e-3, 0.55], [1.2e-3, 0.7], [1.6e-3, 0.45], [2.4e-3, 0.6], [3e-3, 2.4]],
    "release": [[0.0, 0.0], [0.6e-3, 0.35], [1.2e-3, 0.45], [1.6e-3, 0.3], [2.4e-3, 0.42], [3e-3, 2.1]],
    "turn": 1e-4,
}


def branch_scene(curve: dict[str, Any], **values: Any) -> Scene:
    """A hand on a curve, on a mock with counts of a nanometre; `values`: of the scene, or of its device."""
    whole = {key: values.pop(key) for key in ("rate", "precision", "scheme") if key in values}
    link = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": curve}
    device = {"clock": "lockstep", "mass": 0.2, "friction": 9.0, "delay": 1, "force_limit": 20.0} | values
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "curve": link}
    return Scene.model_validate({"version": 1, "rate": 1000.0, "device": device, "modules": modules} | whole)


def random_curve(rng: np.random.Generator) -> dict[str, Any]:
    """Press and release with points at different distances; the branches touch at some, and fall in places."""
    width, points = 10.0 ** rng.uniform(-3.0, -2.0), int(rng.integers(3, 10))
    x = np.sort(rng.uniform(0.0, width, points)) + 1e-6 * np.arange(points)
    release = np.cumsum(rng.uniform(-0.2, 0.5, points))
    press = release + rng.uniform(0.0, 0.6, points) * (rng.random(points) < 0.8)
    some = np.arange(points) != rng.integers(1, points - 1)  # a point that one branch alone has
    press_points = np.stack([x, press]).T[some]
    lower = np.minimum(release, np.interp(x, *press_points.T))
    turn = width * 10.0 ** rng.uniform(-2.3, -0.7)
    return {"press": press_points.tolist(), "release": np.stack([x, lower]).T.tolist(), "turn": float(turn)}


class Way(NamedTuple):
    """A curve on a way, by the second description: positions, m, and z and force, N, at each."""

    x: np.ndarray
    z: np.ndarray
    force: np.ndarray


def on_way(curve: dict[str, Any], path: list[float]) -> Way:
    """Returns a path from its first place and z = 0. Between two places of even numbers F is a parabola, and that of an
    odd number is in the middle of them."""
    (px, press), (rx, release) = (np.array(curve[key]).T for key in ("press", "release"))
    knots, turn = np.union1d(px, rx), curve["turn"]
    x, z, xs, zs = path[0], 0.0, [path[0]], [0.0]
    for to in path[1:]:
        way = np.sign(to - x)
        stops = {float(one) for one in knots if (one - x) * (to - one) > 0.0}
        saturated = x + way * (1.0 - way * z) * turn / 2.0
        stops |= {saturated} if (saturated - x) * (to - saturated) > 0.0 else set()
        for stop in sorted({to, *stops}, key=lambda one: way * one):
            for at in (0.5 * (x + stop), stop):
                xs.append(at)
                zs.append(float(np.clip(zs[-1] + 2.0 * (at - xs[-2]) / turn, -1.0, 1.0)))
            x, z = stop, zs[-1]
    where = np.array(xs)
    up, down = np.interp(where, px, press), np.interp(where, rx, release)
    return Way(where, np.array(zs), 0.5 * (up + down) + 0.5 * (up - down) * np.array(zs))


def work(x: np.ndarray, force: np.ndarray) -> float:
    """The work of a hand against this force, J, by Simpson's rule."""
    return float(np.sum((x[2::2] - x[:-2:2]) / 6.0 * (force[:-2:2] + 4.0 * force[1:-1:2] + force[2::2])))


class Kernel:
    """The compiled program of a scene with a curve: its tension on ways of the hand, and the energy that it stores."""

    def __init__(self, scene: Scene) -> None:
        self.program: Program = compile_scene(scene)
        tank = Tank(new_record(TANK), capacity_j=1.0, refill_j=0.0)
        self.program.stored = StoredEnergy(self.program, scene, tank, np.inf)  # type: ignore[attr-defined]

    def on(self, x: np.ndarray) -> np.ndarray:
        """Begins at the first of these places and returns the tension at each, N."""
        way = np.ascontiguousarray(x[:, None])
        force = np.zeros_like(way)
        start(self.program, way[0])
        ticks(self.program, way, np.zeros_like(way), force, len(way))
        return np.asarray(-force[:, 0])

    @property
    def energy(self) -> float:
        """Energy stored after the last tick, J."""
        addresses = [np.uint64(row.ctypes.data) for row in positions_of(self.program)[::-1]]  # of the last tick
        return float(evaluate(np.uint64(self.program.record.parameters.stored), *addresses, np.uint64(0)))


def random_paths(rng: np.random.Generator, curve: dict[str, Any], count: int) -> Iterator[list[float]]:
    """Yields closed paths from 0: over the whole curve, or within a few turns about some place of it."""
    least, most = curve["release"][0][0], curve["release"][-1][0]
    for _ in range(count):
        about = rng.uniform(least, most)
        wide = rng.random() < 0.5
        inner = rng.uniform(least - 1e-3, most + 1e-3, 8) if wide else about + curve["turn"] * rng.uniform(-2, 2, 20)
        yield [0.0, *inner.tolist(), 0.0]


def lost_on(kernel: Kernel, curve: dict[str, Any], path: list[float]) -> tuple[float, float]:
    """Returns what a closed path took from the hand, J: all in all, and beside what is stored in the end."""
    begins = kernel.energy if kernel.on(np.zeros(2)).size else 0.0
    way = on_way(curve, path)
    spent = work(way.x, kernel.on(way.x))
    return spent, spent - (kernel.energy - begins)


class Compared(NamedTuple):
    """A measured k beside the predicted one, N/m; how many of its uncertainties it is off."""

    curve: dict[str, Any]
    at: float
    branch: str
    measured: float
    predicted: float
    uncertainty: float

    @property
    def off(self) -> float:
        return abs(self.measured - self.predicted) / self.uncertainty


def compared(rng: np.random.Generator) -> Iterator[Compared]:
    """Measures a random curve stuck and on both branches, in the middle of its widest piece that rises on both; yields
    nothing of a place that cannot be measured, which is refused in words."""
    curve = random_curve(rng)
    (px, press), (rx, release) = (np.array(curve[key]).T for key in ("press", "release"))
    knots = np.union1d(px, rx)
    up, down = np.interp(knots, px, press), np.interp(knots, rx, release)
    rising = (np.diff(up) > 0.0) & (np.diff(down) > 0.0) & (np.diff(knots) > 3.0 * curve["turn"])
    if not rising.any():
        return
    widest = int(np.argmax(np.diff(knots) * rising))
    at = float(0.5 * (knots[widest] + knots[widest + 1]))
    steepest = branch_scene(curve).links["curve"].branches.steepest
    scene = branch_scene(curve, friction=float(1.6e-3 * steepest) + 1.0)
    for branch in ("", "press", "release"):
        seen = on_branch(scene, 0, branch) if branch else scene
        try:
            found = package.measure(scene, at=at, **({"branch": branch} if branch else {}))
        except UsageError:
            continue
        (felt,) = package.predict(seen, with_margins=False, at=at).felt
        if found.dominant:
            yield Compared(curve, at, branch or "stuck", found.k, felt.k, found.k_uncertainty)
