"""Strings, stiff strings and membranes keep the scheme's energy and, where nothing holds them, their momentum."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from structure_scenes import AT_REST, CASES, many_structures
from written import RATE, run_of, scene_of, written_out


def undamped(rng: np.random.Generator, ends: tuple[str, str], edges: Sequence[tuple[str, ...]]) -> Scene:
    modules = many_structures(rng, ends, edges, with_links=False)
    return scene_of({name: {**module, "damping": 0.0, "friction": 0.0} for name, module in modules.items()})


def masses_and_springs(rng: np.random.Generator) -> Scene:
    """40 masses and 100 springs between any two of them, and a ground."""
    names = [f"m{i}" for i in range(40)]
    modules: dict[str, Any] = {name: {"type": "mass", "mass": float(rng.uniform(0.5, 1.0))} for name in names}
    modules["wall"] = {"type": "ground", "position": 0.01}
    for i in range(100):
        ends = rng.choice([*names, "wall"], 2, replace=False).tolist()
        stiffness = float(rng.uniform(0.0, 0.1)) * RATE**2
        modules[f"l{i}"] = {"type": "viscoelastic", "between": ends, "stiffness": stiffness}
    return scene_of(modules)


def thrown(rng: np.random.Generator, scene: Scene) -> dict[str, tuple[float, float]]:
    """Every mass somewhere within 1 cm, under way at up to 1 m/s."""
    written = written_out(scene)
    begin = {}
    for name in written.moved:
        now = written.rest[written.place(name)] + rng.uniform(-0.01, 0.01)
        begin[name] = (now, now - rng.uniform(-1.0, 1.0) / RATE)
    return begin


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("which", [*CASES, None], ids=lambda case: "network" if case is None else "-".join(case[0]))
def test_without_damping_the_energy_of_the_scheme_is_kept(which: tuple[Any, Any] | None) -> None:
    """m (x[n+1] - 2 x[n] + x[n-1])/T² = -K x[n], times x[n+1] - x[n-1] and added up over all masses, says that

    E[n] = Σ m/2 ((x[n+1] - x[n])/T)² + x[n+1] · K x[n] / 2

    is the same in every sample.
    """
    rng = np.random.default_rng(7)
    scene = masses_and_springs(rng) if which is None else undamped(rng, *which)
    run = run_of(scene, AT_REST, thrown(rng, scene))
    written = written_out(scene)
    K = written.K.tolil()
    held = written.inverse_mass == 0
    shift = written.rest.copy()  # what is held stays at rest, whatever else moves
    ours = written.places(run.names)
    x = np.tile(shift, (len(run.positions), 1))
    x[:, ours] = run.positions
    mass = np.where(held, 0.0, 1.0 / np.where(held, 1.0, written.inverse_mass))
    if which is None:
        # Away from where all springs are at rest together.
        assert np.count_nonzero(held) == 2
    K = K.tocsr()
    kinetic = (np.diff(x, axis=0) * RATE) ** 2 @ mass / 2.0
    potential = np.einsum("ni,ni->n", x[1:], (K @ x[:-1].T).T) / 2.0
    energy = kinetic + potential
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)


@pytest.mark.parametrize("friction", [0.0, 1e-3])
def test_what_nothing_holds_keeps_its_momentum(friction: float) -> None:
    """Whatever its links do, dampers too. With friction e of the mass in each sample, it is 1 - e of what it was."""
    rng = np.random.default_rng(8)
    modules = many_structures(rng, ("free", "free"), [("free",) * 4], with_links=False)
    modules = {name: {**one, "friction": friction * one["mass"] * RATE} for name, one in modules.items()}
    scene = scene_of(modules)
    begin = thrown(rng, scene)
    for name in modules:  # on average they drift by 2 cm
        mean = np.mean([now - before for point, (now, before) in begin.items() if point.startswith(f"{name}.")])
        begin |= {
            point: (now, before + mean - 2e-6) for point, (now, before) in begin.items() if point.startswith(f"{name}.")
        }
    run = run_of(scene, AT_REST, begin)
    n = np.arange(len(run.positions) - 1)
    for name in modules:
        ours = [i for i, point in enumerate(run.names) if point.startswith(f"{name}.")]
        momentum = np.sum(np.diff(run.positions[:, ours], axis=0), axis=1)
        scale = np.sum(np.abs(np.diff(run.positions[:2, ours], axis=0)))
        expected = momentum[0] * (1.0 - friction) ** n
        np.testing.assert_allclose(momentum, expected, rtol=0.0, atol=1e-10 * scale)
