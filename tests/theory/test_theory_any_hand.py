"""Stability of a scene in any hand, against continuous chains of masses, springs and dampers, moved exactly, and
against the condition of a lone wall."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from hapsim.errors import UsageError
from hapsim.prediction.any_hand import AnyHand
from hapsim.theory import Configuration, Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network import poles_of
from hapsim.theory.network.impedance import loop_impedance
from hapsim.theory.network.scene_passivity import HeldScene, passivity_of
from tests import thorough
from tests.networks import network_of as network

SEEDS = range(thorough.points(1, 4))
RATE = 1000.0
Floats = NDArray[np.float64]


def random_network(rng: np.random.Generator, hands: int = 1, **more: Any) -> Network:
    """Up to eleven masses, each tied to an earlier point, some to grounds."""
    masses = int(rng.integers(0, 12))
    points = hands + masses
    ends = [[int(rng.integers(0, point)), point] for point in range(1, points)] + [[int(rng.integers(0, points)), -1]]
    ends += [[int(rng.integers(0, points)), -1] for _ in range(int(rng.integers(0, 3)))]
    given = {
        "channel_mass": 10.0 ** rng.uniform(-1.3, 0.3, hands),
        "channel_friction": 10.0 ** rng.uniform(-1.0, 0.5, hands),
        "delay": float(rng.choice([0.0, 0.5, 1.0, 1.3, 2.0])),
        "hold": str(rng.choice(["zoh", "zoh", "ramp"])),
        "point_mass": 10.0 ** rng.uniform(-1.5, 0.7, masses),
        "ends": ends,
        "stiffness": 10.0 ** rng.uniform(1.0, 4.0, len(ends)),
        "damping": 10.0 ** rng.uniform(-2.0, 1.0, len(ends)),
    }
    return network(**given | more)


def whole(of: Network) -> AnyHand:
    """Returns a network as one part whose points all belong together."""
    hands, masses = of.channel_mass.size, of.point_mass.size
    names = tuple(f"hand_{i}" for i in range(hands))
    return AnyHand(names, tuple(range(hands)), of, (*names, *(f"mass_{i}.x" for i in range(masses))))


def with_friction(one: AnyHand, friction: Any) -> AnyHand:
    return replace(one, _network=replace(one._network, channel_friction=friction))


class Chain:
    """Chain on one device point: masses (n,) kg, the device's own and the hand's first. Springs and dampers (n, n) join
    each pair of points, and on the diagonal a point and a fixed place."""

    def __init__(self, mass: Floats, stiffness: Floats, damping: Floats, friction: float) -> None:
        n = mass.size
        K, B = (np.diag(of.sum(axis=1)) - of + np.diag(np.diag(of)) for of in (stiffness, damping))
        B[0, 0] += friction
        self.n = n
        self.rates = np.block([[np.zeros((n, n)), np.eye(n)], [-K / mass[:, None], -B / mass[:, None]]])
        self.push = np.zeros(2 * n)
        self.push[n] = 1.0 / mass[0]
        self.read = np.eye(2 * n)[0]


def random_chain(rng: np.random.Generator, mass: float, friction: float) -> Chain:
    n = int(rng.integers(1, 6))
    masses = np.append(
        mass + (0.0 if rng.random() < 0.3 else 10.0 ** rng.uniform(-2, 1)), 10.0 ** rng.uniform(-3, 1, n - 1)
    )
    K, B = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            if i == j or i == j + 1 or rng.random() < 0.2:
                K[i, j] = K[j, i] = 10.0 ** rng.uniform(1, 6) * (i != j or rng.random() < 0.7)
                B[i, j] = B[j, i] = 10.0 ** rng.uniform(-3, 1) * (rng.random() < 0.5)
    return Chain(masses, K, B, friction)


def growth(of: Network, chains: list[Chain]) -> float:
    """The largest modulus of a pole of the sampled loop. The scene's masses by CORDIS's recurrence, written here; the
    chains exactly, with a constant force (hold ramp: one on a straight line) in both parts of a fractional delay."""
    hands, masses, delay = len(chains), of.point_mass.size, of.delay
    queue, fraction, ramps = math.floor(delay), delay - math.floor(delay), of.hold == "ramp"
    waits = queue + (fraction > 0.0) + ramps
    sizes = [2 * one.n for one in chains]
    size = sum(sizes) + hands + 2 * masses + hands * waits  # chains, last readings, masses now and before, forces sent
    at = np.concatenate([[0], np.cumsum(sizes), sum(sizes) + np.cumsum([hands, masses, masses])]).astype(int)
    rows = np.eye(size)
    x = np.stack([one.read @ rows[at[i] : at[i + 1]] for i, one in enumerate(chains)])
    x_before, y, y_before = (
        rows[at[hands] : at[hands + 1]],
        rows[at[hands + 1] : at[hands + 2]],
        rows[at[hands + 2] : at[hands + 3]],
    )
    now, before = (np.vstack([*parts, np.zeros((1, size))]) for parts in ((x, y), (x_before, y_before)))
    force = np.zeros((hands + masses + 1, size))
    for (a, b), K, B in zip(of.ends, of.stiffness, of.damping, strict=True):
        stretch, rate = now[a] - now[b], (now[a] - now[b] - before[a] + before[b]) * of.rate
        force[a] -= K * stretch + B * rate
        force[b] += K * stretch + B * rate
    after = np.zeros((size, size))
    after[at[hands] : at[hands + 1]] = x
    after[at[hands + 1] : at[hands + 2]] = 2 * y - y_before + force[hands:-1] / (of.point_mass[:, None] * of.rate**2)
    after[at[hands + 2] : at[hands + 3]] = y
    sent = [force[:hands], *(rows[size - hands * waits + i * hands :][:hands] for i in range(waits))]  # newest first
    if waits:
        after[size - hands * waits :] = np.vstack(sent[:-1])
    for i, one in enumerate(chains):
        state = rows[at[i] : at[i + 1]]
        last, new = (sent[min(queue + age, waits)][i] for age in (1, 0))
        spans = ((fraction, last, last), (1.0 - fraction, new, new))
        if ramps:
            begin = fraction * sent[waits][i] + (1.0 - fraction) * last
            spans = ((fraction, begin, last), (1.0 - fraction, last, fraction * last + (1.0 - fraction) * new))
        for span, begin, end in spans:
            both = np.zeros((2 * one.n + 2, 2 * one.n + 2))
            both[:-2, :-1] = np.hstack([one.rates, one.push[:, None]]) * span / of.rate
            both[-2, -1] = 1.0
            moved = expm(both)[:-2]
            state = moved[:, :-2] @ state + np.outer(moved[:, -2], begin) + np.outer(moved[:, -1], end - begin)
        after[at[i] : at[i + 1]] = state
    return float(np.abs(np.linalg.eigvals(after)).max())


def chain_of(masses: float, friction: float, stiffness: float = 0.0) -> Chain:
    return Chain(np.array([masses]), np.array([[stiffness]]), np.zeros((1, 1)), friction)


def grown(of: Network, mass: float = 0.0, stiffness: float = 0.0) -> float:
    """Returns the growth with a hand of one mass and spring."""
    chain = chain_of(of.channel_mass[0] + mass, of.channel_friction[0], stiffness)
    return growth(of, [chain])


def test_the_referee_s_loop_is_the_theory_s() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        of = random_network(rng)
        assert grown(of) == pytest.approx(np.abs(poles_of(of)).max(), abs=1e-9)


class TestTheFriction:
    @pytest.mark.parametrize("damper", ["backward", "centred", "filtered"])
    @pytest.mark.parametrize("hold", ["zoh", "ramp"])
    @pytest.mark.parametrize("delay", [0.0, 0.3, 0.5, 1.0, 1.7, 2.0])
    def test_of_a_lone_wall_is_that_of_its_formula(self, delay: float, hold: str, damper: str) -> None:
        rng = np.random.default_rng(1)
        cutoff = 100.0 if damper == "filtered" else None
        for _ in range(5):
            K, B = 10.0 ** rng.uniform(1.0, 4.0), 10.0 ** rng.uniform(-1.0, 1.3)
            wall = Configuration(0.2, RATE, friction=1.0, delay=delay, hold=hold, damper=damper, cutoff=cutoff)
            of = network(
                delay=delay, hold=hold, stiffness=[K], damping=[B], damper=[damper_named(damper, cutoff, RATE)]
            )
            formula = float(wall.needed_friction(K, B))
            # Each is the demand at some frequency: the larger one is closer to the least upper bound. The search begins
            # at 1e-6, where the demand is below its limit at 0 by the square.
            assert 1.0 - 2e-11 < passivity_of(HeldScene(of)).friction / formula < 1.0 + 1e-8

    @pytest.mark.parametrize(
        "more", [{}, {"substeps": 4}, {"substeps": 3, "decimation": "mean"}, {"scheme": "midpoint"}]
    )
    def test_is_of_the_forces_that_the_impedance_has_too(self, more: dict[str, Any]) -> None:
        rng = np.random.default_rng(2)
        hertz = np.array([1.0, 30.0, 120.0, 333.0])
        for hands in (1, 2, 3):
            of = random_network(rng, hands, delay=0.0, hold="zoh", **more)
            theta = 2.0 * np.pi * hertz / RATE
            held = HeldScene(of).forces(np.exp(1j * theta) - 1.0)
            through = (1.0 - np.exp(-1j * theta)) / (1j * theta) / (2j * np.pi * hertz)
            rendered = loop_impedance(of, hertz).rendered
            np.testing.assert_allclose(held * through[:, None, None], rendered, atol=1e-9 * np.abs(rendered).max())

    @pytest.mark.parametrize("seed", SEEDS)
    def test_suffices_in_any_hands(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        for hands in (1, 1, 2, 3):
            one = whole(random_network(rng, hands))
            if one.lasting:
                assert not np.isfinite(one.needed).any()
                continue
            of = replace(one._network, channel_friction=1.001 * one.needed)
            assert whole(of).is_passive
            for _ in range(25):
                chains = [random_chain(rng, *each) for each in zip(of.channel_mass, of.channel_friction, strict=True)]
                assert growth(of, chains) < 1.0 + 1e-9

    @pytest.mark.parametrize(("delay", "damping"), [(0.0, 5.0), (1.0, 10.0), (1.0, 0.5), (2.0, 1.0)])
    def test_is_no_more_than_a_hand_needs_that_moves_at_the_images_too(self, delay: float, damping: float) -> None:
        """A hand with a resonance at each of 2 N images: the share sum 1/sigma² of the bound, which goes to 1."""
        one = whole(network(delay=delay, damping=[damping], channel_friction=[100.0]))
        theta, images = 2.0 * np.pi * one.frequency_hz / RATE, np.arange(-12, 12)
        turned = np.abs(theta + 2.0 * np.pi * images)
        share = float((turned**-2.0).sum()) * 4.0 * math.sin(0.5 * theta) ** 2
        assert share > 0.97
        omega = np.unique(np.round(turned, 9)) * RATE  # at half the rate a motion is its own image
        chain = chain_of(1.0, 0.0)
        n, mass = omega.size, 400.0
        chain.n, chain.read = n, np.concatenate([np.ones(n), np.zeros(n)])
        drag = np.full((n, n), 1.0 / mass)

        def held(friction: float) -> float:
            chain.rates = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -friction * drag]])
            chain.push = np.concatenate([np.zeros(n), np.full(n, 1.0 / mass)])
            return growth(one._network, [chain])

        assert held(0.95 * one.needed[0]) > 1.0 + 1e-9
        assert held(1.001 * one.needed[0]) < 1.0

    def test_is_none_where_a_mass_swings_for_ever_in_a_held_hand(self) -> None:
        of = network(point_mass=[0.5, 2.0], ends=[[0, 1], [0, 2]], stiffness=[800.0, 2000.0], damping=[2.0, 0.0])
        one = whole(of)
        assert one.lasting == "mass_1"
        assert (one.is_passive, one.needed.tolist()) == (False, [math.inf])
        assert one.frequency_hz == pytest.approx(math.sqrt(1000.0) / (2.0 * math.pi), rel=1e-3)
        damped = whole(replace(of, damping=[2.0, 0.1]))
        assert (damped.lasting, damped.needed[0] < 1e3) == ("", True)

    def test_is_worked_out_whatever_drifts_unfelt(self) -> None:
        """A mass on a damper alone stays where it is left, which no hand feels."""
        of = network(point_mass=[0.5], ends=[[0, -1], [0, 1]], stiffness=[500.0, 0.0], damping=[1.0, 0.5])
        assert np.isfinite(whole(of).needed).all()
        loose = network(point_mass=[0.5], ends=[[0, -1], [0, 1]], stiffness=[500.0, 0.0], damping=[1.0, 0.0])
        alone = network(stiffness=[500.0], damping=[1.0])
        assert whole(loose).needed == pytest.approx(whole(alone).needed, rel=1e-9)

    def test_is_the_same_next_to_many_masses_on_grounds(self) -> None:
        count, given = 60, {"stiffness": [500.0], "damping": [5.0]}
        ends = [[0, -1], *([1 + i, -1] for i in range(count))]
        others = {"stiffness": np.linspace(300.0, 3000.0, count), "damping": np.full(count, 2.0)}
        both = {name: np.append(given[name], others[name]) for name in given}
        beside = network(point_mass=np.full(count, 0.5), ends=ends, **both)
        alone = passivity_of(HeldScene(network(**given))).friction
        assert passivity_of(HeldScene(beside)).friction == pytest.approx(alone, rel=1e-9)

    @pytest.mark.parametrize("friction", [1.0, 50.0])
    def test_is_none_where_the_scene_pushes_the_hand_away(self, friction: float) -> None:
        """However slow friction makes it, a hand that nothing holds leaves for good."""
        one = whole(network(stiffness=[-100.0], channel_friction=[friction]))
        assert (one.pushes_away, one.is_passive, one.needed.tolist()) == (True, False, [math.inf])
        behind = network(point_mass=[0.5], ends=[[0, 1], [1, -1]], stiffness=[500.0, -100.0], damping=[5.0, 1.0])
        assert grown(replace(behind, channel_friction=[friction])) > 1.0
        assert not np.isfinite(whole(behind).needed).any()
        held = network(ends=[[0, -1], [0, -1]], stiffness=[-100.0, 300.0], damping=[1.0, 1.0])
        assert not whole(held).pushes_away

    def test_is_found_at_a_resonance_that_is_as_narrow_as_friction_is_little(self) -> None:
        """A mass that swings for minutes has a narrow resonance; the reference is the demand at 200 000 points about
        it."""
        of = network(point_mass=[0.5], ends=[[0, 1], [1, -1]], stiffness=[800.0, 300.0], damping=[1e-3, 1e-3])
        scene = HeldScene(of)
        pole = scene.poles[np.argmax(np.abs(scene.poles))]
        theta = abs(np.angle(pole)) + (1.0 - abs(pole)) * np.linspace(-30.0, 30.0, 200_001)
        z = np.exp(1j * theta)
        demand = (-(1.0 - 1.0 / z) / z * -scene.forces(z - 1.0)[:, 0, 0] / RATE / (4.0 * np.sin(0.5 * theta) ** 2)).real
        found = passivity_of(scene)
        assert found.friction == pytest.approx(demand.max(), rel=1e-6)
        assert found.friction > 20.0

    def test_is_not_reported_where_it_is_not_derived(self) -> None:
        one = whole(network(hold="impulse"))
        assert (one.is_passive, one.shaking) == (None, None)
        assert one.not_derived.startswith("the condition is derived only for holds without impulses")


class TestTheHandThatIsShaken:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_is_shaken_just_below_the_friction_for_one(self, seed: int) -> None:
        rng = np.random.default_rng(100 + seed)
        for _ in range(6):
            one = whole(random_network(rng))
            if not one.needed_for_one > 1e-6:  # a NaN, too
                continue
            assert one.needed_for_one <= one.needed[0] * (1.0 + 1e-9)
            weak = with_friction(one, [0.95 * one.needed_for_one])
            hand = weak.shaking
            assert hand is not None
            assert grown(weak._network, hand.mass, hand.stiffness) > 1.0
            near = grown(weak._network, hand.mass, hand.stiffness)
            assert near >= hand.growth * (1.0 - 1e-9)

    def test_of_several_is_on_one_and_the_others_are_let_go(self) -> None:
        of = network(
            channel_mass=[0.2, 0.3], channel_friction=[0.5, 0.5], ends=[[0, 1]], stiffness=[3000.0], damping=[5.0]
        )
        hand = whole(of).shaking
        assert hand is not None
        held = [chain_of(0.2 + hand.mass * (hand.name == "hand_0"), 0.5, hand.stiffness * (hand.name == "hand_0"))]
        held += [chain_of(0.3 + hand.mass * (hand.name == "hand_1"), 0.5, hand.stiffness * (hand.name == "hand_1"))]
        assert growth(of, held) == pytest.approx(hand.growth, abs=1e-9)

    def test_is_none_of_a_passive_scene(self) -> None:
        one = whole(network(channel_friction=[10.0]))
        assert (one.is_passive, one.shaking) == (True, None)

    def test_moves_at_its_frequency(self) -> None:
        one = whole(network(channel_friction=[3.0], stiffness=[3000.0], damping=[0.5]))
        hand = one.shaking
        assert hand is not None
        of = replace(
            one._network, channel_mass=one._network.channel_mass + hand.mass, channel_stiffness=[hand.stiffness]
        )
        poles = poles_of(of)
        first = poles[np.argmax(np.abs(poles))]
        assert abs(np.angle(first)) * RATE / (2.0 * np.pi) == pytest.approx(hand.frequency_hz, rel=1e-9)


class TestTheWorstHand:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_is_no_better_than_any_of_many(self, seed: int) -> None:
        rng = np.random.default_rng(200 + seed)
        one = whole(random_network(rng))
        if np.isfinite(one.needed_for_one):
            one = with_friction(one, [one.needed_for_one * rng.uniform(0.7, 1.05) + 1e-3])
        worst = one.worst_hand((0.0, 2.0), (0.0, 2000.0))
        assert worst is not None
        tried = [grown(one._network, m, k) for m in np.linspace(0.0, 2.0, 15) for k in np.linspace(0.0, 2000.0, 12)]
        assert worst.spectral_radius >= max(tried) - 5e-5  # 3.6e-5 is the most that one of 200 missed
        assert worst.is_stable == (worst.spectral_radius <= 1.0 + 1e-9)
        assert not (worst.is_stable and max(tried) > 1.0 + 1e-8)
        assert grown(one._network, *worst.masses, *worst.stiffnesses) == pytest.approx(worst.spectral_radius, abs=1e-9)

    def test_is_found_in_a_range_of_any_width(self) -> None:
        """A knob that a clamp of 179 N·m/rad shakes, and a stiffer one does not."""
        knob = {"channel_mass": [1e-4], "channel_friction": [5e-4], "stiffness": [0.3], "damping": [5e-4]}
        one = whole(network(**knob))
        assert one.shaking is not None
        for most, mass in ((1e3, 0.0), (1e6, 2.0), (1e9, 0.0)):
            worst = one.worst_hand((0.0, mass), (0.0, most))
            assert worst is not None
            assert worst.spectral_radius >= one.shaking.growth * (1.0 - 1e-9)

    def test_is_none_where_all_drift(self) -> None:
        """Hands that nothing holds, without friction: a double pole at 1, which rounding moves by 1e-8."""
        of = network(channel_mass=[0.2, 0.3], channel_friction=[0.0, 0.0], delay=0.0, ends=[[0, 1]], damping=[20.0])
        worst = whole(of).worst_hand((0.0, 2.0), (0.0, 0.0))
        assert worst is not None
        assert (worst.is_stable, worst.spectral_radius) == (True, pytest.approx(1.0, abs=1e-12))

    def test_needs_a_range(self) -> None:
        with pytest.raises(UsageError, match=r"a hand's mass: found 2:1, expected low:high, both 0 or more"):
            whole(network()).worst_hand((2.0, 1.0), (0.0, 0.0))
