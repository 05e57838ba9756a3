"""Scenes that can move without stretching anything: against 60 digits, and against their own recurrence."""

from __future__ import annotations

from collections.abc import Iterable

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.network import is_large, large_modes, solve
from hapsim.theory.network.rest_poles import poles_at_rest
from tests.networks import network_of

RATE, M, BENDING = 1000.0, 0.001, 50.0
Link = tuple[int, int, float, float]


def bends(points: Iterable[int], bending: float = BENDING) -> list[Link]:
    """About each point between two others bending/2 (x- - 2 x + x+)², as links; -1 stays where it is."""
    row = list(points)
    links: list[Link] = []
    for left, middle, right in zip(row, row[1:], row[2:], strict=False):
        links += [(middle, left, 2.0 * bending, 0.0), (middle, right, 2.0 * bending, 0.0)]
        links.append((max(left, right), min(left, right), -bending, 0.0))
    return links


def scene(masses: int, links: list[Link], **changed: object) -> Network:
    own = {"channel_mass": [], "channel_friction": [], "point_mass": np.full(masses, M)}
    values = {"stiffness": [link[2] for link in links], "damping": [link[3] for link in links]}
    return network_of(**own | {"ends": [link[:2] for link in links]} | values | changed)


def neighbours(masses: int, stiffness: float, damping: float) -> list[Link]:
    return [(i, i + 1, stiffness, damping) for i in range(masses - 1)]


BARS = {
    "free": (bends(range(6)), 4),
    "free and taut": (bends(range(6)) + neighbours(6, 30.0, 0.0), 2),
    "of three masses": (bends(range(3)), 4),
    "with a damper from one mass to the ground": ([*bends(range(6)), (2, -1, 0.0, 0.05)], 3),
    "with dampers from two masses to the ground": ([*bends(range(6)), (2, -1, 0.0, 0.05), (5, -1, 0.0, 0.05)], 2),
    "with dampers along it, which brake its tilt": (bends(range(6)) + neighbours(6, 0.0, 0.02), 3),
    "on a spring to the ground": ([*bends(range(6)), (2, -1, 20.0, 0.0)], 2),
    "on two springs to the ground": ([*bends(range(6)), (2, -1, 20.0, 0.0), (5, -1, 20.0, 0.1)], 0),
    "on a hinge": (bends([-1, *range(6)]), 2),
    "on a braked hinge": ([*bends([-1, *range(6)]), (4, -1, 0.0, 0.1)], 1),
    "clamped": ([*bends([-1, *range(6)]), (0, -1, BENDING, 0.0)], 0),
    "held by two hinges": (bends([-1, *range(6), -1]), 0),
    "joined to another by a spring": (bends(range(4)) + bends(range(4, 8)) + [(2, 5, 40.0, 0.0)], 6),
    "joined to another by a spring with a damper": (bends(range(4)) + bends(range(4, 8)) + [(2, 5, 40.0, 0.1)], 6),
    "joined to another by a damper": (bends(range(4)) + bends(range(4, 8)) + [(2, 5, 0.0, 0.1)], 7),
    "beside another": (bends(range(4)) + bends(range(4, 8), 3.3), 8),
    "with a mass on a spring and a free mass": ([*bends(range(6)), (3, 6, 10.0, 0.0), (7, 7, 1.0, 0.0)], 6),
    "of a stiffness that is not a dyadic fraction": (bends(range(6), 12.3456789), 4),
    "of two lengths that differ in stiffness": (bends(range(4), 7.7) + bends(range(2, 7), 0.1), 4),
}


def bar(name: str) -> Network:
    links, _ = BARS[name]
    return scene(1 + max(max(link[:2]) for link in links), links)


def exact_poles(name: str) -> np.ndarray:
    """Returns the poles of a bar by x[n+1] = 2 x[n] - x[n-1] - T²/M (K x[n] + B (x[n] - x[n-1])/T) with 60 digits."""
    network = bar(name)
    n = network.point_mass.size
    with mp.workdps(60):
        k, b = mp.zeros(n), mp.zeros(n)
        for (first, second), stiffness, damping in zip(network.ends, network.stiffness, network.damping, strict=True):
            for row, column, sign in ((first, first, 1), (second, second, 1), (first, second, -1), (second, first, -1)):
                if row >= 0 and column >= 0:
                    k[int(row), int(column)] += sign * mp.mpf(float(stiffness))
                    b[int(row), int(column)] += sign * mp.mpf(float(damping))
        matrix = mp.zeros(2 * n)
        for i in range(n):
            matrix[i, i], matrix[i, n + i], matrix[n + i, i] = mp.mpf(2), mp.mpf(-1), mp.mpf(1)
            scale = 1 / (mp.mpf(float(network.point_mass[i])) * mp.mpf(network.rate) ** 2)
            for j in range(n):
                matrix[i, j] -= scale * (k[i, j] + b[i, j] * network.rate)
                matrix[i, n + j] += scale * b[i, j] * network.rate
        poles = mp.eig(matrix, left=False, right=False)
        # A pole at 1 is a double one at the most in a chain: 60 digits leave it within 1e-28 of there.
        return np.array([1.0 if abs(pole - 1) < mp.mpf(10) ** -25 else complex(pole) for pole in poles])


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("name", BARS)
def test_a_bar_rests_drifts_and_grows_as_in_sixty_digits(name: str) -> None:
    exact, (_, expected) = exact_poles(name), BARS[name]
    assert int((exact == 1.0).sum()) == expected
    assert poles_at_rest(bar(name)) == expected
    assert solve(bar(name)).spectral_radius == pytest.approx(np.abs(exact).max(), abs=1e-12)


@pytest.mark.parametrize("beyond", [1.0 + 1e-6, 1.01, 2.0])
def test_a_bar_beyond_its_limit_is_unstable_and_grows_as_predicted(beyond: float) -> None:
    """The fastest motion of a bar is at -1 if the largest eigenvalue of K T²/m is 4."""
    curve = np.diff(np.eye(10), n=2, axis=0)
    bending = 4.0 * M * RATE**2 / np.linalg.eigvalsh(curve.T @ curve).max()
    assert solve(scene(10, bends(range(10), bending / beyond))).spectral_radius == pytest.approx(1.0, abs=1e-12)
    wild = scene(10, bends(range(10), bending * beyond))
    solution = solve(wild)
    assert not solution.is_stable
    x = before = np.random.default_rng(0).standard_normal(10)
    steps, grown = 40_000 if beyond < 1.001 else 400, 0.0
    for n in range(steps):
        force = -bending * beyond * (curve.T @ (curve @ x))
        x, before = 2.0 * x - before + force / (M * RATE**2), x
        size = float(np.linalg.norm(x))
        x, before = x / size, before / size
        grown += np.log(size) if n >= steps // 2 else 0.0
    assert solution.spectral_radius == pytest.approx(np.exp(grown / (steps - steps // 2)), abs=1e-5)
    assert solution.spectral_radius > 1.0 + 1e-4


def test_springs_that_cancel_hold_nothing() -> None:
    both = [(0, -1, 0.1, 0.0), (0, -1, 0.2, 0.0), (0, -1, -0.1, 0.0), (0, -1, -0.2, 0.0)]
    assert poles_at_rest(scene(1, both)) == 2
    assert poles_at_rest(scene(1, [*both[:2], (0, -1, -0.3, 0.0)])) == 0  # 0.1 + 0.2 is not 0.3, as they are written


MASSES = 520


class TestALongBar:
    """So long that some of its poles are worked out in place of all."""

    @pytest.fixture(autouse=True)
    def _short_search(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(large_modes, "MOST_STEPS", 10_000)

    @pytest.mark.thorough
    def test_it_drifts_and_turns_and_no_more(self) -> None:
        network = scene(MASSES, bends(range(MASSES)))
        solution = solve(network)
        assert is_large(network)
        assert solution.spectral_radius == pytest.approx(1.0, abs=1e-11)
        assert not solution.is_stable
        assert sum(mode.frequency_hz == 0.0 for mode in solution.modes) == 4

    @pytest.mark.thorough(keep=1)
    @pytest.mark.parametrize(
        ("first", "beta_l"), [([], 4.730040744862704), ([-1], 3.926602312047919)], ids=["free", "hinged"]
    )
    def test_its_first_swing_is_that_of_the_continuous_bar(self, first: list[int], beta_l: float) -> None:
        """omega = (beta l / N)² sqrt(bending/mass), where the wave is long against the masses' distance."""
        network = scene(MASSES, bends([*first, *range(MASSES)]))
        swing = min(mode.frequency_hz for mode in solve(network).modes if mode.frequency_hz > 0.0)
        expected = (beta_l / MASSES) ** 2 * np.sqrt(BENDING / M) / (2.0 * np.pi)
        assert swing == pytest.approx(expected, rel=3e-3)

    @pytest.mark.thorough
    def test_clamped_and_undamped_it_swings_for_ever_and_does_not_grow(self) -> None:
        network = scene(MASSES, [*bends([-1, *range(MASSES)]), (0, -1, BENDING, 0.0)])
        assert poles_at_rest(network) == 0
        assert solve(network).spectral_radius == pytest.approx(1.0, abs=1e-11)

    @pytest.mark.thorough
    def test_braked_it_comes_to_rest_wherever_it_is(self) -> None:
        braked = [(i, -1, 0.0, 0.01) for i in range(MASSES)]
        network = scene(MASSES, bends(range(MASSES)) + braked)
        solution = solve(network)
        assert solution.spectral_radius == 1.0
        assert sum(mode.pole == 1.0 for mode in solution.modes) == 2


@pytest.mark.parametrize("seed", range(100))
def test_random_bars_springs_and_hands_rest_as_their_null_spaces_predict(seed: int) -> None:
    rng = np.random.default_rng(seed)
    channels, masses = int(rng.integers(0, 3)), int(rng.integers(4, 14))
    points = channels + masses
    links = [(0, -1, 0.0, 0.0)]
    for _ in range(rng.integers(1, 4)):
        row = rng.permutation(points)[: int(rng.integers(3, 7))].tolist()
        links += bends([-1, *row] if rng.random() < 0.3 else row, float(rng.uniform(1.0, 50.0)))
    for _ in range(rng.integers(0, 6)):
        first, second = rng.integers(-1, points, 2).tolist()
        links.append((first, second, float(rng.choice([0.0, 0.0, 30.0, 7.3])), float(rng.choice([0.0, 0.1]))))
    friction, own = rng.choice([0.0, 1.0], channels), rng.choice([0.0, 0.0, 5.0], channels)
    network = scene(masses, links, channel_mass=[0.2] * channels, channel_friction=friction, channel_stiffness=own)
    pull = np.zeros((2, points + 1, points + 1))
    for (a, b), *values in zip(network.ends, network.stiffness, network.damping, strict=True):
        ends = np.zeros(points + 1)
        ends[a] += 1.0
        ends[b] -= 1.0
        pull += np.array(values)[:, None, None] * np.outer(ends, ends)
    stiffness, damping = pull[:, :points, :points] + [np.diag(np.append(x, np.zeros(masses))) for x in (own, friction)]
    values, shapes = np.linalg.eigh(stiffness)
    rigid = shapes[:, np.abs(values) < 1e-9]
    braked = np.linalg.matrix_rank(rigid.T @ damping @ rigid, tol=1e-9) if rigid.size else 0
    assert poles_at_rest(network) == 2 * rigid.shape[1] - braked
