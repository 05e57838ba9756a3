"""Several ports with clocks of their own: known figures, and simulations that know no matrix."""

from __future__ import annotations

import heapq
import math
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.theory import Configuration, Network
from hapsim.theory.interface import Clocks, PortInterface, damper_named
from hapsim.theory.network import felt_pair, solve
from hapsim.theory.network.margins import ChangedLink
from hapsim.theory.network.phases import at_phases, at_worst_phase, extremes, worst_loop
from hapsim.theory.plant import Drive
from hapsim.theory.sample import loop
from hapsim.theory.several_clocks import noise_gain
from tests import thorough
from tests.coasting import Coasting
from tests.networks import network_of

ZOH = PortInterface(1.0, "zoh", "ideal")
FORCE, TICK = 0, 1  # at one instant a force begins to act first
T = 1e-3
MASS, FRICTION, K, B = 0.2, 1.0, 2000.0, 5.0


def tied(phases: tuple[float, ...], **changed: object) -> Network:
    """Two hands on two ports, tied by one spring and damper."""
    own = {"channel_mass": [MASS, MASS], "channel_friction": [FRICTION, FRICTION], "ends": [[0, 1]]}
    return network_of(**own | {"clocks": Clocks((0, 1), (ZOH, ZOH), phases)} | changed)


def as_one(change: np.ndarray) -> np.ndarray:
    """k and b of one spring and damper on the reduced mass, and the slowest decay of both together, 1/s."""
    w = np.linalg.eigvals(change).astype(complex)
    s = np.log1p(w[np.abs(1.0 + w) > 1e-6]) / T
    swing = max(s[s.imag > 1.0], key=lambda one: one.real)
    together = max(one.real for one in s[np.abs(s.imag) < 1e-9] if one.real < -0.1)
    return np.array([0.5 * MASS * abs(swing) ** 2, -MASS * swing.real, together])


class TestTwoHandsOnOneSpring:
    def test_on_one_clock_they_are_one_network(self) -> None:
        k, b, together = as_one(loop(tied(())).change)
        assert (k, b) == (pytest.approx(2167.891401723, abs=5e-10), pytest.approx(2.492382018, abs=5e-10))
        assert together == pytest.approx(-5.0, abs=1e-9)
        # The poles at zero are a double one: rounding moves them by the root of its own size.
        own, whole = (np.linalg.eigvals(loop(one).change) for one in (tied((), clocks=None), tied(())))
        assert np.abs(own[:, None] - whole).min(axis=1).max() < 1e-7

    def test_on_two_clocks_they_feel_a_little_more_at_every_phase(self) -> None:
        least, most = extremes(tied((0.0, 0.0)), lambda at: as_one(loop(tied(at)).change))
        assert least == pytest.approx([2177.511, 2.50485, -4.9814], abs=5e-4)
        assert most == pytest.approx([2180.764, 2.50494, -4.9751], abs=5e-4)
        assert (least[1], most[1]) == (pytest.approx(2.50485, abs=5e-6), pytest.approx(2.50494, abs=5e-6))

    def test_the_stiffest_stable_spring_is_that_of_the_worst_phase(self) -> None:
        one, two = (ChangedLink(tied(at), 0, 0).ranges_searched(False)[0][1] * K for at in ((), (0.0, 0.0)))
        assert (round(one), round(two)) == (3468, 3442)
        beyond = tied((0.0, 0.0), stiffness=[1.001 * two])
        assert not solve(at_worst_phase(beyond)).spectral_radius <= 1.0 + 1e-9

    @pytest.mark.parametrize(
        ("rule", "k", "b", "together"),
        [
            ("extrapolated", (2177.511, 2180.764), (2.50485, 2.50494), (-4.9814, -4.9751)),
            ("last slope", (2206.485, 2208.484), (2.431, 2.444), None),
            ("newest", (2174.914878604, 2174.914878604), (1.909187850, 1.909187850), (-9.96, -9.96)),
        ],
    )
    def test_other_rules_feel_otherwise(
        self, rule: str, k: tuple[float, float], b: tuple[float, float], together: tuple[float, float] | None
    ) -> None:
        found = np.array([as_one(written_out(phase, rule)) for phase in np.linspace(0.0, 1.0, 9)])
        for column, ends, digits in ((0, k, 5e-3), (1, b, 5e-4), (2, together, 5e-3)):
            if ends is not None:
                assert (found[:, column].min(), found[:, column].max()) == pytest.approx(ends, abs=digits)

    @pytest.mark.parametrize("phase", [0.0, 0.3, 0.5, 0.93, 1.0])
    def test_its_loop_is_the_written_out_one(self, phase: float) -> None:
        own, other = (as_one(one) for one in (loop(tied((0.0, phase))).change, written_out(phase, "extrapolated")))
        assert own == pytest.approx(other, rel=1e-9)

    def test_a_port_that_paces_the_other_costs_its_wall_a_sample(self) -> None:
        wall = Configuration(mass=MASS, rate=1.0 / T, friction=FRICTION, delay=2.0)
        assert wall.equivalent(K, B) == pytest.approx((2089.101097779, 0.854595648), abs=5e-10)

    def test_at_half_a_period_both_feel_the_same(self) -> None:
        pair = felt_pair(tied((0.0, 0.5)))
        for of in (pair.k, pair.b):
            assert of == pytest.approx(of.T, rel=1e-9)
            assert of[0, 0] == pytest.approx(of[1, 1], rel=1e-9)

    def test_where_the_phase_wraps_they_change_places(self) -> None:
        first, last = (felt_pair(tied((0.0, phase))) for phase in (0.0, 1.0))
        assert first.k == pytest.approx(last.k[::-1, ::-1], rel=1e-9)
        assert first.b == pytest.approx(last.b[::-1, ::-1], rel=1e-9)


def written_out(phase: float, rule: str) -> np.ndarray:
    """Change of a sample period of the two hands, device by device: each computes its force at its tick, and the one
    computed before begins to act. `rule`: how a port takes the other's positions p0, p1, p2."""
    names = [f"{name}{i}" for i in (0, 1) for name in ("x", "v", "acts", "next", "p0_", "p1_", "p2_")]
    at, one = {name: i for i, name in enumerate(names)}, np.eye(len(names))

    def move(part: float) -> np.ndarray:
        step, whole = expm(part * T * np.array([[0, 1, 0], [0, -FRICTION / MASS, 1 / MASS], [0, 0, 0]])), one.copy()
        for i in (0, 1):
            whole[at[f"x{i}"] : at[f"x{i}"] + 2, at[f"x{i}"] : at[f"x{i}"] + 3] = step[:2]
        return whole

    def tick(i: int, age: float) -> np.ndarray:
        (x, q0, q1), (p0, p1, p2) = (
            (one[at[n]] for n in (f"x{i}", f"p0_{i}", f"p1_{i}")),
            (one[at[f"p{n}_{1 - i}"]] for n in (0, 1, 2)),
        )
        now, before = {
            "extrapolated": (p0 + age * (p0 - p1), p1 + age * (p1 - p2)),
            "last slope": (p0 + age * (p0 - p1), p0 + age * (p0 - p1) - (p0 - p1)),
            "newest": (p0, p1),
        }[rule]
        whole = one.copy()
        whole[at[f"acts{i}"]] = one[at[f"next{i}"]]
        whole[at[f"next{i}"]] = K * (now - x) + B / T * ((now - x) - (before - q0))
        whole[at[f"p0_{i}"]], whole[at[f"p1_{i}"]], whole[at[f"p2_{i}"]] = x, q0, q1
        return whole

    return move(1.0 - phase) @ tick(1, phase) @ move(phase) @ tick(0, 1.0 - phase) - one


class SimulatedPort:
    """One port, from event to event: what it read of its own points, and took of the others."""

    def __init__(self, number: int, network: Network) -> None:
        assert network.clocks is not None
        self.number, self.network, self.owner = number, network, network.clocks.port
        self.interface, self.at = network.clocks.interfaces[number], mp.mpf(network.clocks.phases[number])
        every = zip(network.channel_mass, network.channel_friction, strict=True)
        self.hands = {c: Coasting(*map(mp.mpf, (*one, 0, 0))) for c, one in enumerate(every) if self.owner[c] == number}
        self.clock = self.at
        self.newest = {i: [mp.mpf(0)] * 2 for i, one in enumerate(self.owner) if one == number}
        self.taken = [[mp.mpf(0)] * 2 for _ in self.owner]

    def coast(self, at: mp.mpf) -> None:
        for hand in self.hands.values():
            hand.coast((at - self.clock) / mp.mpf(self.network.rate))
        self.clock = at

    def tick(self, ports: list[SimulatedPort], at: mp.mpf) -> list[mp.mpf]:
        """Reads the hands, takes the other ports' points, moves the masses; returns the forces on the hands."""
        network, rate, self.at = self.network, mp.mpf(self.network.rate), at
        for i, owner in enumerate(self.owner):
            now, before = ports[owner].newest[i]
            if i in self.hands:
                hand, is_mean = self.hands[i], self.interface.sampling == "average" and at >= 1
                before, now = now, hand.travel * rate if is_mean else hand.x
                hand.travel, self.newest[i] = mp.mpf(0), [now, before]
            elif owner != self.number:
                now += (at - ports[owner].at - (i >= len(network.channel_mass))) * (now - before)
            self.taken[i] = [now, self.taken[i][0]]
        total = [mp.mpf(0)] * (len(self.owner) + 1)  # the last is the ground
        taken = [*self.taken, [mp.mpf(0)] * 2]
        for (a, b), k, z in zip(network.ends.tolist(), network.stiffness, network.damping, strict=True):
            now, before = (taken[a][j] - taken[b][j] for j in (0, 1))
            force = mp.mpf(k) * now + mp.mpf(z) * rate * (now - before)
            total[a], total[b] = total[a] - force, total[b] + force
        for i in self.newest.keys() - self.hands.keys():
            now, before = self.taken[i]
            moved = total[i] / mp.mpf(network.point_mass[i - len(network.channel_mass)]) / rate**2
            self.newest[i] = [2 * now - before + moved, now]
        return [total[i] for i in self.hands]


def simulated(network: Network, samples: int, v0: list[float]) -> np.ndarray:
    """Readings (samples, C) of the hands at their ports' ticks. They start at 0, with velocities v0."""
    assert network.clocks is not None
    ports = [SimulatedPort(p, network) for p in range(len(network.clocks.interfaces))]
    for port in ports:
        for c, hand in port.hands.items():
            hand.v = mp.mpf(v0[c])
    queue = [(port.at, TICK, port.number, []) for port in ports]
    heapq.heapify(queue)
    rows = [list[list[mp.mpf]]() for _ in ports]
    while min(map(len, rows)) < samples:
        at, kind, number, forces = heapq.heappop(queue)
        port = ports[number]
        port.coast(at)
        if kind == FORCE:
            for hand, force in zip(port.hands.values(), forces, strict=True):
                hand.force = force
            continue
        forces = port.tick(ports, at)
        rows[number].append([port.newest[c][0] for c in port.hands])
        heapq.heappush(queue, (at + mp.mpf(port.interface.delay), FORCE, number, forces))
        heapq.heappush(queue, (at + 1, TICK, number, []))
    by_channel = [(port, j) for port in ports for j, _ in enumerate(port.hands)]
    channels = [c for port in ports for c in port.hands]
    out = np.zeros((samples, len(channels)))
    for c, (port, j) in zip(channels, by_channel, strict=True):
        out[:, c] = [float(row[j]) for row in rows[port.number][:samples]]
    return out


def random_scene(random: np.random.Generator) -> Network:
    """Two ports with one hand or two each, up to two masses with the first, and links within and across."""
    owner = [0, 1, *random.integers(0, 2, random.integers(0, 3)).tolist()]
    masses = int(random.integers(0, 3))
    points = len(owner) + masses
    ends = [[0, 1], *[[c, int(random.integers(-1, points))] for c in range(points) if random.random() < 0.7]]
    links = [end for end in ends if end[0] != end[1]]
    interfaces = tuple(
        PortInterface(float(random.choice([0.0, 0.4, 1.0, 1.5, 2.0])), "zoh", str(random.choice(["ideal", "average"])))
        for _ in range(2)
    )
    return Network(
        rate=float(random.choice([500.0, 1000.0, 4000.0])),
        channel_mass=random.uniform(0.05, 0.5, len(owner)),
        channel_friction=random.uniform(0.1, 3.0, len(owner)),
        delay=1.0,
        hold="zoh",
        sampling="ideal",
        point_mass=random.uniform(0.02, 0.2, masses),
        ends=links,
        stiffness=random.uniform(50.0, 2000.0, len(links)),
        damping=random.uniform(0.0, 3.0, len(links)),
        clocks=Clocks((*owner, *[0] * masses), interfaces, (0.0, float(random.uniform(0.01, 0.99)))),
    )


@pytest.mark.parametrize("seed", range(thorough.points(5, 40)))
def test_random_scenes_across_two_ports_move_as_their_matrix(seed: int) -> None:
    random = np.random.default_rng(seed)
    network = random_scene(random)
    v0 = random.uniform(-0.3, 0.3, len(network.channel_mass))
    expected = simulated(network, 30, v0.tolist())
    change, points, *_ = loop(network)
    state = np.zeros(len(change))
    begin = len(points)  # of the velocities
    state[begin : begin + v0.size] = v0 / network.rate
    for row in expected:
        assert points[: v0.size] @ state == pytest.approx(row, rel=1e-6, abs=1e-6 * np.abs(expected).max())
        state = state + change @ state


def coupled(**changed: object) -> Network:
    """Three hands on two ports, and two masses that the first port moves."""
    one = {
        "rate": 1000.0,
        "channel_mass": [0.2, 0.15, 0.3],
        "channel_friction": [1.0, 0.5, 2.0],
        "delay": 1.4,
        "hold": "zoh",
        "sampling": "average",
        "point_mass": [0.05, 0.02],
        "ends": [[0, 3], [3, 1], [3, 4], [4, 2], [4, -1], [0, 1], [2, 0]],
        "stiffness": [900.0, 700.0, 300.0, 400.0, 200.0, 150.0, 80.0],
        "damping": [0.4, 0.3, 0.1, 0.2, 0.3, 0.1, 0.2],
    }
    return Network(**(one | changed))  # type: ignore[arg-type]


BELT = Drive(stiffness=2e4, damping=3.0, motor_mass=0.05)
KINDS = {
    "plain": {},
    "substeps": {"substeps": 4},
    "mean of substeps": {"substeps": 3, "decimation": "mean"},
    "another scheme": {"scheme": "rk4"},
    "other dampers": {
        "damper": [damper_named(*one, 1000.0) for one in (("backward", None), ("filtered", 100.0))] * 3
        + [damper_named("backward", None, 1000.0, 3)]
    },
    "drives": {"drives": [Drive(), BELT, Drive(lag=0.002)]},
    "masses of one device": {"channel_mass": [[0.2, 0.0, 0.02], [0.0, 0.15, 0.0], [0.02, 0.0, 0.3]]},
    "scaled links": {"second": [[1.0, 1.0], [1.0, 0.3], [2.0, 2.0], [1.0, 1.0], [1.0, 1.0], [0.5, 0.4], [1.0, 1.2]]},
    "rows": {
        "ends": [],
        "rows": np.eye(5)[[0, 3, 4]] - np.eye(5)[[3, 1, 2]],
        "stiffness": [9e2, 7e2, 1e2],
        "damping": [0.1] * 3,
    },
}


def clocked(network: Network, phases: tuple[float, ...]) -> Network:
    interface = PortInterface(network.delay, network.hold, network.sampling, network.decimation)
    return replace(network, clocks=Clocks((0, 1, 0, 0, 0), (interface,) * 2, phases))


def moving_poles(network: Network) -> np.ndarray:
    """Poles that are no memories: rounding scatters those at zero."""
    poles = 1.0 + np.linalg.eigvals(loop(network).change)
    return np.sort_complex(poles[np.abs(poles) > 0.02].round(9))


@pytest.mark.parametrize("kind", KINDS)
def test_on_one_clock_every_kind_of_scene_is_one_network(kind: str) -> None:
    network = coupled(**KINDS[kind])
    found = moving_poles(clocked(network, ()))  # with further ones: a filter remembers at both its ends
    between_steps = network.substeps > 1 or network.scheme != "cordis"  # the other port sees no step
    for pole in moving_poles(network):
        assert np.abs(found - pole).min() < (3e-3 if between_steps else 1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_only_the_difference_of_the_phases_counts(kind: str) -> None:
    network = coupled(**KINDS[kind])
    one, other = (moving_poles(clocked(network, phases)) for phases in ((0.0, 0.3), (0.7, 0.0)))
    assert one == pytest.approx(other, abs=1e-7)


def test_three_ports_have_a_grid_of_phases() -> None:
    three = tied(
        (0.0, 0.0, 0.0),
        channel_mass=[0.2] * 3,
        channel_friction=[1.0] * 3,
        ends=[[0, 1], [1, 2]],
        stiffness=[K, K],
        damping=[B, B],
        clocks=Clocks((0, 1, 2), (ZOH,) * 3, (0.0, 0.0, 0.0)),
    )
    worst, change = worst_loop(three)
    radius = float(np.abs(1.0 + np.linalg.eigvals(change)).max())
    assert radius <= 1.0 + 1e-9
    swing = [
        max(np.abs(one.imag) and abs(one) for one in 1.0 + np.linalg.eigvals(loop(at_phases(three, at)).change))
        for at in (worst.clocks.phases, (0.0, 0.31, 0.77))
    ]  # type: ignore[union-attr]
    assert swing[0] >= swing[1] - 1e-12


def test_noise_of_the_other_hand_grows_with_its_age() -> None:
    random = np.random.default_rng(4)
    p = random.standard_normal(400_000)
    for age, root in ((0.0, 2.0), (1.0, 14.0), (2.0, 38.0)):
        assert noise_gain(age) ** 2 == pytest.approx(root, rel=1e-12)
        taken = p[1:] + age * (p[1:] - p[:-1])
        assert np.diff(taken).std() == pytest.approx(math.sqrt(root), rel=0.01)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"clocks": Clocks((0,), (ZOH, ZOH))}, "a port from 0 to 1 for each channel and each mass"),
        ({"clocks": Clocks((0, 2), (ZOH, ZOH))}, "a port from 0 to 1 for each channel and each mass"),
        ({"clocks": Clocks((0, 1), (ZOH, ZOH), (0.0,))}, "1 phases, but there are 2 ports"),
        ({"channel_mass": [[0.2, 0.01], [0.01, 0.2]]}, "joins channels of two ports"),
    ],
)
def test_what_does_not_fit_several_clocks_is_refused(changed: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        tied((0.0, 0.0), **changed)
