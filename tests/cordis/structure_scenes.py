"""Scenes of strings, stiff strings and membranes of every size, and links on them."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from written import RATE

SAMPLES = 2_000
ENDS = ("fixed", "clamped", "free")
TWO_ENDS = list(itertools.product(ENDS, repeat=2))
FOUR_EDGES = list(itertools.product(("fixed", "free"), repeat=4))
CASES = [(ends, (FOUR_EDGES[i], FOUR_EDGES[i + 7])) for i, ends in enumerate(TWO_ENDS)]  # every one, of either


class Numbers(NamedTuple):
    """T²/m times K, B/T, friction/T and the stiffness against bending: stable together."""

    a: float = 0.0
    b: float = 0.0
    e: float = 0.0
    g: float = 0.0

    def values(self, mass: float) -> dict[str, float]:
        """The fields of a module that has them."""
        values = {
            "mass": mass,
            "stiffness": self.a * mass * RATE**2,
            "damping": self.b * mass * RATE,
            "friction": self.e * mass * RATE,
        }
        return values | ({"bending": self.g * mass * RATE**2} if self.g else {})

    def pole_pair(self, spread: float) -> np.ndarray:
        """Returns the pole pair of a mode; `spread`: the stiffness of its links if each link has stiffness 1."""
        old = 1.0 - self.b * spread - self.e
        now = 1.0 + old - self.a * spread - self.g * spread**2
        return np.roots([1.0, -now, old])


def some(rng: np.random.Generator, *, bending: bool = False, neighbours: int = 2) -> Numbers:
    most = 2.0 / neighbours
    a, b, e = rng.uniform(0.05, 0.4) * most, rng.uniform(0.0, 0.05) * most, rng.uniform(0.01, 0.03)
    return Numbers(a, b, e, rng.uniform(0.005, 0.03) if bending else 0.0)


def many_structures(
    rng: np.random.Generator, ends: tuple[str, str], edges: Sequence[tuple[str, ...]]
) -> dict[str, Any]:
    """Strings with and without bending and membranes, of every size that a sweep treats in another way, and links."""
    structures: dict[str, Any] = {}
    sizes = [2, 5, 6, 7, 14, 15, 16, 17, 100, *rng.integers(3, 71, 2).tolist()]
    for (i, size), bending in itertools.product(enumerate(sizes), (False, True)):
        values = some(rng, bending=bending).values(rng.uniform(0.001, 0.1))
        where = {"position": float(rng.uniform(-0.02, 0.02)), "ends": list(ends)}
        structures[f"s{i}{'b' if bending else ''}"] = {"type": "string", "masses": size, **values, **where}
    areas = [(2, 2), (3, 5), (3, 7), (2, 14), (2, 15), (2, 16), tuple(rng.integers(2, 11, 2).tolist())]
    for i, ((rows, columns), held) in enumerate(zip(areas, itertools.cycle(edges), strict=False)):
        values = some(rng, neighbours=4).values(rng.uniform(0.001, 0.1))
        where = {"position": float(rng.uniform(-0.02, 0.02)), "edges": list(held)}
        structures[f"m{i}"] = {"type": "membrane", "rows": rows, "columns": columns, **values, **where}
    return structures | links_on(rng, structures)


def places_of(structure: Mapping[str, Any]) -> list[str]:
    if structure["type"] == "string":
        return [str(i) for i in range(structure["masses"])]
    return [f"{r}.{c}" for r in range(structure["rows"]) for c in range(structure["columns"])]


def links_on(rng: np.random.Generator, structures: Mapping[str, Any]) -> dict[str, Any]:
    """The hand, a ground and a mass on the first, the last and some other masses of each, and each on the next."""
    links: dict[str, Any] = {"wall": {"type": "ground", "position": 0.01}, "lump": {"type": "mass", "mass": 1.0}}
    names = list(structures)
    for i, name in enumerate(names):
        places = places_of(structures[name])
        other, mass = names[(i + 1) % len(names)], structures[name]["mass"]
        pairs = [("hand", places[0]), (f"{other}.{places_of(structures[other])[-1]}", places[-1])]
        pairs += [(end, str(rng.choice(places))) for end in ("wall", "hand", "lump")]
        mass = min(mass, structures[other]["mass"])
        for j, (end, place) in enumerate(pairs):
            links[f"l{i}_{j}"] = {
                "type": "viscoelastic",
                "between": [end, f"{name}.{place}"],
                "stiffness": 0.05 * mass * RATE**2 * float(rng.uniform(0.5, 1.0)),
                "damping": 0.02 * mass * RATE * float(rng.uniform(0.5, 1.0)),
            }
    return links
