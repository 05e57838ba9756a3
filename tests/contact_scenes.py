"""Random scenes of hands, masses and contacts, and their motion sample by sample: a referee of what is predicted of
them. All runs of a scene are columns."""

from __future__ import annotations

import itertools
import random
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hapsim.prediction import Prediction
from hapsim.prediction.reach import State
from hapsim.scene import Link, Nonlinear, Scene, parse_scene
from tests.link_formulas import tension_of

Floats = NDArray[np.float64]
Fixed = Mapping[str, tuple[Floats, Floats]]


def contact_scene(seed: int) -> Scene:
    """A hand and one to three masses or cells; springs, and contacts of every kind between them and on a wall."""
    chance = random.Random(seed)
    device: dict[str, Any] = {"clock": "lockstep", "force_limit": 10.0, "mass": chance.uniform(0.1, 0.5)}
    device |= {"friction": chance.uniform(0.2, 2.0), "delay": chance.choice((0, 1))}
    if chance.random() < 0.5:
        device["travel"] = [-0.03, 0.03]
    modules: dict[str, Any] = {"wall": {"type": "ground"}, "hand": {"type": "device", "channel": 0}}
    balls = [f"ball{i}" for i in range(chance.randint(1, 3))]
    for ball in balls:
        modules[ball] = {"type": "mass", "mass": 10.0 ** chance.uniform(-2.0, -0.5)}
        modules[ball]["position"] = at = chance.choice((0.0, 0.0, chance.uniform(-0.02, 0.02)))
        own = {"stiffness": chance.uniform(20.0, 500.0), "damping": chance.choice((0.0, chance.uniform(0.0, 1.0)))}
        if chance.random() < 0.6:
            modules[ball] |= {"type": "cell", "rest": at} | own
        elif chance.random() < 0.8:
            modules[f"{ball}_spring"] = {"type": "viscoelastic", "between": [ball, "wall"]} | own
    for n in range(chance.randint(1, 4)):
        ends = chance.choice([["hand", chance.choice(balls)], [chance.choice(balls), "wall"], [balls[0], balls[-1]]])
        if n == 0 or ends[0] == ends[1]:
            ends = ["hand", chance.choice(balls)]
        modules[f"link{n}"] = _contact(chance) | {"between": ends}
    if chance.random() < 0.3:
        slope = 10.0 ** chance.uniform(-2.0, 0.0)
        curve = [[-1.0, slope], [1.0, -slope]]
        modules["drive"] = {"type": "nonlinear", "between": [balls[0], "wall"], "force_over_velocity": curve}
    document = {"version": 1, "rate": 1000, "device": device, "modules": modules}
    return parse_scene(yaml.safe_dump(document, sort_keys=False), f"contacts {seed}")


def _contact(chance: random.Random) -> dict[str, Any]:
    kind = chance.choice(("buffer", "buffer", "plectrum", "detent", "nonlinear"))
    values: dict[str, Any] = {"stiffness": 10.0 ** chance.uniform(1.5, 3.8), "damping": chance.uniform(0.0, 4.0)}
    if kind == "buffer":
        values["distance"] = chance.uniform(-0.01, 0.01)
    elif kind == "plectrum":
        values["release"] = chance.uniform(0.0005, 0.004)
    elif kind == "detent":
        values = {"pitch": chance.uniform(0.002, 0.01), "depth": chance.uniform(0.1, 1.0), "shape": "snap"}
        values["damping"] = chance.uniform(0.0, 1.0)
    else:
        places = np.cumsum([chance.uniform(0.001, 0.004) for _ in range(4)]) - 0.005
        values = {"force_over_distance": [[float(x), chance.uniform(-1.0, 1.0)] for x in places]}
    return {"type": kind} | values


class Motion:
    """A scene's motion from many beginnings at once; `fixed`: links that are these springs and dampers (N/m, N·s/m) of
    each beginning, beyond the ends of their pieces too; `held`: N, with which a hand pushes steadily."""

    def __init__(
        self, scene: Scene, places: Mapping[str, Floats], fixed: Fixed | None = None, held: float = 0.0
    ) -> None:
        self._scene, self._fixed, self._held, self._period = scene, fixed or {}, held, 1.0 / scene.rate
        self._zero = np.zeros_like(next(iter(places.values())))
        grounds = {name: self._zero + ground.position for name, ground in scene.grounds.items()}
        self.now = {name: place.copy() for name, place in places.items()} | grounds
        self.before = dict(self.now)
        self.speed = self._zero.copy()  # of the hand, which moves in continuous time
        self._late = [self._zero] * int(scene.device.delay)
        self._tensions = {name: tension_of(link, scene.rate) for name, link in scene.links.items()}

    def push(self, name: str, speed: Floats) -> None:
        """Makes a point move at these speeds, m/s."""
        if name == "hand":
            self.speed = speed.copy()
        self.before[name] = self.now[name] - speed * self._period

    def _distance(self, link: Link, of: str = "now") -> Floats:
        first, second = link.between
        return np.asarray(getattr(self, of)[first] - getattr(self, of)[second])

    def _pull(self, name: str, link: Link) -> Floats:
        d, growth = self._distance(link), self._distance(link) - self._distance(link, "before")
        if name in self._fixed:
            stiffness, damping = self._fixed[name]
            return stiffness * d + damping * growth / self._period
        if self._fixed and isinstance(link, Nonlinear) and link.force_over_velocity:
            (slow, low), *_, (fast, high) = link.force_over_velocity  # without bounds: a small motion is to grow
            return np.asarray((high - low) / (fast - slow) * growth / self._period)
        return np.asarray(self._tensions[name](d, growth))

    def step(self) -> None:
        """One sample."""
        forces = dict.fromkeys(self.now, self._zero)
        for name, link in self._scene.links.items():
            pull = self._pull(name, link)
            first, second = link.between
            forces[first], forces[second] = forces[first] - pull, forces[second] + pull
        after = dict(self.now)
        for name, point in self._scene.material_points.items():
            moved = self.now[name] - self.before[name]
            if (held := point.held_by()) is not None:
                own = held.stiffness * (self.now[name] - held.rest) + held.damping * moved / self._period
                forces[name] = forces[name] - own
            after[name] = self.now[name] + moved + forces[name] / point.mass * self._period**2
        force, device = forces["hand"], self._scene.device
        if not self._fixed:
            force = np.clip(force, -device.force_limit, device.force_limit)
        self._late.append(force + self._held)
        mass, friction = device.masses(1)[0], device.frictions(1)[0]
        fast = np.exp(-friction / mass * self._period)
        settled = self._late.pop(0) / friction
        way = (1.0 - fast) * mass / friction
        after["hand"] = self.now["hand"] + settled * self._period + (self.speed - settled) * way
        self.speed = settled + (self.speed - settled) * fast
        self.before, self.now = self.now, after

    def energy(self) -> Floats:
        """J, that the motions have."""
        points = self._scene.material_points.items()
        moved = [one.mass * ((self.now[name] - self.before[name]) / self._period) ** 2 for name, one in points]
        return np.asarray(0.5 * sum(moved) + 0.5 * self._scene.device.masses(1)[0] * self.speed**2)

    def most_energy(self, samples: int) -> Floats:
        """Returns the largest energy over that many samples, J."""
        most = self.energy()
        for _ in range(samples):
            self.step()
            most = np.maximum(most, self.energy())
        return most


def begun(scene: Scene, chance: np.random.Generator, runs: int, fixed: Fixed | None = None) -> Motion:
    """The scene where it begins but for a hand that is anywhere within 2 cm, pushed at random; `fixed`: by little."""
    places = {name: np.full(runs, point.start()[0]) for name, point in scene.material_points.items()}
    places["hand"] = chance.uniform(-0.02, 0.02, runs)
    if fixed is not None:
        places = {name: np.zeros(runs) for name in places}
        scene = _at_zero(scene)
    motion = Motion(scene, places, fixed)
    for name in places:
        motion.push(name, (1e-3 if fixed else 0.3) * chance.uniform(-1.0, 1.0, runs))
    return motion


def _at_zero(scene: Scene) -> Scene:
    """The scene with all cells at rest at 0: within a state only what moves about a rest matters."""
    cells = {name: one for name, one in scene.modules.items() if getattr(one, "rest", None) is not None}
    moved = {name: one.model_copy(update={"rest": 0.0, "position": 0.0}) for name, one in cells.items()}
    return scene.model_copy(update={"modules": type(scene.modules)({**scene.modules, **moved})})


def growths_within(scene: Scene, states: Sequence[State], samples: int, runs: int = 5) -> list[float]:
    """Returns the growth per sample of a motion within each of these states, from the energies of some runs."""
    linear = {name: [state[name].linear for state in states] for name in states[0]} if states else {}
    fixed = {
        name: (np.repeat([one.stiffness for one in every], runs), np.repeat([one.damping for one in every], runs))
        for name, every in linear.items()
    }
    motion = begun(scene, np.random.default_rng(0), runs * len(states), fixed)
    with np.errstate(all="ignore"):
        motion.most_energy(samples // 2)
        early = motion.most_energy(samples // 10)
        motion.most_energy(samples - samples // 5)
        late = motion.most_energy(samples // 10)
        grown = (late / early) ** (0.5 / (samples - samples // 10))
    return [float(most) for most in grown.reshape(len(states), runs).max(axis=1)]


def judged_unstable(prediction: Prediction, state: State) -> bool:
    """Returns whether the prediction reports growth in this state."""
    how = {f"{name} is {option.state}" for name, option in state.items()}
    return any({*one.state.split(", ")} <= how for one in prediction.states.growing)


def unsnapped_states(prediction: Prediction, most: int = 6) -> list[State]:
    """States of the whole scene, of each part one, that no snap leaves: these many at most."""
    every = itertools.product(*prediction.states.parts)
    whole = ({name: option for one in states for name, option in one.items()} for states in every)
    held = (state for state in whole if all(option.linear.stiffness >= 0.0 for option in state.values()))
    return list(itertools.islice(held, most))
