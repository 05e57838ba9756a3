"""Each scheme of the kernel against the same written with dense matrices in NumPy."""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, positions_of
from hapsim.cordis.schemes import SCHEMES, force_expansion
from hapsim.cordis.schemes.exact import ExactDense
from hapsim.cordis.schemes.exact_modes import ExactModes
from hapsim.cordis.schemes.force_expansion import StringForces, WeightedLinks
from hapsim.cordis.schemes.midpoint import Midpoint
from hapsim.errors import UsageError
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from scheme_scenes import RATE, T, by_the_tick, chain, link, network, numbers_in, scene_of, strokes


class Written:
    """A scene as dense matrices, taken apart here: points that move, then hands, then what stays."""

    def __init__(self, scene: Scene) -> None:
        self.names = list(scene.masses)
        self.mass = [one.mass for one in scene.masses.values()]
        joins = [
            (*one.between, one.stiffness, one.damping) for one in scene.links.values() if one.type == "viscoelastic"
        ]
        at = {name: one.position for name, one in scene.masses.items()}
        for name, one in scene.modules.items():
            if one.type != "string":
                continue
            row = [f"{name}.{i}" for i in range(one.masses)]
            self.names += row
            self.mass += [one.mass] * one.masses
            at |= dict.fromkeys([*row, f"{name}.stays"], one.position)
            joins += [(a, b, one.stiffness, one.damping) for a, b in pairwise(row)]
            for end, how in zip((row[0], row[-1]), one.ends, strict=True):
                joins += [(end, f"{name}.stays", one.stiffness, one.damping)] * (how == "fixed")
            joins += [(each, f"{name}.stays", 0.0, one.friction) for each in row]
        self.n = len(self.names)
        stays = [*scene.grounds, *(name for name in at if name.endswith(".stays"))]
        at |= {name: one.position for name, one in scene.grounds.items()}
        self.all = [*self.names, *scene.device_points, *stays]
        self.hands = [(self.all.index(name), one.channel) for name, one in scene.device_points.items()]
        self.inner_k, self.inner_b, self.outer_k, self.outer_b = np.zeros((4, len(self.all), len(self.all)))
        for first, second, k, b in joins:
            spread = np.zeros(len(self.all))
            spread[self.all.index(first)], spread[self.all.index(second)] = 1.0, -1.0
            outer = bool({first, second} & set(scene.device_points))
            stiffness, damping = (self.outer_k, self.outer_b) if outer else (self.inner_k, self.inner_b)
            stiffness += k * np.outer(spread, spread)
            damping += b * np.outer(spread, spread)
        self.buffers = [
            ([self.all.index(end) for end in one.between], one.stiffness, one.damping, one.distance)
            for one in scene.links.values()
            if one.type == "buffer"
        ]
        self.x = np.array([at.get(name, 0.0) for name in self.all])
        self.v = np.array([getattr(scene.modules.get(name), "velocity", 0.0) for name in self.all])
        self.mass = np.array(self.mass)

    def outer(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """N, of what is not inside."""
        force = -self.outer_k @ x - self.outer_b @ v
        for (a, b), stiffness, damping, distance in self.buffers:
            if x[a] - x[b] < distance:
                push = max(0.0, stiffness * (distance - x[a] + x[b]) - damping * (v[a] - v[b]))
                force[a] += push
                force[b] -= push
        return force

    def whole(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return self.outer(x, v) - self.inner_k @ x - self.inner_b @ v

    def rates(self) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """A of z' = A z + g, z = (x, v), and g of an outer force."""
        n = self.n
        a = np.zeros((2 * n, 2 * n))
        a[:n, n:] = np.eye(n)
        a[n:, :n] = -self.inner_k[:n, :n] / self.mass[:, None]
        a[n:, n:] = -self.inner_b[:n, :n] / self.mass[:, None]
        stays = -self.inner_k[:n, n:] @ self.x[n:]
        return a, lambda force: np.concatenate([np.zeros(n), (force[:n] + stays) / self.mass])


def semi_implicit(w: Written) -> Callable[[], None]:
    def step() -> None:
        w.v[: w.n] += T * w.whole(w.x, w.v)[: w.n] / w.mass
        w.x[: w.n] += T * w.v[: w.n]

    return step


def midpoint(w: Written) -> Callable[[], None]:
    a, g = w.rates()
    one = np.eye(2 * w.n)

    def step() -> None:
        z = np.concatenate([w.x[: w.n], w.v[: w.n]])
        z += T * np.linalg.solve(one - 0.5 * T * a, a @ z + g(w.outer(w.x, w.v)))
        w.x[: w.n], w.v[: w.n] = z[: w.n], z[w.n :]

    return step


def exact(w: Written) -> Callable[[], None]:
    a, g = w.rates()
    size = 2 * w.n
    whole = expm(T * np.block([[a, np.eye(size)], [np.zeros((size, 2 * size))]]))

    def step() -> None:
        z = np.concatenate([w.x[: w.n], w.v[: w.n]])
        z = whole[:size, :size] @ z + whole[:size, size:] @ g(w.outer(w.x, w.v))
        w.x[: w.n], w.v[: w.n] = z[: w.n], z[w.n :]

    return step


def rk4(w: Written) -> Callable[[], None]:
    def rate(t: float, z: np.ndarray) -> np.ndarray:
        x, v = w.x + t * w.v, w.v.copy()  # hands and grounds go on as they went
        x[: w.n], v[: w.n] = z
        return np.array([z[1], w.whole(x, v)[: w.n] / w.mass])

    def step() -> None:
        z = np.array([w.x[: w.n], w.v[: w.n]])
        k1 = rate(0.0, z)
        k2 = rate(T / 2, z + T / 2 * k1)
        k3 = rate(T / 2, z + T / 2 * k2)
        k4 = rate(T, z + T * k3)
        w.x[: w.n], w.v[: w.n] = z + T / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    return step


WRITTEN = {"cordis": semi_implicit, "semi_implicit": semi_implicit, "midpoint": midpoint, "rk4": rk4, "exact": exact}


def by_numpy(scene: Scene, measured: np.ndarray, points: list[str]) -> tuple[np.ndarray, np.ndarray]:
    w = Written(scene)
    step = WRITTEN[scene.scheme](w)
    forces, positions = np.zeros_like(measured), np.zeros((len(measured), len(points)))
    places = [w.all.index(name) for name in points]
    before = measured[0]
    for n, now in enumerate(measured):
        for p, channel in w.hands:
            w.x[p], w.v[p] = now[channel], RATE * (now[channel] - before[channel])
        force = w.whole(w.x, w.v)
        for p, channel in w.hands:
            forces[n, channel] = force[p]
        step()
        positions[n] = w.x[places]
        before = now
    return forces, positions


def agree(scene: Scene, seed: int, points: list[str]) -> None:
    measured = strokes(scene.channels, seed)
    forces, positions = by_the_tick(scene, measured, points)
    expected_forces, expected_positions = by_numpy(scene, measured, points)
    size = float(np.max(np.abs(expected_positions)))
    assert 1e-3 < size < 1.0
    print(
        scene.scheme,
        seed,
        np.max(np.abs(positions - expected_positions)) / size,
        np.max(np.abs(forces - expected_forces)) / np.max(np.abs(expected_forces)),
    )
    assert np.max(np.abs(positions - expected_positions)) <= 1e-12 * size
    assert np.max(np.abs(forces - expected_forces)) <= 1e-12 * np.max(np.abs(expected_forces))


HELD = ["m0", "s.2", "m1", "t.1"]  # by something from outside, whatever the scheme


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_scheme_is_the_one_that_is_written_here(scheme: str, seed: int) -> None:
    agree(scene_of(scheme, network(seed)), seed, HELD)


@pytest.mark.parametrize("seed", range(3))
def test_motions_that_go_by_themselves_are_the_same_system(seed: int) -> None:
    scene = scene_of("exact", network(seed, share=3e-4))
    assert ExactModes in numbers_in(scene)
    agree(scene, seed, HELD)


def test_a_damping_that_joins_the_modes_takes_the_dense_matrix() -> None:
    assert ExactDense in numbers_in(scene_of("exact", network(0)))
    nearly = network(0, share=3e-4)
    nearly["l0"]["damping"] *= 1.001
    assert ExactDense in numbers_in(scene_of("exact", nearly))


def shuffled_chain(count: int) -> dict[str, Any]:
    """A chain whose neighbours are far apart in the file."""
    order = np.random.default_rng(5).permutation(count)
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground", "position": 0.01}}
    modules |= {f"m{i}": {"type": "mass", "mass": 0.05 + 0.01 * float(i % 3)} for i in order}
    row = ["wall", *(f"m{i}" for i in range(count))]
    modules |= {f"l{a}": link(a, b, 400.0, 0.1) for a, b in pairwise(row)}
    return modules | {"touch": link("hand", f"m{count - 1}", 300.0, 0.3)}


def test_a_chain_in_any_order_is_narrow() -> None:
    scene = scene_of("midpoint", shuffled_chain(30))
    numbers = compile_scene(scene).parts[-1].numbers
    assert type(numbers) is Midpoint
    assert numbers.order.size == 30
    assert numbers.factor.columns.shape[1] == 1
    agree(scene, 1, ["m29"])


@pytest.mark.parametrize("scheme", ["semi_implicit", "rk4"])
def test_a_structure_taken_apart_is_the_same_as_in_one_pass(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(scheme, network(1))
    assert StringForces in numbers_in(scene)
    monkeypatch.setattr(force_expansion, "STRING", None)
    assert StringForces not in numbers_in(scene)
    assert WeightedLinks in numbers_in(scene)
    agree(scene, 1, HELD)


def test_links_that_remember_are_asked_once_a_sample() -> None:
    """Under the Runge-Kutta scheme their force is held: the first of the four alone, all the way."""
    modules = {"hand": {"type": "device", "channel": 0}, "m": {"type": "mass", "mass": 0.5, "velocity": 0.1}}
    alone = modules | {"touch": link("hand", "m", 0.0, 2.0, damper="centred")}
    scene = scene_of("rk4", alone)
    program = compile_scene(scene)
    start(program, np.zeros(1))
    m = numbers_of(scene)["m"]
    x, older, v = [-2e-4, -1e-4, 0.0], 0.0, 0.1
    for _ in range(200):
        force = np.zeros(1)
        tick(program, np.zeros(1), np.zeros(1), force)
        older = x[-1] - v * T  # what the link felt as the position before
        pull = -2.0 * RATE * 0.5 * (x[-1] - x[0])
        np.testing.assert_allclose(force[0], -pull, rtol=1e-9)
        x = [older, 0.0, x[-1] + T * v + 0.5 * T * T * pull / 0.5]
        v += T * pull / 0.5
        np.testing.assert_allclose(positions_of(program)[0][m], x[-1], rtol=1e-9)


def long_string(masses: int, friction: float) -> dict[str, Any]:
    string = {"type": "string", "masses": masses, "mass": 0.001, "stiffness": 100.0, "friction": friction}
    hand = {"hand": {"type": "device", "channel": 0}, "s": string, "touch": link("hand", "s.0", 1.0)}
    return hand | {"wall": {"type": "ground"}, "stop": link("s.500", "wall", 10.0, 1.0)}


def test_what_is_too_large_for_the_exact_scheme_is_refused() -> None:
    with pytest.raises(UsageError, match="exact is for 1000 masses at most where damping joins the scene's modes"):
        compile_scene(scene_of("exact", long_string(1001, 0.0)))
    with pytest.raises(UsageError, match="exact is for 4000 masses at most, and this scene moves 4001"):
        compile_scene(scene_of("exact", long_string(4001, 0.0)))


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_what_no_matrix_can_hold_is_refused(scheme: str) -> None:
    with pytest.raises(UsageError, match="too large for the scene's scheme"):
        compile_scene(chain(scheme, np.zeros(2), 1e308, 0.0, 1e-3))


# --- single precision ---


def slow_swing(scheme: str, precision: str, ticks: int) -> np.ndarray:
    """A mass that swings at 1/2000 of the rate, sample by sample."""
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules["m"] = {"type": "mass", "mass": 1.0, "position": 0.01}
    stiffness = float((2 * np.pi * RATE / 2000) ** 2)
    scene = scene_of(
        scheme, modules | {"l": link("m", "wall", stiffness), "h": link("hand", "m", 0.0)}, RATE, precision
    )
    return by_the_tick(scene, np.zeros((ticks, 1)), ["m"])[1][:, 0]


def test_a_stored_step_keeps_the_digits_of_a_slow_motion_in_single_precision(figures: Any) -> None:
    errors = {}
    for scheme in ("cordis", "semi_implicit"):
        swing = slow_swing(scheme, "single", 20_000)
        errors[scheme] = float(np.max(np.abs(swing - slow_swing(scheme, "double", 20_000)))) / 0.01
    assert errors["semi_implicit"] < 0.1 * errors["cordis"]
    closer = errors["cordis"] / errors["semi_implicit"]
    figures.note(f"single precision, a 2000th of the rate: semi_implicit is {closer:.0f} times closer than cordis")
