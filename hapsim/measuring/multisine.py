"""A periodic multisine: which frequencies it excites, how strongly each, and its forces over one period.

Random phases, of many draws those with the lowest peak (Pintelon and Schoukens, *System Identification: A Frequency
Domain Approach*, 2012, §5.3). A whole number of periods of every frequency fits in one period of the multisine, so that
nothing leaks from one into another, and what differs from period to period is noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_PERIOD_S = 0.5
_LEAST_SAMPLES, _MOST_SAMPLES = 256, 1 << 15
_LINES = 48
_BELOW_NYQUIST = 0.9
_DRAWS = 64
_SEED = 20040927
_CREST = 2.5  # peak over effective value that a good draw has, about


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
    best, least = np.zeros(lines.samples), math.inf
    for _ in range(_DRAWS):
        spectrum = np.zeros(lines.samples // 2 + 1, dtype=complex)
        turned = np.exp(2j * np.pi * rng.random(lines.bins.size))
        spectrum[lines.bins] = 0.5 * lines.samples * amplitude * turned
        wave = np.fft.irfft(spectrum, lines.samples)
        highest = float(np.max(np.abs(wave)))
        if highest < least:
            best, least = wave, highest
    return best * min(1.0, peak / least) if least > 0.0 else best
