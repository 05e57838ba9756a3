"""Strings, stiff strings and membranes: against the masses and links that they stand for, and against their modes."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, parameter_values, positions_of
from hapsim.prediction import predict
from hapsim.running.changes import differs_in_live_parameters_alone
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from written import RATE, run_of, scene_of, written_out

SAMPLES = 10_000
ENDS = ("fixed", "clamped", "free")
TWO_ENDS = list(itertools.product(ENDS, repeat=2))
FOUR_EDGES = list(itertools.product(("fixed", "free"), repeat=4))
CASES = [(ends, (FOUR_EDGES[i], FOUR_EDGES[i + 7])) for i, ends in enumerate(TWO_ENDS)]  # every one, of either
AT_REST = np.zeros(SAMPLES)


def hand_moving(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """Slowly by 5 cm, faster by less, and a noise of 0.1 mm."""
    n = np.arange(samples)
    return 0.05 * np.sin(0.003 * n) + 0.005 * np.sin(0.31 * n) + 1e-4 * rng.normal(size=samples)


class Numbers(NamedTuple):
    """T²/m times K, B/T, friction/T and the stiffness against bending: stable together."""

    a: float = 0.0
    b: float = 0.0
    e: float = 0.0
    g: float = 0.0

    def values(self, mass: float) -> dict[str, float]:
        """The fields of a module that has them."""
        values = {
            "mass": mass,
            "stiffness": self.a * mass * RATE**2,
            "damping": self.b * mass * RATE,
            "friction": self.e * mass * RATE,
        }
        return values | ({"bending": self.g * mass * RATE**2} if self.g else {})

    def pole_pair(self, spread: float) -> np.ndarray:
        """Of a mode for which the links, each of stiffness 1, are a stiffness `spread` together."""
        old = 1.0 - self.b * spread - self.e
        now = 1.0 + old - self.a * spread - self.g * spread**2
        return np.roots([1.0, -now, old])


def some(rng: np.random.Generator, *, bending: bool = False, neighbours: int = 2) -> Numbers:
    most = 2.0 / neighbours
    a, b, e = rng.uniform(0.05, 0.4) * most, rng.uniform(0.0, 0.05) * most, rng.uniform(0.01, 0.03)
    return Numbers(a, b, e, rng.uniform(0.005, 0.03) if bending else 0.0)


def many_structures(
    rng: np.random.Generator, ends: tuple[str, str], edges: Sequence[tuple[str, ...]], with_links: bool = True
) -> dict[str, Any]:
    """Strings with and without bending and membranes, of every size that a sweep treats in another way."""
    structures: dict[str, Any] = {}
    sizes = [2, 5, 6, 7, 14, 15, 16, 17, 100, *rng.integers(3, 71, 2).tolist()]
    for (i, size), bending in itertools.product(enumerate(sizes), (False, True)):
        values = some(rng, bending=bending).values(rng.uniform(0.001, 0.1))
        where = {"position": float(rng.uniform(-0.02, 0.02)), "ends": list(ends)}
        structures[f"s{i}{'b' if bending else ''}"] = {"type": "string", "masses": size, **values, **where}
    areas = [(2, 2), (3, 5), (3, 7), (2, 14), (2, 15), (2, 16), tuple(rng.integers(2, 11, 2).tolist())]
    for i, ((rows, columns), held) in enumerate(zip(areas, itertools.cycle(edges), strict=False)):
        values = some(rng, neighbours=4).values(rng.uniform(0.001, 0.1))
        where = {"position": float(rng.uniform(-0.02, 0.02)), "edges": list(held)}
        structures[f"m{i}"] = {"type": "membrane", "rows": rows, "columns": columns, **values, **where}
    return structures | (links_on(rng, structures) if with_links else {})


def places_of(structure: Mapping[str, Any]) -> list[str]:
    if structure["type"] == "string":
        return [str(i) for i in range(structure["masses"])]
    return [f"{r}.{c}" for r in range(structure["rows"]) for c in range(structure["columns"])]


def links_on(rng: np.random.Generator, structures: Mapping[str, Any]) -> dict[str, Any]:
    """The hand, a ground and a mass on the first, the last and some other masses of each, and each on the next."""
    links: dict[str, Any] = {"wall": {"type": "ground", "position": 0.01}, "lump": {"type": "mass", "mass": 1.0}}
    names = list(structures)
    for i, name in enumerate(names):
        places = places_of(structures[name])
        other, mass = names[(i + 1) % len(names)], structures[name]["mass"]
        pairs = [("hand", places[0]), (f"{other}.{places_of(structures[other])[-1]}", places[-1])]
        pairs += [(end, str(rng.choice(places))) for end in ("wall", "hand", "lump")]
        mass = min(mass, structures[other]["mass"])
        for j, (end, place) in enumerate(pairs):
            links[f"l{i}_{j}"] = {
                "type": "viscoelastic",
                "between": [end, f"{name}.{place}"],
                "stiffness": 0.05 * mass * RATE**2 * float(rng.uniform(0.5, 1.0)),
                "damping": 0.02 * mass * RATE * float(rng.uniform(0.5, 1.0)),
            }
    return links


def changed(rng: np.random.Generator, modules: Mapping[str, Any]) -> dict[str, Any]:
    """Every live value of the structures a little another."""
    live = ("stiffness", "damping", "friction")
    return {
        name: {key: value * rng.uniform(0.7, 1.1) if key in live else value for key, value in module.items()}
        if module["type"] in ("string", "membrane")
        else module
        for name, module in modules.items()
    }


DOUBLE = [("double", 1e-12, *case) for case in CASES]
SINGLE = [("single", 1e-5, *case) for case in CASES[::4]]


@pytest.mark.parametrize(("precision", "bound", "ends", "edges"), DOUBLE + SINGLE)
def test_a_structure_moves_as_the_masses_and_links_that_it_stands_for(
    precision: str, bound: float, ends: tuple[str, str], edges: Sequence[tuple[str, ...]]
) -> None:
    """The bound of single precision: roundings of 6e-8, which a slow mode makes larger until it dies away."""
    rng = np.random.default_rng(TWO_ENDS.index(ends))
    modules = many_structures(rng, ends, edges)
    before, after = scene_of(modules, precision=precision), scene_of(changed(rng, modules), precision=precision)
    hand = hand_moving(rng)

    def change(n: int, values: np.ndarray) -> None:
        if n == SAMPLES // 2:
            values[:] = parameter_values(after)

    run = run_of(before, hand, at_sample=change)
    written = [written_out(scene) for scene in (before, after)]
    ours, place = written[0].places(run.names), written[0].place("hand")
    x, old = written[0].rest.copy(), written[0].rest.copy()
    x[place] = old[place] = hand[0]
    worst = worst_force = 0.0
    for n in range(SAMPLES):
        x[place] = hand[n]
        following, force = written[n >= SAMPLES // 2].follow(x, old)
        old, x = x, following
        worst = max(worst, float(np.max(np.abs(run.positions[n + 2] - x[ours]))))
        worst_force = max(worst_force, abs(run.forces[n] - force[place]))
    assert worst <= bound * np.max(np.abs(run.positions))
    assert worst_force <= bound * np.max(np.abs(run.forces))
    assert np.max(np.abs(run.positions)) < 0.5


def of_a_string(ends: tuple[str, str], masses: int, k: int) -> tuple[np.ndarray, float]:
    """The shape of a mode, k = 1, 2, ..., and what links of stiffness 1 are in it together."""
    i = np.arange(masses)
    if ends == ("free", "free"):
        angle = (k - 1) * np.pi / masses
        shape = np.cos(angle * (i + 0.5))
    elif "free" in ends:
        angle = (2 * k - 1) * np.pi / (2 * masses + 1)
        shape = np.sin(angle * (i + 1))
        shape = shape if ends[1] == "free" else shape[::-1]
    else:
        angle = k * np.pi / (masses + 1)
        shape = np.sin(angle * (i + 1))
    return shape, 4.0 * np.sin(angle / 2.0) ** 2


class Swinging(NamedTuple):
    """A structure in one mode."""

    module: dict[str, Any]
    numbers: Numbers
    shape: np.ndarray
    spread: float


def swinging_strings(numbers: Numbers, few: bool = False) -> list[Swinging]:
    swinging = []
    ends = [("fixed", "fixed"), ("fixed", "free"), ("free", "fixed"), ("free", "free")]
    for held, masses in itertools.product(ends, (2, 17, 100, 1000)):
        # The string that resists bending has modes in closed form on two hinges.
        if numbers.g and held != ("fixed", "fixed"):
            continue
        modes = {masses // 3 + 2, masses} if masses < 1000 else {2, 3, 500, 1000}
        if held != ("free", "free"):
            modes |= {1}
        for k in sorted(modes)[: 2 if few else None]:
            if k <= masses:
                shape, spread = of_a_string(held, masses, k)
                module = {"type": "string", "masses": masses, "ends": list(held), **numbers.values(0.02)}
                swinging.append(Swinging(module, numbers, shape, spread))
    return swinging


def swinging_membranes(numbers: Numbers) -> list[Swinging]:
    swinging = []
    for edges in FOUR_EDGES:
        for (rows, columns), (k, j) in itertools.product([(2, 5), (17, 12)], [(1, 1), (2, 5)]):
            down, spread_down = of_a_string((edges[0], edges[1]), rows, k)
            along, spread_along = of_a_string((edges[2], edges[3]), columns, j)
            if spread_down + spread_along < 1e-12:
                continue
            module = {"type": "membrane", "rows": rows, "columns": columns, "edges": list(edges)}
            shape = np.outer(down, along).ravel()
            module |= numbers.values(0.02)
            swinging.append(Swinging(module, numbers, shape, spread_down + spread_along))
    return swinging


def identified(q: np.ndarray) -> complex:
    """The pole in the upper half plane of a recurrence q[n+1] - 2 q[n] + q[n-1] = -α q[n] - β (q[n] - q[n-1])."""
    growth = np.diff(q)
    alpha, beta = -np.linalg.lstsq(np.column_stack([q[1:-1], growth[:-1]]), np.diff(growth), rcond=None)[0]
    half = (2.0 - alpha - beta) / 2.0
    # 1 - half² would lose what makes a slow mode swing.
    below = (1.0 - beta) - half**2
    slow = alpha - (alpha + beta) ** 2 / 4.0
    return complex(half, np.sqrt(slow if slow > 0 else below))


def poles_of(swinging: list[Swinging], precision: str = "double", samples: int = 4000) -> list[complex]:
    """Each let go in its mode's shape, 1 mm, all in one scene; the pole that is identified from each one's motion."""
    scene = scene_of({f"x{i}": one.module for i, one in enumerate(swinging)}, precision=precision)
    numbers = numbers_of(scene)
    program = compile_scene(scene)
    shapes = []
    position, previous = positions_of(program)
    for i, one in enumerate(swinging):
        ours = np.array([numbers[f"x{i}.{place}"] for place in places_of(one.module)])
        position[ours] = previous[ours] = 1e-3 * one.shape
        shapes.append((ours, one.shape / (1e-3 * one.shape @ one.shape)))
    nothing = np.zeros(1)
    start(program, nothing)
    q = np.empty((samples, len(swinging)))
    for n in range(samples):
        tick(program, nothing, nothing, nothing)
        x = positions_of(program)[0]
        q[n] = [shape @ x[ours] for ours, shape in shapes]
    return [identified(column) for column in q.T]


def expected_pole(one: Swinging) -> complex:
    return complex(max(one.numbers.pole_pair(one.spread), key=lambda z: z.imag))


UNDAMPED, STIFF, DAMPED = Numbers(a=0.45), Numbers(a=0.2, g=0.1), Numbers(a=0.3, b=0.002, e=1e-4)


@pytest.mark.parametrize(
    "swinging",
    [swinging_strings(UNDAMPED), swinging_strings(STIFF), swinging_membranes(Numbers(a=0.4))],
    ids=["string", "stiff string", "membrane"],
)
def test_an_undamped_mode_swings_as_the_closed_form_of_the_discrete_structure_says(
    swinging: list[Swinging], figures: Any
) -> None:
    for one, z in zip(swinging, poles_of(swinging), strict=True):
        theta = 2.0 * np.arcsin(np.sqrt(one.numbers.a * one.spread + one.numbers.g * one.spread**2) / 2.0)
        assert np.angle(z) == pytest.approx(theta, rel=1e-9)
        assert abs(z) == pytest.approx(1.0, abs=1e-9)
        figures.most("a mode's frequency off by, relative, double precision", abs(np.angle(z) / theta - 1.0))


@pytest.mark.parametrize(
    "swinging",
    [
        swinging_strings(DAMPED, few=True),
        swinging_strings(STIFF._replace(b=0.001, e=1e-4), few=True),
        swinging_membranes(DAMPED),
    ],
    ids=["string", "stiff string", "membrane"],
)
def test_a_damped_mode_dies_away_as_the_closed_form_says(swinging: list[Swinging]) -> None:
    for one, z in zip(swinging, poles_of(swinging, samples=2000), strict=True):
        expected = expected_pole(one)
        assert np.angle(z) == pytest.approx(np.angle(expected), rel=1e-9)
        assert np.log(abs(z)) == pytest.approx(np.log(abs(expected)), rel=1e-7)


@pytest.mark.parametrize(
    "swinging",
    [swinging_strings(Numbers(a=0.03)), swinging_strings(Numbers(a=0.03, g=0.01)), swinging_membranes(Numbers(a=0.03))],
    ids=["string", "stiff string", "membrane"],
)
def test_single_precision_keeps_the_frequency_of_a_slow_mode(swinging: list[Swinging], figures: Any) -> None:
    """Where the recurrence is worked out from differences: coefficients of 32 bits would be wrong by 1e-3."""
    swinging = [one for one in swinging if len(one.shape) <= 204]
    for one, z in zip(swinging, poles_of(swinging, "single"), strict=True):
        expected = np.angle(expected_pole(one))
        assert np.angle(z) == pytest.approx(expected, rel=1e-5)
        figures.most("a mode's frequency off by, relative, single precision", abs(np.angle(z) / expected - 1.0))


def undamped(rng: np.random.Generator, ends: tuple[str, str], edges: Sequence[tuple[str, ...]]) -> Scene:
    modules = many_structures(rng, ends, edges, with_links=False)
    return scene_of({name: {**module, "damping": 0.0, "friction": 0.0} for name, module in modules.items()})


def masses_and_springs(rng: np.random.Generator) -> Scene:
    """40 masses and 100 springs between any two of them, and a ground."""
    names = [f"m{i}" for i in range(40)]
    modules: dict[str, Any] = {name: {"type": "mass", "mass": float(rng.uniform(0.5, 1.0))} for name in names}
    modules["wall"] = {"type": "ground", "position": 0.01}
    for i in range(100):
        ends = rng.choice([*names, "wall"], 2, replace=False).tolist()
        stiffness = float(rng.uniform(0.0, 0.1)) * RATE**2
        modules[f"l{i}"] = {"type": "viscoelastic", "between": ends, "stiffness": stiffness}
    return scene_of(modules)


def thrown(rng: np.random.Generator, scene: Scene) -> dict[str, tuple[float, float]]:
    """Every mass somewhere within 1 cm, under way at up to 1 m/s."""
    written = written_out(scene)
    begin = {}
    for name in written.moved:
        now = written.rest[written.place(name)] + rng.uniform(-0.01, 0.01)
        begin[name] = (now, now - rng.uniform(-1.0, 1.0) / RATE)
    return begin


@pytest.mark.parametrize("which", [*CASES, None], ids=lambda case: "network" if case is None else "-".join(case[0]))
def test_without_damping_the_energy_of_the_scheme_is_kept(which: tuple[Any, Any] | None) -> None:
    """m (x[n+1] - 2 x[n] + x[n-1])/T² = -K x[n], times x[n+1] - x[n-1] and added up over all masses, says that

    E[n] = Σ m/2 ((x[n+1] - x[n])/T)² + x[n+1] · K x[n] / 2

    is the same in every sample.
    """
    rng = np.random.default_rng(7)
    scene = masses_and_springs(rng) if which is None else undamped(rng, *which)
    run = run_of(scene, AT_REST, thrown(rng, scene))
    written = written_out(scene)
    K = written.K.tolil()
    held = written.inverse_mass == 0
    shift = written.rest.copy()  # what is held is where it is at rest, whoever moves
    ours = written.places(run.names)
    x = np.tile(shift, (len(run.positions), 1))
    x[:, ours] = run.positions
    mass = np.where(held, 0.0, 1.0 / np.where(held, 1.0, written.inverse_mass))
    if which is None:
        # Away from where all springs are at rest together.
        assert np.count_nonzero(held) == 2
    K = K.tocsr()
    kinetic = (np.diff(x, axis=0) * RATE) ** 2 @ mass / 2.0
    potential = np.einsum("ni,ni->n", x[1:], (K @ x[:-1].T).T) / 2.0
    energy = kinetic + potential
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)


@pytest.mark.parametrize("friction", [0.0, 1e-3])
def test_what_nothing_holds_keeps_its_momentum(friction: float) -> None:
    """Whatever its links do, dampers too. With friction e of the mass in each sample, it is 1 - e of what it was."""
    rng = np.random.default_rng(8)
    modules = many_structures(rng, ("free", "free"), [("free",) * 4], with_links=False)
    modules = {name: {**one, "friction": friction * one["mass"] * RATE} for name, one in modules.items()}
    scene = scene_of(modules)
    begin = thrown(rng, scene)
    for name in modules:  # on average they drift by 2 cm
        mean = np.mean([now - before for point, (now, before) in begin.items() if point.startswith(f"{name}.")])
        begin |= {
            point: (now, before + mean - 2e-6) for point, (now, before) in begin.items() if point.startswith(f"{name}.")
        }
    run = run_of(scene, AT_REST, begin)
    n = np.arange(len(run.positions) - 1)
    for name in modules:
        ours = [i for i, point in enumerate(run.names) if point.startswith(f"{name}.")]
        momentum = np.sum(np.diff(run.positions[:, ours], axis=0), axis=1)
        scale = np.sum(np.abs(np.diff(run.positions[:2, ours], axis=0)))
        expected = momentum[0] * (1.0 - friction) ** n
        np.testing.assert_allclose(momentum, expected, rtol=0.0, atol=1e-10 * scale)


def small_scene() -> Scene:
    """A string, a stiff string and a membrane on one hand, one of them on another."""
    numbers = Numbers(a=0.3, b=0.02, e=0.001)
    link = {"type": "viscoelastic", "stiffness": 100.0, "damping": 0.5}
    return scene_of(
        {
            "s": {"type": "string", "masses": 5, "ends": ["fixed", "free"], **numbers.values(0.02)},
            "b": {"type": "string", "masses": 4, "ends": ["clamped", "free"], **numbers._replace(g=0.03).values(0.03)},
            "m": {
                "type": "membrane",
                "rows": 3,
                "columns": 2,
                "edges": ["free", "fixed", "fixed", "free"],
                **numbers._replace(a=0.17).values(0.04),
            },
            "l0": {"between": ["hand", "s.2"], **link},
            "l1": {"between": ["hand", "m.2.1"], **link},
            "l2": {"between": ["b.3", "s.4"], **link},
        },
        device={"mass": 0.2, "friction": 1.0, "delay": 1.0},
    )


def loop_of(scene: Scene) -> np.ndarray:
    """The matrix by which a sample takes the scene and its hand on: positions, positions before, the hand's position,
    its position before and its velocity, and the force that acts on it, which is that of the sample before."""
    numbers = numbers_of(scene)
    ours = np.array([number for name, number in numbers.items() if name != "hand"])
    mass, friction = scene.device.masses(1)[0], scene.device.frictions(1)[0]
    flow = expm(np.array([[0, 1, 0], [0, -friction / mass, 1 / mass], [0, 0, 0]]) / scene.rate)
    count = len(ours)
    columns = []
    for unit in np.eye(2 * count + 4):
        program = compile_scene(scene)
        position, previous = positions_of(program)
        position[ours], previous[ours] = unit[:count], unit[count : 2 * count]
        hand, hand_before, velocity, acting = unit[2 * count :]
        start(program, np.array([hand]))
        previous[numbers["hand"]] = hand_before
        force = np.zeros(1)
        tick(program, np.array([hand]), np.zeros(1), force)
        now, before = positions_of(program)
        moved = flow @ [hand, velocity, acting]
        columns.append([*now[ours], *before[ours], moved[0], hand, moved[1], force[0]])
    return np.array(columns).T


def test_the_theory_has_the_poles_of_the_tick() -> None:
    scene = small_scene()
    predicted = predict(scene, with_margins=False)
    left = [complex(z) for z in np.linalg.eigvals(loop_of(scene)) if abs(z) > 1e-9]
    assert len(predicted.poles) == len(left)
    for pole in predicted.poles:
        nearest = min(left, key=lambda z: abs(z - pole))
        assert abs(nearest - pole) < 1e-9
        left.remove(nearest)
    assert predicted.stable
    assert predicted.spectral_radius < 1.0


@pytest.mark.parametrize(("at", "ends"), [(0, ("fixed", "free")), (6, ("fixed", "fixed")), (19, ("clamped", "free"))])
@pytest.mark.parametrize("bending", [0.0, 500.0])
def test_a_plucked_string_begins_at_rest_in_its_triangle(at: int, ends: tuple[str, str], bending: float) -> None:
    values = {**UNDAMPED.values(0.02), "bending": bending, "position": 0.03}
    string = {"type": "string", "masses": 20, "ends": list(ends), "pluck": {"at": at, "by": 0.004}, **values}
    scene = scene_of({"s": string})
    run = run_of(scene, np.zeros(200))
    corner = np.interp(np.arange(20), [-1, at, 20], [0.0, 0.004, 0.0])
    np.testing.assert_allclose(run.positions[0], 0.03 + corner, rtol=1e-15)
    np.testing.assert_array_equal(run.positions[1], run.positions[0])
    written = written_out(scene)
    x = written.rest.copy()
    x[written.places(run.names)] = run.positions[0]
    old = x
    for n in range(200):
        old, x = x, written.follow(x, old)[0]
        np.testing.assert_allclose(run.positions[n + 2], x[written.places(run.names)], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["s5", "s5b", "m2"])
def test_what_is_not_a_number_goes_on_to_all_that_it_holds(name: str) -> None:
    rng = np.random.default_rng(5)
    modules = many_structures(rng, ("fixed", "free"), [("fixed", "free", "free", "fixed")])
    scene = scene_of(modules)
    place = places_of(modules[name])[-1]
    run = run_of(scene, np.zeros(100), {f"{name}.{place}": (np.nan, np.nan)})
    ours = [i for i, point in enumerate(run.names) if point.startswith(f"{name}.")]
    assert np.isnan(run.positions[-1, ours]).all()
    assert np.isnan(run.forces[-1])


def test_with_and_without_bending_a_string_is_another_structure() -> None:
    """Bending is another recurrence, over two neighbours to each side."""
    now, wanted = (scene_of({"s": {"type": "string", "masses": 3, **Numbers(a=0.1, g=g).values(1.0)}}) for g in (0, 1))
    assert not differs_in_live_parameters_alone(now, wanted)
    assert differs_in_live_parameters_alone(now, now)
