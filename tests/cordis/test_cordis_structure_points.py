"""Every type of link on a point of a string, against the same string written out as masses and links."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import yaml

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene
from hapsim.scene import Scene, parse_scene

RATE, MASSES, STIFFNESS, DAMPING = 1000.0, 10, 2000.0, 0.3

LINKS: dict[str, dict[str, Any]] = {
    "viscoelastic": {"stiffness": 300.0, "damping": 0.2},
    "centred": {"type": "viscoelastic", "stiffness": 300.0, "damping": 0.2, "damper": "centred"},
    "filtered": {"type": "viscoelastic", "stiffness": 300.0, "damping": 0.2, "damper": "filtered", "cutoff": 80.0},
    "sensed": {"type": "viscoelastic", "stiffness": 300.0, "damping": 0.2, "damper": "sensed"},
    "spring": {"stiffness": 300.0},
    "damper": {"damping": 0.2},
    "buffer": {"stiffness": 500.0, "damping": 0.2},
    "nonlinear": {
        "force_over_distance": [[-0.02, -3.0], [0.0, 0.0], [0.01, 5.0]],
        "force_over_velocity": [[-1.0, -0.5], [1.0, 0.5]],
    },
    "friction": {"force": 0.5, "static": 0.9, "stiffness": 400.0, "damping": 0.1},
    "plectrum": {"stiffness": 300.0, "damping": 0.1, "release": 0.01},
}


def scene_with(string: dict[str, Any], point: str) -> Scene:
    """A hand for each link, which holds a mass of its own."""
    modules: dict[str, Any] = {f"h{i}": {"type": "device", "channel": i} for i in range(len(LINKS))}
    modules |= string
    for i, (name, values) in enumerate(LINKS.items()):
        ends = [f"h{i}", f"{point}{i}"]
        modules[name] = {"type": name, **values, "between": ends if i % 2 == 0 else ends[::-1]}
    document = {"version": 1, "rate": RATE, "device": {"mass": 0.2}, "modules": modules}
    return parse_scene(yaml.safe_dump(document, sort_keys=False))


def as_a_string() -> Scene:
    string = {"type": "string", "masses": MASSES, "mass": 0.02, "stiffness": STIFFNESS, "damping": DAMPING}
    return scene_with({"s": string}, "s.")


def written_out() -> Scene:
    modules: dict[str, Any] = {"wall": {"type": "ground"}}
    modules |= {f"m{i}": {"type": "mass", "mass": 0.02} for i in range(MASSES)}
    row = ["wall", *(f"m{i}" for i in range(MASSES)), "wall"]
    for i, ends in enumerate(pairwise(row)):
        modules[f"l{i}"] = {"type": "viscoelastic", "between": list(ends), "stiffness": STIFFNESS, "damping": DAMPING}
    return scene_with(modules, "m")


def forces(scene: Scene, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    program = compile_scene(scene)
    start(program, position[0])
    result = np.zeros_like(position)
    for n in range(len(position)):
        tick(program, position[n], velocity[n], result[n])
    return result


def test_a_link_holds_a_mass_of_a_string_as_it_holds_any_other() -> None:
    rng = np.random.default_rng(4)
    position = 0.03 * np.sin(np.cumsum(0.03 * rng.normal(size=(1500, MASSES)), axis=0))
    velocity = rng.normal(size=position.shape)
    of_string, of_masses = (forces(scene, position, velocity) for scene in (as_a_string(), written_out()))
    assert np.all(np.max(np.abs(of_masses), axis=0) > 0.1)
    np.testing.assert_allclose(of_string, of_masses, rtol=0, atol=1e-9)
