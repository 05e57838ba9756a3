"""A scene with one of each module type, in double and in single precision, and how the tests of modules run it.

Each module has a hand of its own, as many in a scene as there are channels: what one does reaches no other. Each hand
walks at random, creeps, stands still and leaps, so that every branch is taken.

In single precision the scene is another: all its numbers, and the places where hands can be, are multiples of powers of
two, so that what decides between branches is exact there too and both precisions take the same.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple, get_args

import numpy as np
import yaml
from numpy.typing import NDArray

from hapsim.cordis.offline import start, tick, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values
from hapsim.scene import DamperScheme, Scene, parse_scene
from hapsim.scene.choices import WITH_CUTOFF, WITH_SENSOR, WITH_SHARPNESS, DetentShape

Array = NDArray[np.float64]
SAMPLES = 10_000


class Numbers(NamedTuple):
    """Parameters of the modules in a precision's scene; SI units."""

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
    pitch: float
    sharp: float
    travel: float
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
        pitch=0.0173,
        sharp=2.3,
        travel=0.0313,
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
        pitch=2**-6,
        sharp=3.0,
        travel=2**-5,
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
    "sine",
    "snap",
    "notch",
    "held",
    "placed",
    "click",
    "dome",
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
    for shape in get_args(DetentShape):
        sharpness = {"sharpness": n.sharp} if shape in WITH_SHARPNESS else {}
        ends = [f"h_{shape}", "wall"]
        link(shape, "detent", ends, pitch=n.pitch, depth=n.force, damping=n.B, shape=shape, **sharpness)
    holds = {"depth": n.force, "damping": n.B}
    link("held", "detent", ["h_held", "wall"], pitch=n.pitch, hold_until=1.25, **holds)
    places, zone = [n.wall + n.pitch * at for at in (-2.0, -1.0, 0.5, 1.0)], n.pitch / 8.0
    more = {"dead_zone": zone, "hold_until": 0.75, "stop": n.K, "only": [1, 2]}
    link("placed", "detent", ["wall", "h_placed"], places=places, **more, **holds)
    button = {"travel": n.travel, "bottom": n.K, "damping": n.B}
    link("click", "click", ["h_click", "wall"], peak=n.static, drop=n.force, peak_at=0.25, **button)
    link("dome", "click", ["wall", "h_dome"], peak=n.force, drop=n.static, **button)  # which stays down
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
    """Inputs and outputs of a run: each (SAMPLES,) by the name of a hand."""

    position: dict[str, Array]
    velocity: dict[str, Array]
    rest: dict[str, Array]
    force: dict[str, Array]


@cache
def place_of(precision: str, hands: Hands, name: str, field: str) -> int:
    """Returns the index of a live value among the parameters."""
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
        update_parameters(self.program)
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
