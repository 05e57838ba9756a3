"""The device point: its position is the hand's, measured; the force of the scene on it is the force in the hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined


class DevicePoints(NamedTuple):
    """P device points, which are the scene's first points, in the order of their channels."""

    channel: NDArray[np.uint32] | None
    """(P,) the device's channel of each; None where every channel has its point: their numbers are then the same."""


def device_points(channels: Sequence[int], of_device: int) -> DevicePoints:
    """Device points on these channels, which ascend, of a device that has so many."""
    every = list(channels) == list(range(of_device))
    return DevicePoints(None if every else np.array(channels, np.uint32))


@inlined
def follow(points, measured, position):
    """Puts every device point where the device says it is: `measured` in m, one value per channel."""
    _follow(points.channel, measured, position)


@inlined
def keep(points, measured, position, previous):
    """Keeps where every device point is, as where it was. `measured`: any array with one value per channel."""
    for i in range(_number(points.channel, measured)):
        previous[i] = position[i]


@inlined
def _number(channel, measured):
    return measured.size if channel is None else channel.size


@inlined
def felt(points, force, out):
    """The scene's force on each channel that it uses, in N; the others are left as they are. The force is used up."""
    _felt(points.channel, force, out)


@inlined
def sensed(points, velocity, point):
    """What the device senses of a point, in the unit of `velocity` (one per channel), and whether it has a sensor."""
    return _sensed(points.channel, velocity, point)


@inlined
def _follow(channel, measured, position):
    if channel is None:
        for i in range(measured.size):
            position[i] = measured[i]
    else:
        for i in range(channel.size):
            position[i] = measured[channel[i]]


@inlined
def _felt(channel, force, out):
    if channel is None:
        for i in range(out.size):
            out[i] = force[i]
            force[i] = 0.0
    else:
        for i in range(channel.size):
            out[channel[i]] = force[i]
            force[i] = 0.0


@inlined
def _sensed(channel, velocity, point):
    if channel is None:
        return (velocity[point], True) if point < velocity.size else (0.0, False)
    return (velocity[channel[point]], True) if point < channel.size else (0.0, False)
