"""A hand on a single link: its recurrence to the last bit, and not a bit of it changed by what else a scene has."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from hapsim.cordis.offline import follow_parameters, start, tick
from hapsim.cordis.program import compile_scene, numbers_of, parameter_values
from hapsim.scene import Scene

SAMPLES = 400
RATE, K, B = 1000.0, 800.0, 3.0
DISTANCE, RELEASE, FORCE, BRISTLE, BRISTLE_DAMPING, CUTOFF = 0.002, 0.004, 1.0, 3000.0, 1.0, 80.0
OVER_DISTANCE = [[-0.01, -3.0], [0.0, 0.0], [0.01, 5.0]]
OVER_VELOCITY = [[-0.1, -1.0], [0.1, 1.0]]
DAMPERS = ("backward", "centred", "filtered", "sensed")
LINKS: dict[str, dict[str, Any]] = {
    f"viscoelastic, {damper}": {"type": "viscoelastic", "stiffness": K, "damping": B, "damper": damper}
    | ({"cutoff": CUTOFF} if damper == "filtered" else {})
    for damper in DAMPERS
} | {
    "spring": {"type": "spring", "stiffness": K},
    "damper": {"type": "damper", "damping": B},
    "buffer": {"type": "buffer", "stiffness": K, "damping": B, "distance": DISTANCE},
    "friction": {"type": "friction", "force": FORCE, "stiffness": BRISTLE, "damping": BRISTLE_DAMPING},
    "plectrum": {"type": "plectrum", "stiffness": K, "damping": B, "release": RELEASE},
    "nonlinear": {"type": "nonlinear", "force_over_distance": OVER_DISTANCE, "force_over_velocity": OVER_VELOCITY},
}
REAL: dict[str, Any] = {"double": np.float64, "single": np.float32}
AMONG_OTHERS: dict[str, Any] = {
    "other": {"type": "device", "channel": 1},
    "ball": {"type": "mass", "mass": 0.1, "velocity": 0.3},
    "held": {"type": "cell", "mass": 0.1, "stiffness": 50.0},
    "s": {"type": "string", "masses": 20, "mass": 0.01, "stiffness": 100.0},
    "by_ball": {"type": "viscoelastic", "between": ["other", "ball"], "stiffness": 300.0, "damping": 1.0},
    "by_string": {"type": "spring", "between": ["other", "s.3"], "stiffness": 20.0},
    "stop": {"type": "buffer", "between": ["ball", "held"], "stiffness": 200.0},
}


def scene_of(name: str, precision: str, **more: Any) -> Scene:
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground", "position": 0.001},
        "link": {"between": ["hand", "wall"], **LINKS[name]},
    }
    keys = {"version": 1, "rate": RATE, "precision": precision, "device": {"mass": 0.2}}
    return Scene.model_validate({**keys, "modules": modules | more})


def hand_and_ground() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The hand trembles, at the speed that it has, at a ground that is moved four times: m, m/s, m."""
    rng = np.random.default_rng(7)
    hand = 0.003 * np.sin(0.05 * np.arange(SAMPLES)) + 1e-4 * rng.normal(size=SAMPLES)
    ground = np.full(SAMPLES, 0.001)
    for n, place in ((100, -0.002), (101, -0.0021), (250, 0.0015), (300, 0.0016)):
        ground[n:] = place
    return hand, RATE * np.diff(hand, prepend=hand[0]), ground


def played(scene: Scene) -> np.ndarray:
    """The force on the hand, sample by sample."""
    program, values = compile_scene(scene), parameter_values(scene)
    rest = int(np.flatnonzero(values == values.dtype.type(0.001))[0])
    hand, speed, ground = hand_and_ground()
    measured, velocity, force = np.zeros((3, scene.channels))
    measured[0] = hand[0]
    start(program, measured)
    forces = np.empty(SAMPLES)
    for n in range(SAMPLES):
        if ground[n] != ground[n - 1] and n > 0:
            values[rest] = ground[n]
            program.parameters.post(values, 1)
        measured[0], velocity[0] = hand[n], speed[n]
        measured[1:] = 0.01 * np.sin(0.03 * n)
        follow_parameters(program)
        tick(program, measured, velocity, force)
        forces[n] = force[0]
    return forces


class Stretch(NamedTuple):
    """By sample, in the precision of the scene: d, and by how much it grew in a sample; how far hand and ground went,
    the hand by its sensor. m."""

    d: np.ndarray
    growth: np.ndarray
    hand: np.ndarray
    ground: np.ndarray


def stretch_in(real: Any) -> Stretch:
    hand, speed, ground = (values.astype(real) for values in hand_and_ground())
    sensed = (real(1.0 / RATE) * hand_and_ground()[1]).astype(real)
    d = hand - ground
    before = np.concatenate([d[:1], d[:-1]])
    assert speed.dtype == d.dtype == before.dtype == real
    return Stretch(d, d - before, sensed, np.diff(ground, prepend=ground[0]))


# The recurrences: what pulls the ends together, sample by sample, every operation in the precision of the scene.


def viscoelastic(damper: str) -> Callable[[Stretch, Any], np.ndarray]:
    def tension(of: Stretch, real: Any) -> np.ndarray:
        return np.array([real(K) * d + real(B * RATE) * g for d, g in zip(of.d, grown(damper, of, real), strict=True)])

    return tension


def grown(damper: str, of: Stretch, real: Any) -> np.ndarray:
    """By how much d grows in a sample, as each damper has it."""
    if damper == "centred":
        return real(0.5) * (of.d - np.concatenate([of.d[:1], of.d[:1], of.d[:-2]]))
    if damper == "sensed":
        return of.hand - of.ground
    if damper == "filtered":
        kept, growth = real(np.exp(-2.0 * np.pi * CUTOFF / RATE)), [real(0)]
        for newest in of.growth:
            growth.append(newest + kept * (growth[-1] - newest))
        return np.array(growth[1:])
    return of.growth


def spring(of: Stretch, real: Any) -> np.ndarray:
    return real(K) * of.d


def damper(of: Stretch, real: Any) -> np.ndarray:
    return real(B * RATE) * of.growth


def buffer(of: Stretch, real: Any) -> np.ndarray:
    pushed = real(K) * (of.d - real(DISTANCE)) + real(B * RATE) * of.growth
    return np.where(of.d < real(DISTANCE), np.minimum(pushed, 0), 0)


def friction(of: Stretch, real: Any) -> np.ndarray:
    def slide() -> Iterator[Any]:
        stiffness, anchor, way = real(BRISTLE), of.d[0], real(0)
        for d, growth in zip(of.d, of.growth, strict=True):
            if way * growth < 0:
                way = real(0)
            bent = stiffness * (d - anchor)
            if way == 0 and abs(bent) > real(FORCE):
                way = np.sign(bent)
            tension = bent + real(BRISTLE_DAMPING * RATE) * growth
            if way != 0:
                tension = way * real(FORCE)
                anchor = d - tension / stiffness
            yield tension

    return np.array(list(slide()))


def plectrum(of: Stretch, real: Any) -> np.ndarray:
    def pluck() -> Iterator[Any]:
        side = real(0)
        for d, growth in zip(of.d, of.growth, strict=True):
            if side * d <= 0:
                side = np.sign(d) if abs(d) > real(RELEASE) else real(0)
            yield real(K) * d + real(B * RATE) * growth if side == 0 else real(0)

    return np.array(list(pluck()))


def curve(points: list[list[float]], unit: float, x: np.ndarray, real: Any) -> np.ndarray:
    """Straight between these points, whose abscissae are in `unit` metres, and level beyond."""
    at, tension = (np.array(points) * [unit, 1.0]).astype(real).T
    piece = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    share = (x - at[piece]) / (at[piece + 1] - at[piece])
    between = tension[piece] + share * (tension[piece + 1] - tension[piece])
    return np.where(x <= at[0], tension[0], np.where(x >= at[-1], tension[-1], between))


def nonlinear(of: Stretch, real: Any) -> np.ndarray:
    return curve(OVER_DISTANCE, 1.0, of.d, real) + curve(OVER_VELOCITY, 1.0 / RATE, of.growth, real)


RECURRENCES: dict[str, Callable[[Stretch, Any], np.ndarray]] = {
    **{f"viscoelastic, {damper}": viscoelastic(damper) for damper in DAMPERS},
    "spring": spring,
    "damper": damper,
    "buffer": buffer,
    "friction": friction,
    "plectrum": plectrum,
    "nonlinear": nonlinear,
}


@pytest.mark.parametrize("precision", REAL)
@pytest.mark.parametrize("name", LINKS)
def test_a_single_link_is_its_recurrence_to_the_last_bit(name: str, precision: str) -> None:
    """But for the visco-elastic link, where a product and the sum that it goes into may be rounded once instead of
    twice: each of its products is then off by half an epsilon of itself, and so is what a filter remembers of one, for
    as long as it does; the sum by half of one more."""
    real = REAL[precision]
    of, forces = stretch_in(real), played(scene_of(name, precision))
    tension = RECURRENCES[name](of, real)
    assert tension.dtype == real
    assert np.ptp(forces) > 0.1
    if not name.startswith("viscoelastic"):
        np.testing.assert_array_equal(forces, -tension)
        return
    growth = grown(name.partition(", ")[2], of, real)
    remembered = 1.0 / (1.0 - np.exp(-2.0 * np.pi * CUTOFF / RATE)) if "filtered" in name else 0.0
    sizes = K * np.abs(of.d) + B * RATE * (np.abs(growth) + 2.0 * remembered * np.max(np.abs(of.growth)))
    assert np.all(np.abs(forces + tension) <= 2.0 * np.finfo(real).eps * sizes)


@pytest.mark.parametrize("precision", REAL)
@pytest.mark.parametrize("name", LINKS)
def test_what_else_a_scene_has_changes_no_bit_of_a_link(name: str, precision: str) -> None:
    alone, among_others = scene_of(name, precision), scene_of(name, precision, **AMONG_OTHERS)
    np.testing.assert_array_equal(played(alone), played(among_others))


@pytest.mark.parametrize("name", LINKS)
def test_single_precision_is_worked_out_in_single_precision(name: str) -> None:
    double, single = (played(scene_of(name, precision)) for precision in REAL)
    assert not np.array_equal(double, single)
    np.testing.assert_array_equal(single, single.astype(np.float32))


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"ball": {"type": "mass", "mass": 0.1}},
        {"second": {"type": "spring", "between": ["hand", "wall"], "stiffness": 1.0}},
        {"other": {"type": "device", "channel": 1}},
    ],
)
def test_every_point_of_a_scene_has_a_force_in_memory(more: dict[str, Any]) -> None:
    scene = scene_of("spring", "double", **more)
    program = compile_scene(scene)
    assert program.force.size == program.rows.shape[1] == len(numbers_of(scene)) == 2 + len(more) - ("second" in more)
