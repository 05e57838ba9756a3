"""A proxy in the theory, beside a loop written out here: a hand with two resonances, delayed force, coupling, a proxy
with an implicit step, and a mass of the scene with an explicit one."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import nnls

from hapsim.theory import Configuration, Network, margins_of
from hapsim.theory.coupling import Coupling, stiffest_coupling
from hapsim.theory.interface import damper_named
from hapsim.theory.network import SURELY, poles_of
from hapsim.theory.network.modes import snap_to_rest
from hapsim.theory.network.scene_passivity import HeldScene, Passivity, passivity_of
from hapsim.theory.rows import cut
from hapsim.theory.sample import loop, sizes_of
from tests import thorough

T = 1e-3
BACKWARD, CENTRED = (damper_named(name, None, 1.0 / T) for name in ("backward", "centred"))


def late(delay: float, hold: str = "zoh") -> Configuration:
    """Returns a device of 1 N·s/m."""
    return Configuration(1.0, 1.0 / T, 1.0, delay, hold)


class Hand(NamedTuple):
    """The device's mass and friction, a spring, and masses each on a spring of its own (kg, N/m)."""

    mass: float
    stiffness: float
    friction: float
    beside: tuple[tuple[float, float], ...] = ()


class Behind(NamedTuple):
    """A proxy on a spring and a damper to a ground, and an explicit mass between two springs: to the proxy, with a
    damper, and to a ground; of 0 kg: none."""

    proxy: float
    K: float = 0.0
    B: float = 0.0
    mass: float = 0.0
    k: float = 0.0
    b: float = 0.0
    held: float = 0.0


def radius(hand: Hand, coupling: Coupling, scene: Behind, delay: int) -> float:
    """Spectral radius of the whole loop."""
    (Kc, Bc), n = coupling, 1 + len(hand.beside)
    springs = np.diag([hand.stiffness, *(k for _, k in hand.beside)])
    for i, (_, k) in enumerate(hand.beside, 1):
        springs[0, 0] += k
        springs[0, i] = springs[i, 0] = -k
    rates = np.zeros((2 * n + 1, 2 * n + 1))
    rates[:n, n : 2 * n] = np.eye(n)
    rates[n : 2 * n, :n] = -springs / np.array([hand.mass, *(m for m, _ in hand.beside)])[:, None]
    rates[n, n], rates[n, 2 * n] = -hand.friction / hand.mass, 1.0 / hand.mass
    moved = expm(rates * T)
    unit = np.eye(2 * n + delay + 5)
    x, (x1, y1, y2, e, e1), late = unit[0], unit[2 * n + delay :], unit[2 * n : 2 * n + delay]
    inertia = scene.proxy / T**2
    total = Kc + Bc / T + inertia + scene.K + scene.B / T + scene.k + scene.b / T
    pushed = (Kc + Bc / T) * x - Bc / T * x1 + (Bc + scene.B + scene.b) / T * y1 + inertia * (2.0 * y1 - y2)
    y = (pushed + scene.k * e + scene.b / T * (e - e1)) / total
    force = -(Kc * (x - y) + Bc / T * (x - x1 - y + y1))
    acting = late[-1] if delay else force
    rows = [moved[i, : 2 * n] @ unit[: 2 * n] + moved[i, 2 * n] * acting for i in range(2 * n)]
    rows += [force, *late[:-1]] if delay else []
    pulled = scene.k * (y - e) + scene.b / T * (y - y1 - e + e1) - scene.held * e
    steps = [2.0 * e - e1 + T**2 / scene.mass * pulled, e] if scene.mass else [0.0 * e, 0.0 * e]
    return float(np.max(np.abs(np.linalg.eigvals(np.array([*rows, x, y, y1, *steps])))))


def network(hand: Hand, coupling: Coupling, scene: Behind, delay: int, **more: Any) -> Network:
    """The same loop in the theory, of a hand with nothing beside it."""
    ends, springs, dampers = [[0, 1], [1, -1]], [coupling.stiffness, scene.K], [coupling.damping, scene.B]
    masses = [scene.proxy]
    if scene.mass:
        ends, masses = [*ends, [1, 2], [2, -1]], [*masses, scene.mass]
        springs, dampers = [*springs, scene.k, scene.held], [*dampers, scene.b, 0.0]
    own = {"channel_stiffness": [hand.stiffness], "implicit": [True, False][: len(masses)]}
    device = [hand.mass], [hand.friction], delay, "zoh", "ideal"
    return Network(1.0 / T, *device, masses, ends, springs, dampers, **(own | more))  # type: ignore[arg-type]


def theory_radius(*of: Any) -> float:
    loop = network(*of)
    return float(np.max(np.abs(snap_to_rest(loop, poles_of(loop)))))


def random_hand(rng: np.random.Generator, friction: float) -> Hand:
    return Hand(10 ** rng.uniform(-5.5, 1.0), 0.0 if rng.random() < 0.3 else 10 ** rng.uniform(0.0, 6.5), friction)


def random_scene(rng: np.random.Generator, has_mass: bool) -> Behind:
    proxy, K, B = (
        10 ** rng.uniform(-5.0, 1.0),
        *(0.0 if rng.random() < 0.4 else 10 ** rng.uniform(*ends) for ends in ((0.0, 6.0), (-2.0, 3.0))),
    )
    if not has_mass:
        return Behind(proxy, K, B)
    mass = 10 ** rng.uniform(-3.0, 0.0)
    # Springs and a damper that leave the mass stable by itself.
    k, held = (mass / T**2 * 10 ** rng.uniform(-4.0, -0.7) for _ in range(2))
    return Behind(proxy, K, B, mass, k, mass / T * 10 ** rng.uniform(-3.0, -0.7), held)


@pytest.mark.parametrize("delay", range(4))
@pytest.mark.parametrize("has_mass", [False, True])
def test_the_poles_are_those_of_the_loop_written_out(delay: int, has_mass: bool) -> None:
    rng, coupling = np.random.default_rng(delay), stiffest_coupling(late(1))
    for _ in range(100):
        hand, scene = random_hand(rng, 0.3), random_scene(rng, has_mass)
        written = radius(hand, coupling, scene, delay)
        assert float(np.abs(poles_of(network(hand, coupling, scene, delay))).max()) == pytest.approx(written, rel=2e-7)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("delay", range(3))
def test_no_hand_shakes_a_proxy_with_the_friction_of_its_coupling(delay: int) -> None:
    rng, coupling = np.random.default_rng(delay), stiffest_coupling(late(delay))
    each = ((random_hand(rng, 1.001), random_scene(rng, False)) for _ in range(300))
    assert max(theory_radius(hand, coupling, scene, delay) for hand, scene in each) < SURELY


def of_the_scene(coupling: Coupling, scene: Behind, delay: int) -> tuple[HeldScene, Passivity]:
    held = HeldScene(network(Hand(1.0, 0.0, 1.0), coupling, scene, delay))
    return held, passivity_of(held)


def shakers(held: HeldScene, passivity: Passivity, delay: int) -> list[Hand]:
    """Hands without losses but the friction that the scene needs, at whose frequency their reactance X is the one that
    asks for it; at the images of that frequency it is -X, X and so on. Those that come closest, with one mass or two
    beside the device's own."""
    theta = 2.0 * math.pi * passivity.frequency_hz * T
    z = np.exp(1j * theta)
    rendered = held.forces(np.array([z - 1.0]))[0, 0, 0] * T / (1.0 - 1.0 / z)
    asked = complex(-rendered * np.exp(-1j * (1 + delay) * theta))
    image = np.array([theta, 2.0 * math.pi - theta, 2.0 * math.pi + theta, 4.0 * math.pi - theta]) / T
    found = []
    for count, first, second in itertools.product((2, 3, 4), np.linspace(0.02, 0.98, 25), np.linspace(0.02, 0.98, 9)):
        at = image[:count]
        gaps = ((0, 1), (2, 3)) if asked.imag > 0.0 else ((1, 2), (3, 3))
        poles = [image[a] + share * (image[b] - image[a] or image[b]) for share, (a, b) in zip((first, second), gaps)]  # noqa: B905
        parts = np.array([at, -1.0 / at, *(at * pole**2 / (pole**2 - at**2) for pole in poles)]).T
        weight = np.array([1.0, 0.4, 0.3, 0.2])[:count]
        parts, wanted = parts * weight[:, None], asked.imag * np.array([1.0, -1.0, 1.0, -1.0])[:count] * weight
        size = np.abs(parts).max(axis=0)
        amounts, off = nnls(parts / size, wanted)
        mass, stiffness, *masses = (amounts / size).tolist()
        beside = tuple((m, m * pole**2) for m, pole in zip(masses, poles, strict=True) if m > 1e-9)
        found.append((off, Hand(1e-7 + mass, stiffness, asked.real, beside)))
    return [hand for _, hand in sorted(found, key=lambda one: one[0])[:60]]


SCENES = {
    "a free proxy of 20 g": Behind(0.02),
    "a free proxy of 1 g": Behind(0.001),
    "a proxy on a spring and a damper": Behind(0.02, 500.0, 1.0),
    "a mass behind": Behind(0.02, 0.0, 0.0, 0.05, 2000.0, 1.0, 0.0),
    "a mass behind, which is held": Behind(0.02, 0.0, 0.0, 0.05, 2000.0, 1.0, 300.0),
    "a light proxy and a mass": Behind(0.001, 0.0, 0.0, 0.02, 5000.0, 1.0, 0.0),
}


@pytest.mark.parametrize("delay", [1, 2])
@pytest.mark.parametrize("name", SCENES)
def test_a_hand_with_two_resonances_needs_all_of_the_friction_of_a_scene(name: str, delay: int, figures: Any) -> None:
    coupling, scene = stiffest_coupling(late(delay)), SCENES[name]
    held, passivity = of_the_scene(coupling, scene, delay)
    hands = shakers(held, passivity, delay)

    def worst(share: float) -> float:
        return max(radius(one._replace(friction=share * passivity.friction), coupling, scene, delay) for one in hands)

    assert worst(1.001) < SURELY
    assert worst(0.95) > 1.0003
    figures.note(f"{name}, delay {delay}: needs {passivity.friction:.4f} of b0; at 0.95 of it {worst(0.95):.4f}-fold")


def test_no_hand_shakes_a_scene_with_explicit_masses_and_the_friction_that_it_needs() -> None:
    rng, judged, scenes = np.random.default_rng(5), 0, thorough.points(20, 60)
    for _ in range(scenes):
        delay = int(rng.integers(0, 3))
        coupling, scene = stiffest_coupling(late(delay)), random_scene(rng, True)
        _, passivity = of_the_scene(coupling, scene, delay)
        if not math.isfinite(passivity.friction):
            continue
        friction = 1.001 * max(passivity.friction, 1e-3)
        judged += 1
        assert max(theory_radius(random_hand(rng, friction), coupling, scene, delay) for _ in range(10)) < SURELY
    assert judged == scenes


def test_margins_are_where_stability_ends() -> None:
    hand, coupling = Hand(0.2, 0.0, 1.0), stiffest_coupling(late(1))
    scene = Behind(0.02, 0.0, 0.0, 0.05, 500.0, 1.0, 300.0)
    found = margins_of(network(hand, coupling, scene, 1))
    assert found.method.startswith("searched")
    factor = found.links[3].stiffness_factor
    assert 1.0 < factor < 1e4
    for share, is_stable in ((0.999, True), (1.001, False)):
        changed = scene._replace(held=share * factor * scene.held)
        assert (radius(hand, coupling, changed, 1) < 1.0) == is_stable


def test_sparse_rows_are_those_of_the_matrix() -> None:
    scene = network(Hand(0.2, 0.0, 1.0), stiffest_coupling(late(1)), SCENES["a mass behind, which is held"], 1)
    dense, sparse = (loop(scene, inputs=True, sparse=kind) for kind in (False, True))
    np.testing.assert_allclose(sparse.change.toarray(), dense.change, rtol=0, atol=1e-15)
    np.testing.assert_allclose(sparse.push.toarray(), dense.push, rtol=0, atol=1e-15)


def test_a_push_on_a_proxy_moves_it_in_the_same_sample() -> None:
    coupling = stiffest_coupling(late(1))
    scene = network(Hand(0.2, 0.0, 1.0), coupling, Behind(0.02, 500.0, 1.0), 1)
    moved = cut(loop(scene, inputs=True).push[:, 1:], sizes_of(scene))
    held = coupling.stiffness + coupling.damping / T
    way = 1.0 / (0.02 / T**2 + held + 500.0 + 1.0 / T)
    assert moved["mass_step"].item() == pytest.approx(way, rel=1e-12)
    assert moved["mass"].item() == pytest.approx(2.0 * way, rel=1e-12)  # where it would coast
    assert moved["held"].item() == pytest.approx(held * way * T**2 / 0.2, rel=1e-12)


@pytest.mark.parametrize(
    "changed",
    [
        {"implicit": [True, True]},
        {"damper": (BACKWARD, BACKWARD, CENTRED, BACKWARD)},
        {"substeps": 2},
        {"scheme": "midpoint"},
    ],
    ids=["two joined", "a damper with a memory", "substeps", "another scheme"],
)
def test_what_an_implicit_step_cannot_do_is_refused(changed: dict[str, Any]) -> None:
    arguments = Hand(0.2, 0.0, 1.0), Coupling(700.0, 0.3), SCENES["a mass behind, which is held"], 1
    network(*arguments, damper=(*[BACKWARD] * 3, CENTRED))
    with pytest.raises(ValueError, match="implicit masses take no link between two"):
        network(*arguments, **changed)
