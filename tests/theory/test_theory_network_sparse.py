"""A string of many masses: its modes by the formula of the discrete string, all of them or some, in little memory."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hapsim.theory import Network, sample
from hapsim.theory.interface import damper_named
from hapsim.theory.network import is_large, large_modes, margins, margins_of, solve, steady_stiffness
from hapsim.theory.network.large_loop import sparse_transition
from tests.networks import network_of
from tests.peak_memory import peak_memory
from tests.transitions import transition

RATE = 1000.0
M, K = 0.01, 1000.0


def string(masses: int, B: float, *, held: int | None = None, **changed: object) -> Network:
    """Equal masses and links between two grounds; ``held``: the mass that a hand is tied to, by a softer link."""
    hands = 0 if held is None else 1
    point = np.arange(masses) + hands
    ends = np.stack([np.append(-1, point), np.append(point, -1)], axis=1)
    stiffness, damping = np.full(masses + 1, K), np.full(masses + 1, B)
    if held is not None:
        ends = np.vstack([ends, [0, held + 1]])
        stiffness, damping = np.append(stiffness, 500.0), np.append(damping, 1.0)
    own = {"channel_mass": [0.2] * hands, "channel_friction": [1.0] * hands, "point_mass": np.full(masses, M)}
    return network_of(**own | {"ends": ends, "stiffness": stiffness, "damping": damping} | changed)


def string_poles(masses: int, B: float) -> np.ndarray:
    """X+ + ((lambda K + lambda Z)/M - 2) X + (1 - lambda Z/M) X- = 0 for each eigenvalue of the string's Laplacian."""
    laplacian = 4.0 * np.sin(np.arange(1, masses + 1) * math.pi / (2.0 * (masses + 1))) ** 2
    kappa, beta = laplacian * K / (M * RATE**2), laplacian * B / (M * RATE)
    half = 1.0 - 0.5 * (kappa + beta)
    root = np.sqrt((half**2 - (1.0 - beta)).astype(complex))
    return np.concatenate([half + root, half - root])


def nearest(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Returns the distance of each found value to the nearest expected one."""
    return np.abs(found[:, None] - expected[None, :]).min(axis=1)


@pytest.mark.parametrize("B", [0.0, 0.3, 3.0])
def test_a_string_has_the_modes_of_the_discrete_string(B: float) -> None:
    solution, expected = solve(string(60, B)), string_poles(60, B)
    found = solution.poles
    if B == 0.3:
        for number, mode in enumerate(solution.modes, start=1):  # they are sines
            shape = np.sin(np.pi * number * np.arange(1, 61) / 61) ** 2
            np.testing.assert_allclose(mode.participation, shape / shape.sum(), atol=1e-9)
    assert found.size == expected.size
    assert nearest(found, expected).max() < 1e-7  # where two real poles meet, the root of rounding
    assert nearest(expected, found).max() < 1e-7


def test_a_large_string_has_some_of_them_and_names_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_modes, "MOST_STEPS", 10_000)
    large = string(1500, 0.3)
    solution = solve(large)
    assert is_large(large)
    assert nearest(solution.poles, string_poles(1500, 0.3)).max() < 1e-10
    assert f"{solution.poles.size} of 3000 poles" in solution.method
    frequencies = sorted(mode.frequency_hz for mode in solution.modes)
    expected = np.sort(np.abs(np.log(string_poles(1500, 0.3)))) * RATE / (2.0 * math.pi)
    np.testing.assert_allclose(frequencies[:8], expected[::2][:8], rtol=1e-7)
    assert frequencies[-1] > 0.999 * expected[-1]
    shape = np.sin(np.arange(1, 1501) * math.pi / 1501) ** 2
    slowest = solution.modes[0]
    np.testing.assert_allclose(slowest.participation, shape / shape.sum(), atol=1e-9)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("damper", ["backward", "filtered"])
def test_sparse_and_dense_agree_on_100_masses(damper: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_modes, "MOST_STEPS", 10_000)
    made = damper_named(damper, 80.0 if damper == "filtered" else None, RATE)
    scene = {"held": 40, "damper": [made] * 102}
    monkeypatch.setattr(sample, "LARGE", 10_000)
    dense = string(100, 0.2, **scene)
    solution_dense = solve(dense)
    every, by_crossings, matrix = solution_dense.poles, margins_of(dense).links, transition(dense)
    assert solution_dense.method == ""
    monkeypatch.setattr(sample, "LARGE", 100)
    monkeypatch.setattr(margins, "MOST_STATES", 0)
    sparse = string(100, 0.2, **scene)
    found_margins = margins_of(sparse)
    solution_sparse = solve(sparse)
    np.testing.assert_array_equal(sparse_transition(sparse).right.toarray(), matrix)
    found = solution_sparse.poles
    assert nearest(found, every).max() < 1e-9
    assert found.size < every.size
    assert solution_sparse.spectral_radius == pytest.approx(solution_dense.spectral_radius, abs=1e-10)
    assert solution_sparse.is_stable == solution_dense.is_stable
    known = [i for i, margin in enumerate(found_margins.links) if not math.isnan(margin.damping_factor)]
    assert 101 in known
    for i in known:
        np.testing.assert_allclose(found_margins.links[i], by_crossings[i], rtol=1e-7)


@pytest.mark.parametrize("places", [(0,), (0, 1)])
def test_what_grows_is_found_wherever_it_is(places: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """One link far from everything, so stiff that its masses fly apart."""
    monkeypatch.setattr(sample, "LARGE", 300)
    scene = string(180, 0.1, held=3)
    stiffness = scene.stiffness.copy()
    stiffness[[100 + place for place in places]] = 3.0 * M * RATE**2
    wild = string(180, 0.1, held=3, stiffness=stiffness)
    solution = solve(wild)
    dense = transition(wild)
    assert not solution.is_stable
    assert solution.spectral_radius == pytest.approx(np.abs(np.linalg.eigvals(dense)).max(), rel=1e-9)
    assert "grow" in solution.method


def test_a_free_string_is_at_the_limit_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_modes, "MOST_STEPS", 10_000)
    loose = string(500, 0.1, held=250)
    ends = [*loose.ends[1:-2].tolist(), [0, 251]]
    free = string(500, 0.1, held=250, ends=ends, stiffness=loose.stiffness[2:], damping=loose.damping[2:])
    solution = solve(free)
    assert is_large(free)
    assert solution.spectral_radius == 1.0
    assert not solution.is_stable
    assert all(
        margin.stiffness_factor > 1.0 for margin in margins_of(free).links if not math.isnan(margin.stiffness_factor)
    )


@pytest.mark.thorough
def test_thousands_of_masses_answer_in_seconds_and_in_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_modes, "MOST_STEPS", 1_000)
    with peak_memory() as grown:
        solution = solve(string(6_000, 0.1))
    assert solution.is_stable
    assert solution.modes[0].participation.shape == (6_000,)
    assert "of 12000 poles" in solution.method
    assert nearest(solution.poles, string_poles(6_000, 0.1)).max() < 1e-10
    assert grown[0] < 1e9  # bytes; one dense matrix would be 1.15e9


class TestAVerdictOnALargeScene:
    """A scene too large for all of its poles, whose growing motion is not where one would look first."""

    @staticmethod
    def by_every_pole(network: Network) -> float:
        return float(np.abs(np.linalg.eigvals(transition(network))).max())

    def test_a_hand_on_a_wall_and_in_the_middle_of_a_string_is_found_to_shake(self) -> None:
        masses = 520
        ends = [[i - 1 if i > 1 else -1, i] for i in range(1, masses + 1)] + [[masses, -1], [0, 244], [0, -1]]
        stiffness, damping = [340.0] * (masses + 1) + [2100.0, 4000.0], [0.04] * (masses + 1) + [7.0, 2.0]
        shaken = Network(RATE, [0.5], [0.2], 1.0, "zoh", "ideal", [0.01] * masses, ends, stiffness, damping)
        solution = solve(shaken)
        assert is_large(shaken)
        expected = self.by_every_pole(shaken)
        assert 1.0005 < expected < 1.002
        assert not solution.is_stable
        assert solution.spectral_radius == pytest.approx(expected, abs=1e-6)

    def test_every_hand_is_looked_at(self) -> None:
        hands, masses = 5, 520
        ends = [[i - 1 if i > hands else -1, i] for i in range(hands, hands + masses)] + [[hands + masses - 1, -1]]
        ends += [[hand, -1] for hand in range(hands)]
        stiffness = [1000.0] * (masses + 1) + [500.0] * 4 + [2100.0]
        damping = [0.1] * (masses + 1) + [2.0] * 5
        network = Network(
            RATE, [0.2] * hands, [1.0] * hands, 1.0, "zoh", "ideal", [0.01] * masses, ends, stiffness, damping
        )
        assert is_large(network)
        assert self.by_every_pole(network) > 1.0001
        assert not solve(network).is_stable

    def test_one_growing_oscillator_among_hundreds_is_seen(self) -> None:
        count = 520
        stiffness = np.geomspace(100.0, 30000.0, count)
        damper = [damper_named("backward", None, RATE)] * count
        damper[502] = damper_named("centred", None, RATE)
        ends = [[i, -1] for i in range(count)]
        network = Network(
            RATE, [], [], 0.0, "zoh", "ideal", [0.01] * count, ends, stiffness, [0.05] * count, (), damper
        )
        assert is_large(network)
        expected = self.by_every_pole(network)
        assert expected > 1.0001
        assert not solve(network).is_stable

    def test_a_motion_that_dies_away_slowly_is_not_called_growing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sample, "LARGE", 300)
        slow = string(200, 0.001, held=100)
        solution = solve(slow)
        assert is_large(slow)
        assert self.by_every_pole(slow) < 1.0
        assert solution.is_stable
        assert "grows by more than" in solution.method


def test_a_steady_push_meets_the_same_on_sparse_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    held, loose = string(30, 0.1, held=7), string(30, 0.1, held=7)
    loose.stiffness[20] = 0.0  # nothing holds the part beyond but the other ground
    loose.stiffness[-3] = 0.0  # nor this one: the masses between are free
    expected = [steady_stiffness(one) for one in (held, loose)]
    monkeypatch.setattr(sample, "LARGE", 50)
    for one, dense in zip((held, loose), expected, strict=True):
        np.testing.assert_allclose(steady_stiffness(one), dense, rtol=1e-9)


def test_few_masses_behind_a_long_delay_have_the_poles_of_their_transition(monkeypatch: pytest.MonkeyPatch) -> None:
    one = string(1, 0.1, held=0, delay=55.0, substeps=3, decimation="last")
    every = solve(one).poles
    monkeypatch.setattr(sample, "LARGE", 50)
    monkeypatch.setattr(large_modes, "MOST_STEPS", 3000)
    some = solve(one)
    assert some.method
    assert abs(some.poles[0] - every[0]) < 1e-9
    assert nearest(some.poles, every).max() < 1e-8
