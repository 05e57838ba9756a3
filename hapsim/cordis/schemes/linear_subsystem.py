"""The linear subsystem of a scene, in matrices: M x'' + B x' + K x = f.

It contains the points that the scene moves, and their linear joins to each other, to grounds and to their rest
positions: links inside structures, the springs of cells, and links with only a spring and a backward damper. All others
act from outside, and so does the position of a ground, which may change while the scene runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.cordis.build_context import BuildContext, PresentType, Scheme, masses_of
from hapsim.cordis.dispatch import Batch, Column
from hapsim.errors import UsageError
from hapsim.scene import Scene

FIXED = -1


class Ties(NamedTuple):
    """L inner links to grounds: point and ground by number, K and B/T in N/m. A moving ground pulls the point."""

    point: NDArray[np.uint32]
    ground: NDArray[np.uint32]
    stiffness: Column
    damping_per_sample: Column


class LinearSubsystem(NamedTuple):
    """n points, and L springs and dampers that join them.

    Attributes:
        point, mass: (n,) by number, rising; kg.
        ends: (L, 2) places among the points, or STAYS.
        stiffness, damping: (L,) N/m and N·s/m.
        force: (n,) N, constant, from the rest positions of structures.
        loaded: (P,) places of the points with a force from outside.
        position, velocity: (n,) m and m/s at the first sample.
    """

    point: NDArray[np.uint32]
    mass: NDArray[np.float64]
    ends: NDArray[np.intp]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]
    force: NDArray[np.float64]
    ties: Ties
    loaded: NDArray[np.uint32]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]

    def stretches(self) -> Any:
        """Returns the sparse (L, n) matrix from positions to the links' stretches."""
        from scipy.sparse import coo_array

        link, end = np.nonzero(self.ends != FIXED)
        place = self.ends[link, end]
        return coo_array((1.0 - 2.0 * end, (link, place)), (len(self.ends), self.point.size)).tocsr()

    def matrix_of(self, values: NDArray[np.float64]) -> Any:
        """Returns K in N/m, or B in N·s/m, sparse (n, n), from a stiffness or a damping for each link."""
        from scipy.sparse import diags_array

        spread = self.stretches()
        return (spread.T @ diags_array(values) @ spread).tocsr()


def _inner_links(scene: Scene) -> dict[str, Any]:
    """Returns the scene's links inside the subsystem, by name."""
    hands = scene.device_points.keys()
    outside = ((name, link) for name, link in scene.links.items() if hands.isdisjoint(link.between))
    return {name: link for name, link in outside if link.law().in_a_matrix}


def inside(scene: Scene) -> frozenset[str]:
    """Returns the names of the subsystem's modules, without points that pull themselves: only their mass is in it."""
    points = [name for name, point in scene.material_points.items() if not point.pulls_itself]
    return frozenset([*points, *scene.structures, *_inner_links(scene)])


def matrix_scheme(part_of: Callable[[LinearSubsystem, BuildContext], Batch]) -> Scheme:
    """Returns the scheme that turns the linear subsystem into matrices. `part_of`: makes the part that moves it."""

    def parts(scene: Scene, context: BuildContext, present: Sequence[PresentType]) -> tuple[Batch, ...]:
        outside = tuple(one.build(context) for one in present if not one.kind.moves_points)
        inner = _linear_subsystem(scene, context)
        return outside if inner is None else (*outside, part_of(inner, context))

    return Scheme(parts, inside)


def _linear_subsystem(scene: Scene, context: BuildContext) -> LinearSubsystem | None:
    """Returns the subsystem of `scene` at the program's positions; None if the scene moves nothing."""
    mass = {context.number[name]: kilograms for name, kilograms in masses_of(scene)}
    if not mass:
        return None
    point = np.array(sorted(mass), np.uint32)
    place = {int(number): i for i, number in enumerate(point)}
    joins = list(_joins(scene, context, place))
    ends = np.array([(first, second) for first, second, *_ in joins], np.intp).reshape(-1, 2)
    stiffness, damping = (np.array([join[column] for join in joins], np.float64) for column in (2, 3))
    position = context.state.position[point].astype(np.float64)
    velocity = context.rate * (position - context.state.previous[point])
    force = np.zeros(point.size)
    for first, second, k, _, rest in joins:
        if second == FIXED:
            force[first] += k * rest
    for name, one in scene.material_points.items():
        velocity[place[context.number[name]]] = one.start()[1]  # to the last digit, whatever the rows' precision
    ties, held = _ties(scene, context), inside(scene)
    outer = {end for name, link in scene.links.items() if name not in held for end in link.between}
    outer |= {name for name, point in scene.material_points.items() if point.pulls_itself}
    outer |= {one.point for one in scene.sound.values()}
    loaded = {context.number[end] for end in outer} | {int(p) for p in ties.point}
    return LinearSubsystem(
        point=point,
        mass=np.array([mass[int(number)] for number in point]),
        ends=ends,
        stiffness=stiffness,
        damping=damping,
        force=force,
        ties=ties,
        loaded=np.array(sorted(place[number] for number in loaded if number in place), np.uint32),
        position=position,
        velocity=velocity,
    )


TOO_LARGE = "a stiffness, a damping or one over a mass is too large for the scene's scheme: try cordis"


def require_finite(*arrays: Any) -> None:
    """Raises UsageError if a number of the subsystem is not finite."""
    if not all(np.isfinite(array).all() for array in arrays):
        raise UsageError(TOO_LARGE)


def _joins(
    scene: Scene, context: BuildContext, place: Mapping[int, int]
) -> Iterator[tuple[int, int, float, float, float]]:
    """Yields the links inside: first place, second or FIXED, N/m, N·s/m, and the fixed end's position, m. The position
    of a ground acts as a force from outside, so here it is 0."""
    structures: Mapping[str, Any] = scene.structures
    for name, structure in structures.items():
        places = [place[context.number[f"{name}.{each}"]] for each in structure.point_names()]
        for first, second, k, z in structure.elements().links:
            yield places[first], FIXED if second < 0 else places[second], k, z, structure.position
    for name, point in scene.material_points.items():
        held = point.held_by()
        if held is not None:
            yield place[context.number[name]], FIXED, *held
    for link in _inner_links(scene).values():
        first, second = (place.get(context.number[end], FIXED) for end in link.between)
        if first == FIXED:
            first, second = second, first
        yield first, second, *link.law().linear()[:2], 0.0


def _ties(scene: Scene, context: BuildContext) -> Ties:
    tied = []
    for link in _inner_links(scene).values():
        stiffness, damping, *_ = link.law().linear()
        for end, ground in (link.between, link.between[::-1]):
            if ground in scene.grounds:
                tied.append((context.number[end], context.number[ground], stiffness, damping * context.rate))
    point, ground, k, b = np.array(tied, np.float64).reshape(-1, 4).T
    return Ties(point.astype(np.uint32), ground.astype(np.uint32), context.column(k), context.column(b))


@inlined
def add_tie_forces(ties, state):
    """Adds the forces of the grounds' positions and velocities on the points that are tied to them."""
    for i in range(np.uint64(ties.point.size)):
        x = state.position[ties.ground[i]]
        way = x - state.previous[ties.ground[i]]
        state.force[ties.point[i]] += ties.stiffness[i] * x + ties.damping_per_sample[i] * way
