"""The string of a comparison, and the timing, for peers without hapsim's packages: only numpy is imported.

The string has equal masses and visco-elastic links, and is fixed at both ends. Its eigenfrequencies are known exactly,
and are identified in a simulation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# (shape, samples) -> the motion along that shape, sample by sample, once the string was released in it at rest.
Record = Callable[[Vector, int], Vector]

STEADY = 1.0 + 1e-9  # the largest modulus of a pole that counts as stable: the fit's own error stays below
_PERIODS = 2.0
_LEAST_SAMPLES = 64
_POINTS_PER_PERIOD = 16.0


@dataclass(frozen=True)
class StringOfMasses:
    """N masses in one dimension (transverse), N + 1 equal links between them and the two fixed ends.

    m x_i'' = K (x_{i-1} - 2 x_i + x_{i+1}) + B (v_{i-1} - 2 v_i + v_{i+1}), in continuous time; with bending, and u_i
    for x_{i-1} - 2 x_i + x_{i+1} (0 at the ends), S (u_{i-1} - 2 u_i + u_{i+1}) is subtracted.
    """

    masses: int
    mass: float  # of each, kg
    stiffness: float  # of each link, K in N/m
    damping: float  # of each link, B in N·s/m
    bending: float = 0.0  # S in N/m

    @classmethod
    def tuned(
        cls,
        masses: int,
        total_mass: float = 0.005,
        fundamental: float = 20.0,
        damping_ratio: float = 1e-4,
        sharp: float = 0.0,
    ) -> StringOfMasses:
        """A string of `total_mass` in kg whose first mode rings at `fundamental` Hz with `damping_ratio`, but for the
        bending, which makes mode 5 so much higher: `sharp`, relative."""
        mass = total_mass / masses
        omega = 2.0 * math.pi * fundamental
        stiffness = mass * (omega / (2.0 * math.sin(math.pi / (2.0 * (masses + 1))))) ** 2
        of_mode_5 = (2.0 * math.sin(5.0 * math.pi / (2.0 * (masses + 1)))) ** 2
        bending = stiffness * ((1.0 + sharp) ** 2 - 1.0) / of_mode_5
        return cls(masses, mass, stiffness, 2.0 * damping_ratio * stiffness / omega, bending)

    def frequency(self, mode: int) -> float:
        """The undamped frequency in Hz of mode 1 to N: |s| of its poles over 2 pi, which no damping moves."""
        square = 4.0 * math.sin(math.pi * mode / (2.0 * (self.masses + 1))) ** 2
        return math.sqrt((self.stiffness + self.bending * square) * square / self.mass) / (2.0 * math.pi)

    def shape(self, mode: int) -> Vector:
        """The masses' displacements in mode 1 to N, 1 at the most, shape (N,)."""
        return np.asarray(np.sin(math.pi * mode * self._along))

    def plucked(self) -> Vector:
        """The masses' displacements in m when the string is lifted by 1 mm at a third of its length, shape (N,)."""
        return np.asarray(1e-3 * np.minimum(3.0 * self._along, 1.5 * (1.0 - self._along)))

    @property
    def _along(self) -> Vector:
        return np.arange(1, self.masses + 1) / (self.masses + 1)


def held_mass(string: StringOfMasses) -> int:
    """The mass, from 0, that a hand holds: a third of the way."""
    return string.masses // 3


def hand_link(string: StringOfMasses) -> tuple[float, float]:
    """K (N/m) and B (N·s/m) between a hand and its mass: a hundredth of a link's, so that a stable string stays so."""
    return 0.01 * string.stiffness, 0.01 * string.damping


def hand_motion(samples: int, rate: float) -> Vector:
    """A hand that moves by 1 mm, twice a second; m, shape (samples,)."""
    return np.asarray(1e-3 * np.sin(4.0 * np.pi * np.arange(samples) / rate))


def frequencies_of(
    record: Record,
    string: StringOfMasses,
    rate: float,
    modes: Iterable[int],
    explicit: bool = True,
    steady: float = STEADY,
) -> list[float]:
    """The eigenfrequency in Hz of each mode as it is simulated at `rate` Hz; NaN for all where that is unstable.

    `explicit`: the scheme may be unstable, which its highest mode shows: that one is the first to be. `steady`:
    the largest modulus of a pole that counts as stable.
    """
    if explicit:
        with np.errstate(all="ignore"):
            if not np.all(np.abs(poles(record(string.shape(string.masses), _LEAST_SAMPLES), 1)) <= steady):
                return [math.nan for _ in modes]
    return [_frequency(record, string, rate, mode) for mode in modes]


def project(rows: Vector, shape: Vector) -> Vector:
    """Returns the amplitude of `shape` (N,) in each of the displacements `rows` (..., N)."""
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


def poles(motion: Vector, stride: int) -> NDArray[np.complex128]:
    """The pole pair, to the power of `stride`, of the recurrence q[n+s] = c1 q[n] + c2 q[n-s] that fits `motion` best.

    Least squares on the second difference, α q[n] + β (q[n] - q[n-s]): slow motion would leave c1 and c2 hardly other
    than 2 and -1. With w = z - 1 the poles solve w² - (α + β) w - α = 0. NaN where the motion is not finite, or there
    is none.
    """
    nothing = np.full(2, complex(math.nan, math.nan))
    if not np.all(np.isfinite(motion)) or np.max(np.abs(motion)) > 1e150:
        return nothing
    now = motion[stride:-stride]
    growth = now - motion[: -2 * stride]
    bend = (motion[2 * stride :] - now) - growth
    columns = np.stack([now, growth], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    if not np.all(scale > 0.0):
        return nothing
    alpha, beta = np.linalg.lstsq(columns / scale, bend, rcond=None)[0] / scale
    half = (alpha + beta) / 2.0
    root = np.sqrt(complex(half * half + alpha))
    return np.array([1.0 + half + root, 1.0 + half - root])


ROUND_S = 0.15
_WARM = 0.2  # of a round


class Timed:
    """A simulation that is timed in rounds of about `round_s`, each of as many samples.

    `advance`: simulates that many samples. It is called until it has run warm.
    """

    def __init__(self, advance: Callable[[int], object], rate: float, round_s: float = ROUND_S) -> None:
        self._advance, self._rate = advance, rate
        samples = 1
        advance(samples)  # the first may compile
        while (took := self._took(samples)) < _WARM * round_s:
            samples *= 4 if took < 0.25 * _WARM * round_s else 2
        self._samples = max(1, round(samples * round_s / took))

    def round(self) -> float:
        """Seconds of processor time for each second that is simulated at `rate` Hz, this time."""
        return self._took(self._samples) * self._rate / self._samples

    def _took(self, samples: int) -> float:
        """Returns the processor time of the calling thread, s: a progress display does not count."""
        begin = time.thread_time()
        self._advance(samples)
        return time.thread_time() - begin


def cost_of(advance: Callable[[int], object], rate: float, rounds: int, round_s: float = ROUND_S) -> list[float]:
    """Seconds of processor time for each second that is simulated at `rate` Hz, one for each round."""
    timed = Timed(advance, rate, round_s)
    return [timed.round() for _ in range(rounds)]
