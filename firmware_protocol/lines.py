"""Lines: what FORCE carries for a device that evaluates the force law at its own rate (PROTOCOL.md, section 6).

Between two samples the device sets, `steps` times per sample, from its position x, with x_n of the sample that the
force answers:

    u = F + k (x_n - x);  f is a bound where u is at or beyond it, else u - b v, clipped to the bounds

A line is F, k, b, low and high, in SI units or in counts. Loop, mock, prediction and tests share what is here; the C
of `firmware/` computes the same to the bit. Compiled; Python calls the functions too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_protocol.compiled import inlined

LARGEST_STIFFNESS, LARGEST_DAMPING, LARGEST_BOUND = 32767, 65535, 32767
"""Counts: k and the bounds have 16 bits and a sign, b has 16 bits without one."""
SHIFTS = range(-15, 32)
"""Shifts for which a product fits 64 bits."""
_LEAST, _MOST = -(2**31), 2**31 - 1


@dataclass(frozen=True)
class Lines:
    """Board that follows lines, as it describes itself. Tuples have one entry per channel."""

    steps: int
    """Local periods per sample."""
    delay: int
    """Local periods from a measurement until its force acts."""
    window: int
    """Local periods over which the velocity is measured."""
    kept: int
    """Reported positions that it remembers: an older answer counts as expired."""
    stiffness_scale: tuple[float, ...]
    """(N/m) per count."""
    damping_scale: tuple[float, ...]
    """(N·s/m) per count."""
    largest_stiffness: tuple[float, ...]
    """N/m, of either sign; a larger one saturates."""
    largest_damping: tuple[float, ...]
    """N·s/m."""

    def scales(self, channel: int) -> tuple[float, float, float, float]:
        """Returns the channel's scales and largest values, as `line_counts` takes them."""
        own = (self.stiffness_scale, self.damping_scale, self.largest_stiffness, self.largest_damping)
        stiffness, damping, most_stiffness, most_damping = (each[channel] for each in own)
        return stiffness, damping, most_stiffness, most_damping


def line_units(ratio: float, window_s: float) -> tuple[float, float]:
    """Returns one count of stiffness (N/m) and of damping (N·s/m) that no shift divides. `ratio`: force scale over
    position scale, N/m; `window_s`: of the velocity, s."""
    return ratio, ratio * window_s


def lines_of(
    board: tuple[int, int, int, int],
    units: Sequence[tuple[float, float]],
    shifts: Sequence[tuple[int, int]],
    largest: Sequence[tuple[int, int]],
) -> Lines:
    """Returns the lines of a device. `board`: steps, delay, window, kept; for each channel `line_units`, and shifts and
    largest counts of stiffness and damping."""
    scales = [
        tuple(math.ldexp(unit, -s) for unit, s in zip(*each, strict=True)) for each in zip(units, shifts, strict=True)
    ]
    most = [tuple(n * scale for n, scale in zip(*each, strict=True)) for each in zip(largest, scales, strict=True)]
    stiffness, damping = zip(*scales, strict=True)
    most_stiffness, most_damping = zip(*most, strict=True)
    return Lines(*board, stiffness, damping, most_stiffness, most_damping)


@inlined
def pack_line(stiffness, damping, low, high):
    """Returns the two words of a line in counts."""
    return (stiffness << 16) | (damping & 0xFFFF), (low << 16) | (high & 0xFFFF)


@inlined
def unpack_line(first, second):
    """Returns (stiffness, damping, low, high) in counts, of two words as a decoder gives them, signed."""
    return first >> 16, first & 0xFFFF, second >> 16, ((second & 0xFFFF) ^ 0x8000) - 0x8000


@inlined
def counts_of(value, scale, least, most):
    """Returns (the nearest counts of a value, whether they are within `least` to `most`); else those saturate."""
    counts = np.rint(value / scale)
    inside = np.float64(min(max(counts, least), most))
    return np.int64(inside), inside == counts


@inlined
def bound_counts(low, high, limit):
    """Returns the bounds `low` and `high` (N) in counts of limit / 32767: outward, at most to the limit; 0 is exact."""
    unit = limit / LARGEST_BOUND
    lower = math.floor(min(max(low / unit, -LARGEST_BOUND), LARGEST_BOUND))
    upper = math.ceil(min(max(high / unit, -LARGEST_BOUND), LARGEST_BOUND))
    return np.int64(lower), np.int64(upper)


@inlined
def line_counts(stiffness, damping, low, high, scales, limit):
    """Returns (k, b, low, high) in counts, and whether k and b fit.

    Arguments: N/m, N·s/m, N, N; `scales`: (stiffness_scale, damping_scale, largest_stiffness, largest_damping) of
    `Lines`; `limit`: N. k and b become the nearest counts, at most the largest; the bounds go outward.
    """
    k_scale, b_scale, k_most, b_most = scales
    most = math.floor(k_most / k_scale + 0.5)
    k, k_fits = counts_of(stiffness, k_scale, -most, most)
    b, b_fits = counts_of(damping, b_scale, 0.0, math.floor(b_most / b_scale + 0.5))
    lower, upper = bound_counts(low, high, limit)
    return k, b, lower, upper, k_fits and b_fits


@inlined
def _saturated(value):
    return min(max(value, _LEAST), _MOST)


@inlined
def shifted_product(factor, difference, shift):
    """Returns factor * difference / 2^shift rounded down, with the difference and the result saturated to 32 bits."""
    product = factor * _saturated(difference)
    return _saturated(product >> shift if shift >= 0 else product << -shift)


@inlined
def bound_in_force_counts(bound, limit):
    """Returns a bound as force counts, rounded towards zero. `limit`: of the force, counts."""
    size = min(abs(bound), LARGEST_BOUND) * limit // LARGEST_BOUND
    return size if bound >= 0 else -size


@inlined
def line_force(force, stiffness, damping, low, high, ahead, moved, shifts):
    """Returns the force that a device puts out, all in counts.

    `low`, `high`: force counts. `ahead`: x - x_n; `moved`: x less the position a window before. `shifts`: of stiffness
    and damping.
    """
    u = force - shifted_product(stiffness, ahead, shifts[0])
    if u >= high:
        return high
    if u <= low:
        return low
    return min(max(u - shifted_product(damping, moved, shifts[1]), low), high)


def as_sent(stiffness: float, damping: float, lines: Lines, channel: int) -> tuple[float, float]:
    """Returns stiffness (N/m) and damping (N·s/m) as the wire carries them. Raises ValueError where one is beyond the
    device's largest."""
    scales = lines.scales(channel)
    k, b, *_, fits = line_counts(stiffness, damping, 0.0, 0.0, scales, 1.0)
    if not fits:
        raise ValueError(
            f"found {stiffness:.6g} N/m with {damping:.6g} N·s/m, expected at most {scales[2]:.6g} N/m and from 0 to "
            f"{scales[3]:.6g} N·s/m: the device's board takes no more"
        )
    return float(k * scales[0]), float(b * scales[1])
