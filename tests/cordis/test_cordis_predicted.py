"""Theory of a scene under each scheme against the tick itself: the whole transition, number by number."""

from __future__ import annotations

import json
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, positions_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.prediction.linear import linear_scene, network_of
from hapsim.running.compile_ahead import scenes_with_every_module
from hapsim.scene import DamperScheme, Scene, ViscoElastic, parse_scene
from hapsim.scene.choices import WITH_CUTOFF, WITH_SENSOR
from hapsim.theory import Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network.network import BACKWARD, inner_links, is_memoryless
from hapsim.theory.rows import cut
from hapsim.theory.sample import Sample
from hapsim.theory.schemes import SCHEMES as THEORY
from tests.transitions import transition

RATE = 1000.0
T = 1.0 / RATE
MASSES = 4
DELAY = 0.37
HAND = (0.2, 1.0, 400.0)  # kg, N·s/m, N/m


def link(between: tuple[str, str], stiffness: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": between, "stiffness": stiffness, "damping": damping, **more}


Steps = tuple[int, str]
"""Steps per sample period, and the requested force."""


@cache
def scene_of(scheme: str, seed: int, steps: Steps = (1, "last")) -> Scene:
    """A hand and four masses with links of every kind that is linear."""
    random = np.random.default_rng(seed)
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules |= {f"m{i}": {"type": "mass", "mass": float(random.uniform(0.02, 0.2))} for i in range(MASSES)}
    joins = [("m0", "wall"), ("m0", "m1"), ("m2", "m1"), ("m3", "m0"), ("hand", "m1"), ("m2", "hand"), ("hand", "m3")]
    dampers = sorted(get_args(DamperScheme), key=lambda name: name in WITH_SENSOR)
    if steps[0] > 1:
        dampers.remove("centred")  # refused there
    how = [{"damper": name} | ({"cutoff": 90.0} if name in WITH_CUTOFF else {}) for name in dampers]
    for i in range(18):
        between = joins[i % len(joins)]
        k, b = float(random.uniform(50.0, 900.0)), float(random.uniform(0.1, 1.5))
        if i < 12:
            kind = int(random.integers(len(how) - (0 if "hand" in between else len(WITH_SENSOR))))
            modules[f"l{i}"] = link(between, k, b, **how[kind])
        elif i < 14:
            modules[f"l{i}"] = {"type": "buffer", "between": between, "stiffness": k, "damping": b, "distance": 1.0}
        elif i < 16:
            curves = {"force_over_distance": [[-9.0, -9.0 * k], [9.0, 9.0 * k]]}
            curves |= {"force_over_velocity": [[-9e3, -9e3 * b], [9e3, 9e3 * b]]}
            modules[f"l{i}"] = {"type": "nonlinear", "between": between, **curves}
        else:
            one = {"type": "spring", "stiffness": k} if i == 16 else {"type": "damper", "damping": b}
            modules[f"l{i}"] = {"between": between, **one}
    modules["held"] = {"type": "cell", "mass": 0.05, "stiffness": 800.0, "damping": 0.3}
    modules["skin"] = link(("held", "m2"), 100.0, 0.1)
    device = {"mass": HAND[0], "friction": HAND[1], "stiffness": HAND[2], "delay": DELAY}
    document = {"version": 1, "rate": RATE, "scheme": scheme, "device": device, "modules": modules}
    if steps[0] > 1:
        document |= {"substeps": steps[0]}
        device |= {"decimation": steps[1]}
    return parse_scene(json.dumps(document))


def network_in(scene: Scene) -> Network:
    return network_of(scene, linear_scene(scene))[0]


def state_of(sample: Sample, reduced: np.ndarray) -> np.ndarray:
    """The theory's state of x, x before and the hand's velocity times T, with dampers that remember what the kernel's
    do as they begin: that the hand has rested, and everything else moved as it does."""
    points = reduced.size // 2
    now, way, velocity = reduced[:points], reduced[:points] - reduced[points:-1], reduced[-1:]
    mass_step = way[1:] / sample.network.substeps
    moved = sample.tick.stretches @ np.append(0.0, mass_step)
    parts = {"position": now[:1], "mass": now[1:], "velocity": velocity, "last_step": way[:1], "mass_step": mass_step}
    parts |= {"sensed_change": velocity, "held": np.zeros(sample.sizes["held"])}
    for name, lists in (("old_steps", sample.tick.old_steps), ("old_rates", sample.tick.old_rates)):
        parts[name] = np.concatenate([np.zeros(0), *(moved[links] for links in lists)])
    return np.concatenate([parts[name] for name, size in sample.sizes.items() if size])


def played(sample: Sample, state: np.ndarray) -> tuple[float, np.ndarray]:
    """The force on the hand, and the state at the next sample: the rows of the theory as one column of numbers."""
    parts = cut(state[:, None], sample.sizes)
    begun = sample.start(parts)
    step = begun
    for _ in range(sample.network.substeps):
        more = sample.tick.step(step)
        step = {name: step[name] + more[name] for name in step}
    moved = {name: step[name] - begun[name] for name in step}
    return float(moved["force"][0, 0]), state + sample.state_change(parts, moved)[:, 0]


def ticked(scheme: str, seed: int, reduced: np.ndarray, steps: Steps) -> np.ndarray:
    """Force on the hand, positions and positions before at the next sample, by one tick from a state."""
    points = (reduced.size - 1) // 2
    x, before = reduced[:points], reduced[points : 2 * points]
    scene = scene_of(scheme, seed, steps)
    modules, moved = dict(scene.modules), (*(f"m{i}" for i in range(MASSES)), "held")  # the cell begins at rest
    for name, at, way in zip(moved, x[1:].tolist(), (x - before)[1:].tolist(), strict=True):
        modules[name] = modules[name].model_copy(update={"position": at, "velocity": RATE * way})
    program = compile_scene(scene.model_copy(update={"modules": modules}))
    start(program, before[:1])
    force, forces = np.zeros(1), []
    for share in np.arange(1, steps[0] + 1) / steps[0]:
        tick(program, before[:1] + share * (x - before)[:1], np.array([share * RATE * reduced[-1]]), force)
        forces.append(force[0])
    force[0] = forces[-1] if steps[1] == "last" else np.mean(forces)
    now, previous = positions_of(program)
    return np.concatenate([force, now[2:], previous[2:]])


def hand_step(delay: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(2, 2), (2,), (2,): x and T v of the hand at the next sample, of x and T v, the force before and the force."""
    mass, friction, stiffness = HAND
    rate = T * np.array([[0.0, 1.0, 0.0], [-stiffness / mass, -friction / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    scale = np.diag([1.0, T])
    first, second = expm(rate * delay), expm(rate * (1.0 - delay))
    whole = scale @ (second[:2, :2] @ first[:2, :2]) @ np.linalg.inv(scale)
    return whole, scale @ second[:2, :2] @ first[:2, 2], scale @ second[:2, 2]


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize("steps", [(1, "last"), (5, "last"), (12, "mean")], ids=str)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_tick_is_the_transition_that_is_predicted(scheme: str, seed: int, steps: Steps) -> None:
    """Every linear link, between a hand, masses and what stays: of each number of the state, one after the other; and
    the theory's rows, on numbers, are the tick to a few digits of rounding."""
    network = network_in(scene_of(scheme, seed, steps))
    sample, matrix = Sample(network), transition(network)
    points = 1 + network.point_mass.size
    at_rest = ticked(scheme, seed, np.zeros(2 * points + 1), steps)
    motion, _, now = hand_step(DELAY)
    for unit in np.eye(2 * points + 1):
        reduced = 1e-3 * unit
        state = state_of(sample, reduced)
        asked, after = played(sample, state)
        found = ticked(scheme, seed, reduced, steps) - at_rest
        force, found = found[0], found[1:]
        size = np.abs(found).max(initial=1e-3)
        assert abs(asked - force) < 1e-11 * max(abs(force), 1.0)
        for expected in (matrix @ state, after):
            parts = cut(expected, sample.sizes)
            mass, step = parts["mass"], parts["mass_step"]
            np.testing.assert_allclose(found, [*mass, *(mass - step)], rtol=0.0, atol=1e-11 * size)
            hand = motion @ [reduced[0], reduced[-1]] + now * force
            moved = [parts["position"][0], parts["velocity"][0]]
            np.testing.assert_allclose(moved, hand, rtol=0.0, atol=1e-11 * size)


@pytest.mark.parametrize("scheme", [name for name, model in THEORY.items() if model])
def test_the_same_links_are_inside_as_in_the_kernel(scheme: str) -> None:
    scene = scene_of(scheme, 1)
    rubs = {"type": "friction", "between": ("m0", "wall"), "force": 1.0, "stiffness": 10.0}
    plucks = {"type": "plectrum", "between": ("m0", "m1"), "stiffness": 10.0, "release": 0.1}
    document = json.loads(scene.model_dump_json(exclude_none=True, exclude_defaults=True))
    types = {name: {"type": one.type} for name, one in scene.modules.items()}
    modules = {name: types[name] | one for name, one in document["modules"].items()} | {"rubs": rubs, "plucks": plucks}
    scene = parse_scene(json.dumps({"version": 1, **document, "modules": modules}))
    linear, network = linear_scene(scene), network_in(scene)
    names = list(linear.links)
    found = {names[link] for link in inner_links(network) if link < len(names)}
    in_matrices = inside(scene) if (inside := SCHEMES[scheme].inside) else set()
    assert found == (in_matrices or {*names} - remembering(scene)) & {*names}
    assert found < set(names)


def remembering(scene: Scene) -> set[str]:
    """The links for which the kernel keeps more than where points are."""
    return {name for part in compile_scene(scene).parts if part.memory for name in part.memory.modules} & {*scene.links}


def test_the_kernel_remembers_what_the_theory_states() -> None:
    scene = next(iter(scenes_with_every_module("double")))
    dampers = {
        name: damper_named(one.damper, one.cutoff, RATE) if isinstance(one, ViscoElastic) else BACKWARD
        for name, one in scene.links.items()
    }
    linear = {name: one.law().linear() for name, one in scene.links.items()}
    remember = {name for name, one in linear.items() if not (one.memoryless and is_memoryless(dampers[name]))}
    assert remembering(scene) == remember != set()
    in_a_matrix = {name for name, one in linear.items() if one.in_a_matrix}
    assert {scene.links[name].type for name in in_a_matrix} == {"viscoelastic", "spring", "damper"}
    assert all(dampers[name] == BACKWARD for name in in_a_matrix)
