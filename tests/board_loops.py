"""Loops with the force law on the board, written out event by event: a second description, for tests of the theory and
of what runs."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from hapsim.theory import Network
from hapsim.theory.interface import BoardLaw

T = 1e-3
Link = tuple[int, int, float, float]
"""Two points, K and B: hands first, then masses; -1 is a ground."""


class Written(NamedTuple):
    """A scene as the loop below reads it. ``late``: delay of a line in local periods. ``chains``: masses (kg) behind
    each hand, each on a spring (N/m) to the one before; of passive hands. ``implicit``: its only mass is a proxy.
    ``sent``: k and b of each hand's line where they are not those of its links."""

    masses: list[float]
    frictions: list[float]
    springs: list[float]
    points: list[float]
    links: list[Link]
    late: int
    board: BoardLaw
    chains: tuple[tuple[tuple[float, float], ...], ...] = ()
    implicit: bool = False
    sent: tuple[tuple[float, float], ...] = ()

    def network(self, **changed: Any) -> Network:
        ends, K, B = [link[:2] for link in self.links], *np.array([link[2:] for link in self.links]).T
        own = {"channel_stiffness": self.springs, "board": self.board, "implicit": [self.implicit] * len(self.points)}
        delay = self.late / self.board.steps
        given: Any = (1.0 / T, self.masses, self.frictions, delay, "zoh", "ideal", self.points, ends, K, B)
        return Network(*given, **(own | changed))

    def plant(self, hand: int) -> tuple[NDArray, NDArray]:
        """Rates of (x, v) of the device and of its chain, and what a force on the device adds to them."""
        chain = self.chains[hand] if self.chains else ()
        each = [self.masses[hand], *(mass for mass, _ in chain)]
        A = np.zeros((2 * len(each), 2 * len(each)))
        A[::2, 1::2] = np.eye(len(each))
        A[1, :2] -= self.springs[hand] / each[0], self.frictions[hand] / each[0]
        for i, (_, spring) in enumerate(chain):
            for one, other in ((i, i + 1), (i + 1, i)):
                A[2 * one + 1, [2 * one, 2 * other]] += spring / each[one] * np.array([-1.0, 1.0])
        return A, np.eye(len(A))[1] / each[0]


def one_sample(scene: Written, idle: int = 0) -> NDArray:
    """Matrix of a sample, (n, n): the loop runs on every number of its state at once. ``idle``: local periods before
    the first line begins, without a force."""
    (N, D, W), hands, points = scene.board, len(scene.masses), len(scene.points)
    plants, lines = [scene.plant(hand) for hand in range(hands)], -(-scene.late // N)
    parts = [len(A) for A, _ in plants] + [hands, points, points] + [hands] * (W + D + lines)
    rows = np.eye(sum(parts))
    every = np.split(rows, np.cumsum(parts)[:-1])
    moving, (x_before, y, y_before), memory = every[:hands], every[hands : hands + 3], every[hands + 3 :]
    seen, under_way, queue = memory[:W], memory[W : W + D], memory[W + D :]  # all newest first
    x, none = np.stack([one[0] for one in moving]), np.zeros((1, len(rows)))
    # The host's tick: the links at the positions of now.
    if scene.implicit:  # a mass whose place balances all forces
        ((a, _, K, B), (_, _, Kg, Bg)), inertia = scene.links, scene.points[0] / T**2
        pushed = inertia * (2.0 * y - y_before) + K * x[a] + B / T * (x[a] - x_before[a] + y) + Bg / T * y
        stands = pushed / (inertia + K + B / T + Kg + Bg / T)
        next_place, after = 2.0 * stands - y, [stands, y]
    else:
        at, before = np.vstack([x, y, none]), np.vstack([x_before, y_before, none])
        force = np.zeros_like(at)
        for a, z, K, B in scene.links:
            pull = K * (at[a] - at[z]) + B / T * (at[a] - before[a] - at[z] + before[z])
            force[a] -= pull
            force[z] += pull
        next_place = 2.0 * y - y_before + T**2 / np.array(scene.points)[:, None] * force[hands : hands + points]
        after = [next_place, y]
    # The line of each hand: masses stand at their next places, other hands where they are.
    place = np.vstack([x, next_place, none])
    way = np.vstack([x - x_before, next_place - after[int(not scene.implicit)], none])
    c, k, b = np.zeros_like(x), np.zeros((hands, 1)), np.zeros((hands, 1))
    for one, other, K, B in scene.links:
        for end, far in ((one, other), (other, one)):
            if 0 <= end < hands:
                c[end] += K * place[far] + B / T * way[far]
                k[end] += K
                b[end] += B
    for hand, (its_k, its_b) in enumerate(scene.sent):
        c[hand] += (its_k - k[hand]) * x[hand]
        k[hand], b[hand] = its_k, its_b
    queue, h, read = [c, *queue], T / N, x
    moves = [expm(h * np.block([[A, B[:, None]], [np.zeros((1, len(A) + 1))]]))[:-1] for A, B in plants]
    for j in range(N):
        x = np.stack([one[0] for one in moving])
        computed = queue[-(-max(scene.late - j, 0) // N)] - k * x - b * (x - seen[W - 1]) / (W * h)
        computed = computed * float(j >= idle)
        under_way, seen = [computed, *under_way], [x, *seen][:W]
        moving = [
            move @ np.vstack([one, under_way[D][i]]) for i, (one, move) in enumerate(zip(moving, moves, strict=True))
        ]
        under_way = under_way[:D]
    return np.vstack([*moving, read, *after, *seen, *under_way, *queue[:lines]])


def board(rng: np.random.Generator) -> BoardLaw:
    N = int(rng.choice([1, 2, 4, 5, 10, 20]))
    return BoardLaw(N, int(rng.integers(0, 4)), int(rng.integers(1, N + 1)))


def random_scene(rng: np.random.Generator) -> Written:
    hands, points, its = int(rng.integers(1, 3)), int(rng.integers(0, 4)), board(rng)

    def some(least: float, most: float) -> float:
        return float(rng.choice([0.0, 10 ** rng.uniform(least, most)]))

    def link(a: int, b: int) -> Link:
        return a, b, float(10 ** rng.uniform(1, 3.5)), some(-1, 0.7)

    every = hands + points
    links = [link(at, -1) for at in range(every)]  # so that no pole is a double one at 1
    links += [link(int(rng.integers(0, at)), at) for at in range(1, every)]
    return Written(
        [float(10 ** rng.uniform(-1.2, 0.3)) for _ in range(hands)],
        [some(-1, 0.7) for _ in range(hands)],
        [some(0, 3) for _ in range(hands)],
        [float(10 ** rng.uniform(-1.5, 0.5)) for _ in range(points)],
        links,
        int(rng.integers(0, 5 * its.steps)),
        its,
    )
