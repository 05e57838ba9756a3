"""The driving-point impedance of a running loop, identified from records of periodic excitations.

An excitation e is added to the scene's force a; f = a + e acts, late and held, on the real mass, and the device reads
the position y. Of these three alone, frequency by frequency and, of several channels, from one experiment for each:

* device:       f over the velocity. The real mass, friction and spring, as the loop sees them.
* rendered:    -a over the velocity. What the sampled, held and late scene presents at the device point.
* closed loop:  e over the velocity, the sum of the two. What meets an additional force of the loop.

The velocity is 2 pi j f y. Each force counts as it acts on the mass: of a held force the part at its own frequency,
late by the device's delay. How the device holds and delays is what it declares; the positions show when that is wrong,
for then the device is not its mass, friction and spring.

It never sees a prediction, nor the scene.

How certain: the ratio over the periods' means (Pintelon and Schoukens, *System Identification: A Frequency Domain
Approach*, 2012, §2.4 to §2.5), the residual of each pair of periods giving the variance, in which what disturbs
position and force alike cancels. To that is added the rounding of the positions to counts as if it were the same in
every period, which no mean makes smaller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.measuring.converters import Complexes, Converters, Floats
from hapsim.measuring.multisine import Periods

CONFIDENCE = 0.999
"""That the true values lie within their circles, at all frequencies and of all channels together."""

LEAST_PERIODS = 4

_OVERLAP = 1.5
"""Variance of the mean of overlapping pairs of periods over that of independent ones: Hann's
windows, half overlapping, are correlated by a sixth, which makes 4/3; the scatter shows a little less than there is."""


class Circles(NamedTuple):
    """Values (n, C, C) in N·s/m, [:, i, j] the force on channel i over the velocity of channel j while the others are
    held, and the radii of the circles about them that hold the true values, all of them together with 99.9 %."""

    value: Complexes
    uncertainty: Floats


@dataclass(frozen=True)
class Impedance:
    """What was measured at n frequencies, Hz (n,), on C channels: see the top of this file."""

    frequency: Floats
    device: Circles
    rendered: Circles
    closed_loop: Circles
    periods: tuple[int, ...]
    """How many pairs of periods, each overlapping the next, count in each experiment."""


def impedance_of(
    experiments: Sequence[Periods], frequency: Floats, rate: float, delay: float, converters: Converters
) -> Impedance:
    """The impedances from one experiment for each channel, the excitation on the first channel first.

    `rate` in Hz and `delay` in samples are what the device declares, by which a computed force becomes one that acts.

    Raises:
        UsageError: too few periods, or motions that do not distinguish the channels.
    """
    settled = [one.after(settling(one, c)[0]) for c, one in enumerate(experiments)]
    position, scene, force = (
        np.stack([np.mean(getattr(one, name), axis=0) for one in settled], axis=-1)  # (n, C, experiments)
        for name in ("position", "scene", "force")
    )
    try:
        inverse = np.linalg.inv(position)
    except np.linalg.LinAlgError:
        raise UsageError("the excitations did not move every channel: there is nothing to be measured") from None
    # What a rounding of the positions does to the scene's force is the scene's doing, and no error of what it renders.
    counted = [_rounded(one, force @ inverse) for one in settled]
    computed = [one.rounded_scene + (not one.by_position) * _rounded(one, scene @ inverse) for one in settled]
    unseen = np.array([counted, computed, np.add(counted, computed)])
    acting, rendered = [one.force for one in settled], [-one.scene for one in settled]
    both = [a + b for a, b in zip(acting, rendered, strict=True)]
    late = converters.response(frequency, rate, delay)
    through = (late / (2j * np.pi * frequency))[:, None, None]
    circles = []
    for ratio, forces, more in zip((force, -scene, force - scene), (acting, rendered, both), unseen, strict=True):
        radius = _radius(settled, forces, ratio @ inverse, inverse, more)
        circles.append(Circles(ratio @ inverse * through, np.abs(through) * radius))
    device, scene_alone, loop = circles
    return Impedance(frequency, device, scene_alone, loop, tuple(one.pairs for one in settled))


def _rounded(periods: Periods, ratio: Complexes) -> Floats:
    """(n, C) complex variance of the forces that the positions' rounding stands for, at these N/m."""
    return np.asarray(np.abs(ratio) ** 2 @ periods.rounded_position)


def _radius(
    settled: Sequence[Periods], forces: Sequence[Complexes], ratio: Complexes, inverse: Complexes, unseen: Floats
) -> Floats:
    """(n, C, C) of the circles about ``ratio``, of the forces (P, n, C) over the positions, in N/m.

    ``unseen``: of each experiment a complex variance (n, C) of the forces that the scatter between periods need not
    show.
    """
    outside = (1.0 - CONFIDENCE) / ratio.size  # of each circle, Bonferroni
    total = np.zeros(ratio.shape)
    for d, (one, force) in enumerate(zip(settled, forces, strict=True)):
        scatter = _variance_of_mean(force - np.einsum("nij,pnj->pni", ratio, one.position))
        squared = _quantile(one.pairs, outside) * scatter - math.log(outside) * unseen[d]
        total += squared[:, :, None] * np.abs(inverse[:, d, :])[:, None, :] ** 2
    return np.sqrt(total)


def _quantile(count: int, outside: float) -> float:
    """What the square of a complex mean of `count` values exceeds with the probability ``outside``, over its estimated
    variance: of F with 2 and 2 (count - 1) degrees of freedom, in closed form."""
    return (count - 1) * (outside ** (-1.0 / (count - 1)) - 1.0)


def settling(periods: Periods, channel: int) -> tuple[int, float]:
    """(how many periods at the beginning do not count, for the mean of the rest to be as certain as possible; the
    relative radius of the device's impedance then, in the median) of an experiment that excites this channel.

    Raises:
        UsageError: there are too few periods.
    """
    if periods.pairs < LEAST_PERIODS + 1:
        raise UsageError(
            f"only {periods.pairs} periods of the excitation were recorded whole, expected {LEAST_PERIODS + 1} or "
            "more: measure for longer with --duration; where positions are lost, `hapsim doctor` shows which rates are "
            "kept"
        )
    found = []
    for first in range(1, periods.pairs - LEAST_PERIODS + 1):
        rest = periods.after(first)
        force, position = rest.force[:, :, [channel]], rest.position[:, :, [channel]]
        mean = np.mean(force, axis=0)
        variance = _variance_of_mean(force - mean / np.mean(position, axis=0) * position)
        variance *= _quantile(rest.pairs, (1.0 - CONFIDENCE) / mean.size)
        found.append((first, float(np.median(np.sqrt(variance) / np.abs(mean)))))
    return min(found, key=lambda one: one[1])


def _variance_of_mean(residual: Complexes) -> Floats:
    """(n, C) complex variance of the mean of (P, n, C) overlapping pairs of periods."""
    return np.asarray(_OVERLAP * np.var(residual, axis=0, ddof=1) / residual.shape[0])
