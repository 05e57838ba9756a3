"""A scene written out as matrices, from the elements that its structures say they consist of, and a run of its tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from scipy import sparse

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, parameter_values, positions_of
from hapsim.scene import Scene, parse_scene

RATE = 1000.0


def scene_of(modules: Mapping[str, Any], **more: Any) -> Scene:
    """A scene at 1 kHz with a hand on channel 0, and these modules."""
    hand = {"hand": {"type": "device", "channel": 0}}
    document = {"version": 1, "rate": RATE, "device": {"mass": 0.2}, **more, "modules": hand | dict(modules)}
    return parse_scene(yaml.safe_dump(document, sort_keys=False))


@dataclass
class Written:
    """A scene as K, Z and M over its points: hands, grounds, masses, the structures' masses, and what holds these."""

    scene: Scene
    points: list[str]
    K: Any
    Z: Any
    inverse_mass: np.ndarray
    rest: np.ndarray

    @property
    def moved(self) -> list[str]:
        """The points that have a mass of the scene's."""
        return [name for name, inverse in zip(self.points, self.inverse_mass, strict=True) if inverse > 0]

    def place(self, name: str) -> int:
        return self.points.index(name)

    def places(self, names: list[str]) -> np.ndarray:
        index = {name: i for i, name in enumerate(self.points)}
        return np.array([index[name] for name in names], np.intp)

    def follow(self, x: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(x[n+1] of what the scene moves, all else as it is; the force on every point in N)."""
        force = -(self.K @ x) - self.Z @ (x - before) * self.scene.rate
        step = self.inverse_mass / self.scene.rate**2
        return np.where(step > 0, x + (x - before) + step * force, x), force


def written_out(scene: Scene) -> Written:
    mass = dict.fromkeys([*scene.device_points, *scene.grounds], 0.0)
    mass |= {name: module.mass for name, module in scene.masses.items()}
    rest = {name: module.position for name, module in scene.grounds.items()}
    rest |= {name: module.position for name, module in scene.masses.items()}
    links = [(*link.between, link.stiffness, link.damping) for link in scene.links.values()]
    for name, structure in scene.structures.items():
        elements = structure.elements()
        names = [f"{name}.{place}" for place in structure.point_names()]
        mass |= dict(zip(names, elements.masses, strict=True)) | {f"{name}.": 0.0}
        rest |= dict.fromkeys([*names, f"{name}."], structure.position)
        names.append(f"{name}.")
        links += [(names[a], names[b], k, z) for a, b, k, z in elements.links]
    points = list(mass)
    index = {name: i for i, name in enumerate(points)}
    rows = np.array([[index[a], index[b]] for a, b, _, _ in links]).reshape(-1, 2)
    spread = sparse.csr_array(
        (np.tile([1.0, -1.0], len(links)), (np.repeat(np.arange(len(links)), 2), rows.ravel())),
        shape=(len(links), len(points)),
    )
    K, Z = (spread.T @ sparse.diags_array([link[i] for link in links]) @ spread for i in (2, 3))
    inverse = np.array([1.0 / m if m else 0.0 for m in mass.values()])
    return Written(scene, points, K.tocsr(), Z.tocsr(), inverse, np.array([rest.get(name, 0.0) for name in points]))


@dataclass
class Run:
    """Positions of the points `names` by sample, the first being where they were a sample before; the hand's force."""

    names: list[str]
    positions: np.ndarray
    forces: np.ndarray


def run_of(
    scene: Scene,
    hand: np.ndarray,
    begin: Mapping[str, tuple[float, float]] | None = None,
    at_sample: Callable[[int, np.ndarray], None] = lambda _n, _values: None,
) -> Run:
    """Runs the tick with the hand at `hand`, m. `begin`: positions of points at the first sample and before it; what
    is not named begins as the scene says. `at_sample(n, values)` may change the live parameters before each tick."""
    values = parameter_values(scene)
    program = compile_scene(scene, values)
    numbers = numbers_of(scene)
    names = [name for name in numbers if name not in scene.device_points and name not in scene.grounds]
    ours = np.array([numbers[name] for name in names])
    position, previous = positions_of(program)
    for name, (now, before) in (begin or {}).items():
        position[numbers[name]], previous[numbers[name]] = now, before
    start(program, hand[:1])
    positions, forces = np.empty((len(hand) + 2, len(ours)), position.dtype), np.zeros((len(hand), 1))
    positions[0], positions[1] = previous[ours], position[ours]
    rest = np.zeros(1)
    for n in range(len(hand)):
        at_sample(n, values)
        tick(program, hand[n : n + 1], rest, forces[n])
        positions[n + 2] = positions_of(program)[0][ours]
    return Run(names, positions, forces[:, 0])
