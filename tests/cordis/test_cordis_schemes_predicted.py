"""Each scheme's tick against its formula: the matrix of a step, of which frequency and stability limit follow."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, positions_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
from scheme_formulas import spectral_radius, step_matrix, stiffness_limit
from scheme_scenes import RATE, T, chain


def step_of(scheme: str, count: int, stiffness: float, damping: float, rate: float = RATE) -> np.ndarray:
    """The matrix by which one tick takes (x, v) on."""
    columns = []
    for unit in np.eye(2 * count):
        columns.append(np.concatenate(after(chain(scheme, unit, stiffness, damping, rate), 1)))
    return np.array(columns).T


def after(scene: Scene, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """(x, v) of the masses."""
    program = compile_scene(scene)
    start(program, np.zeros(1))
    for _ in range(ticks):
        tick(program, np.zeros(1), np.zeros(1), np.zeros(1))
    now, before = positions_of(program)
    masses = [numbers_of(scene)[name] for name in scene.masses]
    return now[masses], scene.rate * (now - before)[masses]


def chain_matrices(count: int, stiffness: float, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = 2.0 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    return 0.1 * (1 + np.arange(count) % 2), stiffness * rows, damping * rows


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize(("count", "stiffness", "damping"), [(1, 2e4, 3.0), (2, 1e4, 5.0), (6, 3e4, 0.0)])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_tick_is_the_matrix_of_the_formula(scheme: str, count: int, stiffness: float, damping: float) -> None:
    found = step_of(scheme, count, stiffness, damping)
    expected = step_matrix(scheme, *chain_matrices(count, stiffness, damping), T)
    scale = np.repeat([1.0, T], count)  # (x, T v): both in metres
    normal = scale[:, None] * expected / scale
    np.testing.assert_allclose(scale[:, None] * found / scale, normal, atol=3e-13)
    assert spectral_radius(found) == pytest.approx(spectral_radius(expected), abs=1e-12)


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_no_stiffness_makes_an_implicit_scheme_unstable(scheme: str, damping: float) -> None:
    """A million times what CORDIS's scheme stands; without damping the energy stays what it was."""
    limit = stiffness_limit("cordis", 0.1, 0.0, T)
    state = np.concatenate([[0.01, -0.02, 0.01], np.zeros(3)])
    x, v = after(chain(scheme, state, 1e6 * limit, damping), 10_000)
    mass, K, _ = chain_matrices(3, 1e6 * limit, damping)
    energy = [x @ K @ x + v @ (mass * v), state[:3] @ K @ state[:3]]
    assert energy[0] <= energy[1] * (1.0 + 1e-9)
    if damping == 0.0:
        assert energy[0] == pytest.approx(energy[1], rel=1e-6)
