"""A check, from the rows of a run, whether the device's sensed acceleration contradicts its positions.

The second difference of the positions over some milliseconds is the mean of the acceleration, weighted by a triangle.
Both signals have noise: the slope of one on the other is too small, and the true scale lies between that slope and the
inverse of the other. So only a sign or a scale that no noise explains is a contradiction.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.description import Description
from hapsim.loop.ring import SENSED
from hapsim.scene import Scene

_COLUMNS = ("position_counts", SENSED["acceleration"])
_REACH_S = 0.004  # from the middle of a second difference to its ends
_LEAST_WINDOWS = 8
_CERTAIN, _OFF = 4.0, 0.3  # uncertainties; of the scale


class SensorCheck:
    """The check of one run. `add` takes its rows, `sentence` gives the result so far."""

    def __init__(self, rate_hz: float, description: Description) -> None:
        self._rate, self._scales = rate_hz, (description.position_scale, description.acceleration_scale)
        self._reach = max(1, round(_REACH_S * rate_hz))
        away = np.abs(np.arange(-self._reach, self._reach + 1))
        self._triangle = (self._reach - away) / self._reach**2
        self._rows: NDArray[Any] | None = None
        self._sums = np.zeros((6, description.channels))  # 1, s, d, s s, s d, d d of sensed s and difference d

    def add(self, rows: NDArray[Any]) -> None:
        """Adds rows that follow those of the last call."""
        rows = rows if self._rows is None else np.concatenate([self._rows, rows])
        gaps = np.flatnonzero(np.diff(rows["sample"]) != 1)
        rows = rows[gaps[-1] + 1 :] if gaps.size else rows
        k = self._reach
        self._rows = rows[-2 * k :].copy()
        if len(rows) <= 2 * k:
            return
        position, sensed = (rows[name] * one for name, one in zip(_COLUMNS, self._scales, strict=True))
        d = (position[2 * k :] - 2.0 * position[k:-k] + position[: -2 * k]) * (self._rate / k) ** 2
        s = np.column_stack([np.convolve(one, self._triangle, "valid") for one in sensed.T])
        self._sums += [np.sum(one, axis=0) for one in (np.ones_like(s), s, d, s * s, s * d, d * d)]

    def sentence(self, scene: Scene) -> str:
        """Returns a sentence without a full stop about the first channel with a contradiction; "" if there is none."""
        for name, point in scene.device_points.items():
            times = self._times(point.channel)
            if times is not None:
                what = "sign" if times < 0.0 else "scale"
                return (
                    f"{name}: the sensed acceleration is about {times:.2g} times that of the positions: its {what} is "
                    "wrong. `hapsim identify` measures the sensor"
                )
        return ""

    def _times(self, channel: int) -> float | None:
        """Returns how many times the acceleration of the positions the sensed one is, if that contradicts them."""
        n, s, d, ss, sd, dd = self._sums[:, channel]
        windows = n / (2.0 * self._reach)
        if windows < _LEAST_WINDOWS:
            return None
        ss, sd, dd = ss - s * s / n, sd - s * d / n, dd - d * d / n
        if not min(ss, dd) > 0.0:
            return None
        off = _CERTAIN * math.sqrt(max(1.0 - sd * sd / (ss * dd), 0.0) / windows)  # of a correlation
        ratio = math.sqrt(ss / dd)
        least, most = (sd / math.sqrt(ss * dd) + side * off for side in (-1.0, 1.0))
        if most < 0.0:
            return -ratio
        return ratio if least * ratio > 1.0 + _OFF or (least > 0.0 and ratio < least * (1.0 - _OFF)) else None
