"""The device point: its position is the hand's, measured; the force of the scene on it is the force in the hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined


class DevicePoints(NamedTuple):
    """P device points, which are the scene's first points; `channel`: the device's channel of each, shape (P,)."""

    channel: NDArray[np.uint32]


def device_points(channels: Sequence[int]) -> DevicePoints:
    """Device points on these channels of the device."""
    return DevicePoints(np.array(channels, np.uint32))


@inlined
def follow(points, measured, position):
    """Puts every device point where the device says it is: `measured` in m, one value per channel."""
    for i in range(points.channel.size):
        position[i] = measured[points.channel[i]]


@inlined
def felt(points, force, out):
    """The scene's force on each channel that it uses, in N; the others are left as they are."""
    for i in range(points.channel.size):
        out[points.channel[i]] = force[i]
