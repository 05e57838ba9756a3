"""What one lone hand feels: k, b and what is beside them, of a loop as the scene and its correction have it; what it
should feel with a correction, and how well the device has to be known for that."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from hapsim.prediction.characteristic import Piece
from hapsim.prediction.correction import (
    CORRECTIONS,
    Corrected,
    CorrectionKind,
    Remedies,
    Rendering,
    felt_error,
    remedies_for,
    stable_masses,
)
from hapsim.prediction.linear import LinearScene, hand_of
from hapsim.scene.choices import WITH_SENSOR
from hapsim.theory import Configuration, frequency_and_ratio
from hapsim.theory.correction import PredictedLoop, StatePredictor, as_read

_PLAIN = 0.01  # an error of what is felt that is worth a correction
_SPAN, _TRIED = 10.0, 81  # masses from a tenth to ten times the one that is taken for true


class Robustness(NamedTuple):
    """What a hand on one device point meets beside k and b."""

    steady_stiffness: float
    """N/m: the stiffness that a steady push meets, the device's own spring included."""
    noise_gain: float
    """N rms of force per m rms of white noise on the positions that are read; infinite where it is unstable."""
    stable_masses: tuple[float, float]
    """kg: the least and the most mass with which the loop is stable; 0 and infinity beyond thirty times the declared
    one. NaN where it is stable with none near that."""


@dataclass(frozen=True, eq=False)
class Felt:
    """What the hand feels on one device point whose links all end on grounds: a temporary hybrid system of its own.
    Each number is worked out when it is asked for."""

    DOCUMENT = (
        "name channel stiffness damping k b frequency_hz damping_ratio dominant stable spectral_radius poles passive "
        "linear_limit reason limits.configuration=formula limits.stiffness=stiffness limits.damping=damping "
        "mass=configuration.mass friction=configuration.friction delay=configuration.delay hold=configuration.hold "
        "sampling=configuration.sampling damper=configuration.damper cutoff=configuration.cutoff "
        "device_stiffness=configuration.stiffness *robustness"
    )

    name: str
    channel: int
    configuration: Configuration
    stiffness: float
    """K, N/m, simulated."""
    damping: float
    """B, N·s/m, simulated."""
    predictor: StatePredictor | None = None
    """Whose state the force answers, with a correction that predicts."""
    without_predictor: Configuration | None = None
    """The device that the loop then seems to have, by which limits and passivity are worked out."""

    @cached_property
    def loop(self) -> Configuration | PredictedLoop:
        """The closed loop, of K and B."""
        return self.configuration if self.predictor is None else PredictedLoop(self.configuration, self.predictor)

    @property
    def formula(self) -> Configuration:
        """The configuration by which limits and passivity are worked out."""
        return self.without_predictor or self.configuration

    @cached_property
    def _equivalent(self) -> tuple[float, float]:
        k, b = self.loop.equivalent(self.stiffness, self.damping)
        return float(k), float(b)

    @property
    def k(self) -> float:
        """N/m; NaN where no spring and damper is equivalent."""
        return self._equivalent[0]

    @property
    def b(self) -> float:
        """N·s/m, real friction included."""
        return self._equivalent[1]

    @cached_property
    def frequency_hz(self) -> float:
        """Eigenfrequency; NaN without a spring."""
        return swing(self.configuration.mass, self.k if self.k > 0.0 else math.nan, self.b)[0]

    @cached_property
    def damping_ratio(self) -> float:
        """Of critical damping; NaN without a spring."""
        return swing(self.configuration.mass, self.k if self.k > 0.0 else math.nan, self.b)[1]

    @property
    def dominant(self) -> bool:
        """Whether a spring and damper is equivalent."""
        return math.isfinite(self.k) and math.isfinite(self.b)

    @cached_property
    def stable(self) -> bool:
        """Whether every motion dies out."""
        if self.predictor is None:
            return bool(self.configuration.is_stable(self.stiffness, self.damping))
        return self.spectral_radius < 1.0

    @property
    def spectral_radius(self) -> float:
        """The largest modulus of a pole."""
        return abs(self.poles[0])

    @cached_property
    def poles(self) -> tuple[complex, ...]:
        """In the z-plane, by decreasing modulus."""
        return tuple(complex(pole) for pole in self.loop.poles(self.stiffness, self.damping))

    @cached_property
    def passive(self) -> bool | None:
        """Whether no hand can make it unstable (Colgate and Schenkel); None where the condition is not derived."""
        with contextlib.suppress(ValueError):
            return bool(self.formula.is_passive(self.stiffness, self.damping))
        return None

    @cached_property
    def needed_friction(self) -> float:
        """N·s/m, with which no hand can make it unstable; NaN where that is not derived."""
        with contextlib.suppress(ValueError):
            return float(self.formula.needed_friction(self.stiffness, self.damping))
        return math.nan

    @property
    def linear_limit(self) -> float:
        """N/m: the stiffness that the linear rule allows, (b0 + B)/(T/2 + delay T) (Gil et al.)."""
        return float(self.formula.linear_stiffness_limit(self.damping))

    @cached_property
    def reason(self) -> str:
        """Why there is no equivalent, where there is none."""
        if self.predictor is None:
            return str(self.configuration.why_no_equivalent(self.stiffness, self.damping))
        return "" if math.isfinite(self.k) else "the slowest poles are not those of a spring and damper"

    @cached_property
    def stiffness_factor(self) -> float:
        """By how much K could grow before the loop is unstable, B as it is; infinity if never, below 1 if it is."""
        if self.stiffness == 0.0:
            return math.inf
        stiffest = float(self.formula.stable_stiffness(self.damping)[1])
        return stiffest / self.stiffness if stiffest > 0.0 else 0.0

    @cached_property
    def stable_damping(self) -> tuple[float, float]:
        """N·s/m: from least to most B, with K as it is; NaN where no damping makes it stable."""
        least, most = self.formula.stable_damping(self.stiffness)
        return float(least), float(most)

    @cached_property
    def robustness(self) -> Robustness:
        """What the hand meets beside k and b."""
        c, element = self.configuration, (self.stiffness, self.damping)
        loop = PredictedLoop(c, as_read(c) if self.predictor is None else self.predictor)
        with np.errstate(all="ignore"):  # beyond all numbers nothing is stable
            return Robustness(
                steady_stiffness=loop.steady_stiffness(*element) + c.stiffness,
                noise_gain=loop.noise_gain(*element),
                stable_masses=stable_masses(lambda true: loop._replace(plant=true), c, element),
            )

    def with_mass(self, mass: float) -> Felt:
        """The same hand where its true mass is `mass` kg, while links and predictor stay made for the other."""
        return replace(self, configuration=replace(self.configuration, mass=mass))

    def masses_with(self, frequency_hz: float) -> Iterator[float]:
        """Yields every mass, kg, within a factor of ten with which the eigenfrequency is this one."""
        from scipy.optimize import brentq

        def off(mass: float) -> float:
            return self.with_mass(mass).frequency_hz - frequency_hz

        tried = self.configuration.mass * np.geomspace(1.0 / _SPAN, _SPAN, _TRIED)
        errors = [off(mass) for mass in tried.tolist()]
        for i in range(_TRIED - 1):
            if errors[i] * errors[i + 1] <= 0.0:  # not where one of them is NaN
                with contextlib.suppress(ValueError):  # NaN in between
                    yield float(brentq(off, tried[i], tried[i + 1], xtol=1e-15, rtol=1e-12))


def robustness_of(felt: Felt) -> Robustness:
    """What a hand meets beside k and b, by this prediction."""
    return felt.robustness


def felt_by(rendering: Rendering, linear: LinearScene, name: str) -> Felt:
    """What a lone hand feels; under a predictor in its loop, of the device as it is declared."""
    felt = _felt(name, rendering.seen.device_points[name].channel, *hand_of(rendering.seen, linear, name))
    port = next((port for port in rendering.ports if port.name == name), None)
    if port is None or rendering.kind is None or not rendering.kind.predicts or felt.stiffness == felt.damping == 0.0:
        return felt
    device, predictor = port.declared, rendering.predictor_of(port)
    return replace(felt, configuration=device, predictor=predictor, without_predictor=felt.configuration)


_felt = lru_cache(1024)(Felt)  # regions in which a hand feels the same


def correction_for(felt: Felt) -> str:
    """The simplest correction with which this hand would feel its stiffness and damping as they are written; "" where
    it does so within a hundredth without one, and where none makes it so."""
    device = felt.configuration
    k, b = felt.stiffness + device.stiffness, felt.damping + device.friction
    if felt.predictor is not None or not felt_error((np.array(felt.k), np.array(felt.b)), (k, b), device.mass) > _PLAIN:
        return ""
    for name in ("poles",) if device.spring_lag else ("poles", "predictor"):
        if np.isfinite(CORRECTIONS[name].seen_by_theory(device).simulated(k, b)).all():
            return name
    return ""


def swing(mass: float, k: float, b: float) -> tuple[float, float]:
    """Eigenfrequency in Hz and damping ratio."""
    frequency, ratio = frequency_and_ratio(mass, k, b)
    return float(frequency), float(ratio)


def felt_at_rate(felt: Felt, rate_hz: float) -> Felt:
    """What the same hand feels where the device samples at `rate_hz` while the loop takes it to sample at the rate of
    `felt`: the loop makes a velocity of a step with the period that it believes in, so a damper is stronger by as much
    as the true period is longer, and a filter's cutoff lower. A velocity that the device senses is what it is."""
    device = replace(felt.configuration, rate=rate_hz)
    if felt.predictor is not None:
        return replace(felt, configuration=device)
    slower = felt.configuration.rate / rate_hz
    device = replace(device, cutoff=None if device.cutoff is None else device.cutoff / slower)
    return replace(felt, configuration=device, damping=felt.damping * (1.0 if device.damper in WITH_SENSOR else slower))


_MASSES = 9  # of a span, at which the error of a correction is looked at
_REACHED = 1e-6  # an error of a correction that is none


class Desired(NamedTuple):
    """The stiffness and damping asked for at a device point, what is real included; how near a correction gets."""

    name: str
    channel: int
    k: float
    """N/m"""
    b: float
    """N·s/m"""
    frequency_hz: float
    damping_ratio: float
    error: float
    """Of what is felt, as `felt_error` counts it; over a span of masses the largest."""
    reached: bool
    remedies: Remedies | None
    """What would make it reachable; None where it is reached, or the mass is a span."""
    stable_masses: tuple[float, float]
    steady_stiffness: float
    """Both as in `Robustness`, of the corrected loop."""


def desired_of(rendering: Rendering, felt: Sequence[Felt], here: Mapping[str, Piece]) -> Iterator[Desired]:
    """Yields one for each of these lone hands that a correction acts on; `here`: where those with regions are."""
    hands = {one.name: one for one in felt}
    if rendering.kind is None:
        return
    for port in (one for one in rendering.ports if one.name in hands and not math.isnan(one.desired[0])):
        one, device, (k, b) = hands[port.name], port.declared, port.desired
        piece = here.get(port.name)
        least, most = rendering.desired.device.mass_spans(rendering.desired.channels)[port.channel]
        if piece is not None:
            k, b = device.stiffness + piece.stiffness, device.friction + piece.damping
            error = float(felt_error((np.array(one.k), np.array(one.b)), (k, b), one.configuration.mass))
        else:
            masses = np.geomspace(least, most, 1 if least == most else _MASSES).tolist()
            error = max(_error_with(rendering.kind, port, mass) for mass in masses)
        reached = port.reached if piece is None else error < _REACHED
        given_up = not reached and piece is None and least == most
        yield Desired(
            port.name,
            port.channel,
            k,
            b,
            *swing(device.mass, k, b),
            error=error,
            reached=reached,
            remedies=remedies_for(rendering.kind, device, port.desired) if given_up else None,
            stable_masses=one.robustness.stable_masses,
            steady_stiffness=one.robustness.steady_stiffness,
        )


def _error_with(kind: CorrectionKind, port: Corrected, mass: float) -> float:
    """`felt_error` of a hand of this mass, once an estimate of it has settled; 0 for the device alone."""
    one = port.settled(mass)
    if one.stiffness == one.damping == 0.0:
        return 0.0
    loop = kind.closed(replace(port.declared, mass=mass), replace(port.declared, mass=one.made_for), one.observer)
    return float(felt_error(loop.equivalent(one.stiffness, one.damping), port.desired, mass))


SHARES = (0.05, 0.1)
"""By which k and b may be off."""
_STEP = 0.02  # of the mass, of b, and of a sample: what is desired may be met again further away, which does not count
_LONGER = 1.3  # times the one before, each step, up to
_LONGEST = 0.1
_MOST = 100.0  # steps: what they do not leave is as good as any
_HALVINGS = 16


class Tolerance(NamedTuple):
    """The least and the most of each with which k and b stay within a share of what is desired, and the loop stable;
    infinite where e^10 times the mass, ten times b, or ten samples more do not leave it."""

    share: float
    mass: tuple[float, float]
    """kg."""
    friction: tuple[float, float]
    """N·s/m."""
    delay: tuple[float, float]
    """Sample periods."""


def tolerance_of(felt: Felt, k: float, b: float, share: float) -> Tolerance | None:
    """Of a hand that is to feel k and b (N/m, N·s/m); None where it does not, with the device as it is declared.

    One of the three is varied at a time, for what was made for the declared ones.
    """
    device = felt.configuration

    def meets(other: Configuration) -> bool:
        try:
            found = replace(felt, configuration=other)
            return found.stable and abs(found.k - k) <= share * k and abs(found.b - b) <= share * b
        except (ValueError, ArithmeticError):
            return False

    if not meets(device):
        return None
    m, b0, delay = device.mass, device.friction, device.delay

    def span(of: Callable[[float], Configuration], most_less: float) -> tuple[float, float]:
        return _last(lambda x: meets(of(x)), -1, most_less), _last(lambda x: meets(of(x)), 1)

    less, more = span(lambda x: replace(device, mass=m * math.exp(x)), math.inf)
    weaker, stronger = span(lambda x: replace(device, friction=b0 + b * x), b0 / b)
    sooner, later = span(lambda x: replace(device, delay=delay + x), delay)
    mass, friction = (m * math.exp(less), m * math.exp(more)), (b0 + b * weaker, b0 + b * stronger)
    return Tolerance(share, mass, friction, (delay + sooner, delay + later))


def _last(meets: Callable[[float], bool], side: int, most: float = math.inf) -> float:
    """How far from 0 to this side, and by `most` at most, what is asked is met without a gap; infinite for ever."""
    at, step = 0.0, _STEP
    while True:
        beyond = min(at + step, most)
        if at == most or at > _MOST * _LONGEST:
            return side * (at if at == most else math.inf)
        if not meets(side * beyond):
            break
        at, step = beyond, min(_LONGER * step, _LONGEST)
    for _ in range(_HALVINGS):
        middle = 0.5 * (at + beyond)
        at, beyond = (middle, beyond) if meets(side * middle) else (at, middle)
    return side * at
