"""Strings, stiff strings and membranes, against the masses and links that they stand for."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.program import parameter_values
from hapsim.running.changed_scene import differs_in_live_parameters_alone

sys.path.insert(0, str(Path(__file__).parent))
from structure_scenes import CASES, SAMPLES, TWO_ENDS, Numbers, many_structures, places_of
from written import run_of, scene_of, written_out


def hand_moving(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """Slowly by 5 cm, faster by less, and a noise of 0.1 mm."""
    n = np.arange(samples)
    return 0.05 * np.sin(0.003 * n) + 0.005 * np.sin(0.31 * n) + 1e-4 * rng.normal(size=samples)


def changed(rng: np.random.Generator, modules: Mapping[str, Any]) -> dict[str, Any]:
    """Every live value of the structures a little another."""
    live = ("stiffness", "damping", "friction")
    return {
        name: {key: value * rng.uniform(0.7, 1.1) if key in live else value for key, value in module.items()}
        if module["type"] in ("string", "membrane")
        else module
        for name, module in modules.items()
    }


DOUBLE = [("double", 1e-12, *case) for case in CASES]
SINGLE = [("single", 1e-5, *case) for case in CASES[::4]]


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(("precision", "bound", "ends", "edges"), DOUBLE + SINGLE)
def test_a_structure_moves_as_the_masses_and_links_that_it_stands_for(
    precision: str, bound: float, ends: tuple[str, str], edges: Sequence[tuple[str, ...]]
) -> None:
    """The bound of single precision: roundings of 6e-8, which a slow mode makes larger until it dies away."""
    rng = np.random.default_rng(TWO_ENDS.index(ends))
    modules = many_structures(rng, ends, edges)
    before, after = scene_of(modules, precision=precision), scene_of(changed(rng, modules), precision=precision)
    hand = hand_moving(rng)

    def change(n: int, values: np.ndarray) -> None:
        if n == SAMPLES // 2:
            values[:] = parameter_values(after)

    run = run_of(before, hand, at_sample=change)
    written = [written_out(scene) for scene in (before, after)]
    ours, place = written[0].places(run.names), written[0].place("hand")
    x, old = written[0].rest.copy(), written[0].rest.copy()
    x[place] = old[place] = hand[0]
    worst = worst_force = 0.0
    for n in range(SAMPLES):
        x[place] = hand[n]
        following, force = written[n >= SAMPLES // 2].follow(x, old)
        old, x = x, following
        worst = max(worst, float(np.max(np.abs(run.positions[n + 2] - x[ours]))))
        worst_force = max(worst_force, abs(run.forces[n] - force[place]))
    assert worst <= bound * np.max(np.abs(run.positions))
    assert worst_force <= bound * np.max(np.abs(run.forces))
    assert np.max(np.abs(run.positions)) < 0.5


@pytest.mark.parametrize(("at", "ends"), [(0, ("fixed", "free")), (6, ("fixed", "fixed")), (19, ("clamped", "free"))])
@pytest.mark.parametrize("bending", [0.0, 500.0])
def test_a_plucked_string_begins_at_rest_in_its_triangle(at: int, ends: tuple[str, str], bending: float) -> None:
    values = {**Numbers(a=0.45).values(0.02), "bending": bending, "position": 0.03}
    string = {"type": "string", "masses": 20, "ends": list(ends), "pluck": {"at": at, "by": 0.004}, **values}
    scene = scene_of({"s": string})
    run = run_of(scene, np.zeros(200))
    corner = np.interp(np.arange(20), [-1, at, 20], [0.0, 0.004, 0.0])
    np.testing.assert_allclose(run.positions[0], 0.03 + corner, rtol=1e-15)
    np.testing.assert_array_equal(run.positions[1], run.positions[0])
    written = written_out(scene)
    x = written.rest.copy()
    x[written.places(run.names)] = run.positions[0]
    old = x
    for n in range(200):
        old, x = x, written.follow(x, old)[0]
        np.testing.assert_allclose(run.positions[n + 2], x[written.places(run.names)], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["s5", "s5b", "m2"])
def test_what_is_not_a_number_goes_on_to_all_that_it_holds(name: str) -> None:
    rng = np.random.default_rng(5)
    modules = many_structures(rng, ("fixed", "free"), [("fixed", "free", "free", "fixed")])
    scene = scene_of(modules)
    place = places_of(modules[name])[-1]
    run = run_of(scene, np.zeros(100), {f"{name}.{place}": (np.nan, np.nan)})
    ours = [i for i, point in enumerate(run.names) if point.startswith(f"{name}.")]
    assert np.isnan(run.positions[-1, ours]).all()
    assert np.isnan(run.forces[-1])


def test_with_and_without_bending_a_string_is_another_structure() -> None:
    """Bending is another recurrence, over two neighbours to each side."""
    now, wanted = (scene_of({"s": {"type": "string", "masses": 3, **Numbers(a=0.1, g=g).values(1.0)}}) for g in (0, 1))
    assert not differs_in_live_parameters_alone(now, wanted)
    assert differs_in_live_parameters_alone(now, now)
