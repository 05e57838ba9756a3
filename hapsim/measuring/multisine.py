"""A periodic multisine, and the periods of a trace that it excited, frequency by frequency.

Random phases, of many draws those with the lowest peak (Pintelon and Schoukens, *System Identification: A Frequency
Domain Approach*, 2012, §5.3). A whole number of periods of every frequency fits in one period of the multisine, so that
nothing leaks from one into another, and what differs from period to period is noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
_CREST = 2.5  # peak over effective value that a good draw has, about
_FEWEST_CHANGES = 8.0  # fewer would make a circle wider than 0.7 counts, the most that rounding does to an amplitude
_OPERATIONS = 10.0  # roundings of a double between a position and the scene's force


class Lines(NamedTuple):
    """The excited frequencies: ``bins`` (n,) whole numbers of periods in a period of ``samples`` at ``rate`` Hz."""

    bins: NDArray[np.intp]
    samples: int
    rate: float

    @property
    def frequency(self) -> Floats:
        """(n,) Hz."""
        return np.asarray(self.bins * (self.rate / self.samples), np.float64)

    @property
    def period_s(self) -> float:
        """After which the force repeats, s."""
        return self.samples / self.rate

    def each(self, peak: float) -> float:
        """The amplitude of each of them, all alike, so that their sum has about this peak."""
        return peak / (_CREST * math.sqrt(0.5 * self.bins.size))


def lines_for(rate: float) -> Lines:
    """Frequencies in about even steps of their logarithm, from one period to close below the Nyquist frequency."""
    samples = min(max(round(_PERIOD_S * rate), _LEAST_SAMPLES), _MOST_SAMPLES)
    bins = np.unique(np.rint(np.geomspace(1.0, _BELOW_NYQUIST * 0.5 * samples, _LINES)).astype(np.intp))
    return Lines(bins, samples, rate)


def multisine(lines: Lines, amplitude: Floats, peak: float) -> Floats:
    """(samples,) N: one period with these amplitudes (n,), made smaller throughout where its peak is above ``peak``."""
    rng = np.random.default_rng(_SEED)
    spectra = np.zeros((_DRAWS, lines.samples // 2 + 1), dtype=complex)
    turned = np.exp(2j * np.pi * rng.random((_DRAWS, lines.bins.size)))
    spectra[:, lines.bins] = 0.5 * lines.samples * amplitude * turned
    waves = np.fft.irfft(spectra, lines.samples)
    highest = np.max(np.abs(waves), axis=1)
    best = int(np.argmin(highest))
    return np.asarray(waves[best] * min(1.0, peak / max(float(highest[best]), 1e-300)))


class Periods(NamedTuple):
    """P pairs of whole periods, each overlapping the next by one; n frequencies, C channels: amplitudes (P, n, C) in m
    and N, and the complex variances (C,) of one pair's amplitudes that their scatter does not show, m² and N²."""

    position: Complexes
    scene: Complexes
    """What the scene's modules asked for."""
    force: Complexes
    """All that acted, by the loop's count of samples: the scene's, the excitation's, clipped and rounded."""
    rounded_position: Floats
    rounded_scene: Floats
    by_position: bool
    """Whether the scene's forces come of the recorded positions alone: then their rounding is no error of the ratio."""
    limited: int
    """Samples whose force was clipped at its limit."""
    lost: int
    """Periods that do not count: samples are missing."""

    @property
    def pairs(self) -> int:
        """P."""
        return self.position.shape[0]

    def after(self, settled: int) -> Periods:
        """Those from number `settled` on."""
        return self._replace(position=self.position[settled:], scene=self.scene[settled:], force=self.force[settled:])

    def on(self, channels: list[int]) -> Periods:
        """Those of some channels, in this order."""
        names = ("position", "scene", "force", "rounded_position", "rounded_scene")
        return self._replace(**{name: getattr(self, name)[..., channels] for name in names})


def periods_of(trace: Trace, lines: Lines, converters: Converters, *, senses: bool) -> Periods:
    """The whole periods of a trace. `senses`: the scene's forces come of velocities too, whose rounding no trace
    records; the frequencies that nothing excites show how large it is."""
    samples, scene = lines.samples, trace.asked_force
    number, rows_in = np.unique(trace.sample // samples, return_counts=True)
    begins = np.cumsum(rows_in) - rows_in
    whole = rows_in == samples
    pairs = begins[:-1][whole[:-1] & whole[1:] & (np.diff(number) == 1)]

    def amplitudes(signal: Floats) -> Complexes:
        found = [_amplitudes(signal[i : i + 2 * samples], lines) for i in pairs]
        return np.array(found, complex).reshape(-1, lines.bins.size, signal.shape[1])

    # How often the count changes in a period: as many of the roundings are independent of each other. Where a channel
    # hardly moves, they follow its motion, and lie where that lies: at the frequencies that are excited.
    later = trace.position_counts[trace.sample.size // 2 :]
    changes = np.mean(np.diff(later, axis=0) != 0, axis=0) * samples
    rounded = 4.0 / np.clip(changes, _FEWEST_CHANGES, samples)
    share = 4.0 / samples  # of a white error's variance, in an amplitude
    computed = share * (_OPERATIONS * np.finfo(float).eps * np.max(np.abs(scene), axis=0, initial=0.0)) ** 2
    if senses and pairs.size:  # the variance of the mean period at the frequencies that are not excited
        mean = np.mean([scene[first : first + samples] for first in pairs[pairs.size // 2 :]], axis=0)
        others = np.setdiff1d(np.arange(1, (samples + 1) // 2), lines.bins)
        computed = computed + np.mean(np.abs(np.fft.rfft(mean, axis=0)[others] * (2.0 / samples)) ** 2, axis=0)
    missing = int(number[-1] - number[0] + 1 - number.size) if number.size else 0  # nothing was recorded of them
    return Periods(
        amplitudes(trace.position - np.mean(trace.position, axis=0)),
        amplitudes(scene),
        amplitudes(_acting_force(trace, converters)),
        rounded_position=rounded * trace.position_scale**2 / 12.0,
        rounded_scene=computed,
        by_position=not senses,
        limited=int(np.count_nonzero(trace.flags & LIMITED)),
        lost=int(np.count_nonzero(rows_in[1:-1] != samples)) + missing,
    )


def _acting_force(trace: Trace, converters: Converters) -> Floats:
    """(N, C): the force that acted in place of each row's: where that came too late, or never left, the one before."""
    missed = trace.flags & UNSENT != 0
    if not is_always_late(trace):
        missed[:-1] |= (trace.flags[1:] & LATE_FORCE != 0) & (np.diff(trace.sample) == 1)
    if not converters.keeps_last_force:
        return np.where(missed[:, None], 0.0, trace.force)
    row = np.maximum.accumulate(np.where(missed, 0, np.arange(missed.size)))
    return np.asarray(trace.force[row])


def _amplitudes(signal: Floats, lines: Lines) -> Complexes:
    """(n, C) of two periods (2 samples, C), by a window of Hann: it is zero one period's frequency away from each, so
    that what is periodic is separated exactly, and it begins and ends softly, so that what dies away hardly leaks."""
    window = 1.0 - np.cos(np.pi * np.arange(2 * lines.samples) / lines.samples)
    return np.asarray(np.fft.rfft(signal * window[:, None], axis=0)[2 * lines.bins] / lines.samples)
