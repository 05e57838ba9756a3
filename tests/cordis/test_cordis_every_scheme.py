"""Every type of module, under every scheme and in either precision, against dense matrices and recurrences in NumPy;
and that two programs of one scene have nothing in common.

What a scheme works into matrices stands together in one network. What pulls from outside, a link of each type, holds
points of that network.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.linalg import expm

from hapsim.cordis.modules.linear_links import SCALED
from hapsim.cordis.modules.proxy import PROXY
from hapsim.cordis.offline import start, tick, update_parameters
from hapsim.cordis.program import PART_TYPES, Program, compile_scene, numbers_of, parameter_values, positions_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.running.compile_ahead import scenes_with_every_module
from hapsim.scene import Scene, parse_scene

sys.path.insert(0, str(Path(__file__).parent))
from tests.link_formulas import tension_of

Array = NDArray[np.float64]
RATE = 1024.0
T = 1.0 / RATE
SAMPLES = 3000
CUTOFF = 61.0

#: What positions and forces may differ by, over the largest. What was rounded is carried on, as velocity too, until
#: dampers have used it up: some thousand samples, and 6e-8 of a position in each of them.
WITHIN = {"double": 1e-12, "single": 1e-4}

#: Each link from outside by its name: its ends, of which the first is a hand of its own, and what it is.
OUTSIDE: dict[str, tuple[str, dict[str, Any]]] = {
    "backward": ("ball", {"type": "viscoelastic", "stiffness": 200.0, "damping": 0.3}),
    "centred": ("held", {"type": "viscoelastic", "stiffness": 150.0, "damping": 0.2, "damper": "centred"}),
    "filtered": (
        "s.3",
        {"type": "viscoelastic", "stiffness": 100.0, "damping": 0.2, "damper": "filtered", "cutoff": CUTOFF},
    ),
    "sensed": ("m.1.1", {"type": "viscoelastic", "stiffness": 120.0, "damping": 0.2, "damper": "sensed"}),
    "spring": ("b.2", {"type": "spring", "stiffness": 90.0}),
    "damper": ("lump", {"type": "damper", "damping": 0.4}),
    "buffer": ("m.0.2", {"type": "buffer", "stiffness": 250.0, "damping": 0.2, "distance": 2**-9}),
    "nonlinear": (
        "s.6",
        {
            "type": "nonlinear",
            "force_over_distance": [[-0.03, -2.0], [0.0, 0.1], [0.02, 1.5]],
            "force_over_velocity": [[-2.0, -0.2], [0.1, 0.1], [2.0, 0.2]],
        },
    ),
    "friction": ("ball", {"type": "friction", "force": 0.5, "stiffness": 400.0, "damping": 0.1}),
    "plectrum": ("b.4", {"type": "plectrum", "stiffness": 150.0, "damping": 0.1, "release": 2**-6}),
    "sine": ("held", {"type": "detent", "pitch": 2**-6, "depth": 0.1, "damping": 0.2}),
    "snap": ("s.5", {"type": "detent", "pitch": 2**-6, "depth": 0.1, "damping": 0.2, "shape": "snap"}),
    "notch": ("m.1.0", {"type": "detent", "pitch": 2**-5, "depth": 0.1, "shape": "notch", "sharpness": 3.0}),
    "click": ("m.1.2", {"type": "click", "travel": 2**-6, "peak": 0.4, "drop": 0.2, "bottom": 150.0, "damping": 0.2}),
    "holds": ("held", {"type": "detent", "pitch": 2**-6, "depth": 0.1, "damping": 0.2, "hold_until": 0.75}),
    "branches": (
        "s.2",
        {
            "type": "nonlinear",
            "force_over_distance": {
                "press": [[-0.03, -1.5], [0.0, 0.2], [0.02, 1.5]],
                "release": [[-0.03, -2.0], [0.01, 0.3], [0.02, 1.4]],
                "turn": 2**-7,
            },
        },
    ),
}


@cache
def scene_of(scheme: str, precision: str) -> Scene:
    """Masses, a cell and a structure of each kind, joined to each other and a ground, and every link from outside."""
    modules: dict[str, Any] = {
        "wall": {"type": "ground", "position": 2**-7},
        "ball": {"type": "mass", "mass": 0.1, "position": 0.01, "velocity": 0.1},
        "lump": {"type": "mass", "mass": 0.2, "velocity": -0.1},
        "held": {"type": "cell", "mass": 0.05, "stiffness": 300.0, "damping": 0.3, "rest": 0.004, "velocity": 0.05},
        "s": {"type": "string", "masses": 9, "mass": 0.02, "stiffness": 900.0, "damping": 0.1, "friction": 0.02},
        "b": {"type": "string", "masses": 7, "bending": 300.0, "mass": 0.03, "stiffness": 500.0, "damping": 0.1},
        "m": {"type": "membrane", "rows": 2, "columns": 3, "mass": 0.03, "stiffness": 600.0, "damping": 0.1},
        "tie": {"type": "viscoelastic", "between": ["wall", "ball"], "stiffness": 250.0, "damping": 0.3},
        "tied": {"type": "spring", "between": ["s.1", "m.0.0"], "stiffness": 80.0},
        "braked": {"type": "damper", "between": ["lump", "held"], "damping": 0.3},
        "hung": {"type": "spring", "between": ["wall", "lump"], "stiffness": 100.0},
    }
    modules["s"] |= {"ends": ["fixed", "free"], "position": 0.002}
    modules["b"] |= {"ends": ["clamped", "fixed"], "friction": 0.02}
    modules["m"] |= {"edges": ["fixed", "free", "fixed", "fixed"], "friction": 0.02, "position": -0.003}
    for channel, (name, (held, link)) in enumerate(OUTSIDE.items()):
        modules[f"h_{name}"] = {"type": "device", "channel": channel}
        modules[name] = {"between": [f"h_{name}", held], **link}
    keys = {"version": 1, "rate": RATE, "scheme": scheme, "precision": precision, "device": {"mass": 0.2}}
    keys |= {"sound": {"ear": {"from": "ball", "of": "velocity"}}}
    return parse_scene(yaml.safe_dump(keys | {"modules": modules}, sort_keys=False))


def test_every_type_of_module_is_in_the_scene() -> None:
    scene, (*_, plane) = scene_of("cordis", "double"), scenes_with_every_module("double")
    without = {kind.name for kind in PART_TYPES if not (kind.select(scene) or kind.select(plane))}
    assert without == {PROXY.name, SCALED.name}  # have CORDIS's scheme alone


def strokes(seed: int) -> tuple[Array, Array]:
    """Returns positions of the hands, exact in both precisions, and their sensed velocities: m, m/s."""
    rng = np.random.default_rng(seed)
    steps = 0.06 * rng.normal(size=(SAMPLES, len(OUTSIDE)))
    measured = 0.02 * np.sin(np.cumsum(steps, axis=0) + np.arange(len(OUTSIDE)) % 14)
    return np.round(measured * 2**16) / 2**16, np.round(rng.normal(size=measured.shape) * 2**6) / 2**8


REMEMBER = ("centred", "filtered", "friction", "plectrum", "holds", "branches")


class Dense:
    """The scene: M, K, B of its n points and of what they are tied to, which stays, and its links from outside."""

    def __init__(self, scene: Scene) -> None:
        mass: dict[str, float] = {name: point.mass for name, point in scene.material_points.items()}
        at = {name: getattr(one, "rest", getattr(one, "position", 0.0)) for name, one in scene.modules.items()}
        joins: list[tuple[str, str, float, float]] = []
        for name, point in scene.material_points.items():
            if held := point.held_by():
                joins.append((name, f"{name}.stays", held.stiffness, held.damping))
                at[f"{name}.stays"] = held.rest
        structures: Mapping[str, Any] = scene.structures
        for name, one in structures.items():
            elements, points = one.elements(), [f"{name}.{place}" for place in one.point_names()]
            mass |= dict(zip(points, elements.masses, strict=True))
            at |= dict.fromkeys([*points, f"{name}.stays"], one.position)
            points.append(f"{name}.stays")
            joins += [(points[a], points[b], k, z) for a, b, k, z in elements.links]
        for name, one in scene.links.items():
            if name not in OUTSIDE:
                joins.append((*one.between, getattr(one, "stiffness", 0.0), getattr(one, "damping", 0.0)))
        self.n = len(mass)
        self.names = [*mass, *scene.grounds, *(name for name in at if name.endswith(".stays"))]
        self.K, self.B = np.zeros((2, len(self.names), len(self.names)))
        for a, b, k, z in joins:
            spread = np.zeros(len(self.names))
            spread[self.names.index(a)], spread[self.names.index(b)] = 1.0, -1.0
            self.K += k * np.outer(spread, spread)
            self.B += z * np.outer(spread, spread)
        self.mass = np.array(list(mass.values()))
        self.x = np.array([at[name] for name in self.names])
        self.v = np.array([getattr(scene.modules.get(name), "velocity", 0.0) for name in self.names])
        self.held = [self.names.index(held) for held, _ in OUTSIDE.values()]
        self.hand, self.hand_v, self.sensed = np.zeros((3, len(OUTSIDE)))
        self.tension = [
            tension_of(scene.links[name], RATE, lambda i=i: (self.sensed[i] - self.hand_v[i]) * T)
            for i, name in enumerate(OUTSIDE)
        ]
        self.kept = np.zeros(len(OUTSIDE))

    def begin_sample(self) -> Array:
        """All tensions at the sample; those of the links that remember are kept until the next."""
        self.kept = self.tensions(self.x, self.v, 0.0, range(len(OUTSIDE)))
        return self.kept

    def tensions(self, x: Array, v: Array, late: float, which: Any) -> Array:
        """Returns these links' tensions `late` s after the sample, with the hands extrapolated; the others keep
        theirs."""
        tensions = self.kept.copy()
        for i in which:
            d = self.hand[i] + late * self.hand_v[i] - x[self.held[i]]
            tensions[i] = self.tension[i](d, T * (self.hand_v[i] - v[self.held[i]]))
        return tensions

    def outer(self, tensions: Array) -> Array:
        force = np.zeros(len(self.names))
        np.add.at(force, self.held, tensions)
        return force[: self.n]

    def inner(self, x: Array, v: Array) -> Array:
        return -(self.K @ x + self.B @ v)[: self.n]

    def rates(self) -> tuple[Array, Array]:
        """A and g of z' = A z + g, z = (x, v), g of what stays."""
        n = self.n
        a = np.zeros((2 * n, 2 * n))
        a[:n, n:] = np.eye(n)
        a[n:, :n] = -self.K[:n, :n] / self.mass[:, None]
        a[n:, n:] = -self.B[:n, :n] / self.mass[:, None]
        return a, np.concatenate([np.zeros(n), -self.K[:n, n:] @ self.x[n:] / self.mass])


Step = Callable[[], None]


def semi_implicit(w: Dense) -> Step:
    def step() -> None:
        w.v[: w.n] += T * (w.inner(w.x, w.v) + w.outer(w.kept)) / w.mass
        w.x[: w.n] += T * w.v[: w.n]

    return step


def by_matrix(w: Dense, ahead: Array, of_force: Array, stays: Array) -> Step:
    def step() -> None:
        pushed = stays + np.concatenate([np.zeros(w.n), w.outer(w.kept) / w.mass])
        z = ahead @ np.concatenate([w.x[: w.n], w.v[: w.n]]) + of_force @ pushed
        w.x[: w.n], w.v[: w.n] = z[: w.n], z[w.n :]

    return step


def midpoint(w: Dense) -> Step:
    a, stays = w.rates()
    one = np.eye(2 * w.n)
    return by_matrix(w, *(np.linalg.solve(one - 0.5 * T * a, right) for right in (one + 0.5 * T * a, T * one)), stays)


def exact(w: Dense) -> Step:
    a, stays = w.rates()
    size = 2 * w.n
    whole = expm(T * np.block([[a, np.eye(size)], [np.zeros((size, 2 * size))]]))
    return by_matrix(w, whole[:size, :size], whole[:size, size:], stays)


def rk4(w: Dense) -> Step:
    asked = [i for i, name in enumerate(OUTSIDE) if name not in REMEMBER]

    def rate(late: float, z: Array) -> Array:
        x, v = w.x.copy(), w.v.copy()
        x[: w.n], v[: w.n] = z
        force = w.inner(x, v) + w.outer(w.tensions(x, v, late, asked))
        return np.array([z[1], force / w.mass])

    def step() -> None:
        z = np.array([w.x[: w.n], w.v[: w.n]])
        k1 = rate(0.0, z)
        k2 = rate(T / 2, z + T / 2 * k1)
        k3 = rate(T / 2, z + T / 2 * k2)
        k4 = rate(T, z + T * k3)
        w.x[: w.n], w.v[: w.n] = z + T / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    return step


STEPS = {"cordis": semi_implicit, "semi_implicit": semi_implicit, "midpoint": midpoint, "rk4": rk4, "exact": exact}


@cache
def by_numpy(scheme: str) -> tuple[Array, Array]:
    """Forces on the hands in N, (SAMPLES, hands), and where what they hold is a sample later, in m."""
    w = Dense(scene_of(scheme, "double"))
    step = STEPS[scheme](w)
    forces, positions = np.zeros((2, SAMPLES, len(OUTSIDE)))
    measured, sensed = strokes(1)
    for n in range(SAMPLES):
        w.hand, w.hand_v, w.sensed = measured[n], RATE * (measured[n] - measured[max(n - 1, 0)]), sensed[n]
        forces[n] = -w.begin_sample()
        step()
        positions[n] = w.x[w.held]
    return forces, positions


def ticks_of(program: Program, scene: Scene, seed: int) -> Iterator[tuple[Array, Array]]:
    """Ticks the scene's program: forces on the hands and positions of what they hold, sample by sample."""
    numbers = numbers_of(scene)
    held = [numbers[name] for name, _ in OUTSIDE.values()]
    measured, sensed = strokes(seed)
    start(program, measured[0])
    for n in range(SAMPLES):
        force = np.zeros(len(OUTSIDE))
        update_parameters(program)
        tick(program, measured[n], sensed[n], force)
        yield force, positions_of(program)[0][held].astype(np.float64)


def played(samples: Iterator[tuple[Array, Array]]) -> tuple[Array, Array]:
    forces, positions = (np.array(rows) for rows in zip(*samples, strict=True))
    return forces, positions


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_hands_take_every_link_to_its_ends(scheme: str) -> None:
    """Else the comparison below would not tell what a link does there."""
    by_link = dict(zip(OUTSIDE, by_numpy(scheme)[0].T, strict=True))
    for name in ("buffer", "plectrum", "notch", "click"):
        assert 50 < np.count_nonzero(by_link[name]) < SAMPLES - 50
    slides = np.abs(by_link["friction"]) == 0.5
    assert 50 < np.count_nonzero(slides) < SAMPLES - 50


@pytest.mark.parametrize("precision", WITHIN)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_module_under_every_scheme_is_as_it_is_written_here(scheme: str, precision: str) -> None:
    expected_forces, expected_positions = by_numpy(scheme)
    scene = scene_of(scheme, precision)
    forces, positions = played(ticks_of(compile_scene(scene), scene, 1))
    sizes = np.max(np.abs(expected_forces), axis=0)
    assert np.all(sizes > 0.05)
    assert 1e-3 < np.max(np.abs(expected_positions)) < 0.5
    assert np.max(np.abs(positions - expected_positions)) <= WITHIN[precision] * np.max(np.abs(expected_positions))
    off = np.max(np.abs(forces - expected_forces), axis=0)
    assert np.all(off <= WITHIN[precision] * sizes)
    if precision == "single":
        np.testing.assert_array_equal(forces, forces.astype(np.float32))
        assert np.all(off > 1e-9 * sizes)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_programs_of_one_scene_have_nothing_in_common(scheme: str) -> None:
    """One goes as it would alone, bit by bit, while another is moved between its samples, by other hands and with other
    parameters; and what is built after both begins where they began."""
    scene = scene_of(scheme, "double")
    alone = played(ticks_of(compile_scene(scene), scene, 1))
    first, second = compile_scene(scene), compile_scene(scene)
    second.parameters.post(0.5 * parameter_values(scene), 100)
    together = zip(ticks_of(first, scene, 1), ticks_of(second, scene, 2), strict=True)
    of_first, of_second = zip(*together, strict=True)
    for expected, found in zip(alone, played(iter(of_first)), strict=True):
        np.testing.assert_array_equal(found, expected)
    assert np.max(np.abs(played(iter(of_second))[0] - alone[0])) > 0.05
    for expected, found in zip(alone, played(ticks_of(compile_scene(scene), scene, 1)), strict=True):
        np.testing.assert_array_equal(found, expected)
