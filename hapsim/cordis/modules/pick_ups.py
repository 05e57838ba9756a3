"""Pick-ups: the values of a scene's output channels in each step.

They act last among the actions that add forces. So the positions are those of this step and of the one before, and a
point's force is the sum over its links. Each writes gain times the quantity to the program's `pick_up_values`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BatchType, BuildContext
from hapsim.cordis.dispatch import Batch, Column, action
from hapsim.scene.sound_channels import QUANTITIES

_VELOCITY, _POSITION, _FORCE = range(3)
assert QUANTITIES == ("velocity", "position", "force")


class PickUps(NamedTuple):
    """C pick-ups: point and quantity, by number, gain; shape (C,). `rate`: Hz; `pick_up_values`: the result, (C,)."""

    point: NDArray[np.uint32]
    of: NDArray[np.uint8]
    gain: Column
    rate: NDArray[np.float64]
    pick_up_values: NDArray[np.float64]


@action
def sample_pick_ups(pick_ups, state):
    """Samples every pick-up in this step."""
    pick_ups, state = value_of(pick_ups), value_of(state)
    for c in range(np.uint64(pick_ups.point.size)):
        p = pick_ups.point[c]
        if pick_ups.of[c] == _VELOCITY:
            value = (np.float64(state.position[p]) - np.float64(state.previous[p])) * pick_ups.rate[0]
        elif pick_ups.of[c] == _POSITION:
            value = np.float64(state.position[p])
        else:
            value = np.float64(state.force[p])
        pick_ups.pick_up_values[c] = np.float64(pick_ups.gain[c]) * value


def _build(pick_ups: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    point = np.array([context.number[one.point] for one in pick_ups.values()], np.uint32)
    of = np.array([QUANTITIES.index(one.of) for one in pick_ups.values()], np.uint8)
    return Batch(
        PickUps(point, of, columns[0], np.array([context.rate]), context.pick_up_values), add_forces=sample_pick_ups
    )


PICK_UP = BatchType(lambda scene: scene.sound, _build, name="pick-ups", compiled_as="gain times the signal")
