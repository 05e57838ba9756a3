"""Play of a transmission, from the motion at frequencies that no force excites.

A multisine of even lines and a ride on an odd one leave the other odd lines to what is not linear. Dry friction has the
sign of the velocity, which the record shows: its motion is taken away. Of what is left, play takes a force from the
belt's pull, between motor and handle; the rest of the friction acts on one side. Both are about as strong at all
frequencies, but they move the sensor otherwise: a slow force between the two moves nothing. So three powers are fitted
to the odd lines (Whittle's likelihood): of either force, and of the noise.

The belt's pull is a dead zone of the motor's lead. For a lead that is like noise, of rms s, and a zone of half width
d = u s, the stiffness that a fit finds is the share g = 2 (1 - P(u)) of the belt's, and the rest of the pull has the
power k² s² (2 (1 + u²) (1 - P(u)) - 2 u p(u) - g²), with P and p of the normal distribution (Gelb and Vander Velde,
*Multiple-Input Describing Functions*, 1968, §2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import brentq, nnls
from scipy.special import digamma, ndtr

from hapsim.measuring.converters import Complexes, Floats

_CERTAIN = 8.0  # of the likelihood's logarithm, by which a force between motor and handle fits better than none
_EFFECT = 1.0  # the same for each excitation, times the lacking share of the stiffness; friction alone has up to 0.7
_LEAST = 0.03  # the lacking share: with less the stiffness is known
_ROUNDS = 30
_WIDEST = 4.0  # rms leads: with a wider half of the play, motor and handle hardly ever mesh
_AMPLIFIED = 2.0  # by a belt, from the side that is read to the other
_NEIGHBOURS = 9  # lines over which the noise is averaged
_FINER = 4  # samples in one of the record, at which a sign is taken


class Spectra(NamedTuple):
    """Motion and force of R excitations at the first n lines of a period, excited or not."""

    samples: int
    """Samples of a period."""
    frequency: Floats
    """(n,) Hz."""
    moved: Complexes
    """(R, n) amplitudes of the position, m."""
    pushed: Complexes
    """(R, n) amplitudes of the acting force, N."""
    noise: Floats
    """(R, n) m², mean squared amplitude of what does not repeat."""
    is_silent: NDArray[np.bool_]
    """(n,) True for an odd line that no force excites, nor is an odd multiple of the ride."""


@dataclass(frozen=True)
class MeasuredResponse:
    """Motion and force of R excitations with other phases, and the response at n excited lines."""

    spectra: Spectra
    excited: NDArray[np.intp]
    """(n,) of the lines of the spectra."""

    @property
    def frequency(self) -> Floats:
        """Excited frequencies, (n,) Hz."""
        return self.spectra.frequency[self.excited]

    @cached_property
    def each(self) -> Complexes:
        """Sampled position over sent force of each excitation, (R, n) m/N."""
        return np.asarray(self.spectra.moved[:, self.excited] / self.spectra.pushed[:, self.excited])

    @property
    def mean(self) -> Complexes:
        """The mean of the excitations, (n,)."""
        return np.asarray(np.mean(self.each, axis=0))

    @property
    def scatter(self) -> Floats:
        """Relative standard deviation (n,) from excitation to excitation: noise, and motion that is not linear.
        Averaged over neighbouring lines."""
        freedom = len(self.each) - 1
        squares = np.sum(np.abs(self.each / self.mean - 1.0) ** 2, axis=0) / freedom
        unbiased = math.log(freedom) - float(digamma(freedom))  # of a mean of logarithms
        return np.exp(0.5 * (uniform_filter1d(np.log(squares + 1e-300), _NEIGHBOURS, mode="nearest") + unbiased))

    @property
    def noise(self) -> Floats:
        """Relative standard deviation (n,) of what does not repeat within an excitation."""
        noise = np.mean(self.spectra.noise[:, self.excited], axis=0)
        return np.sqrt(noise / np.mean(np.abs(self.spectra.moved[:, self.excited]) ** 2, axis=0))

    @property
    def deviation(self) -> Floats:
        """Standard deviation of the mean, (n,), complex."""
        return np.asarray(self.scatter * np.abs(self.mean) / math.sqrt(len(self.each)))


class Play(NamedTuple):
    """Play between motor and handle."""

    size: float
    """m, about."""
    share: float
    """Share of the belt's stiffness that a linear fit finds."""


class Responses(NamedTuple):
    """Answers of a fitted device at the lines of ``Spectra``, each (n,)."""

    held: Complexes
    """Position that is read per held force, m/N."""
    rubbed: Complexes
    """The same per dry friction."""
    parted: Complexes
    """The same per force that presses motor and handle apart."""
    lead: Complexes
    """Lead of the motor before the handle per held force, m/N."""
    rubbing: Complexes
    """Position of the side with the friction per held force, m/N."""


def _beyond(spectra: Spectra, by: Responses) -> Complexes:
    """Returns the motion (R, n) that is not linear, m, without that of dry friction as the silent lines show it."""
    off, ratio = spectra.moved - by.held * spectra.pushed, by.rubbing / by.held
    # Behind a belt, the noise of the position that is read would hide the velocity.
    rubbing = by.rubbing * spectra.pushed + np.where(np.abs(ratio) < _AMPLIFIED, ratio, 0.0) * off
    rubbed = by.rubbed * _signs(2j * np.pi * spectra.frequency * rubbing, spectra.samples)
    scale = np.sqrt(np.mean(spectra.noise, axis=0))
    seen, one = ((each / scale)[:, spectra.is_silent] for each in (off, rubbed))
    force = float(np.sum((one.conj() * seen).real) / np.sum(np.abs(one) ** 2))  # N, against the velocity
    return np.asarray(off - min(force, 0.0) * rubbed)


def play_in(spectra: Spectra, by: Responses, stiffness: float) -> Play | None:
    """Returns the play that these spectra show behind a fitted stiffness, N/m; None if they show none."""
    silent, count, noise = spectra.is_silent, len(spectra.moved), np.mean(spectra.noise, axis=0)
    beyond = (_beyond(spectra, by) / np.sqrt(noise))[:, silent]
    powers = np.abs(by.rubbed) ** 2 / noise, np.ones(silent.size), np.abs(by.parted) ** 2 / noise
    columns, left = np.stack(powers, axis=1)[silent], np.mean(np.abs(beyond) ** 2, axis=0)
    (_, without), (found, with_play) = (_fitted(columns[:, :some], left) for some in (2, 3))
    lead = math.sqrt(0.5 * float(np.sum(np.mean(np.abs(by.lead * spectra.pushed) ** 2, axis=0))))
    force = math.sqrt(0.5 * float(found[2]) * silent.size)  # the excited lines have as much of it
    play, gain = _play(force / (stiffness * lead), lead), without - with_play
    lacks = 1.0 - play.share
    return play if gain * count > _CERTAIN and lacks > _LEAST and gain * lacks > _EFFECT else None


def _signs(amplitudes: Complexes, samples: int) -> Complexes:
    """Returns the amplitudes of the sign of periodic signals, of which these are the amplitudes, (R, n)."""
    lines, fine = amplitudes.shape[1], _FINER * samples
    spectra = np.zeros((len(amplitudes), fine // 2 + 1), complex)
    spectra[:, 1 : 1 + lines] = 0.5 * fine * amplitudes
    signs = np.sign(np.fft.irfft(spectra, fine))
    return np.asarray(np.fft.rfft(signs)[:, 1 : 1 + lines] * (2.0 / fine), complex)


def _fitted(columns: Floats, power: Floats) -> tuple[Floats, float]:
    """Returns the factors of the columns that make powers most likely, each of them 0 or more, and minus the logarithm
    of the likelihood of one excitation."""
    model = power + columns[:, 1]
    for _ in range(_ROUNDS):
        factors, _ = nnls(columns / model[:, None], power / model)
        model = columns @ factors + 1e-12 * power
    return factors, float(np.sum(np.log(model) + power / model))


def _play(lacking: float, lead: float) -> Play:
    """Returns the play whose rest of the pull is this share of the fitted one. ``lead``: rms, m."""

    def share(u: float) -> float:
        return 2.0 * float(ndtr(-u))

    def rest(u: float) -> float:
        density = math.exp(-0.5 * u * u) / math.sqrt(2.0 * math.pi)
        return math.sqrt(max((1.0 + u * u) * share(u) - 2.0 * u * density - share(u) ** 2, 0.0)) / share(u)

    half = float(brentq(lambda u: rest(u) - lacking, 0.0, _WIDEST)) if lacking < rest(_WIDEST) else _WIDEST
    return Play(2.0 * half * lead, share(half))
