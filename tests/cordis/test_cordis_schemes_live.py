"""Changes to a running scene under each scheme."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from hapsim.cordis.offline import start, tick, update_parameters
from hapsim.cordis.program import compile_scene, parameter_values, positions_of
from hapsim.cordis.schemes import SCHEMES

sys.path.insert(0, str(Path(__file__).parent))
from scheme_scenes import RATE, T, by_the_tick, chain, link, network, scene_of, strokes


@pytest.mark.parametrize("scheme", ["cordis", "semi_implicit", "rk4"])
def test_without_a_matrix_everything_may_change(scheme: str) -> None:
    scene = scene_of(scheme, network(0))
    changed = scene_of(scheme, network(0) | {"l0": network(0)["l0"] | {"stiffness": 1.0}})
    values = parameter_values(scene)
    program = compile_scene(scene, values)
    values[:] = parameter_values(changed)
    measured = strokes(2, 4)[:50]
    expected, _ = by_the_tick(changed, measured, [])
    start(program, measured[0])
    for n, now in enumerate(measured):
        force = np.zeros(2)
        tick(program, now, np.zeros(2), force)
        np.testing.assert_array_equal(force, expected[n])


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_a_ground_that_moves_pulls_what_is_tied_to_it(scheme: str) -> None:
    """A ground pulls by its position and its velocity: its position is a live value."""
    state = np.zeros(2)
    scene = chain(scheme, state, 1000.0, 2.0)
    program = compile_scene(scene)
    start(program, np.zeros(1))
    values = parameter_values(scene)
    values[0] = 0.01
    program.parameters.post(values, 1)
    update_parameters(program)
    tick(program, np.zeros(1), np.zeros(1), np.zeros(1))
    a = np.array(
        [[0.0, 1.0, 0.0], [-2 * 1e3 / 0.1, -2 * 2.0 / 0.1, (1e3 * 0.01 + 2.0 * 0.01 * RATE) / 0.1], [0.0, 0.0, 0.0]]
    )
    one = np.eye(3)
    step = expm(T * a) if scheme == "exact" else np.linalg.solve(one - 0.5 * T * a, one + 0.5 * T * a)
    now, before = positions_of(program)
    np.testing.assert_allclose([now[3], RATE * (now - before)[3]], step[:2, 2], rtol=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_scene_that_moves_nothing_needs_no_scheme(scheme: str) -> None:
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": link("hand", "wall", 5.0)}
    program = compile_scene(scene_of(scheme, modules))
    start(program, np.array([0.01]))
    force = np.zeros(1)
    tick(program, np.array([0.01]), np.zeros(1), force)
    assert force[0] == -0.05
