"""The force law on the board, beside a loop that is written out event by event."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from hapsim.theory import Configuration, Network
from hapsim.theory.interface import BoardLaw
from hapsim.theory.network import felt_pair, margins_of, poles_of
from hapsim.theory.network.impedance import device_matrix, loop_impedance
from hapsim.theory.network.scene_passivity import HeldScene, passivity_of
from tests.board_loops import T, Written, one_sample, random_scene
from tests.networks import network_of


def apart(scene: Written) -> float:
    """Largest distance of a pole that lasts, of one loop, to the nearest of the other."""
    both = np.linalg.eigvals(one_sample(scene)), poles_of(scene.network())
    lasting = [one[np.abs(one) > 0.6] for one in both]
    assert all(one.size for one in lasting)
    return max(np.abs(other[:, None] - one).min(axis=0).max() for one, other in zip(lasting, both[::-1], strict=True))


def test_the_poles_are_those_of_a_loop_that_is_written_out() -> None:
    rng = np.random.default_rng(72)
    assert max(apart(random_scene(rng)) for _ in range(300)) < 1e-9


def coupled(rng: np.random.Generator, **changed: Any) -> Written:
    """A hand on a coupling, a proxy on a wall."""
    K, its = float(10 ** rng.uniform(2.5, 3.8)), BoardLaw(10, 1, int(rng.choice([1, 10])))
    wall = 0, -1, float(rng.choice([0.0, 10 ** rng.uniform(2, 5)])), float(rng.choice([0.0, 5.0]))
    links = [(0, 1, K, float(K * T * rng.uniform(0.02, 0.4))), (1, *wall[1:])]
    given = Written([0.2], [1.0], [0.0], [float(10 ** rng.uniform(-3, -1))], links, 10 * int(rng.integers(0, 4)), its)
    return given._replace(implicit=True, **changed)


def test_a_proxy_behind_a_line_is_that_of_the_loop_that_is_written_out() -> None:
    rng = np.random.default_rng(5)
    assert max(apart(coupled(rng, springs=[300.0])) for _ in range(30)) < 1e-9


@pytest.mark.parametrize("window", [1, 10])
def test_a_hand_on_a_ground_is_in_the_loop_of_the_board_alone(window: int) -> None:
    local = Configuration(0.2, 10.0 / T, 1.0, 1.0, window=window)
    poles = local.poles(2000.0, 5.0) ** 10
    for late in (0, 10, 13, 170):
        of_scene = Written([0.2], [1.0], [0.0], [], [(0, -1, 2000.0, 5.0)], late, BoardLaw(10, 1, window)).network()
        assert [np.abs(poles_of(of_scene) - one).min() for one in poles[:2]] == pytest.approx([0.0, 0.0], abs=1e-12)
        pair, alone = felt_pair(of_scene), local.equivalent(2000.0, 5.0)
        assert (pair.k[0, 0], pair.b[0, 0]) == pytest.approx(alone, rel=1e-9)
    expected = {1: (2009.843658662, 5.727012989), 10: (2033.138, 5.7813)}[window]
    assert local.equivalent(2000.0, 5.0) == pytest.approx(expected, rel={1: 1e-9, 10: 1e-5}[window])
    stiffest = local.stable_stiffness(5.0)[1]
    assert stiffest == pytest.approx({1: 39_894.456, 10: 38_408.0}[window], rel={1: 1e-7, 10: 1e-5}[window])
    assert margins_of(of_scene).links[0].stiffness_factor == pytest.approx(stiffest / 2000.0, rel=1e-6)


@pytest.mark.parametrize(
    ("late", "stiffest", "by_host"), [(1, 27_623.2, 5365.4), (2, 13_452.2, 3307.8), (5, 5100.9, 901.7)]
)
def test_a_mass_behind_the_line_limits_its_stiffness(late: int, stiffest: float, by_host: float) -> None:
    its = BoardLaw(10, 1, 1)

    def growth(K: float, **law: Any) -> float:
        links = [(0, 1, K, 5.0), (1, -1, 3000.0, 2.0)]
        of_scene = Written([0.2], [1.0], [0.0], [0.5], links, 10 * late, its).network(**law)
        return float(np.abs(poles_of(of_scene)).max()) - 1.0

    assert brentq(growth, 0.9 * stiffest, 1.1 * stiffest) == pytest.approx(stiffest, rel=1e-5)
    held = brentq(lambda K: growth(K, board=None), 0.9 * by_host, 1.1 * by_host)
    assert held == pytest.approx(by_host, rel=1e-4)


def test_the_impedance_of_a_line_to_a_ground_is_that_of_the_loop_of_the_board() -> None:
    f, local = np.array([0.1, 10.0, 123.0, 400.0]), Configuration(0.2, 10.0 / T, 1.0, 2.0, window=3, stiffness=300.0)
    scene = Written([0.2], [1.0], [300.0], [], [(0, -1, 2000.0, 5.0)], 13, BoardLaw(10, 2, 3))
    found, own = loop_impedance(scene.network(), f).rendered[:, 0, 0], 1.0 + 300.0 / (2j * np.pi * f)
    assert found + own == pytest.approx(local.impedance(2000.0, 5.0, f), rel=1e-9)
    driven = HeldScene(scene.network()).driving_impedance(2.0 * np.pi * f * T, 0)
    assert driven == pytest.approx(0.2 * 2j * np.pi * f + local.impedance(2000.0, 5.0, f), rel=1e-9)


def test_scene_and_device_answer_each_other_at_every_pole() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        of_scene = random_scene(rng).network()
        poles = poles_of(of_scene)
        w = poles[(np.abs(poles) > 0.7) & (poles.imag > 0.01)] - 1.0

        def met(w: NDArray, scene: Network = of_scene) -> NDArray:
            return np.abs(np.linalg.det(HeldScene(scene).forces(w) + device_matrix(scene)(w)))

        assert (met(w) < 1e-3 * met(w + 1e-4)).all()


def test_no_hand_shakes_a_scene_with_the_friction_that_it_needs() -> None:
    """Chains of masses and springs without losses; with a tenth less friction one of them does."""
    rng, shaken = np.random.default_rng(8), []
    for _ in range(25):
        scene = coupled(rng)
        needed = passivity_of(HeldScene(scene.network())).friction
        if not np.isfinite(needed):
            continue
        for _ in range(12):
            chain = tuple((10 ** rng.uniform(-3, 0), 10 ** rng.uniform(2, 6)) for _ in range(rng.integers(0, 3)))
            held = scene._replace(
                masses=[10 ** rng.uniform(-2, 0.5)], springs=[rng.choice([0.0, 10 ** rng.uniform(1, 5.5)])]
            )
            held = held._replace(chains=(chain,))
            assert np.abs(np.linalg.eigvals(one_sample(held._replace(frictions=[1.001 * needed])))).max() < 1.0 + 1e-9
            less = held._replace(frictions=[0.9 * needed])
            shaken.append(np.abs(np.linalg.eigvals(one_sample(less))).max())
    assert len(shaken) > 100
    assert max(shaken) > 1.0 + 1e-6


def test_a_coupling_to_a_fixed_thing_may_be_ten_times_as_stiff() -> None:
    K = 7698.003589
    wall = Written([0.2], [1.0], [0.0], [], [(0, -1, K, 0.366025404 * K * T / 10.0)], 10, BoardLaw(10, 1, 1))
    assert passivity_of(HeldScene(wall.network())).friction == pytest.approx(0.9295583782, rel=1e-9)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"hold": "ramp"}, "board needs a zoh hold"),
        ({"sampling": "average"}, "board needs a zoh hold"),
        ({"delay": 1.04}, "whole local periods of delay"),
        ({"decimation": "mean"}, "the force of the last step"),
        ({"rows": np.eye(1), "ends": ()}, "board takes no rows"),
    ],
)
def test_what_the_board_cannot_do_is_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        network_of(board=BoardLaw(10, 1, 1), **changed)
