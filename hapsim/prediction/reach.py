"""How far from each other the points of a scene can be, and where each link's distance begins."""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterator

import numpy as np

from hapsim.laws import Linear
from hapsim.prediction.linear import STAYS, LinearScene
from hapsim.prediction.pieces import Option
from hapsim.scene import Scene
from hapsim.theory.arrays import Floats

_FIXED = "."  # whatever stays where it is; no point is called so
_MEETS = 1e-12  # m: what overlaps by less does not


class Reach:
    """How far from each other the ends of a scene's contacts can be.

    Attributes:
        apart: (n, n): m, by how much the first may be further than the second from where each begins; n - 1 points
            that contacts touch, and what is fixed.
    """

    def __init__(self, scene: Scene, linear: LinearScene, contacts: Collection[str]) -> None:
        self._begins = beginnings(scene)
        touched = {end for name in contacts for end in linear.links[name].between if end not in scene.grounds}
        self._index = {name: i for i, name in enumerate((*sorted(touched), _FIXED))}
        near: dict[str, list[tuple[str, float]]] = {}
        for first, second, least, most in self._limits(scene, linear, contacts):
            near.setdefault(second, []).append((first, most))
            near.setdefault(first, []).append((second, -least))
        ways = [_least_ways(near, name) for name in self._index]
        self.apart = np.array([[way.get(name, math.inf) for way in ways] for name in self._index])

    def _limits(
        self, scene: Scene, linear: LinearScene, contacts: Collection[str]
    ) -> Iterator[tuple[str, str, float, float]]:
        """Two points, and between which distances from where they begin to each other they stay, m."""
        for name, hand in scene.device_points.items():
            low, high = scene.device.travels(scene.channels)[hand.channel]
            begins = self._begins[name]
            yield name, _FIXED, low - begins, high - begins
        fast = {name: (abs(point.start()[1]), point.mass) for name, point in scene.material_points.items()}
        named = [*linear.links.items(), *(("", link) for link in linear.inner)]
        for (name, link), stretch in zip(named, stretches_at_the_beginning(scene, linear), strict=True):
            if name in contacts:
                continue
            first, second = (_FIXED if end in linear.fixed else end for end in link.between)
            # A hand goes where it likes: what ties a mass to it says nothing of where that is.
            if link.stiffness > 0.0 and first != second and not {first, second} & scene.device_points.keys():
                speeds = (fast.get(end, (0.0, 0.0)) for end in link.between)
                swung = sum(v * math.sqrt(m / link.stiffness) for v, m in speeds)
                way = 2.0 * (scene.device.force_limit / link.stiffness + abs(stretch) + swung)
                yield first, second, -way, way

    def met(self, between: tuple[str, str], options: tuple[Option, ...]) -> tuple[Option, ...]:
        """These without those for which the ends have to meet, or to move by more, where they cannot."""
        begins = self._begins[between[0]] - self._begins[between[1]]
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        options = tuple(one for one in options if one.moved <= self.apart[i, j] + self.apart[j, i])
        meet = self.limited(self.apart, between, Option("", Linear(0.0, 0.0), -2.0 * _MEETS, 2.0 * _MEETS)) is not None
        return tuple(one for one in options if not one.through or meet or one.low <= begins <= one.high)

    def limited(self, apart: Floats, between: tuple[str, str], option: Option) -> Floats | None:
        """`apart` where this link is in such a piece; None where it cannot be."""
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        begins = self._begins[between[0]] - self._begins[between[1]]
        for one, other, most in ((i, j, option.high - begins), (j, i, begins - option.low)):
            if apart[other, one] + most <= _MEETS:
                return None
            if most < apart[one, other]:
                apart = np.minimum(apart, apart[:, [one]] + most + apart[[other], :])
        return apart


def stretches_at_the_beginning(scene: Scene, linear: LinearScene) -> Floats:
    """(L,): m, from rest, of the scene's links and of what its structures and material points consist of."""
    begins, found = beginnings(scene), []
    for link in (*linear.links.values(), *linear.inner):
        first, second = ("" if end == STAYS else end for end in link.between)
        name = first or second
        if first and second:
            found.append(begins[first] - begins[second])
        elif (point := scene.material_points.get(name)) is None:
            found.append((begins[name] - scene.structures[name.partition(".")[0]].position) * (1.0 if first else -1.0))
        else:
            held = point.held_by()
            found.append(0.0 if held is None else begins[name] - held.rest)
    return np.array(found)


def beginnings(scene: Scene) -> dict[str, float]:
    """Where each point of the scene is when it begins, m: a hand at 0, or as near as its travel lets it."""
    found = {name: ground.position for name, ground in scene.grounds.items()}
    for name, point in scene.device_points.items():
        low, high = scene.device.travels(scene.channels)[point.channel]
        found[name] = min(max(0.0, low), high)
    found |= {name: mass.start()[0] for name, mass in scene.material_points.items()}
    for name, structure in scene.structures.items():
        places = (f"{name}.{place}" for place in structure.point_names())
        found |= dict(zip(places, structure.initial_positions(), strict=True))
    return found


def _least_ways(near: dict[str, list[tuple[str, float]]], start: str) -> dict[str, float]:
    """From `start` to every point that limits reach, the least sum of them (Dijkstra, 1959)."""
    found: dict[str, float] = {}
    waiting = [(0.0, start)]
    while waiting:
        way, name = heapq.heappop(waiting)
        if name not in found:
            found[name] = way
            for other, more in near.get(name, ()):
                if other not in found and math.isfinite(more):
                    heapq.heappush(waiting, (way + more, other))
    return found
