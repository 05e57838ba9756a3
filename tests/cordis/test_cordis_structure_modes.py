"""Strings, stiff strings and membranes in single precision, against their modes in closed form."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, numbers_of, positions_of

sys.path.insert(0, str(Path(__file__).parent))
from structure_scenes import FOUR_EDGES, Numbers, places_of
from written import scene_of


def of_a_string(ends: tuple[str, str], masses: int, k: int) -> tuple[np.ndarray, float]:
    """The shape of a mode, k = 1, 2, ..., and what links of stiffness 1 are in it together."""
    i = np.arange(masses)
    if ends == ("free", "free"):
        angle = (k - 1) * np.pi / masses
        shape = np.cos(angle * (i + 0.5))
    elif "free" in ends:
        angle = (2 * k - 1) * np.pi / (2 * masses + 1)
        shape = np.sin(angle * (i + 1))
        shape = shape if ends[1] == "free" else shape[::-1]
    else:
        angle = k * np.pi / (masses + 1)
        shape = np.sin(angle * (i + 1))
    return shape, 4.0 * np.sin(angle / 2.0) ** 2


class Swinging(NamedTuple):
    """A structure in one mode."""

    module: dict[str, Any]
    numbers: Numbers
    shape: np.ndarray
    spread: float


def swinging_strings(numbers: Numbers) -> list[Swinging]:
    swinging = []
    ends = [("fixed", "fixed"), ("fixed", "free"), ("free", "fixed"), ("free", "free")]
    for held, masses in itertools.product(ends, (2, 17, 100)):
        # The string that resists bending has modes in closed form on two hinges.
        if numbers.g and held != ("fixed", "fixed"):
            continue
        modes = {masses // 3 + 2, masses}
        if held != ("free", "free"):
            modes |= {1}
        for k in sorted(modes):
            if k <= masses:
                shape, spread = of_a_string(held, masses, k)
                module = {"type": "string", "masses": masses, "ends": list(held), **numbers.values(0.02)}
                swinging.append(Swinging(module, numbers, shape, spread))
    return swinging


def swinging_membranes(numbers: Numbers) -> list[Swinging]:
    swinging = []
    for edges in FOUR_EDGES:
        for (rows, columns), (k, j) in itertools.product([(2, 5), (17, 12)], [(1, 1), (2, 5)]):
            down, spread_down = of_a_string((edges[0], edges[1]), rows, k)
            along, spread_along = of_a_string((edges[2], edges[3]), columns, j)
            if spread_down + spread_along < 1e-12:
                continue
            module = {"type": "membrane", "rows": rows, "columns": columns, "edges": list(edges)}
            shape = np.outer(down, along).ravel()
            module |= numbers.values(0.02)
            swinging.append(Swinging(module, numbers, shape, spread_down + spread_along))
    return swinging


def identified(q: np.ndarray) -> complex:
    """The pole in the upper half plane of a recurrence q[n+1] - 2 q[n] + q[n-1] = -α q[n] - β (q[n] - q[n-1])."""
    growth = np.diff(q)
    alpha, beta = -np.linalg.lstsq(np.column_stack([q[1:-1], growth[:-1]]), np.diff(growth), rcond=None)[0]
    half = (2.0 - alpha - beta) / 2.0
    # 1 - half² would lose what makes a slow mode swing.
    below = (1.0 - beta) - half**2
    slow = alpha - (alpha + beta) ** 2 / 4.0
    return complex(half, np.sqrt(slow if slow > 0 else below))


def poles_of(swinging: list[Swinging]) -> list[complex]:
    """Each released in its mode's shape, 1 mm, all in one scene; the pole that is identified from each one's motion."""
    scene = scene_of({f"x{i}": one.module for i, one in enumerate(swinging)}, precision="single")
    numbers = numbers_of(scene)
    program = compile_scene(scene)
    shapes = []
    position, previous = positions_of(program)
    for i, one in enumerate(swinging):
        ours = np.array([numbers[f"x{i}.{place}"] for place in places_of(one.module)])
        position[ours] = previous[ours] = 1e-3 * one.shape
        shapes.append((ours, one.shape / (1e-3 * one.shape @ one.shape)))
    nothing = np.zeros(1)
    start(program, nothing)
    q = np.empty((4000, len(swinging)))
    for n in range(4000):
        tick(program, nothing, nothing, nothing)
        x = positions_of(program)[0]
        q[n] = [shape @ x[ours] for ours, shape in shapes]
    return [identified(column) for column in q.T]


def expected_pole(one: Swinging) -> complex:
    return complex(max(one.numbers.pole_pair(one.spread), key=lambda z: z.imag))


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    "swinging",
    [swinging_strings(Numbers(a=0.03)), swinging_strings(Numbers(a=0.03, g=0.01)), swinging_membranes(Numbers(a=0.03))],
    ids=["string", "stiff string", "membrane"],
)
def test_single_precision_keeps_the_frequency_of_a_slow_mode(swinging: list[Swinging], figures: Any) -> None:
    """The recurrence in differences keeps the frequency; coefficients of 32 bits would be wrong by 1e-3."""
    for one, z in zip(swinging, poles_of(swinging), strict=True):
        expected = np.angle(expected_pole(one))
        assert np.angle(z) == pytest.approx(expected, rel=1e-5)
        figures.most("a mode's frequency off by, relative, single precision", abs(np.angle(z) / expected - 1.0))
