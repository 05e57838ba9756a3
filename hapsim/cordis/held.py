"""The masses of a structure that links hold.

A structure moves all its masses in one pass, without forces. Forces of links reach only the masses that they hold:
those are moved once more, and no other mass is asked.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.cordis.kind import Column, Frame
from hapsim.cordis.lanes import add_to_one
from hapsim.cordis.mass import mobility_of


class Held(NamedTuple):
    """The H masses of a kind of structure that links hold, by number, and their T²/m in m/N."""

    point: NDArray[np.uint32]
    mobility: Column


def held_of(structures: Mapping[str, Any], frame: Frame) -> Held | None:
    """Those masses of these structures that a link holds; None where none does."""
    numbers = [
        (frame.number[f"{name}.{place}"], one.mass) for name, one in structures.items() for place in one.places()
    ]
    held = [(number, mass) for number, mass in numbers if number in frame.touched]
    if not held:
        return None
    return Held(np.array([number for number, _ in held], np.uint32), mobility_of([mass for _, mass in held], frame))


@inlined
def push_held(held, moment):
    """Adds to the motion of each mass that links hold what their force on it does, and forgets the force."""
    if held is None:
        return
    for h in range(held.point.size):
        p = held.point[h]
        add_to_one(moment.following, np.uint64(p), held.mobility[h] * moment.force[p])
        moment.force[p] = 0.0
