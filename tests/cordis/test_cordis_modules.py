"""Every module's compiled code against a recurrence of its own, written in Python from what its file says.

Each module has a hand of its own, as many in a scene as there are channels: what one does reaches no other. Each hand
walks at random, creeps, stands still and leaps, so that every branch is taken; that it was, each test asserts.

In single precision the scene is another: all its numbers, and the places where hands can be, are multiples of powers of
two, so that what decides between branches is exact there too and both precisions take the same.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple, get_args

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from hapsim.cordis.modules.friction import Frictions
from hapsim.cordis.modules.plectrum import Plectra
from hapsim.cordis.offline import follow_parameters, start, tick
from hapsim.cordis.program import Program, compile_scene, parameter_values
from hapsim.prediction.linear import linear_scene
from hapsim.scene import DamperScheme, Scene, parse_scene
from hapsim.scene.choices import WITH_CUTOFF, WITH_SENSOR

Array = NDArray[np.float64]
SAMPLES = 10_000

#: What forces may differ by, over the largest force of the module, in double and in single precision. A mass and a cell
#: carry what was rounded on from sample to sample.
WITHIN = {"double": 1e-12, "single": 1e-6}
WITHIN_CARRIED_ON = {"double": 1e-12, "single": 2e-4}


class Numbers(NamedTuple):
    """What the modules of a precision's scene are made of; SI units."""

    rate: float
    mass: float
    wall: float
    K: float
    B: float
    soft: float
    distance: float
    force: float
    static: float
    bristle: float
    bristle_damping: float
    release: float
    over_distance: list[list[float]]
    over_velocity: list[list[float]]


NUMBERS = {
    "double": Numbers(
        rate=1000.0,
        mass=0.0137,
        wall=0.0031,
        K=731.3,
        B=0.771,
        soft=113.7,
        distance=0.0047,
        force=1.13,
        static=2.21,
        bristle=1511.0,
        bristle_damping=0.31,
        release=0.0191,
        over_distance=[[-0.031, 3.1], [-0.0123, -2.7], [0.0017, 0.3], [0.0113, 1.9], [0.0297, 1.1]],
        over_velocity=[[-2.1, -0.7], [-0.13, -1.9], [0.11, 1.7], [1.9, 0.6]],
    ),
    "single": Numbers(
        rate=1024.0,
        mass=2**-6,
        wall=2**-8,
        K=512.0,
        B=0.5,
        soft=128.0,
        distance=2**-7,
        force=1.0,
        static=2.0,
        bristle=1024.0,
        bristle_damping=0.25,
        release=2**-6,
        over_distance=[[-0.03125, 3.0], [-0.015625, -2.75], [0.0, 0.25], [0.0078125, 2.0], [0.03125, 1.0]],
        over_velocity=[[-2.0, -0.75], [-0.125, -2.0], [0.125, 1.75], [2.0, 0.5]],
    ),
}

HANDS = (
    "mass",
    "ground",
    "cell",
    "device",
    "other",
    "spring",
    "damper",
    "backward",
    "centred",
    "filtered",
    "sensed",
    "buffer",
    "nonlinear",
    "friction",
    "plectrum",
)
CUTOFF = 61.0

#: Those that stand in one scene. `device` and `other`, which hold one link, have to be in the same.
Hands = tuple[str, ...]
SCENES: tuple[Hands, ...] = tuple(HANDS[first : first + 8] for first in range(0, len(HANDS), 8))


def scene_with(name: str) -> Hands:
    """The hands of the scene in which this one is."""
    return next(hands for hands in SCENES if name in hands)


@cache
def scene_of(precision: str, hands: Hands) -> Scene:
    """The scene, with a hand `h_…` for each of these modules."""
    n = NUMBERS[precision]
    modules: dict[str, Any] = {f"h_{name}": {"type": "device", "channel": i} for i, name in enumerate(hands)}
    modules |= {
        "wall": {"type": "ground", "position": n.wall},
        "m": {"type": "mass", "mass": n.mass, "position": n.wall, "velocity": 0.25},
        "moved": {"type": "ground", "position": n.wall},
        "c": {"type": "cell", "mass": n.mass, "stiffness": n.K, "damping": n.B, "rest": n.wall, "velocity": 0.25},
    }

    def link(name: str, kind: str, between: list[str], **values: Any) -> None:
        if name in hands:
            modules[name] = {"type": kind, "between": between, **values}

    link("mass", "spring", ["h_mass", "m"], stiffness=n.soft)
    link("ground", "viscoelastic", ["h_ground", "moved"], stiffness=n.K, damping=n.B)
    link("cell", "spring", ["c", "h_cell"], stiffness=n.soft)
    link("device", "viscoelastic", ["h_device", "h_other"], stiffness=n.K, damping=n.B)
    link("spring", "spring", ["h_spring", "wall"], stiffness=n.K)
    link("damper", "damper", ["wall", "h_damper"], damping=n.B)
    for damper in get_args(DamperScheme):
        cutoff = {"cutoff": CUTOFF} if damper in WITH_CUTOFF else {}
        ends = [f"h_{damper}", "moved" if damper in WITH_SENSOR else "wall"]
        link(damper, "viscoelastic", ends, stiffness=n.K, damping=n.B, damper=damper, **cutoff)
    link("buffer", "buffer", ["h_buffer", "wall"], stiffness=n.K, damping=n.B, distance=n.distance)
    curves = {"force_over_distance": n.over_distance, "force_over_velocity": n.over_velocity}
    link("nonlinear", "nonlinear", ["wall", "h_nonlinear"], **curves)
    bristle = {"stiffness": n.bristle, "damping": n.bristle_damping}
    link("friction", "friction", ["h_friction", "wall"], force=n.force, static=n.static, **bristle)
    link("plectrum", "plectrum", ["wall", "h_plectrum"], stiffness=n.K, damping=n.B, release=n.release)
    document = {"version": 1, "rate": n.rate, "precision": precision, "device": {"mass": 0.2}, "modules": modules}
    return parse_scene(yaml.safe_dump(document, sort_keys=False))


def walk(rng: np.random.Generator, precision: str) -> Array:
    """A hand that creeps, walks, leaps and stands still, within 50 mm: (SAMPLES,) m."""
    steps = rng.choice([0.0, 1e-3, 0.02, 0.3], SAMPLES // 50, p=[0.2, 0.3, 0.3, 0.2]).repeat(50)
    position: Array = 0.05 * np.sin(np.cumsum(steps * rng.normal(size=SAMPLES)))
    return np.round(position * 2**16) / 2**16 if precision == "single" else position


def rests_of(rng: np.random.Generator, where: float) -> Array:
    """A fixed point that is moved now and then, by 4 mm at the most: (SAMPLES,) m."""
    moves = rng.random(SAMPLES) < 0.02
    moves[:5], moves[-5:] = False, False
    places = where + rng.integers(-(2**6), 2**6, SAMPLES) * 2.0**-14
    return np.array([where, *places])[np.maximum.accumulate(np.where(moves, np.arange(1, SAMPLES + 1), 0))]


class Run(NamedTuple):
    """What went in and what came out: each (SAMPLES,) by the name of a hand."""

    position: dict[str, Array]
    velocity: dict[str, Array]
    rest: dict[str, Array]
    force: dict[str, Array]


@cache
def place_of(precision: str, hands: Hands, name: str, field: str) -> int:
    """Where a live value stands among the parameters."""
    scene = scene_of(precision, hands)
    other = scene.modules[name].model_copy(update={field: getattr(scene.modules[name], field) + 1.0})
    changed = scene.model_copy(update={"modules": dict(scene.modules) | {name: other}})
    (place,) = np.flatnonzero(parameter_values(changed) != parameter_values(scene))
    return int(place)


class Bench:
    """A compiled scene, from sample to sample as the loop takes it."""

    def __init__(self, precision: str, hands: Hands) -> None:
        self.scene, self.hands = scene_of(precision, hands), hands
        self._wanted = parameter_values(self.scene)
        self._places = [place_of(precision, hands, *value) for value in (("moved", "position"), ("c", "rest"))]
        self.program: Program = compile_scene(self.scene)

    def start(self, position: Array) -> None:
        """Hands at `position` (C,) m, at rest."""
        start(self.program, position)

    def step(self, position: Array, velocity: Array, rests: Array | None = None) -> Array:
        """The forces (C,) N at a sample; `rests`: where the ground and the cell rest from now on."""
        if rests is not None and not np.array_equal(self._wanted[self._places], rests.astype(self._wanted.dtype)):
            self._wanted[self._places] = rests
            self.program.parameters.post(self._wanted, 1)
        follow_parameters(self.program)
        force = np.zeros(len(self.hands))
        tick(self.program, position, velocity, force)
        return force


def run_of(precision: str) -> Run:
    rng = np.random.default_rng(20)
    position = np.array([walk(rng, precision) for _ in HANDS]).T.copy()
    velocity = np.round(rng.normal(size=position.shape) * 2**8) / 2**8
    wall = NUMBERS[precision].wall
    rests = np.array([rests_of(rng, wall), rests_of(rng, wall)]).T.copy()
    forces = []
    for hands in SCENES:
        bench, own = Bench(precision, hands), [HANDS.index(name) for name in hands]
        bench.start(position[0, own])
        samples = zip(position[:, own], velocity[:, own], rests, strict=True)
        forces.append([bench.step(*sample) for sample in samples])
    force = np.concatenate(forces, axis=1)

    def named(columns: Array) -> dict[str, Array]:
        return dict(zip(HANDS, columns.T, strict=True))

    return Run(named(position), named(velocity), {"ground": rests[:, 0], "cell": rests[:, 1]}, named(force))


@pytest.fixture(scope="module")
def runs() -> Callable[[str], Run]:
    """The run of each precision, done once."""
    done: dict[str, Run] = {}

    def run(precision: str) -> Run:
        if precision not in done:
            done[precision] = run_of(precision)
        return done[precision]

    return run


# The recurrences. Each takes what went in, and yields the force on the hand, sample by sample, telling its branches.

Branches = Counter[str]
Recurrence = Callable[[Run, Numbers, Branches], Iterator[float]]


def moving(points: Run, n: Numbers, hold: float, held_at: Array | None) -> Iterator[float]:
    """A hand and a mass with a spring between them; the mass held at a place that may move. By velocities."""
    name = "mass" if held_at is None else "cell"
    home = np.full(SAMPLES, n.wall) if held_at is None else held_at
    x, v = n.wall, 0.25
    before, home_before = x - v / n.rate, home[0]
    for hand, rest in zip(points.position[name], home, strict=True):
        pulled = n.soft * (x - hand)
        own = -hold * (x - rest) - hold / n.K * n.B * n.rate * ((x - rest) - (before - home_before))
        yield pulled
        before, home_before = x, rest
        v += (own - pulled) / n.mass / n.rate
        x += v / n.rate


def mass(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    return moving(points, n, 0.0, None)


def cell(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    took["the rest moved"] += int(np.count_nonzero(np.diff(points.rest["cell"])))
    return moving(points, n, n.K, points.rest["cell"])


def spring_and_damper(d: Array, K: float, B: float, rate: float) -> Array:
    """Tension, N, by the backward difference; at rest before the first sample."""
    return K * d + B * rate * np.diff(d, prepend=d[0])


def ground(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    took["the ground moved"] += int(np.count_nonzero(np.diff(points.rest["ground"])))
    yield from -spring_and_damper(points.position["ground"] - points.rest["ground"], n.K, n.B, n.rate)


def device(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from -spring_and_damper(points.position["device"] - points.position["other"], n.K, n.B, n.rate)


def other(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    yield from (-force for force in device(points, n, took))


def spring(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from n.K * (n.wall - points.position["spring"])


def damper(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from spring_and_damper(n.wall - points.position["damper"], 0.0, n.B, n.rate)


def backward(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from -spring_and_damper(points.position["backward"] - n.wall, n.K, n.B, n.rate)


def centred(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    d = points.position["centred"] - n.wall
    past = np.concatenate([[d[0], d[0]], d[:-2]])
    yield from -(n.K * d + n.B * n.rate * (d - past) / 2.0)


def filtered(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    d = points.position["filtered"] - n.wall
    kept, v = np.exp(-2.0 * np.pi * CUTOFF / n.rate), 0.0
    for now, before in zip(d, [d[0], *d[:-1]], strict=True):
        v = kept * v + (1.0 - kept) * (now - before) * n.rate
        yield -(n.K * now + n.B * v)


def sensed(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    rest = points.rest["ground"]  # which has no sensor
    speed = points.velocity["sensed"] - n.rate * np.diff(rest, prepend=rest[0])
    yield from -(n.K * (points.position["sensed"] - rest) + n.B * speed)


def buffer(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    before = points.position["buffer"][0]
    for x in points.position["buffer"]:
        depth = n.distance - (x - n.wall)
        push = n.K * depth - n.B * n.rate * (x - before)
        before = x
        took["apart" if depth <= 0 else "pushes" if push > 0 else "would hold back"] += 1
        yield push if depth > 0 and push > 0 else 0.0


def nonlinear(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    d = n.wall - points.position["nonlinear"]
    v = n.rate * np.diff(d, prepend=d[0])
    for x, points_of, what in ((d, n.over_distance, "m"), (v, n.over_velocity, "m/s")):
        for piece in np.searchsorted([at for at, _ in points_of], x):
            took[f"piece {piece} over {what}"] += 1
    yield from np.interp(d, *zip(*n.over_distance, strict=True)) + np.interp(v, *zip(*n.over_velocity, strict=True))


def friction(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    reach = n.force / n.bristle
    bent, way, before = 0.0, 0, points.position["friction"][0]
    for x in points.position["friction"]:
        step, before = x - before, x
        if way and np.sign(step) == -way:
            took["turns back and sticks"] += 1
            way = 0
            turned = True
        else:
            turned = False
        bent += step  # the anchor stays; where it slides it is dragged, below
        if way == 0 and n.bristle * abs(bent) > n.static:
            way = 1 if bent > 0 else -1
            took["turns about in one sample" if turned else "breaks away"] += 1
        if way:
            took["slides on" if step else "stands, slid"] += 1
            bent = way * reach
            yield -way * n.force
        else:
            took["sticks"] += 1
            yield -(n.bristle * bent + n.bristle_damping * n.rate * step)


def plectrum(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    let_go, before = 0.0, n.wall - points.position["plectrum"][0]
    for x in points.position["plectrum"]:
        d = n.wall - x
        step, before = d - before, d
        met = let_go != 0.0 and (d == 0 or (d > 0) != (let_go > 0))
        if let_go and not met:
            took["let go"] += 1
            yield 0.0
        elif abs(d) <= n.release:
            took["grips again" if met else "grips"] += 1
            let_go = 0.0
            yield n.K * d + n.B * n.rate * step
        else:
            took["passes beyond its reach" if met else "lets go"] += 1
            let_go = d
            yield 0.0


RECURRENCES: dict[str, tuple[Recurrence, set[str]]] = {
    "mass": (mass, set()),
    "ground": (ground, {"the ground moved"}),
    "cell": (cell, {"the rest moved"}),
    "device": (device, set()),
    "other": (other, set()),
    "spring": (spring, set()),
    "damper": (damper, set()),
    "backward": (backward, set()),
    "centred": (centred, set()),
    "filtered": (filtered, set()),
    "sensed": (sensed, set()),
    "buffer": (buffer, {"apart", "pushes", "would hold back"}),
    "nonlinear": (
        nonlinear,
        {f"piece {i} over m" for i in range(6)} | {f"piece {i} over m/s" for i in range(5)},
    ),
    "friction": (
        friction,
        {
            "sticks",
            "breaks away",
            "slides on",
            "stands, slid",
            "turns back and sticks",
            "turns about in one sample",
        },
    ),
    "plectrum": (plectrum, {"grips", "lets go", "let go", "grips again", "passes beyond its reach"}),
}


@pytest.mark.parametrize("precision", NUMBERS)
@pytest.mark.parametrize("name", RECURRENCES)
def test_a_module_is_the_recurrence_that_its_file_says(name: str, precision: str, runs: Callable[[str], Run]) -> None:
    recurrence, branches = RECURRENCES[name]
    took: Branches = Counter()
    run = runs(precision)
    expected = np.array(list(recurrence(run, NUMBERS[precision], took)))
    error = float(np.max(np.abs(run.force[name] - expected)) / np.max(np.abs(expected)))
    assert set(took) == branches
    assert all(count >= 5 for count in took.values()), took
    assert np.max(np.abs(expected)) > 0.5
    assert error <= (WITHIN_CARRIED_ON if name in ("mass", "cell") else WITHIN)[precision]


@pytest.mark.parametrize("precision", NUMBERS)
def test_what_is_not_a_number_comes_out_as_such_whatever_state_a_module_is_in(precision: str) -> None:
    rng = np.random.default_rng(21)
    position = np.array([walk(rng, precision) for _ in HANDS]).T.copy()
    states: Counter[tuple[str, float]] = Counter()
    for last, hands in itertools.product(rng.integers(30, SAMPLES, 60), SCENES):
        bench, own = Bench(precision, hands), [HANDS.index(name) for name in hands]
        nothing = np.full(len(hands), np.nan)
        bench.start(position[last - 30, own])
        for n in range(last - 30, last):
            bench.step(position[n, own], np.zeros(len(hands)))
        for part in bench.program.parts:
            if isinstance(part.numbers, Frictions):
                states["friction", float(part.numbers.sliding[0])] += 1
            elif isinstance(part.numbers, Plectra):
                states["plectrum", float(part.numbers.side[0])] += 1
        assert np.all(np.isnan(bench.step(nothing, nothing))), states
    assert set(states) == {(name, state) for name in ("friction", "plectrum") for state in (-1.0, 0.0, 1.0)}


SWING = 1e-7  # m


@pytest.mark.parametrize(
    ("name", "at"),
    [
        ("spring", 0.0),
        ("damper", 0.0),
        ("backward", 0.0),
        ("buffer", -0.002),
        ("nonlinear", 0.0),
        ("friction", 0.0),
        ("plectrum", 0.0),
    ],
)
def test_a_small_swing_meets_the_link_that_the_theory_takes_it_for(name: str, at: float) -> None:
    hands = scene_with(name)
    bench = Bench("double", hands)
    n, hand = NUMBERS["double"], hands.index(name)
    swing = SWING * np.sin(0.3 * np.arange(400))
    position = np.full((400, len(hands)), n.wall)
    position[:, hand] += at + swing
    bench.start(position[0])
    force = np.array([bench.step(x, np.zeros(len(hands)))[hand] for x in position])
    speed = n.rate * np.diff(swing, prepend=swing[0])
    met = np.linalg.lstsq(np.array([swing, speed, np.ones(400)]).T, -force, rcond=None)[0]
    link = linear_scene(bench.scene).links[name]
    assert met[0] == pytest.approx(link.stiffness, rel=1e-6, abs=1e-5)
    assert met[1] == pytest.approx(link.damping, rel=1e-6, abs=1e-7)
