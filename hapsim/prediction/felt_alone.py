"""Spring and damper that one single hand feels, with related quantities, of a loop as the scene and its correction have
it; the desired ones with a correction, and the tolerance for errors of the device's parameters."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from hapsim.prediction.any_hand import possible_friction
from hapsim.prediction.characteristic import Piece
from hapsim.prediction.correction import (
    CORRECTIONS,
    GOOD,
    Corrected,
    CorrectionKind,
    Remedies,
    Rendering,
    felt_error,
    remedies_for,
    stable_masses,
)
from hapsim.prediction.correction.kind import Observer, by_sensors, without_delay
from hapsim.prediction.linear import LinearScene, hand_of, network_of_hand
from hapsim.scene.choices import WITH_SENSOR
from hapsim.theory import Configuration, frequency_and_ratio
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.correction import PredictedLoop, filtered_noise_gain, plain_predictor, white_noise_gain
from hapsim.theory.interface import StatePredictor
from hapsim.theory.network.felt import OF_STEP, felt_pair
from hapsim.theory.network.modes import AT_THE_LIMIT

_PLAIN = 0.01  # an error of k or b that is worth a correction
_SPAN, _TRIED = 10.0, 81  # masses from a tenth to ten times the declared one


class Robustness(NamedTuple):
    """Quantities that a hand meets besides k and b."""

    steady_stiffness: float
    """Stiffness that a steady push meets, N/m, the device's own spring included."""
    noise_gain: float
    """Force noise, N rms, per m rms of white noise on the positions that are read; infinite if unstable."""
    stable_masses: tuple[float, float]
    """Least and greatest mass with which the loop is stable, kg; 0 and infinity beyond thirty times the declared one.
    NaN if it is stable with none near that."""
    acceleration_noise_gain: float = math.nan
    """The same per m/s² rms of white noise on the sensed acceleration; NaN where none is used."""


@dataclass(frozen=True, eq=False)
class Felt:
    """Felt spring and damper on one device point whose links all end on grounds: a temporary hybrid system of its own.
    Each number is computed on demand."""

    DOCUMENT = (
        "name channel stiffness damping k b frequency_hz damping_ratio dominant stable spectral_radius poles passive "
        "linear_limit reason limits.configuration=formula limits.stiffness=stiffness limits.damping=damping "
        "mass=configuration.mass friction=configuration.friction delay hold=configuration.hold "
        "sampling=configuration.sampling damper=configuration.damper cutoff=configuration.cutoff "
        "device_stiffness=configuration.stiffness *robustness"
    )

    name: str
    channel: int
    configuration: Configuration
    stiffness: float
    """Simulated K, N/m."""
    damping: float
    """Simulated B, N·s/m."""
    predictor: StatePredictor | None = None
    """Predictor whose state the force answers, with a correction that predicts."""

    @cached_property
    def loop(self) -> Configuration | PredictedLoop:
        """Closed loop, a function of K and B."""
        return self.configuration if self.predictor is None else PredictedLoop(self.configuration, self.predictor)

    @property
    def formula(self) -> Configuration:
        """Device of the linear rule, as the links see it."""
        return self.configuration if self.predictor is None else without_delay(self.configuration)

    @property
    def delay(self) -> float:
        """Delay of the force behind the position that it answers, sample periods; that of the board for its law."""
        return self.configuration.delay / self.configuration.steps

    @cached_property
    def _solved(self) -> tuple[Complexes, Floats, Floats]:
        return self.loop.solved(self.stiffness, self.damping)

    @cached_property
    def _equivalent(self) -> tuple[float, float]:
        k, b = map(float, self._solved[1:])
        if self.configuration.ahead is not None and self.stiffness > 0.0 and self.stable:
            # What answers an acceleration may ring for longer than the hand, which hardly moves with it.
            pair = felt_pair(network_of_hand(self.configuration, self.stiffness, self.damping))
            k, b = float(pair.k[0, 0]), float(pair.b[0, 0])
        least = OF_STEP * self.configuration.mass * self.configuration.rate
        return 0.0 if abs(k) <= least * self.configuration.rate else k, 0.0 if abs(b) <= least else b

    @property
    def k(self) -> float:
        """Felt stiffness, N/m; NaN if no spring and damper is equivalent."""
        return self._equivalent[0]

    @property
    def b(self) -> float:
        """Felt damping, N·s/m, real friction included."""
        return self._equivalent[1]

    @cached_property
    def frequency_hz(self) -> float:
        """Eigenfrequency, Hz; NaN without a spring."""
        return swing(self.configuration.mass, self.k if self.k > 0.0 else math.nan, self.b)[0]

    @cached_property
    def damping_ratio(self) -> float:
        """Ratio to critical damping; NaN without a spring."""
        return swing(self.configuration.mass, self.k if self.k > 0.0 else math.nan, self.b)[1]

    @property
    def dominant(self) -> bool:
        """True if a spring and damper is equivalent."""
        return math.isfinite(self.k) and math.isfinite(self.b)

    @cached_property
    def stable(self) -> bool:
        """True if every motion decays."""
        if self.predictor is None:
            return bool(self.configuration.is_stable(self.stiffness, self.damping))
        return self.spectral_radius < 1.0

    @property
    def settles(self) -> bool:
        """True if it is stable, or rests at any place: nothing holds it, but something brakes it."""
        slowest, *others = self.poles
        return self.stable or (slowest == 1.0 and max(map(abs, others), default=0.0) < 1.0 - AT_THE_LIMIT)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a pole."""
        return abs(self.poles[0])

    @cached_property
    def poles(self) -> tuple[complex, ...]:
        """Poles in the z-plane, for a sample period of the host, by decreasing modulus."""
        steps = self.configuration.steps
        return tuple(complex(pole) ** steps for pole in self._solved[0])

    @cached_property
    def passive(self) -> bool | None:
        """True if no hand can make it unstable (Colgate and Schenkel); None if the condition is not derived."""
        needed = self.needed_friction
        return None if math.isnan(needed) else self.stiffness >= 0.0 and self.configuration.friction > needed

    @cached_property
    def needed_friction(self) -> float:
        """Friction with which no hand can make it unstable, N·s/m; infinite if none does, NaN if not derived, as for
        a predictor."""
        c = self.configuration
        if self.predictor is None:
            with contextlib.suppress(ValueError):
                return float(possible_friction(c.needed_friction(self.stiffness, self.damping), c.mass, c.rate))
        return math.nan

    @property
    def linear_limit(self) -> float:
        """Stiffness limit of the linear rule, (b0 + B)/(T/2 + delay T), N/m (Gil et al.)."""
        return float(self.formula.linear_stiffness_limit(self.damping))

    @cached_property
    def reason(self) -> str:
        """Reason why there is no equivalent; "" if there is one."""
        if math.isfinite(self.k):
            return ""
        why = "" if self.predictor else str(self.configuration.why_no_equivalent(self.stiffness, self.damping))
        return why or "the slowest poles are not those of a spring and damper"

    @cached_property
    def stiffness_factor(self) -> float:
        """Factor by which K can grow before the loop becomes unstable, with B unchanged; infinity if never, below 1 if
        it is."""
        if self.stiffness == 0.0:
            return math.inf
        stiffest = float(self.loop.stable_stiffness(self.damping)[1])
        return stiffest / self.stiffness if stiffest > 0.0 else 0.0

    @cached_property
    def stable_damping(self) -> tuple[float, float]:
        """Stable range of B, N·s/m, with K unchanged; NaN if no damping makes it stable."""
        least, most = self.loop.stable_damping(self.stiffness)
        return float(least), float(most)

    @property
    def steady_stiffness(self) -> float:
        """Stiffness that a steady push meets, N/m, the device's own included."""
        c, element = self.configuration, (self.stiffness, self.damping)
        if not self._has_state:
            return self.stiffness + c.stiffness
        with np.errstate(all="ignore"):  # an infinite loop is not stable
            return self._predicted.steady_stiffness(*element) + c.stiffness

    @property
    def _has_state(self) -> bool:
        """True if the loop is that of a predictor, or of a trivial one: no board and no sensed acceleration."""
        return self.configuration.ahead is None and self.configuration.steps == 1

    @cached_property
    def _predicted(self) -> PredictedLoop:
        predictor = plain_predictor(self.configuration) if self.predictor is None else self.predictor
        return PredictedLoop(self.configuration, predictor)

    @cached_property
    def robustness(self) -> Robustness:
        """Quantities besides k and b."""
        c, element = self.configuration, (self.stiffness, self.damping)
        with np.errstate(all="ignore"):  # an infinite loop is not stable
            of_positions, of_acceleration = self._noise_gains
            masses = stable_masses(
                lambda true: replace(self._predicted, plant=true) if self._has_state else true, c, element
            )
            return Robustness(self.steady_stiffness, of_positions, masses, of_acceleration)

    @property
    def _noise_gains(self) -> tuple[float, float]:
        """`noise_gain` and `acceleration_noise_gain` of `Robustness`; a board's for every position that it reads."""
        c, element = self.configuration, (self.stiffness, self.damping)
        if c.ahead is not None:
            position, velocity, acceleration = self._force_noise.tolist()
            return math.hypot(position, velocity * c.rate), acceleration
        if self._has_state:
            return self._predicted.noise_gain(*element), math.nan
        if not self.stable:
            return math.inf, math.nan
        weights = np.array(c.normalised_loop.damper.of_positions)
        read = self.damping * c.rate * weights + self.stiffness * (np.arange(weights.size) == 0)
        answer = np.array(c.normalised(*element)) @ c.normalised_loop.reads
        hand = c.normalised_loop
        return filtered_noise_gain(hand.change, hand.push, answer, read), math.nan

    @cached_property
    def _force_noise(self) -> Floats:
        """Force noise, N rms, per unit rms of white noise on the sensed position (m), velocity and acceleration."""
        c = self.configuration
        ahead_s, hand = c.seen_ahead_s, c.normalised_loop
        read = np.array([self.stiffness, self.damping]) @ [[1.0, ahead_s, 0.5 * ahead_s**2], [0.0, 1.0, ahead_s]]
        if not self.stable or not hand.damper.senses:
            return np.full(3, math.nan if self.stable else math.inf)
        answer = np.array(c.normalised(self.stiffness, self.damping)) @ hand.reads
        return np.asarray(np.abs(read) * white_noise_gain(hand.change, hand.push, answer))

    def at_rate(self, rate_hz: float) -> Felt:
        """Returns the prediction for a device that samples at `rate_hz`; the loop still assumes this one's rate. It
        divides a step by the assumed period, so a damper is stronger by the ratio of the true period to it, and a
        filter's cutoff lower. A sensed velocity does not change."""
        device = replace(self.configuration, rate=rate_hz * self.configuration.steps)
        share = device.rate / self.configuration.rate
        if device.ahead is not None:
            return replace(self, configuration=replace(device, ahead=device.ahead._replace(period=share)))
        if self.predictor is not None:
            return replace(self, configuration=device)
        device = replace(device, cutoff=None if device.cutoff is None else device.cutoff * share)
        damping = self.damping * (1.0 if device.damper in WITH_SENSOR else 1.0 / share)
        return replace(self, configuration=device, damping=damping)

    def with_mass(self, mass: float) -> Felt:
        """Returns the same hand with a true mass of `mass` kg; links and predictor stay made for the other."""
        return replace(self, configuration=replace(self.configuration, mass=mass))

    def masses_with(self, frequency_hz: float) -> Iterator[float]:
        """Yields every mass, kg, within a factor of ten, that gives this eigenfrequency."""
        from scipy.optimize import brentq

        def off(mass: float) -> float:
            return self.with_mass(mass).frequency_hz - frequency_hz

        tried = self.configuration.mass * np.geomspace(1.0 / _SPAN, _SPAN, _TRIED)
        errors = [off(mass) for mass in tried.tolist()]
        for i in range(_TRIED - 1):
            if errors[i] * errors[i + 1] <= 0.0:  # False if one of them is NaN
                with contextlib.suppress(ValueError):  # NaN in between
                    yield float(brentq(off, tried[i], tried[i + 1], xtol=1e-15, rtol=1e-12))


def robustness_of(felt: Felt) -> Robustness:
    """Returns the quantities besides k and b that this prediction gives."""
    return felt.robustness


def felt_of(rendering: Rendering, linear: LinearScene, name: str) -> Felt:
    """Returns the prediction for a single hand; with a predictor in its loop, for the device as declared."""
    felt = _felt(name, rendering.seen.device_points[name].channel, *hand_of(rendering.seen, linear, name))
    port = next((port for port in rendering.ports if port.name == name), None)
    if port is None or rendering.kind is None or not rendering.kind.predicts or felt.stiffness == felt.damping == 0.0:
        return felt
    return replace(felt, configuration=port.declared, predictor=rendering.predictor_of(port))


_felt = lru_cache(1024)(Felt)  # regions in which a hand feels the same


def correction_for(felt: Felt, sensors: Collection[str] = ()) -> str:
    """Returns the simplest correction with which this hand would feel the scene's stiffness and damping; "" if they are
    within a hundredth without one, or if none achieves it. First of all the one that needs no mass, where the device
    has its ``sensors`` and it is good for half and for twice the mass."""
    device = felt.configuration
    k, b = felt.stiffness + device.stiffness, felt.damping + device.friction
    if felt.predictor is not None or not felt_error((np.array(felt.k), np.array(felt.b)), (k, b), device.mass) > _PLAIN:
        return ""
    by_host = device.steps == 1
    if (
        by_host
        and {"velocity", "acceleration"} <= {*sensors}
        and max(errors_by_mass(felt_if_sensed(felt), k, b)) <= GOOD
    ):
        return "sensed"
    for name in ("poles",) if device.spring_lag or not by_host else ("poles", "predictor"):
        if np.isfinite(CORRECTIONS[name].seen_by_theory(device).simulated(k, b)).all():
            return name
    return ""


def felt_if_sensed(felt: Felt) -> Felt:
    """Returns the same hand with ``correction: sensed``."""
    return replace(felt, configuration=by_sensors(felt.configuration))


def errors_by_mass(felt: Felt, k: float, b: float) -> list[float]:
    """Errors of the felt k and b, of `felt_error`, with the declared mass, with half and with twice of it."""
    hands = [felt.with_mass(share * felt.configuration.mass) for share in (1.0, 0.5, 2.0)]
    return [float(felt_error((np.array(one.k), np.array(one.b)), (k, b), one.configuration.mass)) for one in hands]


def swing(mass: float, k: float, b: float) -> tuple[float, float]:
    """Eigenfrequency in Hz and damping ratio."""
    frequency, ratio = frequency_and_ratio(mass, k, b)
    return float(frequency), float(ratio)


_MASSES = 9  # of a span, at which the error of a correction is computed
_REACHED = 1e-6  # an error of a correction that counts as zero


class Desired(NamedTuple):
    """Desired stiffness and damping at a device point, real parts included, and the error of the correction."""

    name: str
    channel: int
    k: float
    """Desired stiffness, N/m."""
    b: float
    """Desired damping, N·s/m."""
    frequency_hz: float
    damping_ratio: float
    error: float
    """Error of the felt k and b by `felt_error`; over a span of masses the largest."""
    reached: bool
    remedies: Remedies | None
    """Changes that would make it reachable; None if it is reached, or the mass is a span."""
    stable_masses: tuple[float, float]
    steady_stiffness: float
    """Steady stiffness and `stable_masses` of the corrected loop, as in `Robustness`."""


def desired_of(rendering: Rendering, felt: Sequence[Felt], here: Mapping[str, Piece]) -> Iterator[Desired]:
    """Yields one for each of these single hands with a correction; `here`: the regions of those that have some."""
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
        given_up = not reached and piece is None and least == most and not rendering.kind.by_sensors
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
            steady_stiffness=one.steady_stiffness,
        )


def _error_with(kind: CorrectionKind, port: Corrected, mass: float) -> float:
    """Returns `felt_error` of a hand of this mass, once an estimate of it has settled; 0 for the device alone."""
    one = port.settled(mass)
    if one.rendered == (0.0, 0.0):
        return 0.0
    true = replace(port.declared, mass=mass)
    loop = PredictedLoop(true, one.predictor) if kind.predicts else kind.closed(true, port.declared, Observer())
    return float(felt_error(loop.equivalent(*one.rendered), port.desired, mass))


SHARES = (0.05, 0.1)
"""Shares by which k and b may be off."""
_STEP = 0.02  # of the mass, of b, and of a sample: k and b may agree again further away, which does not count
_LONGER = 1.3  # factor from step to step, up to
_LONGEST = 0.1
_MOST = 100.0  # steps: beyond, the range counts as unlimited
_HALVINGS = 16


class Tolerance(NamedTuple):
    """Ranges (least, most) in which k and b stay within a share of the desired ones, and the loop stable. Infinite if
    e^10 times the mass, ten times b, or ten samples more are still within it."""

    share: float
    mass: tuple[float, float]
    """Range of the mass, kg."""
    friction: tuple[float, float]
    """Range of the friction, N·s/m."""
    delay: tuple[float, float]
    """Range of the delay, sample periods."""


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Tolerances of one hand with the desired k and b (N/m, N·s/m). Mass, friction and delay are varied one at a time,
    with links and predictor made for the declared ones; each value is tried once for all shares."""

    felt: Felt
    k: float
    b: float
    _tried: dict[tuple[str, float], tuple[float, float]] = field(default_factory=dict)

    def within(self, share: float) -> Tolerance | None:
        """Returns the tolerance for this share; None if the declared device does not reach k and b."""
        spans = {name: span for name in Tolerance._fields[1:] if (span := self.of(name, share))}
        return Tolerance(share, **spans) if spans else None

    def of(self, name: str, share: float) -> tuple[float, float] | None:
        """Returns one range of it, by the name of its field."""

        def meets(x: float) -> bool:
            off_k, off_b = self._errors(name, x)
            return off_k <= share * self.k and off_b <= share * self.b

        if not meets(0.0):
            return None
        device = self.felt.configuration
        # b0 - b (b0 / b) may be less
        less = {"mass": math.inf, "friction": device.friction / self.b if self.b else 0.0, "delay": device.delay}[name]
        low, high = (self._value(name, _last(meets, side, most)) for side, most in ((-1, less), (1, math.inf)))
        return (low / device.steps, high / device.steps) if name == "delay" else (low, high)

    def _value(self, name: str, x: float) -> float:
        """Returns what this parameter is at a distance of x."""
        device = self.felt.configuration
        if name == "mass":
            return device.mass * math.exp(x)
        return max(device.friction + self.b * x, 0.0) if name == "friction" else device.delay + x

    def _errors(self, name: str, x: float) -> tuple[float, float]:
        """Errors of k and b, N/m and N·s/m, at this value of a parameter; infinite if it makes the loop unstable."""
        if (name, x) not in self._tried:
            found = math.inf, math.inf
            with contextlib.suppress(ValueError, ArithmeticError):
                changed: dict[str, Any] = {name: self._value(name, x)}
                device = replace(self.felt.configuration, **changed)
                hand = replace(self.felt, configuration=device)
                if hand.stable:
                    found = abs(hand.k - self.k), abs(hand.b - self.b)
            self._tried[name, x] = found
        return self._tried[name, x]


def _last(meets: Callable[[float], bool], side: int, most: float = math.inf) -> float:
    """Returns the largest distance from 0 to this side, `most` at the most, up to which the condition holds without a
    gap; infinite if it has no end."""
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
