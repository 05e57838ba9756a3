"""The frequency that a simulated mode rings at, from its own motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.strings import StringOfMasses

# (shape, samples) -> the motion along that shape, sample by sample, once the string was released in it at rest.
Record = Callable[[NDArray[np.float64], int], NDArray[np.float64]]

STEADY = 1.0 + 1e-9  # the largest modulus of a pole that counts as stable: the fit's own error stays below
STEADY_IN_SINGLE = 1.0 + 1e-4

_PERIODS = 2.0
_LEAST_SAMPLES = 64
_POINTS_PER_PERIOD = 16.0


def frequencies_of(
    record: Record,
    string: StringOfMasses,
    rate: float,
    modes: Iterable[int],
    explicit: bool = True,
    steady: float = STEADY,
) -> list[float]:
    """The eigenfrequency in Hz of each mode as it is simulated at `rate` Hz; NaN for all where that is unstable.

    `explicit`: the scheme may be unstable, which its highest mode tells: that one is the first to be. `steady`:
    the largest modulus of a pole that counts as stable.
    """
    if explicit and not _stable(record, string, steady):
        return [math.nan for _ in modes]
    return [_frequency(record, string, rate, mode) for mode in modes]


def project(rows: NDArray[np.float64], shape: NDArray[np.float64]) -> NDArray[np.float64]:
    """How much of `shape` (N,) is in each of the displacements `rows` (..., N)."""
    return np.asarray(rows @ shape / (shape @ shape))


def _frequency(record: Record, string: StringOfMasses, rate: float, mode: int) -> float:
    expected = string.frequency(mode)
    samples = max(_LEAST_SAMPLES, math.ceil(_PERIODS * rate / expected))
    stride = max(1, int(rate / (_POINTS_PER_PERIOD * expected)))
    pair = poles(record(string.shape(mode), samples), stride)
    if not np.all(np.isfinite(pair)) or np.any(pair == 0.0):
        return math.nan
    exponents = np.log(pair) * rate / stride
    return float(math.sqrt(abs(exponents[0] * exponents[1])) / (2.0 * math.pi))


def _stable(record: Record, string: StringOfMasses, steady: float) -> bool:
    with np.errstate(all="ignore"):
        pair = poles(record(string.shape(string.masses), _LEAST_SAMPLES), 1)
        return bool(np.all(np.abs(pair) <= steady))


def poles(motion: NDArray[np.float64], stride: int) -> NDArray[np.complex128]:
    """The pole pair, to the power of `stride`, of the recurrence q[n+s] = c1 q[n] + c2 q[n-s] that fits `motion` best.

    Least squares on the second difference, α q[n] + β (q[n] - q[n-s]): slow motion would leave c1 and c2 hardly other
    than 2 and -1. With w = z - 1 the poles solve w² - (α + β) w - α = 0. NaN where the motion is not finite, or there
    is none.
    """
    if not np.all(np.isfinite(motion)) or np.max(np.abs(motion)) > 1e150:
        return np.full(2, complex(math.nan, math.nan))
    now = motion[stride:-stride]
    growth = now - motion[: -2 * stride]
    bend = (motion[2 * stride :] - now) - growth
    columns = np.stack([now, growth], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    if not np.all(scale > 0.0):
        return np.full(2, complex(math.nan, math.nan))
    alpha, beta = np.linalg.lstsq(columns / scale, bend, rcond=None)[0] / scale
    half = (alpha + beta) / 2.0
    root = np.sqrt(complex(half * half + alpha))
    return np.array([1.0 + half + root, 1.0 + half - root])
