"""Words of `hapsim check` for what nothing holds: motions that rest anywhere, with a pole at 1."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from hapsim.cli.check_plane import angle
from hapsim.number_format import number
from hapsim.theory.network import is_large
from hapsim.theory.network.felt import matrices
from hapsim.theory.network.modes import AT_THE_LIMIT

if TYPE_CHECKING:
    from hapsim.prediction import Prediction

_MOVES = 1e-6  # of the largest amplitude: what moves less is held
_NAMED = 3  # of modules that move together
_ROUNDED, _SLIDES = 1e-13, 1e-5  # of the largest stiffness: what holds nothing, on a line and in the plane


def radius_words(prediction: Prediction) -> str:
    """Returns the spectral radius of a prediction in words; of a stable one at 1 what moves freely, and the spectral
    radius of the rest; "" if it is not finite."""
    radius = prediction.spectral_radius
    if not math.isfinite(radius):
        return ""
    at_rest = [pole for pole in prediction.poles if pole.imag == 0.0 and pole.real >= 1.0 - AT_THE_LIMIT]
    if prediction.verdict != "stable" or not at_rest:
        return f"spectral radius {radius:.9g}"
    moving = [abs(pole) for pole in prediction.poles if pole not in at_rest]
    return "; ".join([*_free(prediction), *(f"the rest {number(max(moving), 9)}" for _ in moving[:1])])


def _free(prediction: Prediction) -> Iterator[str]:
    """Yields phrases on the modules that move freely, those that move together in one."""
    if is_large(prediction.network):
        yield "a part of it moves freely"
        return
    network, along = prediction.network, dict[str, list[int]]()
    for i, point in enumerate(prediction.points):
        along.setdefault(point.partition(".")[0], []).append(i)
    *_, K = matrices(network)
    _, sizes, right = np.linalg.svd(K)
    free = right[sizes <= (_SLIDES if network.rows is not None else _ROUNDED) * sizes.max(initial=0.0)]
    moved = free.T @ free

    def move(name: str, of: list[str]) -> list[str]:
        """Returns those that move where this one does."""
        return [other for other in of if np.abs(moved[np.ix_(along[name], along[other])]).max() > _MOVES]

    left = [name for name in along if move(name, [name])]
    while left:
        first, *others = group = move(left[0], left)
        left = [name for name in left if name not in group]
        yield f"{_listed(group)} freely{' together' if others else _direction(prediction, first, moved, along[first])}"


def _listed(names: list[str]) -> str:
    first, *others = map(escape, names)
    if not others:
        return f"{first} moves"
    if len(others) >= _NAMED:
        others = [*others[: _NAMED - 1], f"{len(others) - _NAMED + 1} others"]
    return f"{', '.join([first, *others[:-1]])} and {others[-1]} move"


def _direction(prediction: Prediction, name: str, moved: Any, own: list[int]) -> str:
    """Returns the direction in the plane in which this module moves: along a link, or at an angle; "" if in each."""
    values, vectors = np.linalg.eigh(moved[np.ix_(own, own)])
    if len(own) == 1 or values[0] > _MOVES:
        return ""
    x, y = vectors[:, 1].tolist()
    acting = [one for one in prediction.links if one.acts and name in one.link.between]
    if len(acting) == 1:
        return f" along {escape(acting[0].name)}"
    return f" along {angle(math.degrees(math.atan2(y, x)) % 180.0)}"
