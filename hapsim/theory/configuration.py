"""One haptic simulator as it deforms the parameter space: mass, rate, friction, delay, hold and sampling."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory import checks
from hapsim.theory.arrays import Bools, Complexes, Floats
from hapsim.theory.interface import HOLDS, SAMPLINGS
from hapsim.theory.pair import oscillator_of_quadratic, pair_of_oscillator, pair_of_quadratic
from hapsim.theory.passivity import needed_friction
from hapsim.theory.plant import Plant, sampled_plant
from hapsim.theory.poles import (
    Leading,
    all_within,
    characteristic,
    leading_pair,
    roots,
    sort_by_modulus,
    without_pair,
)

_quietly = np.errstate(all="ignore")  # what is out of range becomes NaN


@dataclass(frozen=True)
class Configuration:
    """The loop around a temporary hybrid system (Florens et al., §4 and §6).

    A real mass, with the real friction of the device, is coupled to a simulated visco-elastic element (K, B)
    by a position that is sampled and a force that is late and held. What the hand meets is the real
    oscillator of the same mass with stiffness k and damping b; b is the total damping, the real friction
    included.

    Methods take arrays, broadcast them against each other and return arrays of that shape (scalars for
    scalars). Where there is no answer, or an argument is not finite, the answer is NaN (False where it is a
    yes or a no); nothing warns and nothing is raised.

    Attributes:
        mass: real mass, hand and moving part of the device, kg, > 0.
        rate: sample rate, Hz, > 0.
        friction: real viscous friction b0, N·s/m, >= 0.
        delay: from the sampling of a position to the change of the force that answers it, periods, >= 0.
        hold: "zoh", a force lasts until the next; or "impulse", it strikes once, with the impulse f T.
        sampling: "ideal", the position at the sample; or "average", its mean over the last sample period.

    Raises:
        ValueError: an argument is out of its range; the sentence says which, and what was expected.
    """

    mass: float
    rate: float
    friction: float = 0.0
    delay: float = 1.0
    hold: str = "zoh"
    sampling: str = "ideal"

    def __post_init__(self) -> None:
        for name in ("mass", "rate"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))
        for name in ("friction", "delay"):
            object.__setattr__(self, name, checks.not_negative(name, getattr(self, name)))
        checks.one_of("hold", self.hold, HOLDS)
        checks.one_of("sampling", self.sampling, SAMPLINGS)

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

    @_quietly
    def normalised(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """(K T²/m, B T/m), the paper's units (§6), of stiffnesses in N/m and dampings in N·s/m."""
        kappa, beta = self._normalised(K, B)
        return kappa[()], beta[()]

    @_quietly
    def simulated(self, k: ArrayLike, b: ArrayLike, *, dominant: bool = True) -> tuple[Floats, Floats]:
        """The simulated (K, B) that the hand meets as the real (k, b): the paper's Figure 4, in closed form.

        Args:
            k: stiffness that the hand is to meet, N/m.
            b: total damping that it is to meet, real friction included, N·s/m. Over-, critically and
                under-damped alike; negative for a motion that grows.
            dominant: also ask that the two poles of (k, b) be the slowest of the loop. Where a further pole
                decays no faster the hand does not meet (k, b), and no other (K, B) makes it so. False leaves
                these in.

        Returns:
            K in N/m and B in N·s/m, NaN where no (K, B) does it: at and above the Nyquist frequency, and,
            unless ``dominant`` is False, where the loop has slower poles than those asked for.
        """
        kappa, sigma = self._normalised(k, b)
        w, decayed = pair_of_oscillator(sigma, kappa, self._plant.damping)
        z = w.plus(1.0)
        ratio = z.power(self._plant.order).over(z.polynomial(self._plant.numerator))
        # On both poles the visco-elastic element, kappa + (kappa + beta) w, is -w (w + A) ratio. Here is that
        # line's value at w = 0, and its slope; K is multiplied out to a product, with no friction to cancel.
        K = (w.near * w.far * (ratio.far + decayed.near * ratio.slope)).real
        B = -(w.near * decayed.near * ratio.slope + (w.near + decayed.far) * ratio.far).real - K
        good = np.isfinite(K) & np.isfinite(B) & (kappa - 0.25 * sigma**2 < np.pi**2)
        if dominant:
            others = without_pair(characteristic(self._plant, K, B), w)
            good &= all_within(others, np.minimum(np.abs(z.near), np.abs(z.far)))
        K, B = K * self.stiffness_unit, B * self.damping_unit
        return np.where(good, K, np.nan)[()], np.where(good, B, np.nan)[()]

    @_quietly
    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """The real (k, b) that the hand meets where (K, B) is simulated (Florens et al., §5).

        Read from the slowest-decaying pair of poles, a complex pair or two positive real ones: s = ln(z)/T,
        k = m s1 s2, b = -m (s1 + s2).

        Args:
            K: simulated stiffness, N/m.
            B: simulated damping, N·s/m.

        Returns:
            k in N/m and b in N·s/m, real friction included. NaN where ``dominant`` is False.
        """
        _, lead = self._solved(K, B)
        sigma, kappa = oscillator_of_quadratic(lead.p, lead.q)
        k = np.where(lead.dominant, kappa * self.stiffness_unit, np.nan)
        b = np.where(lead.dominant, sigma * self.damping_unit, np.nan)
        return k[()], b[()]

    @_quietly
    def dominant(self, K: ArrayLike, B: ArrayLike) -> Bools:
        """Whether the loop is a second-order object to the hand.

        It is where the slowest poles are a complex pair or two positive real ones, and every further pole
        decays faster than both.
        """
        return self._solved(K, B)[1].dominant[()]

    @_quietly
    def dominant_poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """The pair (..., 2) in the z-plane that ``equivalent`` reads; NaN where ``dominant`` is False."""
        _, lead = self._solved(K, B)
        return np.where(lead.dominant[..., None], _poles_of(lead), np.nan)

    @_quietly
    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """All poles (..., N) of the loop in the z-plane, by decreasing modulus.

        N is 2 for the impulse hold with ideal sampling and no delay, one more for each whole sample of delay,
        one more for a fraction of one, for the zero-order hold and for averaged sampling.
        """
        poles, lead = self._solved(K, B)
        poles[..., :2] = np.where(lead.dominant[..., None], _poles_of(lead), poles[..., :2])
        return sort_by_modulus(poles)

    def spectral_radius(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """The largest modulus of a pole: below 1 every motion dies out."""
        return np.abs(self.poles(K, B)[..., 0])

    @_quietly
    def is_stable(self, K: ArrayLike, B: ArrayLike) -> Bools:
        """Whether every motion dies out (Florens et al., §6.2: the limit is the curve b = 0).

        Where ``dominant`` is True it is K > 0 and b > 0, which holds for the slowest of motions, where a
        spectral radius rounds to 1; elsewhere a spectral radius below 1.
        """
        poles, lead = self._solved(K, B)
        restores = np.broadcast_to(np.asarray(K, dtype=float) > 0.0, lead.p.shape)
        return np.where(lead.dominant, restores & (lead.p > lead.q), np.abs(poles[..., 0]) < 1.0)[()]

    @_quietly
    def is_passive(self, K: ArrayLike, B: ArrayLike) -> Bools:
        """Whether the wall gives no energy away, whatever holds it: Colgate and Schenkel's condition.

        The friction has to exceed the upper bound over 0 < w <= pi/T of

            T/(2 (1 - cos wT)) · Re[(1 - exp(-jwT)) (K + B (1 - exp(-jwT))/T) exp(-jwT delay)]

        which is K T/2 + |B| without delay and K T (delay + 1/2) for a spring alone. A negative K is never
        passive. For whole samples of delay the condition is necessary and sufficient; a fraction of one is
        taken, as by Gil et al., at the fundamental frequency only.

        Raises:
            ValueError: the hold is not "zoh" or the sampling not "ideal": the condition is not derived.
        """
        if self.hold != "zoh" or self.sampling != "ideal":
            raise ValueError(
                "The passivity condition is derived for the zero-order hold with ideal sampling only, "
                f"not for hold {self.hold!r} with sampling {self.sampling!r}."
            )
        K, B = np.broadcast_arrays(np.asarray(K, dtype=float), np.asarray(B, dtype=float))
        needed = needed_friction(0.5 * self.period * K, B, self.delay)
        return ((K >= 0.0) & (self.friction > needed))[()]

    @_quietly
    def characteristic(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Coefficients (..., N + 1) of the monic characteristic polynomial in z, highest power first.

        The paper's P K + Q B + R (§6) divided by its leading coefficient.
        """
        return characteristic(self._plant, *self._normalised(K, B))

    @cached_property
    def _plant(self) -> Plant:
        return sampled_plant(self.friction / self.damping_unit, self.delay, self.hold, self.sampling)

    def _normalised(self, stiffness: ArrayLike, damping: ArrayLike) -> tuple[Floats, Floats]:
        stiffness, damping = np.broadcast_arrays(np.asarray(stiffness, dtype=float), np.asarray(damping, dtype=float))
        return stiffness / self.stiffness_unit, damping / self.damping_unit

    def _solved(self, K: ArrayLike, B: ArrayLike) -> tuple[Complexes, Leading]:
        """All poles as eigenvalues, and the leading pair, polished."""
        kappa, beta = self._normalised(K, B)
        poles = roots(characteristic(self._plant, kappa, beta))
        return poles, leading_pair(self._plant, kappa, beta, poles)


def _poles_of(lead: Leading) -> Complexes:
    w = pair_of_quadratic(lead.p, lead.q)
    return 1.0 + np.stack([w.near, w.far], axis=-1)
