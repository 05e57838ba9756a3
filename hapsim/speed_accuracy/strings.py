"""A string of masses with a hand on one of them: where its first modes ring."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst

from hapsim.cordis.offline import start, ticks_watched
from hapsim.cordis.program import Program, compile_scene, numbers_of
from hapsim.cordis.schemes.exact_modes import ExactModes
from hapsim.scene import Device, DevicePoint, Scene, String, ViscoElastic
from hapsim.speed_accuracy.results import Found, schemes


@dataclass(frozen=True)
class StringOfMasses:
    """N masses in one dimension (transverse), N + 1 equal links between them and the two fixed ends.

    m x_i'' = K (x_{i-1} - 2 x_i + x_{i+1}) + B (v_{i-1} - 2 v_i + v_{i+1}), in continuous time; with bending, and u_i
    for x_{i-1} - 2 x_i + x_{i+1} (0 at the ends), S (u_{i-1} - 2 u_i + u_{i+1}) is subtracted.

    `masses`: N. `mass`: of each, in kg. `stiffness`, `damping`: of each link, K in N/m and B in N·s/m. `bending`: S in
    N/m.
    """

    masses: int
    mass: float
    stiffness: float
    damping: float
    bending: float = 0.0

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

    def shape(self, mode: int) -> NDArray[np.float64]:
        """The masses' displacements in mode 1 to N, 1 at the most, shape (N,)."""
        along = np.arange(1, self.masses + 1) / (self.masses + 1)
        return np.asarray(np.sin(math.pi * mode * along))

    def plucked(self) -> NDArray[np.float64]:
        """The masses' displacements in m when the string is lifted by 1 mm at a third of its length, shape (N,)."""
        along = np.arange(1, self.masses + 1) / (self.masses + 1)
        return np.asarray(1e-3 * np.minimum(3.0 * along, 1.5 * (1.0 - along)))


def held_mass(string: StringOfMasses) -> int:
    """The mass, from 0, that a hand holds: a third of the way."""
    return string.masses // 3


def hand_link(string: StringOfMasses) -> tuple[float, float]:
    """K in N/m and B in N·s/m between a hand and the mass it holds: a hundredth of a link's, so that a string that is
    stable stays so."""
    return 0.01 * string.stiffness, 0.01 * string.damping


def hand_motion(samples: int, rate: float) -> NDArray[np.float64]:
    """A hand that moves by 1 mm, twice a second; m, shape (samples,)."""
    return np.asarray(1e-3 * np.sin(4.0 * np.pi * np.arange(samples) / rate))


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


class _Kept(NamedTuple):
    """Where a program keeps a string: at the beginning of the row whose turn it is; `amounts`, there, of the shape."""

    rows: list[NDArray[np.floating]]
    amounts: NDArray[np.float64]


def record(scene: Scene, string: StringOfMasses, shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """The motion along `shape` (N,), sample by sample, once the scene's string was released in it; shape (samples,)."""
    program = compile_scene(scene)
    kept = _kept(program, scene, shape)
    for row in kept.rows:
        row[: string.masses] = kept.amounts
    start(program, np.zeros(scene.channels))
    watched = np.empty(samples)
    ticks_watched(program, kept.rows, kept.amounts / (kept.amounts @ kept.amounts), watched)
    return watched


def _kept(program: Program, scene: Scene, shape: NDArray[np.float64]) -> _Kept:
    """As positions of its masses; or, by the exact scheme, as how much there is of each of its modes: sines, all of one
    norm, the slowest first."""
    for part in program.parts:
        if isinstance(part.numbers, ExactModes):
            return _Kept(3 * [part.numbers.position], dst(shape, type=1) / (shape.size + 1))
    first = numbers_of(scene)["string.0"]
    return _Kept([row[first:] for row in program.rows], shape)


MODES = (1, 2, 3, 4, 5)


class RingingString:
    """A `string` and how it is called."""

    quantities: tuple[str, ...] = ("frequency",)

    def __init__(self, name: str, title: str, string: StringOfMasses) -> None:
        self.name, self.title, self.string = name, title, string

    def methods(self) -> tuple[str, ...]:
        return schemes()

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        return scene_of(self.string, method, precision, rate, *hand_link(self.string))

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Rings it in some of its modes: the frequency that is furthest off, relative."""
        steady = STEADY if precision == "double" else STEADY_IN_SINGLE
        ring = partial(record, scene_of(self.string, method, precision, rate), self.string)
        rung = frequencies_of(ring, self.string, rate, MODES, steady=steady)
        errors = [frequency / self.string.frequency(mode) - 1.0 for mode, frequency in zip(MODES, rung, strict=True)]
        if not all(math.isfinite(error) for error in errors):
            return Found({}, "unstable")
        return Found({"frequency": max(errors, key=abs)})


def scene_of(
    string: StringOfMasses, method: str, precision: str, rate: float, stiffness: float = 0.0, damping: float = 0.0
) -> Scene:
    """The string as a scene; the hand's link in N/m and N·s/m."""
    return Scene(
        version=1,
        scheme=method,  # type: ignore[arg-type]
        precision=precision,  # type: ignore[arg-type]
        rate=rate,
        device=Device(clock="lockstep", mass=0.2),
        modules={
            "hand": DevicePoint(channel=0),
            "string": String(
                masses=string.masses,
                mass=string.mass,
                stiffness=string.stiffness,
                damping=string.damping,
                bending=string.bending,
            ),
            "touch": ViscoElastic(
                between=("hand", f"string.{held_mass(string)}"), stiffness=stiffness, damping=damping
            ),
        },
    )
