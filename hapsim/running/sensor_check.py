"""A check, from the rows of a run, whether the device's sensed acceleration contradicts its positions.

The second difference of the positions over some milliseconds is the mean of the acceleration, weighted by a triangle.
Both signals have noise: the slope of one on the other is too small, and the true scale lies between that slope and the
inverse of the other. So only a sign or a scale that no noise explains is a contradiction.

A sensor is stuck if its value stands still while the positions accelerate by several of its counts. Motion then bends
the positions more over a long reach than over one sample; noise bends both alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.description import Description
from hapsim.loop.ring import SENSED
from hapsim.number_format import duration
from hapsim.scene import Scene

_COLUMNS = ("position_counts", SENSED["acceleration"])
_REACH_S = 0.004  # from the middle of a second difference to its ends
_LEAST_WINDOWS = 8
_CERTAIN, _OFF = 4.0, 0.3  # uncertainties; of the scale
_STUCK_WINDOWS, _STUCK_COUNTS, _MOTION = 4, 4.0, 2.0  # _MOTION: ratio of the two bends, which is 1 for noise


class SensorCheck:
    """The check of one run. `add` takes its rows, `sentence` gives the result so far."""

    def __init__(self, rate_hz: float, description: Description) -> None:
        self._rate, self._scales = rate_hz, (description.position_scale, description.acceleration_scale)
        self._reach = k = max(1, round(_REACH_S * rate_hz))
        self._triangle = (k - np.abs(np.arange(-k, k + 1))) / k**2
        self._rows: list[NDArray[Any]] = []
        self._sums = np.zeros((6, description.channels))  # 1, s, d, s s, s d, d d of sensed s and difference d
        self._still = np.zeros((5, description.channels))  # since s changed: 1, d, d d, and e, e e of one sample

    def add(self, rows: NDArray[Any]) -> None:
        """Adds rows that follow those of the last call."""
        rows = np.concatenate([*self._rows, rows])
        rows = rows[np.max(np.flatnonzero(np.diff(rows["sample"]) != 1), initial=-1) + 1 :]  # behind the last gap
        k = self._reach
        self._rows = [rows[-2 * k :].copy()]
        if len(rows) <= 2 * k:
            return
        position, sensed = (rows[name] * one for name, one in zip(_COLUMNS, self._scales, strict=True))
        d = (position[2 * k :] - 2.0 * position[k:-k] + position[: -2 * k]) * (self._rate / k) ** 2
        s = np.column_stack([np.convolve(one, self._triangle, "valid") for one in sensed.T])
        self._sums += [np.sum(one, axis=0) for one in (np.ones_like(s), s, d, s * s, s * d, d * d)]
        steps = np.diff(rows[_COLUMNS[1]], axis=0) != 0
        changed = np.where(steps.any(axis=0), len(steps) - np.argmax(steps[::-1], axis=0), 0)  # first row behind a step
        is_still = np.arange(len(d))[:, None] >= changed
        e = (np.diff(position, 2, axis=0) * (self._rate / k) ** 2)[k - 1 : k - 1 + len(d)]
        self._still *= changed == 0
        self._still += [np.sum(one * is_still, axis=0) for one in (np.ones_like(d), d, d * d, e, e * e)]

    def sentence(self, scene: Scene) -> str:
        """Returns a sentence without a full stop about the first channel with a contradiction; "" if there is none."""
        for name, point in scene.held.device_points.items():
            if still_s := self._stuck_for(point.channel):
                return (
                    f"{name}: the sensed acceleration has not changed by one count for {duration(still_s)} although "
                    "the position accelerated: sensor or cable? `hapsim identify` measures the sensor"
                )
            n, s, d, ss, sd, dd = self._sums[:, point.channel].tolist()
            windows = n / (2.0 * self._reach)
            if windows < _LEAST_WINDOWS or not (ss > s * s / n and dd > d * d / n):
                continue
            ss, sd, dd = ss - s * s / n, sd - s * d / n, dd - d * d / n
            times, alike = (ss / dd) ** 0.5, sd / (ss * dd) ** 0.5
            off = _CERTAIN * (max(1.0 - alike**2, 0.0) / windows) ** 0.5
            is_large, is_small = (alike - off) * times > 1.0 + _OFF, times < (alike - off) * (1.0 - _OFF)
            if alike + off < 0.0 or is_large or is_small:
                what, times = ("sign", -times) if alike < 0.0 else ("scale", times)
                return (
                    f"{name}: the sensed acceleration is about {times:.2g} times that of the positions: its {what} is "
                    "wrong. `hapsim identify` measures the sensor"
                )
        return ""

    def _stuck_for(self, channel: int) -> float:
        """Returns the time, s, for which the value of a channel has been stuck until now; 0 if it is not."""
        n, d, dd, e, ee = self._still[:, channel].tolist()
        if self._reach < _MOTION or n < 2.0 * self._reach * _STUCK_WINDOWS:
            return 0.0
        bend, of_a_sample = (max(square / n - (mean / n) ** 2, 0.0) ** 0.5 for mean, square in ((d, dd), (e, ee)))
        is_motion = bend > max(_STUCK_COUNTS * self._scales[1][channel], _MOTION * of_a_sample)
        return (n + 2.0 * self._reach) / self._rate if is_motion else 0.0
