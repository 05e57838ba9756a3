"""Parameters of one haptic simulator: hand and device, rate, delay, hold, sampling, damper."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hapsim.holds import HOLDS
from hapsim.theory.arrays import Bools, Complexes, Floats, not_negative, one_of, positive
from hapsim.theory.hand.inverse_map import (
    Undamped,
    double_pole,
    element_of_oscillator,
    is_attainable,
    leads,
    stable_interval,
    undamped_curve,
)
from hapsim.theory.hand.lone_hand import LoneHand, characteristic, lone_hand
from hapsim.theory.hand.pole_pair import PolePair, oscillator_of_quadratic
from hapsim.theory.hand.poles import (
    OWN_ABOVE_NYQUIST,
    UNLIKE_PAIR,
    LeadingPair,
    all_poles,
    all_within,
    broadcast_in_blocks,
    dominance_reasons,
)
from hapsim.theory.hand.wall_passivity import needed_friction
from hapsim.theory.interface import SAMPLINGS, Ahead, damper_gain, damper_named, delay_and_hold, hold_lag, lag_of
from hapsim.theory.plant import RIGID, Drive

MOST_EIGENVALUES = 8  # poles; beyond, a stable interval is sought without eigenvalues, which take too long
_STEP, _LEAST = 1e-5, 1e-3  # of differences in K and B: a share of them, and of their units at least
_ROUNDED = 1e-9  # in the paper's units; less is rounding
_SAME = 1e-6  # relative difference of two pairs; less is rounding
_no_warnings = np.errstate(all="ignore")  # numbers out of range become NaN


class Deformation(NamedTuple):
    """Change of the felt k and b with the simulated K and B. Undeformed, both stretches are 1 and the others 0."""

    stretch_k: float
    """dk/dK."""
    k_by_B_per_s: float  # noqa: N815
    b_by_K_s: float  # noqa: N815
    stretch_b: float
    """db/dB."""
    crossing_deg: float
    """Angle at which curves of equal k and equal b cross in the plane of K T²/m and B T/m, 0 to 90 degrees: at 90 the
    deformation is homothetic, below sheared."""


@dataclass(frozen=True)
class Configuration:
    """Loop around a temporary hybrid system (Florens et al., §4 and §6).

    A real mass, with the real friction of the device, is coupled to a simulated visco-elastic element (K, B) by a
    sampled position and a delayed, held force. The hand feels the real oscillator of the same mass with stiffness k and
    damping b, the device's own spring and friction included.

    Methods take arrays, broadcast them against each other and return arrays of that shape (scalars for scalars). Where
    no answer exists, or an argument is not finite, the answer is NaN (False for a verdict), without a warning.

    Attributes:
        mass: real mass, hand and moving part of the device, kg, > 0.
        rate: sample rate, Hz, > 0.
        friction: real viscous friction b0, N·s/m, >= 0.
        delay: from the sampling of a position to the change of the force that answers it, periods, >= 0.
        hold: name in ``hapsim.holds.HOLDS``: the shape that the device gives to the forces that it receives.
        sampling: "ideal", the position at the sample; or "average", its mean over the last sample period.
        stiffness: real spring k0 of the device, N/m, >= 0.
        damper: the source of the simulated damper's velocity: "backward", the difference of the last two positions (the
            paper's); "centred", the difference across two periods; "filtered", a first-order low-pass behind the
            backward one; "sensed", the velocity that the device measures.
        cutoff: of the filtered damper, Hz, > 0; None for the others.
        spring_lag: sample periods, >= 0. The simulated spring uses an earlier position, interpolated between the last
            two; only with the backward damper, and then B acts as B - K spring_lag T. For the mean of the forces of N
            substeps it is (N - 1)/(2 N).
        ahead: the element sees the sensed motion ahead of its reading; None: the reading.
        drive: motor and transmission between the force and the hand. The pair (k, b) is then that of the two slowest
            motions, and is felt where the handle answers an impulse so.
        window: sample periods over which a backward damper takes its difference.
        steps: sample periods of this loop in one of the host. Above 1 it is the loop of a board that evaluates the law
            itself (``board_lines.py``); ``rate``, ``delay`` and poles are those of the board.

    Raises:
        ValueError: an argument is out of its range; the message states which, and the range.
    """

    DOCUMENT = "mass rate friction delay hold sampling stiffness damper cutoff spring_lag ahead"

    mass: float
    rate: float
    friction: float = 0.0
    delay: float = 1.0
    hold: str = "zoh"
    sampling: str = "ideal"
    stiffness: float = 0.0
    damper: str = "backward"
    cutoff: float | None = None
    spring_lag: float = 0.0
    ahead: Ahead | None = None
    drive: Drive = RIGID
    window: int = 1
    steps: int = 1

    def __post_init__(self) -> None:
        for name in ("mass", "rate"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("friction", "delay", "stiffness", "spring_lag"):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        one_of("hold", self.hold, HOLDS)
        one_of("sampling", self.sampling, SAMPLINGS)
        damper_named(self.damper, self.cutoff, self.rate, self.window)
        if self.spring_lag and self.damper != "backward":
            raise ValueError(
                f"damper is {self.damper!r}, but the mean of the substeps' forces (spring_lag {self.spring_lag:g}) is "
                "derived only for a backward damper."
            )
        derived = {"sampling": self.sampling == "ideal", "hold": not HOLDS[self.hold].has_impulses}
        derived["damper"] = not damper_named(self.damper, self.cutoff, self.rate).senses
        if unfit := [name for name, is_derived in derived.items() if self.drive.inner and not is_derived]:
            found = f"{unfit[0]} is {getattr(self, unfit[0])!r}"
            raise ValueError(f"{found}, for which the loop of a transmission or a motor lag is not derived.")
        if not self.drive.motor_mass < self.mass:
            raise ValueError(f"mass is {self.mass:g} kg, but the motor alone has {self.drive.motor_mass:g} kg.")

    @property
    def period(self) -> float:
        """Sample period T, s."""
        return 1.0 / self.rate

    @property
    def stiffness_unit(self) -> float:
        """m/T² in N/m: the stiffness that is 1 in the paper's normalised units (§6)."""
        return self.mass * self.rate**2

    @property
    def damping_unit(self) -> float:
        """m/T in N·s/m: the damping that is 1 in the paper's normalised units (§6)."""
        return self.mass * self.rate

    @_no_warnings
    def normalised(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """(K T²/m, B T/m), the paper's units (§6), of stiffnesses in N/m and dampings in N·s/m."""
        kappa, beta = self._normalised(K, B)
        return kappa[()], beta[()]

    @broadcast_in_blocks
    def simulated(self, k: ArrayLike, b: ArrayLike, *, dominant: bool = True) -> tuple[Floats, Floats]:
        """Returns the simulated (K, B) that the hand feels as the real (k, b): the paper's Figure 4, in closed form.

        Args:
            k: desired total stiffness, the device's own spring included, N/m.
            b: desired total damping, real friction included, N·s/m; negative for a motion that grows.
            dominant: require the two poles of (k, b) to be the slowest of the loop. If another pole decays no faster,
                no (K, B) makes the hand feel (k, b).

        Returns:
            K in N/m and B in N·s/m; NaN at and above the Nyquist frequency, and where ``dominant`` is not met.
        """
        K, B, pair, good = self._element(k, b)
        if dominant:
            good &= self._leads(K, B, pair)
        K, B = K * self.stiffness_unit, B * self.damping_unit
        return np.where(good, K, np.nan), np.where(good, B, np.nan)

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """Returns the real (k, b) that the hand feels for a simulated (K, B) (Florens et al., §5), N/m and N·s/m. It is
        read from the slowest-decaying pair of poles, a complex pair or two positive real ones: s = ln(z)/T, k = m s1
        s2, b = -m (s1 + s2). NaN where ``dominant`` is False."""
        _, k, b = self.solved(K, B)
        return k, b

    @broadcast_in_blocks
    def solved(self, K: ArrayLike, B: ArrayLike) -> tuple[Complexes, Floats, Floats]:
        """Returns ``poles`` and the two of ``equivalent``, in the time of one of them."""
        lead, poles = self._solved(K, B)
        sigma, kappa = oscillator_of_quadratic(lead.p, lead.q)
        held = (np.asarray(K) != 0.0) | (self.stiffness != 0.0)  # otherwise only rounding is left
        k = np.where(lead.dominant, held * kappa * self.stiffness_unit, np.nan)
        b = np.where(lead.dominant, sigma * self.damping_unit, np.nan)
        return poles, k, b

    def deformation(self, K: float, B: float) -> Deformation:
        """Returns the deformation of the parameter space at (K, B) (Florens et al., §5), by differences; NaN where
        ``dominant`` is False."""
        unit = np.array([self.stiffness_unit, self.damping_unit])
        at = np.array([K, B])
        steps = np.diag(_STEP * np.maximum(np.abs(at), _LEAST * unit))
        ends = [self.equivalent(*(at[:, None] + sign * steps)) for sign in (1.0, -1.0)]
        # In the paper's units, in which the curves cross at right angles where nothing is deformed.
        change = (np.array(ends[0]) - np.array(ends[1])) / unit[:, None] / (2.0 * np.diag(steps) / unit)
        change = np.where(np.abs(change) < _ROUNDED, 0.0, change)
        turn = np.subtract(*np.arctan2(*change.T[::-1]))
        (k_K, k_B), (b_K, b_B) = (change * unit[:, None] / unit).tolist()
        return Deformation(k_K, k_B, b_K, b_B, abs(math.degrees(math.remainder(turn, math.pi))))

    @broadcast_in_blocks
    def dominant(self, K: ArrayLike, B: ArrayLike) -> Bools:
        """Returns whether the slowest poles are a complex pair or positive and real, and all others decay faster."""
        return self._solved(K, B)[0].dominant

    @broadcast_in_blocks
    def dominant_poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """Dominant pair (..., 2) in the z-plane, from which ``equivalent`` is read; NaN where ``dominant`` is False."""
        lead, poles = self._solved(K, B)
        return np.where(lead.dominant[:, None], poles[:, :2], np.nan)

    @broadcast_in_blocks
    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """Poles (..., N) of the loop in the z-plane, by decreasing modulus. N is 2 for the impulse hold with ideal
        sampling and no delay. It is one more for each whole sample of delay, for a fraction of one, for the zero-order
        hold, for averaged sampling and for each memory of a damper (a sensed one has none)."""
        return self._solved(K, B)[1]

    def spectral_radius(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Largest modulus of a pole: below 1 every motion decays."""
        return np.abs(self.poles(K, B)[..., 0])

    @broadcast_in_blocks
    def is_stable(self, K: ArrayLike, B: ArrayLike) -> Bools:
        """Returns whether every motion decays (Florens et al., §6.2: the limit is the curve b = 0). Where ``dominant``
        is True the test is k > 0 and b > 0, since the spectral radius of a slow motion rounds to 1."""
        lead, poles = self._solved(K, B)
        # Without a spring of the device, q has the sign of K, even where K is too small to change q.
        restores = lead.q > 0.0 if self.stiffness else np.asarray(K) > 0.0
        held = (np.asarray(K) != 0.0) | (self.stiffness != 0.0)  # otherwise a pole is 1
        decays = held & (np.abs(poles[:, 0]) < 1.0)
        return decays if self.drive.inner else np.where(lead.dominant, restores & (lead.p > lead.q), decays)

    @_no_warnings
    def is_passive(self, K: ArrayLike, B: ArrayLike) -> Bools:
        """Returns whether the wall gives no energy to any hand: K >= 0 and a friction above ``needed_friction``.

        Raises:
            ValueError: as ``needed_friction``.
        """
        needed = self.needed_friction(K, B)
        return ((np.asarray(K, dtype=float) >= 0.0) & (self.friction > needed))[()]

    @_no_warnings
    def needed_friction(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Real friction, N·s/m, above which a wall (K, B) is passive (Colgate and Schenkel, 1997).

        K T/2 + |B| for the backward damper without delay, K T (delay + 1/2) for a spring alone behind whole samples of
        delay; more for a delay with a fraction of a sample (see ``wall_passivity.py``).

        Raises:
            ValueError: the hold has impulses, the sampling not "ideal" or the damper "sensed": the condition is not
                derived. (A sampled velocity passes every image of a motion: no friction suffices.)
        """
        if (
            HOLDS[self.hold].has_impulses
            or self.sampling != "ideal"
            or self.normalised_loop.damper.senses
            or self.ahead is not None
            or self.drive.lag > 0.0
            or (self.drive.is_elastic and (self.drive.reads_handle or self.drive.brakes_handle))
        ):
            raise ValueError(
                "The passivity condition is derived for holds without impulses, ideal sampling and a damper that "
                f"differentiates positions only, not for hold {self.hold!r} with sampling {self.sampling!r} and the "
                f"{self.damper} damper, and for a motor that does not lag, with the position and the friction."
            )
        K, B = np.broadcast_arrays(np.asarray(K, dtype=float), np.asarray(B, dtype=float))
        damping = B - self.spring_lag * self.period * K
        needed = needed_friction(
            self.period * K.ravel(), damping.ravel(), lag_of(self.delay, self.hold), self.normalised_loop.damper
        )
        return needed.reshape(K.shape)[()]

    @_no_warnings
    def stability_limit(self, frequency: ArrayLike) -> tuple[Floats, Floats]:
        """Element (K, B) with which the hand oscillates without decay at a frequency in Hz: the curve b = 0 (§6.2),
        closed form. NaN from the Nyquist frequency on, and where another pole of the loop lies outside the unit
        circle."""
        k = self.mass * (2.0 * np.pi * np.asarray(frequency, dtype=float)) ** 2
        return self.simulated(k, 0.0)

    @_no_warnings
    def stable_stiffness(self, B: ArrayLike) -> tuple[Floats, Floats]:
        """Lowest interval (least, most) of K, N/m, in which the loop is stable for B in N·s/m; NaN if there is none."""
        least, most = self._stable_interval(0, self._normalised(0.0, B)[1])
        return (least * self.stiffness_unit)[()], (most * self.stiffness_unit)[()]

    @_no_warnings
    def stable_damping(self, K: ArrayLike) -> tuple[Floats, Floats]:
        """Lowest interval (least, most) of B, N·s/m, in which the loop is stable for K in N/m; NaN if there is none."""
        least, most = self._stable_interval(1, self._normalised(K, 0.0)[0])
        return (least * self.damping_unit)[()], (most * self.damping_unit)[()]

    @_no_warnings
    def linear_stiffness_limit(self, B: ArrayLike) -> Floats:
        """Largest stiffness near the origin, (b0 + B)/(T/2 + delay T), N/m; too large as B grows (Gil et al., 2004).
        T/2 is the zero-order hold's mean delay; averaged sampling adds as much, ``spring_lag`` its own, and the impulse
        hold has none. Infinite without any delay, and where the element sees as far ahead."""
        lag = max(self._lag + self.spring_lag - self.seen_ahead_s * self.rate, 0.0)
        return ((self.friction + np.asarray(B, dtype=float)) / (lag * self.period))[()]

    @_no_warnings
    def fold(self, decay: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
        """Fold of the map (K, B) -> (k, b) as (K, B, k, b), N/m and N·s/m. There the faster pole of the dominant pair
        is a double one; on the far side no spring and damper is equivalent. The parameter of the curve is the ``decay``
        of that pole in 1/s, > 0. NaN where another pair dominates, and behind a drive."""
        decay = np.asarray(decay, dtype=float)
        if self.drive.inner:
            return (np.full(decay.shape, np.nan),) * 4
        fast = decay.ravel() * self.period
        kappa, beta, slow = double_pole(self.normalised_loop, fast)
        K, B = kappa * self.stiffness_unit, beta * self.damping_unit
        k, b = slow * fast * self.stiffness_unit, (slow + fast) * self.damping_unit
        return tuple(value.reshape(decay.shape)[()] for value in (K, B, k, b))  # type: ignore[return-value]

    @_no_warnings
    def impedance(self, K: ArrayLike, B: ArrayLike, frequency: ArrayLike) -> Complexes:
        """Felt impedance, force over velocity in N·s/m, at a frequency in Hz (the paper's Figure 2). It includes the
        device's friction and spring, but not its mass, and of a held force only the part at the frequency itself. NaN
        at 0 and from the Nyquist frequency on."""
        f = np.asarray(frequency, dtype=float)
        jw, theta = 2j * np.pi * f, 2.0 * np.pi * f * self.period
        damping = np.asarray(B) - self.spring_lag * self.period * np.asarray(K)
        element = np.asarray(K) / jw + damping * damper_gain(self.normalised_loop.damper, theta)
        if self.ahead is not None:
            turned = jw * self.seen_ahead_s
            element = np.asarray(K) / jw * (1.0 + turned + 0.5 * turned**2) + damping * (1.0 + turned)
        rendered = element * delay_and_hold(theta, self.delay, self.hold, self.sampling)
        rendered = rendered + self.friction + self.stiffness / jw
        return np.where((theta > 0.0) & (theta < np.pi), rendered, np.nan)[()]

    @broadcast_in_blocks
    def why_no_equivalent(self, K: ArrayLike, B: ArrayLike) -> NDArray[np.str_]:
        """Reason why ``equivalent`` is NaN; "" where it is not."""
        lead, poles = self._solved(K, B)
        if self.drive.inner:
            return np.where(lead.dominant, "", UNLIKE_PAIR)
        words = dominance_reasons(poles, lead.dominant)
        return words if self._own_swing_is_seen else np.full(words.shape, OWN_ABOVE_NYQUIST)

    @_no_warnings
    def characteristic(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Coefficients (..., N + 1) of the monic characteristic polynomial in z, highest power first. The polynomial is
        the paper's P K + Q B + R (§6) divided by its leading coefficient."""
        kappa, beta = self._normalised(K, B)
        return np.stack(characteristic(self.normalised_loop, kappa, beta), axis=-1)

    @property
    def seen_ahead_s(self) -> float:
        """Time by which the element sees the motion ahead of its reading, s."""
        if self.ahead is None:
            return 0.0
        return (self._lag + self.ahead.delay - self.delay) * self.ahead.period * self.period

    @property
    def _lag(self) -> float:
        """Mean lag of sampling, delay and hold, sample periods."""
        return self.delay + hold_lag(self.hold) + SAMPLINGS[self.sampling].lag + self.drive.lag * self.rate

    @cached_property
    def normalised_loop(self) -> LoneHand:
        """Loop without an element, in the paper's normalised units (§6), as rows of its state."""
        own = self.friction / self.damping_unit, self.stiffness / self.stiffness_unit
        damper = damper_named(self.damper, self.cutoff, self.rate, self.window)
        ahead = self.ahead and self.ahead._replace(masses=tuple(one / self.mass for one in self.ahead.masses))
        drive = self.drive.normalised(self.mass, self.rate)
        return lone_hand(*own, self.delay, self.hold, self.sampling, damper, self.spring_lag, ahead, drive)

    def _stable_interval(self, sought: int, given: Floats) -> tuple[Floats, Floats]:
        def is_stable(kappa: Floats, beta: Floats) -> Bools:
            if self.normalised_loop.degree > MOST_EIGENVALUES:
                return all_within(characteristic(self.normalised_loop, kappa, beta), np.ones(kappa.shape))
            return np.asarray(self.is_stable(kappa * self.stiffness_unit, beta * self.damping_unit))

        least, most = stable_interval(self.normalised_loop, _undamped(self), sought, given.ravel(), is_stable)
        return least.reshape(given.shape), most.reshape(given.shape)

    def _normalised(self, stiffness: ArrayLike, damping: ArrayLike) -> tuple[Floats, Floats]:
        stiffness, damping = np.broadcast_arrays(np.asarray(stiffness, dtype=float), np.asarray(damping, dtype=float))
        return stiffness / self.stiffness_unit, damping / self.damping_unit

    def _element(self, k: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats, PolePair, Bools]:
        """Returns (K T²/m, B T/m, the poles of (k, b), whether an answer exists); other poles are not checked."""
        kappa, sigma = self._normalised(k, b)
        more_kappa, more_sigma = self._normalised(np.subtract(k, self.stiffness), np.subtract(b, self.friction))
        K, B, pair = element_of_oscillator(self.normalised_loop, (sigma, kappa), (more_sigma, more_kappa))
        return K, B, pair, np.isfinite(kappa + sigma) & np.isfinite(K) & np.isfinite(B) & is_attainable(sigma, kappa)

    @cached_property
    def _own_swing_is_seen(self) -> bool:
        """True if mass and real spring oscillate below the Nyquist frequency; only an image of others is sampled."""
        return self.drive.inner > 0 or bool(is_attainable(self.normalised_loop.damping, self.normalised_loop.stiffness))

    def _leads(self, K: Floats, B: Floats, pair: PolePair) -> Bools:
        """Returns whether this pair of the loop with a normalised element (K, B) moves the hand; of an undamped pair,
        whether no motion grows."""
        if not self.drive.inner:
            return leads(self.normalised_loop, K, B, pair)
        lead, poles = all_poles(self.normalised_loop, K, B)
        off, size = np.abs(lead.p - pair.p) + np.abs(lead.q - pair.q), np.abs(pair.p) + np.abs(pair.q)
        is_limit = (np.abs(pair.p - pair.q) <= _ROUNDED * size) & (np.abs(poles[:, 0]) <= 1.0 + _ROUNDED)
        return (lead.dominant & (off <= _SAME * size)) | is_limit

    def _solved(self, K: ArrayLike, B: ArrayLike) -> tuple[LeadingPair, Complexes]:
        """Leading pair and all poles for (n,) stiffnesses and dampings."""
        K, B = np.asarray(K), np.asarray(B)
        return _solved_at(self, float(K[0]), float(B[0])) if K.size == 1 else self._solve(K, B)

    def _solve(self, K: ArrayLike, B: ArrayLike) -> tuple[LeadingPair, Complexes]:
        lead, poles = all_poles(self.normalised_loop, *self._normalised(K, B))
        return lead._replace(dominant=lead.dominant & self._own_swing_is_seen), poles


@lru_cache(256)  # one element needs its k and b, poles, stability and reason
def _solved_at(configuration: Configuration, K: float, B: float) -> tuple[LeadingPair, Complexes]:
    return configuration._solve([K], [B])


@lru_cache(64)  # shared by all regions of a hand
def _undamped(configuration: Configuration) -> Undamped:
    return undamped_curve(configuration.normalised_loop)


_POINTS, _ZOOMS = 61, 8  # of the search for the stiffest wall


class StiffestWall(NamedTuple):
    """Stiffest wall, K in N/m and B in N·s/m; (0, 0) if no wall with a spring qualifies."""

    stiffness: float
    damping: float


def stiffest_passive(configuration: Configuration) -> StiffestWall:
    """Returns the stiffest wall that is stable in every hand (Colgate and Schenkel, 1997), B >= 0.

    The friction that passivity needs is proportional to the wall. Along each direction of the (K, B) plane one wall
    needs exactly the friction of the device.

    Raises:
        ValueError: the passivity condition is not derived (``Configuration.needed_friction``).
    """
    unit = 2.0 * configuration.rate

    def stiffness(angle: Floats) -> Floats:
        K = unit * np.cos(angle)
        needed = np.asarray(configuration.needed_friction(K, np.sin(angle)))
        return np.asarray(K * (configuration.friction / needed))

    angle, K = _highest(stiffness, 0.0, 0.5 * np.pi * (1.0 - 1e-9))
    return StiffestWall(K, K * float(np.tan(angle)) / unit) if K > 0.0 else StiffestWall(0.0, 0.0)


def stiffest_stable(configuration: Configuration) -> StiffestWall:
    """Returns the stiffest wall that is stable with the hand's own mass, B >= 0."""

    def stiffness(B: Floats) -> Floats:
        most = np.asarray(configuration.stable_stiffness(B)[1])
        return np.where(np.isfinite(most), most, 0.0)

    B, K = _highest(stiffness, 0.0, 4.0 * configuration.damping_unit)
    return StiffestWall(K, B) if K > 0.0 else StiffestWall(0.0, 0.0)


def _highest(function: Callable[[Floats], Floats], low: float, high: float) -> tuple[float, float]:
    """Returns (argument, value) of the maximum: the best point of a grid, then of finer grids around it."""
    best, most = low, 0.0
    for _ in range(_ZOOMS):
        at = np.linspace(low, high, _POINTS)
        value = function(at)
        place = int(np.argmax(value))
        if value[place] >= most:
            best, most = float(at[place]), float(value[place])
        step = at[1] - at[0]
        low, high = max(low, best - step), min(high, best + step)
    return best, most
