"""Random scenes whose hands move masses or each other, and a referee of their pairs: the hands' simulated answers to
impulses beside those of M x'' + b x' + k x = 0."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy
import yaml
from numpy.typing import NDArray

from hapsim import predict
from hapsim.prediction import Part
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene
from hapsim.theory.network import SURELY, FeltPair, felt_pair

Floats = NDArray[np.float64]

FAMILIES = ("usual", "chain", "two hands", "three hands", "nearly rigid", "drifting")
WITHIN, SMALL = 0.1, 0.01  # of the largest answer: what is off by less agrees, what is smaller is not compared
VELOCITY, COUNT, FORCE = 1e-3, 1e-11, 10.0  # of a struck hand, m/s; of the mock, m; its limit, N
LONGEST = 27.0  # s


def pair_scene(seed: int) -> Scene:
    """One of the ``FAMILIES`` in turn. Masses differ by up to a thousand, frictions by up to two hundred."""
    draw, family = np.random.default_rng(seed), FAMILIES[seed % len(FAMILIES)]

    def size(low: float, high: float) -> float:
        return float(10.0 ** draw.uniform(low, high))

    def link(first: str, second: str, stiff: tuple[float, float] = (1.3, 3.6)) -> dict[str, Any]:
        k, b = size(*stiff), size(-2.0, 0.8)
        return {"type": "viscoelastic", "between": [first, second], "stiffness": k, "damping": b}

    is_rigid, hands = (
        family == "nearly rigid",
        ["hand", "right", "third"][: {"two hands": 2, "three hands": 3}.get(family, 1)],
    )
    modules: dict[str, Any] = {name: {"type": "device", "channel": i} for i, name in enumerate(hands)}
    masses = [
        f"m{i}" for i in range(int(draw.integers(3, 9) if family == "chain" else draw.integers(len(hands) == 1, 4)))
    ]
    for name in masses:
        light = is_rigid and draw.random() < 0.7
        modules[name] = {"type": "mass", "mass": size(-3.0, -1.5) if light else size(-2.3, 0.5)}
    points = [*hands, *masses] if draw.random() < 0.5 else [hands[0], *masses, *hands[1:]]
    for first, second in pairwise(points):
        modules[f"{first}_{second}"] = link(first, second, (3.0, 4.3) if is_rigid else (1.3, 3.6))
    if family != "drifting":
        modules["wall"] = {"type": "ground"}
        held = [name for name in points if draw.random() < (0.3 if is_rigid else 0.45)]
        modules |= {f"{name}_hold": link(name, "wall") for name in held or points[-1:] * (family == "chain")}
    device = {"clock": "lockstep", "force_limit": FORCE, "delay": float(draw.choice([0.0, 0.5, 1.0, 2.0]))}
    device |= {"mass": [size(-1.7, 0.0) for _ in hands], "friction": [size(-1.0, 1.3) for _ in hands]}
    device |= {"hold": str(draw.choice(["zoh", "zoh", "impulse"]))}
    document = {"version": 1, "rate": float(draw.choice([1000, 2000, 5000])), "device": device, "modules": modules}
    document |= {"substeps": int(draw.choice([1, 1, 3]))}
    return parse_scene(yaml.safe_dump(document, sort_keys=False), f"pair {seed}")


def flicked(scene: Scene, hands: int, struck: int) -> Scene:
    """The scene with one hand that starts at ``VELOCITY``."""
    mock = {"quantum": COUNT, "initial": {"velocity": [VELOCITY * (hand == struck) for hand in range(hands)]}}
    return parse_scene(yaml.safe_dump(scene.model_dump(mode="json", exclude_none=True) | {"mock": mock}))


def answers(scene: Scene, hands: int, struck: int) -> Floats:
    """Positions (samples, hands), m, after a flick of one hand, until all are small."""
    duration = 1.0
    while True:
        found = run_in_memory(flicked(scene, hands, struck), duration=duration).position[:, :hands]
        sizes = np.abs(found).max(axis=1)
        end = 1 + int(np.flatnonzero(sizes > SMALL * sizes.max())[-1])
        if end < 0.9 * len(found) or duration >= LONGEST:
            return np.asarray(found[:end])
        duration *= 3.0


def of_pair(scene: Scene, k: Floats, b: Floats, struck: int, samples: int) -> Floats:
    """The same positions of hands on this pair, whatever its eigenvectors."""
    hands = len(k)
    mass = np.array(scene.device.masses(hands))[:, None]
    change = np.block([[np.zeros((hands, hands)), np.eye(hands)], [-k / mass, -b / mass]])
    step = scipy.linalg.expm(change / scene.rate)
    found = VELOCITY * np.eye(2 * hands)[[hands + struck]]
    while len(found) < samples:
        found, step = np.concatenate([found, found @ step.T]), step @ step
    return np.asarray(found[:samples, :hands])


@np.errstate(all="ignore")
def off_by(scene: Scene, k: Floats, b: Floats) -> float:
    """Largest difference of a hand's positions from the pair's, rms, of the largest position after that flick."""
    worst = 0.0
    for struck in range(len(k)):
        seen = answers(scene, len(k), struck)
        off = np.nan_to_num(seen - of_pair(scene, k, b, struck, len(seen)), nan=1e9)
        worst = max(worst, float(np.sqrt((off**2).mean(axis=0).max()) / np.abs(seen).max()))
    return worst


class Judged(NamedTuple):
    """One scene that does not grow."""

    scene: Scene
    part: Part
    pair: FeltPair
    """Pair that the motions give, whether it is stated or not."""
    off: float
    """Difference of the simulated positions from its own; infinite if there is none."""

    @property
    def result(self) -> str:
        """Word for the part: none, right, false or lost."""
        is_right = self.off <= WITHIN
        return ("lost" if is_right else "none") if self.part.felt.reason else "right" if is_right else "false"


def judged(seed: int) -> Judged | None:
    """None of a scene that is unstable, or whose hand is alone."""
    scene = pair_scene(seed)
    prediction = predict(scene, with_margins=False)
    part = prediction.parts[0]
    if part.alone is not None or prediction.spectral_radius > SURELY:
        return None
    pair = felt_pair(part.network, most=math.inf)
    return Judged(scene, part, pair, math.inf if pair.reason else off_by(scene, pair.k, pair.b))
