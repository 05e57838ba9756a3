"""Each scheme of the kernel against the same written with dense matrices in NumPy, and against the theory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.linalg import expm

from hapsim.cordis.offline import follow_parameters, start, tick
from hapsim.cordis.program import compile_scene, numbers_of, parameter_values, positions_of
from hapsim.cordis.schemes import SCHEMES, force_expansion
from hapsim.cordis.schemes.exact_dense import ExactDense
from hapsim.cordis.schemes.exact_modes import ExactModes
from hapsim.cordis.schemes.force_expansion import StringForces, WeightedLinks
from hapsim.cordis.schemes.midpoint import Midpoint
from hapsim.errors import UsageError
from hapsim.scene import Scene, parse_scene
from hapsim.theory.schemes import SCHEMES as THEORY
from hapsim.theory.schemes import spectral_radius

RATE = 1000.0
T = 1.0 / RATE
SAMPLES = 10_000


def scene_of(scheme: str, modules: Mapping[str, Any], rate: float = RATE, precision: str = "double") -> Scene:
    document = {"version": 1, "rate": rate, "precision": precision, "scheme": scheme, "device": {"mass": 0.2}}
    return parse_scene(yaml.safe_dump(document | {"modules": dict(modules)}, sort_keys=False))


def link(first: str, second: str, stiffness: float, damping: float = 0.0, **more: Any) -> dict[str, Any]:
    between = {"type": "viscoelastic", "between": [first, second]}
    return between | {"stiffness": float(stiffness), "damping": float(damping)} | more


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


def numbers_in(scene: Scene) -> set[type]:
    """What the parts of a scene's program work on."""
    return {type(part.numbers) for part in compile_scene(scene).parts}


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


# --- against the theory ---


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


def step_of(scheme: str, count: int, stiffness: float, damping: float, rate: float = RATE) -> np.ndarray:
    """The matrix by which one tick takes (x, v) on."""
    columns = []
    for unit in np.eye(2 * count):
        columns.append(np.concatenate(after(chain(scheme, unit, stiffness, damping, rate), 1)))
    return np.array(columns).T


def after(scene: Scene, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """(x, v) of the masses."""
    program = compile_scene(scene)
    start(program, np.zeros(1))
    for _ in range(ticks):
        tick(program, np.zeros(1), np.zeros(1), np.zeros(1))
    now, before = positions_of(program)
    masses = [numbers_of(scene)[name] for name in scene.masses]
    return now[masses], scene.rate * (now - before)[masses]


def chain_matrices(count: int, stiffness: float, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = 2.0 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    return 0.1 * (1 + np.arange(count) % 2), stiffness * rows, damping * rows


@pytest.mark.parametrize(("count", "stiffness", "damping"), [(1, 2e4, 3.0), (2, 1e4, 5.0), (6, 3e4, 0.0)])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_tick_is_the_matrix_of_the_theory(scheme: str, count: int, stiffness: float, damping: float) -> None:
    found = step_of(scheme, count, stiffness, damping)
    expected = THEORY[scheme].step(*chain_matrices(count, stiffness, damping), T)
    scale = np.repeat([1.0, T], count)  # (x, T v): both in metres
    normal = scale[:, None] * expected / scale
    np.testing.assert_allclose(scale[:, None] * found / scale, normal, atol=3e-13)
    assert spectral_radius(found) == pytest.approx(spectral_radius(expected), abs=1e-12)


@pytest.mark.parametrize(("scheme", "order"), [("cordis", 2), ("semi_implicit", 2), ("midpoint", 2), ("rk4", 4)])
def test_the_frequency_is_wrong_by_the_order_of_the_theory(scheme: str, order: int) -> None:
    """One mass on two springs, at omega T of 0.1 and half of it."""
    assert order == THEORY[scheme].order
    errors = []
    for angle in (0.1, 0.05):
        pole = np.linalg.eigvals(step_of(scheme, 1, 0.05 * (angle * RATE) ** 2, 0.0))[0]
        errors.append(abs(np.angle(pole)) / angle - 1.0)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.01)
    assert errors[1] == pytest.approx(THEORY[scheme].error * 0.05**order, rel=0.01)


def test_the_exact_frequency_is_exact() -> None:
    pole = np.linalg.eigvals(step_of("exact", 1, 0.05 * (2.5 * RATE) ** 2, 0.0))[0]
    assert abs(np.angle(pole)) == pytest.approx(2.5, rel=1e-14)
    assert THEORY["exact"].error == 0.0


@pytest.mark.parametrize("scheme", ["cordis", "semi_implicit", "rk4"])
@pytest.mark.parametrize("damping", [0.0, 20.0, 60.0])
def test_one_mass_is_stable_up_to_the_limit_of_the_theory(scheme: str, damping: float) -> None:
    limit = THEORY[scheme].stiffness_limit(0.1, 2.0 * damping, T)
    state = np.array([0.01, 0.0])
    within, _ = after(chain(scheme, state, 0.5 * limit * 0.999, damping), 10_000)
    beyond, _ = after(chain(scheme, state, 0.5 * limit * 1.001, damping), 10_000)
    assert abs(within[0]) < 1.0
    assert abs(beyond[0]) > 10.0


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_no_stiffness_makes_an_implicit_scheme_unstable(scheme: str, damping: float) -> None:
    """A million times what CORDIS's scheme stands; without damping the energy stays what it was."""
    limit = THEORY["cordis"].stiffness_limit(0.1, 0.0, T)
    assert THEORY[scheme].stiffness_limit(0.1, 2.0 * damping, T) == np.inf
    state = np.concatenate([[0.01, -0.02, 0.01], np.zeros(3)])
    x, v = after(chain(scheme, state, 1e6 * limit, damping), 10_000)
    mass, K, _ = chain_matrices(3, 1e6 * limit, damping)
    energy = [x @ K @ x + v @ (mass * v), state[:3] @ K @ state[:3]]
    assert energy[0] <= energy[1] * (1.0 + 1e-9)
    if damping == 0.0:
        assert energy[0] == pytest.approx(energy[1], rel=1e-6)


# --- what may change while the scene runs ---


@pytest.mark.parametrize("scheme", ["cordis", "semi_implicit", "rk4"])
def test_without_a_matrix_everything_may_change(scheme: str) -> None:
    scene = scene_of(scheme, network(0))
    changed = scene_of(scheme, network(0) | {"l0": network(0)["l0"] | {"stiffness": 1.0}})
    values = parameter_values(scene)
    program = compile_scene(scene, values)
    values[:] = parameter_values(changed)
    measured = strokes(2, 4)[:50]
    expected, _ = by_the_tick(changed, measured, [])
    start(program, measured[0])
    for n, now in enumerate(measured):
        force = np.zeros(2)
        tick(program, now, np.zeros(2), force)
        np.testing.assert_array_equal(force, expected[n])


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_a_ground_that_moves_pulls_what_is_tied_to_it(scheme: str) -> None:
    """By where it is, and by how it got there: its position is one of the values that may change."""
    state = np.zeros(2)
    scene = chain(scheme, state, 1000.0, 2.0)
    program = compile_scene(scene)
    start(program, np.zeros(1))
    values = parameter_values(scene)
    values[0] = 0.01
    program.parameters.post(values, 1)
    follow_parameters(program)
    tick(program, np.zeros(1), np.zeros(1), np.zeros(1))
    a = np.array(
        [[0.0, 1.0, 0.0], [-2 * 1e3 / 0.1, -2 * 2.0 / 0.1, (1e3 * 0.01 + 2.0 * 0.01 * RATE) / 0.1], [0.0, 0.0, 0.0]]
    )
    one = np.eye(3)
    step = expm(T * a) if scheme == "exact" else np.linalg.solve(one - 0.5 * T * a, one + 0.5 * T * a)
    now, before = positions_of(program)
    np.testing.assert_allclose([now[3], RATE * (now - before)[3]], step[:2, 2], rtol=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_scene_that_moves_nothing_needs_no_scheme(scheme: str) -> None:
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": link("hand", "wall", 5.0)}
    program = compile_scene(scene_of(scheme, modules))
    start(program, np.array([0.01]))
    force = np.zeros(1)
    tick(program, np.array([0.01]), np.zeros(1), force)
    assert force[0] == -0.05


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
