"""Where a scene rests while its hands hold still, and what its links are there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import spsolve

from hapsim.errors import UsageError
from hapsim.laws import Law, Linear
from hapsim.scene import Scene
from hapsim.theory.arrays import Floats

_MOST_STEPS = 100
_AT_REST = 1e-12  # m, by which the last step still moves a mass
_HALVINGS = 30
_LEAST_STIFFNESS = 1e-9  # of the stiffest link: what holds a mass that nothing else holds


class _Springs(NamedTuple):
    """L links, the linear ones inside structures first; `laws` are those of the last ones."""

    joins: csr_array
    """(L, N): 1 at a link's first end, -1 at its second, where these are masses."""
    fixed: Floats
    """(L,): m, what ends that do not move add to its distance."""
    stiffness: Floats
    """(L,): N/m, of the linear ones."""
    laws: list[Law]

    def distances(self, x: Floats) -> Floats:
        """(L,): m, with the masses at x."""
        return np.asarray(self.joins @ x + self.fixed)

    def tensions(self, d: Floats) -> Floats:
        """(L,): N."""
        first = d.size - len(self.laws)
        of_laws = [float(law.tension(one)) for law, one in zip(self.laws, d[first:], strict=True)]
        return np.append(self.stiffness * d[:first], of_laws)

    def slopes(self, d: Floats) -> Floats:
        """(L,): N/m; 0 where the tension falls."""
        of_laws = [law.slope(float(one)) for law, one in zip(self.laws, d[-len(self.laws) :], strict=True)]
        return np.maximum(np.append(self.stiffness, of_laws), 0.0)

    def forces(self, x: Floats) -> Floats:
        """(N,): N on each mass."""
        return np.asarray(-(self.joins.T @ self.tensions(self.distances(x))))

    def stiffness_matrix(self, x: Floats) -> csc_array:
        """(N, N): N/m."""
        slopes = self.slopes(self.distances(x))
        least = _LEAST_STIFFNESS * max(float(slopes.max()), 1.0)
        return csc_array(self.joins.T @ diags_array(slopes) @ self.joins + least * eye_array(x.size))


def links_at_rest(scene: Scene, hands: Mapping[str, float]) -> dict[str, Linear]:
    """The spring and damper of each link of the scene, by name, as of `distances_at_rest`."""
    found = {}
    for name, d in distances_at_rest(scene, hands).items():
        law = scene.links[name].law()
        taken = f"is taken as {law.state(d)}, as it is where the masses rest" if law.assumption else ""
        found[name] = law.linear(d)._replace(assumption=taken)
    return found


def distances_at_rest(scene: Scene, hands: Mapping[str, float]) -> dict[str, float]:
    """m, of the ends of each link of the scene, by name, while the hands hold still at these places (m) and the masses
    rest. A link that sticks has no force there. UsageError where no rest is found."""
    number, start = _masses(scene)
    held = {name: ground.position for name, ground in scene.grounds.items()} | dict(hands)
    rows: list[tuple[int, int, float, float]] = []
    for name, structure in scene.structures.items():
        numbers = [*(number[f"{name}.{place}"] for place in structure.point_names()), -1]  # -1 is the last
        for a, b, k, _ in structure.elements().links:
            ends = numbers[a], numbers[b]
            rows.append((*ends, structure.position * ((ends[0] < 0) - (ends[1] < 0)), k))
    for name, point in scene.material_points.items():
        if (own := point.held_by()) is not None:
            rows.append((number[name], -1, -own.rest, own.stiffness))
    laws, linear = [link.law() for link in scene.links.values()], len(rows)
    for link in scene.links.values():
        first, second = link.between
        apart = held.get(first, 0.0) - held.get(second, 0.0)
        rows.append((number.get(first, -1), number.get(second, -1), apart, 0.0))
    table = np.array(rows, float).reshape(-1, 4)
    row, side = np.nonzero(table[:, :2] >= 0.0)
    joins = csr_array((1.0 - 2.0 * side, (row, table[row, side].astype(int))), shape=(len(rows), len(number)))
    springs = _Springs(joins, table[:, 2], table[:linear, 3], laws)
    d = springs.distances(_relaxed(springs, np.array(start)))[linear:]
    return dict(zip(scene.links, d.tolist(), strict=True))


def _masses(scene: Scene) -> tuple[dict[str, int], list[float]]:
    """The number of every mass, by the name of its point, and where it starts, m."""
    start = {name: point.start()[0] for name, point in scene.material_points.items()}
    for name, structure in scene.structures.items():
        start |= {f"{name}.{place}": structure.position for place in structure.point_names()}
    return {name: i for i, name in enumerate(start)}, list(start.values())


def _relaxed(springs: _Springs, x: Floats) -> Floats:
    """(N,): where the masses rest, m, by Newton's steps, each halved until the forces are less."""
    if not x.size:
        return x
    forces = springs.forces(x)
    for _ in range(_MOST_STEPS):
        step = np.atleast_1d(spsolve(springs.stiffness_matrix(x), forces))
        if float(np.max(np.abs(step))) <= _AT_REST:
            return x
        for _ in range(_HALVINGS):
            nearer = springs.forces(x + step)
            if float(np.abs(nearer).max()) < float(np.abs(forces).max()):
                break
            step = 0.5 * step
        x, forces = x + step, springs.forces(x + step)
    raise UsageError("at: no place was found where the scene's masses rest while the hand holds still there")
