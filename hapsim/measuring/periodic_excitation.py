"""The driving-point impedances of a running loop, from records of a periodic excitation.

A multisine e is added to the scene's force a. Of many draws of random phases it has the lowest peak (Pintelon and
Schoukens, *System Identification: A Frequency Domain Approach*, 2012, §5.3). The force f = a + e acts, late and held,
on the real mass, and the device samples the position y. The multisine holds a whole number of periods of each
frequency, so frequencies do not leak into each other, and differences between periods are noise. Each frequency is
identified by itself from a, e and y; several channels need one experiment for each:

* device:       f over the velocity. The real mass, friction and spring, as seen by the loop.
* rendered:    -a over the velocity. The sampled, held and late scene at the device point.
* closed loop:  e over the velocity, the sum of the two. The impedance against an additional force of the loop.

The velocity is 2 pi j f y. Each force counts as it acts on the mass: the part of a held force at its own frequency,
late by the device's delay. Hold and delay are as declared; if they are wrong, the device does not look like a mass with
friction and spring. Neither a prediction nor the scene is used here.

Uncertainty: the variance of the ratio of the means comes from the residual of each pair of periods (§2.4 to §2.5), in
which disturbances common to position and force cancel. The rounding of the positions is added as if it were the same in
every period, so that no mean reduces it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import LATE_FORCE, LIMITED, UNSENT
from hapsim.measuring.converters import Complexes, Converters, Floats
from hapsim.measuring.trace_quality import is_always_late
from hapsim.recording.trace import Trace

_PERIOD_S = 0.5
_LEAST_SAMPLES, _MOST_SAMPLES = 256, 1 << 15
_LINES = 48
_BELOW_NYQUIST = 0.9
_DRAWS = 64
_SEED = 20040927
_CREST = 2.5  # peak over rms value of a good draw, about
_FEWEST_CHANGES = 8.0  # fewer would make a circle wider than 0.7 counts, the largest effect of rounding on an amplitude
_OPERATIONS = 10.0  # roundings of a double between a position and the scene's force


class Lines(NamedTuple):
    """The excited frequencies: `bins` (n,) whole numbers of periods in a period of `samples` at `rate` Hz."""

    bins: NDArray[np.intp]
    samples: int
    rate: float

    @property
    def frequency(self) -> Floats:
        """Frequencies (n,), Hz."""
        return np.asarray(self.bins * (self.rate / self.samples), np.float64)

    @property
    def period_s(self) -> float:
        """Period of the force, s."""
        return self.samples / self.rate

    def each(self, peak: float) -> float:
        """Returns the common amplitude of all frequencies for a sum with about this peak."""
        return peak / (_CREST * math.sqrt(0.5 * self.bins.size))


def lines_for(rate: float) -> Lines:
    """Returns frequencies spaced about evenly in their logarithm, from one period to just below the Nyquist limit."""
    samples = min(max(round(_PERIOD_S * rate), _LEAST_SAMPLES), _MOST_SAMPLES)
    bins = np.unique(np.rint(np.geomspace(1.0, _BELOW_NYQUIST * 0.5 * samples, _LINES)).astype(np.intp))
    return Lines(bins, samples, rate)


def multisine(lines: Lines, amplitude: Floats, peak: float, number: int = 0) -> Floats:
    """Returns one period (samples,) in N with these amplitudes (n,), scaled down if its peak exceeds `peak`. `number`:
    of the draws of phases; each number has others."""
    rng = np.random.default_rng(_SEED + number)
    spectra = np.zeros((_DRAWS, lines.samples // 2 + 1), dtype=complex)
    turned = np.exp(2j * np.pi * rng.random((_DRAWS, lines.bins.size)))
    spectra[:, lines.bins] = 0.5 * lines.samples * amplitude * turned
    waves = np.fft.irfft(spectra, lines.samples)
    highest = np.max(np.abs(waves), axis=1)
    best = int(np.argmin(highest))
    return np.asarray(waves[best] * min(1.0, peak / max(float(highest[best]), 1e-300)))


class Periods(NamedTuple):
    """Amplitudes (P, n, C) in m and N of P pairs of whole periods, n frequencies, C channels. Neighbouring pairs share
    one period. The complex variances (C,) in m² and N² are those that the scatter of the pairs does not show."""

    position: Complexes
    scene: Complexes  # the force of the scene's modules
    force: Complexes
    """The acting force, by the loop's sample numbers: the scene's and the excitation's, clipped and rounded."""
    rounded_position: Floats
    rounded_scene: Floats
    by_position: bool
    """True if the scene's forces depend on the recorded positions alone: their rounding is then no error of the ratio.
    """
    limited: int  # samples whose force was clipped at its limit
    lost: int  # ignored periods with missing samples

    @property
    def pairs(self) -> int:
        """Number of pairs, P."""
        return self.position.shape[0]

    def after(self, settled: int) -> Periods:
        """Returns the pairs from number `settled` on."""
        return self._replace(position=self.position[settled:], scene=self.scene[settled:], force=self.force[settled:])

    def on(self, channels: list[int]) -> Periods:
        """Returns the pairs of these channels, in this order."""
        names = ("position", "scene", "force", "rounded_position", "rounded_scene")
        return self._replace(**{name: getattr(self, name)[..., channels] for name in names})


def periods_of(trace: Trace, lines: Lines, converters: Converters, *, senses: bool) -> Periods:
    """Returns the whole periods of a trace. `senses`: the scene also uses sensed velocities. No trace records their
    rounding; the frequencies that are not excited show how large it is."""
    samples, scene = lines.samples, trace.asked_force
    number, rows_in = np.unique(trace.sample // samples, return_counts=True)
    begins = np.cumsum(rows_in) - rows_in
    whole = rows_in == samples
    pairs = begins[:-1][whole[:-1] & whole[1:] & (np.diff(number) == 1)]

    def amplitudes(signal: Floats) -> Complexes:
        found = [_amplitudes(signal[i : i + 2 * samples], lines) for i in pairs]
        return np.array(found, complex).reshape(-1, lines.bins.size, signal.shape[1])

    # The number of changes of the count in a period is the number of independent roundings. If a channel hardly moves,
    # they follow its motion, at the excited frequencies.
    later = trace.position_counts[trace.sample.size // 2 :]
    changes = np.mean(np.diff(later, axis=0) != 0, axis=0) * samples
    rounded = 4.0 / np.clip(changes, _FEWEST_CHANGES, samples)
    share = 4.0 / samples  # of a white error's variance, in an amplitude
    computed = share * (_OPERATIONS * np.finfo(float).eps * np.max(np.abs(scene), axis=0, initial=0.0)) ** 2
    if senses and pairs.size:  # the variance of the mean period at the frequencies that are not excited
        mean = np.mean([scene[first : first + samples] for first in pairs[pairs.size // 2 :]], axis=0)
        others = np.setdiff1d(np.arange(1, (samples + 1) // 2), lines.bins)
        computed = computed + np.mean(np.abs(np.fft.rfft(mean, axis=0)[others] * (2.0 / samples)) ** 2, axis=0)
    missing = int(number[-1] - number[0] + 1 - number.size) if number.size else 0  # periods without a record
    return Periods(
        amplitudes(trace.position - np.mean(trace.position, axis=0)),
        amplitudes(scene),
        amplitudes(acting_force(trace, converters)),
        rounded_position=rounded * trace.position_scale**2 / 12.0,
        rounded_scene=computed,
        by_position=not senses,
        limited=int(np.count_nonzero(trace.flags & LIMITED)),
        lost=int(np.count_nonzero(rows_in[1:-1] != samples)) + missing,
    )


def acting_force(trace: Trace, converters: Converters) -> Floats:
    """Returns the acting force (N, C): if the force of a row came too late or was not sent, the one before acted."""
    missed = trace.flags & UNSENT != 0
    if not is_always_late(trace):
        missed[:-1] |= (trace.flags[1:] & LATE_FORCE != 0) & (np.diff(trace.sample) == 1)
    if not converters.keeps_last_force:
        return np.where(missed[:, None], 0.0, trace.force)
    row = np.maximum.accumulate(np.where(missed, 0, np.arange(missed.size)))
    return np.asarray(trace.force[row])


def _amplitudes(signal: Floats, lines: Lines) -> Complexes:
    """Returns the amplitudes (n, C) of two periods (2 samples, C), by a Hann window. Its spectrum is zero at the other
    excited frequencies, so they are separated exactly. Its soft ends reduce the leakage of a decaying motion."""
    window = 1.0 - np.cos(np.pi * np.arange(2 * lines.samples) / lines.samples)
    return np.asarray(np.fft.rfft(signal * window[:, None], axis=0)[2 * lines.bins] / lines.samples)


CONFIDENCE = 0.999
"""Probability that all true values, at all frequencies and of all channels, lie within their circles."""

LEAST_PERIODS = 4

_OVERLAP = 1.5
"""Variance of the mean of overlapping pairs of periods over that of independent ones. Half-overlapping Hann windows are
correlated by a sixth, which makes 4/3; the scatter underestimates it a little."""


class Circles(NamedTuple):
    """Impedances (n, C, C) in N·s/m and their uncertainties. [:, i, j]: force on channel i over the velocity of channel
    j while the others are held. Circles with these radii hold all true values together with 99.9 %."""

    value: Complexes
    uncertainty: Floats


@dataclass(frozen=True)
class Impedance:
    """The measured impedances at n frequencies (n,) in Hz, on C channels; see the top of this file."""

    frequency: Floats
    device: Circles
    rendered: Circles
    closed_loop: Circles
    periods: tuple[int, ...]
    """Number of pairs of periods used in each experiment."""


def impedance_of(
    experiments: Sequence[Periods], frequency: Floats, rate: float, delay: float, converters: Converters
) -> Impedance:
    """Returns the impedances from one experiment for each channel, in the order of the channels.

    `rate` in Hz and `delay` in samples are as declared by the device. Raises UsageError for too few periods, or for
    motions that do not distinguish the channels.
    """
    settled = [one.after(settling(one, c)[0]) for c, one in enumerate(experiments)]
    position, scene, force = (
        np.stack([np.mean(getattr(one, name), axis=0) for one in settled], axis=-1)  # (n, C, experiments)
        for name in ("position", "scene", "force")
    )
    try:
        inverse = np.linalg.inv(position)
    except np.linalg.LinAlgError:
        raise UsageError("the excitations did not move every channel: nothing was measured") from None
    # The scene answers to rounded positions. So their rounding in its force is no error of the rendered impedance.
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
    """Returns the complex variance (n, C) of the forces that the positions' rounding causes. `ratio`: N/m."""
    return np.asarray(np.abs(ratio) ** 2 @ periods.rounded_position)


def _radius(
    settled: Sequence[Periods], forces: Sequence[Complexes], ratio: Complexes, inverse: Complexes, unseen: Floats
) -> Floats:
    """Returns the radii (n, C, C) of the circles about `ratio`, the forces (P, n, C) over the positions, in N/m.

    `unseen`: for each experiment a complex variance (n, C) of the forces that the scatter of the periods may not show.
    """
    outside = (1.0 - CONFIDENCE) / ratio.size  # of each circle, Bonferroni
    total = np.zeros(ratio.shape)
    for d, (one, force) in enumerate(zip(settled, forces, strict=True)):
        scatter = _variance_of_mean(force - np.einsum("nij,pnj->pni", ratio, one.position))
        squared = _quantile(one.pairs, outside) * scatter - math.log(outside) * unseen[d]
        total += squared[:, :, None] * np.abs(inverse[:, d, :])[:, None, :] ** 2
    return np.sqrt(total)


def _quantile(count: int, outside: float) -> float:
    """Returns the quantile of the squared mean of `count` complex values over its estimated variance. It is exceeded
    with probability `outside`: F with 2 and 2 (count - 1) degrees of freedom, in closed form."""
    return (count - 1) * (outside ** (-1.0 / (count - 1)) - 1.0)


def settling(periods: Periods, channel: int) -> tuple[int, float]:
    """Returns the number of ignored first periods, and the median relative radius of the device's impedance from the
    rest. The number makes the mean of the rest most certain. `channel`: the excited one. Raises UsageError for too few
    periods."""
    if periods.pairs < LEAST_PERIODS + 1:
        raise UsageError(
            f"only {periods.pairs} periods of the excitation were recorded completely, expected at least "
            f"{LEAST_PERIODS + 1}: measure longer with --duration. If positions are lost, `hapsim doctor` shows which "
            "rates can be kept"
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
    """Returns the complex variance (n, C) of the mean of (P, n, C) overlapping pairs of periods."""
    return np.asarray(_OVERLAP * np.var(residual, axis=0, ddof=1) / residual.shape[0])
