"""Modules that are too stiff, or damp too much, for CORDIS's scheme by themselves, and how many substeps carry them.

In a step of T a mode of M x'' = -K x - B v, between hands that hold still, passes z = -1 where K T² + 2 B T > 4 M.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from hapsim.number_format import frequency, number, rounded_down
from hapsim.prediction.linear import linear_scene, network_of
from hapsim.scene import Scene
from hapsim.theory import Network
from hapsim.theory.network.network import BACKWARD
from hapsim.theory.schemes import SCHEMES

_MOST = 4.0  # of (K T² + 2 B T)/M
_DENSE = 500  # masses, of which the largest value is found at once; of more by iteration
_MOST_SUBSTEPS = 1000  # of a scene


def own_limits(scene: Scene) -> Iterator[str]:
    """Yields a sentence for each module of `scene` that passes its own limit; where none does, but all of them together
    do, for the one that comes nearest."""
    linear = linear_scene(scene)
    if SCHEMES[scene.scheme] is not None or not linear.masses:
        return
    network, _ = network_of(scene, linear)
    owner = np.array([*linear.links, *(one.between[0].partition(".")[0] for one in linear.inner)])
    every, rate = np.full(owner.size, True), scene.step_rate
    found = {name: _largest(network, owner == name, rate) for name in dict.fromkeys(owner.tolist())}
    whole = _largest(network, every, rate)
    if not whole > _MOST:
        return
    steps, largest = scene.substeps, whole
    while largest > _MOST and steps <= _MOST_SUBSTEPS:
        steps = max(steps + 1, math.floor(steps * math.sqrt(largest / _MOST)))  # never beyond what springs need
        largest = _largest(network, every, steps * scene.rate)
    remedy = f"{steps} substeps in place of {scene.substeps} carry it" if steps <= _MOST_SUBSTEPS else "add mass there"
    for name in [one for one in found if found[one] > _MOST] or [max(found, key=found.__getitem__)]:
        own, alone = owner == name, found[name] > _MOST
        stiffness, damping = (float(values[own].max()) for values in (network.stiffness, network.damping))
        damps = 2.0 * damping * rate > stiffness
        value, unit = (damping, "N·s/m") if damps else (stiffness, "N/m")
        most = f"more than the {rounded_down(value * _MOST / found[name], 5)} {unit} that its masses carry"
        why = most if alone else "with what it is joined to, more than its masses carry"
        yield f"{name}: {number(value)} {unit} is {why} in steps of {frequency(rate)}; {remedy}."


def _largest(network: Network, links: Any, rate: float) -> float:
    """The largest (K T² + 2 B T)/M of a mode of these links, (L,) bools, at `rate` Hz. A damper that remembers
    more than one position does not count: at z = -1 it damps less, or not at all."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import svds

    hands = network.channel_mass.size
    links = np.flatnonzero(links & (network.ends.max(axis=1) >= hands))
    plain = np.array([network.damper[link] == BACKWARD for link in links])
    weight = network.stiffness[links] / rate**2 + 2.0 * network.damping[links] * plain / rate
    ends = network.ends[links] - hands
    row, side = np.nonzero(ends >= 0)
    mass = ends[row, side]
    entry = np.sqrt(np.maximum(weight[row], 0.0) / network.point_mass[mass]) * (1.0 - 2.0 * side)
    _, column = np.unique(mass, return_inverse=True)
    matrix = coo_array((entry, (row, column)), shape=(links.size, column.max(initial=0) + 1)).tocsr()
    if min(matrix.shape) <= _DENSE:
        return float(np.linalg.norm(matrix.toarray(), 2)) ** 2 if links.size else 0.0
    return float(svds(matrix, 1, return_singular_vectors=False, tol=1e-3)[0]) ** 2
