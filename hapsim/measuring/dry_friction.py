"""Dry friction, as a record of positions shows it: which way the hand slides, and where it stands still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapsim.measuring.converters import Floats

_REACH = 4  # samples to either side, over which a hand that stands still does not move
_STILL = 2.0  # counts, or standard deviations of the noise: less than that is no motion
_FOURTH = 70.0  # the variance of white noise's fourth difference, over its own
_MEDIAN = 0.6745  # of a normal distribution's absolute value, in standard deviations


def slides(position: Floats) -> Floats:
    """Returns the mean direction, -1 to 1, in which the hand moves from each sample to the next: where it turns round
    in between, by when a velocity that changes evenly is zero."""
    velocity = np.gradient(position) if position.size > 1 else np.zeros_like(position)
    least = np.abs(velocity[:-1]) + np.abs(velocity[1:])
    return np.append((velocity[:-1] + velocity[1:]) / np.maximum(least, 1e-300), 0.0)


def noise_of(position: Floats) -> float:
    """Returns the standard deviation of what is white in the positions, in counts."""
    return float(np.median(np.abs(np.diff(position, 4))) / _MEDIAN / np.sqrt(_FOURTH)) if position.size > 4 else 0.0


def stands(position: Floats) -> NDArray[np.bool_]:
    """Returns at which samples the hand stands still, as near as counts and noise tell, or has just begun or ceased to:
    dry friction then takes just the force that acts."""
    noise = noise_of(position)
    padded = np.pad(position, _REACH, mode="edge")
    still = np.abs(padded[2 * _REACH :] - padded[: -2 * _REACH]) <= _STILL * max(noise, 1.0)
    hardly = np.abs(np.diff(position, prepend=position[:1])) <= max(noise, 1.0)
    return _widened(still | (_widened(still, _REACH) & hardly), 1)


def _widened(chosen: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    return np.convolve(chosen, np.ones(2 * by + 1), "same")[: chosen.size] > 0.5
