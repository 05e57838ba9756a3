"""measure_trace: identifies the spring and damper that a hand felt, from the record alone."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import RunError, UsageError
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED, OFF_GRID
from hapsim.measuring.converters import Floats
from hapsim.measuring.fitted_pair import OVER_SOON, FittedPair, Poles, SecondMode, dominant_pairs
from hapsim.measuring.regression import MOST_ORDER, Fit, Regression, Segment, noise_of, shaken, slides, stands
from hapsim.measuring.scene_law import following, rest_by, shortest_law
from hapsim.measuring.trace_quality import ROUNDING, SeenRate, seen_rate, unbroken
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace

_MOST_ROWS = 6000
_FAINT_COUNTS = 40.0  # below this position, or below the next step from sample to sample, rounding is no longer like
_SLOW_COUNTS = 8.0  # noise: it follows the motion
_COARSE_COUNTS = 40.0  # a record without a larger step has no loud parts: all of it is used
_QUIET_SPELL = 64  # samples between two loud parts of one motion
_RUN_UP = 8
_QUIETER = 0.1  # in sums of squares
_PUSH_NEWTON = 1e-6  # a smaller surplus is rounding of the force, not a push
_DRIFTS = tuple(
    1.0 - d for d in (0, 3e-4, 1e-3, 3e-3, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 1.0)
)
_SHAKEN = tuple(shaken(10.0**exponent) for exponent in np.arange(-3.0, 0.5, 0.4))  # a smaller ratio does not show
_SURE_ENOUGH = 0.01  # relative uncertainty of k and b
_TOO_UNSURE = 0.02  # relative uncertainty of k, and of what b makes of it, of a motion that is over soon
_FAR_OFF = 5.0  # times the uncertainty of the best fit: a less certain fit is no alternative
_LEAST_ORDER = 3  # the least order of a usable record: a pair of poles, and one pole of delay, filter or hold
_MOST_SPOILT = 0.1  # of the samples: with more, missing motion is not the cause
_UNDECIDED = 20.0  # of the criterion: four standard deviations of p, squared, and a margin for its coarse steps
_ROUNDED = 1.1  # times rounding: the residual of a fit with rounding as its only error
_SEEN = 5.0  # uncertainties: weaker evidence of dry friction is ignored
_SUSPECTED, _SPOILT_FIT = 3.0, 2.0  # uncertainties; times rounding and noise: above these dry friction is looked for
_FAR_BETTER = 0.5  # of a residual: neither chance nor another order of a fit reduces it so much
_SPOILT = LATE_FORCE | BRIDGED | OFF_GRID


class TooLittleMotionError(UsageError):
    """The hand moved by too few counts for a spring and damper to show."""


class Attempt(NamedTuple):
    """One run of a measurement."""

    push_n: float
    """The largest push, N."""
    left: str
    """The links that changed when the hand left its region, in words; "" if it stayed within."""
    k: float
    """Felt stiffness, N/m; NaN if nothing was identified."""
    uncertainty: float
    """Relative uncertainty of k."""


@dataclass(frozen=True, repr=False)
class Measurement:
    """The spring and damper that the hand felt. Each value has its standard uncertainty."""

    DOCUMENT = (
        "k b frequency_hz damping_ratio frequency_uncertainty_hz damping_ratio_uncertainty k_uncertainty b_uncertainty "
        "pole pole_uncertainty poles dominant too_fast reason mass order samples residual_m dry_friction_n "
        "mass_kg=mass mass_uncertainty_kg=mass_uncertainty"
    )

    k: float
    """Felt stiffness, N/m."""
    b: float
    """Felt damping, N·s/m, with the device's own friction."""
    frequency_hz: float
    """Eigenfrequency sqrt(k/m) / 2 pi, Hz."""
    damping_ratio: float
    frequency_uncertainty_hz: float
    damping_ratio_uncertainty: float
    k_uncertainty: float
    """Standard uncertainty of k, N/m, with that of the mass if known."""
    b_uncertainty: float
    pole: complex
    """z-plane pole of the pair: the one with the larger modulus, in the upper half."""
    pole_uncertainty: float
    poles: tuple[complex, ...]
    """All poles of the motion, by decreasing modulus. A faster pole is less certain."""
    dominant: bool
    """False if the slowest poles are not those of a spring and damper; the values above are then NaN."""
    reason: str
    """The reason if `dominant` is False."""
    mass: float
    """Mass in kg to which k and b refer. They are proportional to it; eigenfrequency and damping ratio are not."""
    mass_uncertainty: float | None
    """Standard uncertainty of the mass, kg; None for a declared mass."""
    second_mode: SecondMode | None
    """A second oscillating mode, if the motion has one."""
    order: int
    samples: int
    residual_m: float
    """Standard deviation of the fit's residual, m; ideally the rounding of the position alone."""
    trace: Trace = field(repr=False, compare=False)
    """The record that was identified."""
    dry_friction_n: float = 0.0
    """Dry friction, N, which is no part of b; 0 if the motion shows none. NaN if it shows some but not how much: k and
    b may then be off by more than their uncertainty."""
    failure: RunError | None = field(default=None, repr=False, compare=False)
    """The error that ended the run early; enough was recorded before it for the values above."""
    seen_rate: SeenRate | None = field(default=None, compare=False)
    """Rate at which the device sampled, from the arrival of its positions; None if they do not show it."""
    push_n: float | None = field(default=None, compare=False)
    """The largest push, N; None if unknown."""
    at_m: float | None = field(default=None, compare=False)
    """Position in m to which the hand was led; None if it was not led."""
    attempts: tuple[Attempt, ...] = field(default=(), compare=False)
    """All runs at that position, or both where a second run pushed harder. The result is from the most certain run in
    which the hand stayed in its region."""

    def __repr__(self) -> str:
        if not self.dominant:
            return f"<Measurement of {self.samples} samples: {self.reason}>"
        k, b = (
            f"{value:.6g} ± {off:.1g}" for value, off in ((self.k, self.k_uncertainty), (self.b, self.b_uncertainty))
        )
        return f"<Measurement of {self.samples} samples: k {k} N/m, b {b} N·s/m>"

    @property
    def left_region(self) -> str:
        """Links that changed when the hand left its region in the identified run, in words; "" if none, or not led."""
        return next((one.left for one in self.attempts if one.push_n == self.push_n), "")

    @property
    def too_fast(self) -> bool:
        """True if one pole of the pair decays within three samples, and k is not known to a few per cent."""
        half = self.b / (2.0 * self.mass)
        fastest = half + math.sqrt(max(half**2 - self.k / self.mass, 0.0))
        unsure = self.k_uncertainty / (abs(self.k) + self.mass * half**2)
        return self.dominant and fastest > -math.log(OVER_SOON) * self.trace.rate and unsure > _TOO_UNSURE

    def felt_mass(self, hand_stiffness: float) -> tuple[float, float]:
        """Returns the mass that the hand feels beside the device's own, and its standard uncertainty, kg.

        `hand_stiffness`: of the hand that held the device, N/m. A rigid mass on that hand would oscillate at the lowest
        recorded frequency. NaN if nothing oscillates."""
        swings = [] if not self.dominant or self.damping_ratio >= 1.0 else [(self.k, self.k_uncertainty)]
        if self.second_mode is not None:
            s = self.trace.rate * cmath.log(self.second_mode.pole)
            swings.append((self.mass * abs(s) ** 2, math.nan))
        k, uncertainty = min(swings, default=(math.nan, math.nan))
        return self.mass * (hand_stiffness / k - 1.0), self.mass * hand_stiffness / k**2 * uncertainty

    def at_rate(self, rate_hz: float) -> Measurement:
        """Returns the measurement for a device that sampled at `rate_hz` instead of the trace's rate: the motion has
        the same sample periods, of another length. The uncertainty of `seen_rate` adds to those of k and b."""
        share = rate_hz / self.trace.rate
        unsure = self.seen_rate.uncertainty_hz / rate_hz if self.seen_rate else 0.0
        changed = {}
        powers = (("k", "k_uncertainty", 2), ("b", "b_uncertainty", 1), ("frequency_hz", "frequency_uncertainty_hz", 1))
        for name, uncertainty, power in powers:
            changed[name] = value = getattr(self, name) * share**power
            changed[uncertainty] = math.hypot(getattr(self, uncertainty) * share**power, power * value * unsure)
        return replace(self, **changed)


def measure_trace(
    trace: Trace, mass: float, channel: int = 0, mass_uncertainty: float | None = None, *, pressed: bool = False
) -> Measurement:
    """Identifies the spring and damper that a mass of `mass` kg on `channel` felt during the trace.

    `mass_uncertainty`: standard uncertainty of the mass, kg; None for a declared mass. `pressed`: a constant force acts
    in addition to the scene's, so that the scene's force is not zero where the hand rests. Raises UsageError if nothing
    moves.
    """
    with one_thread():
        segments, fits, sticks = _fitted(trace, channel, pressed)
        read = _read(segments, fits)
    at = next((i for i, one in enumerate(read) if one.pair is not None), 0)
    best, found = fits[at][0], read[at]
    pair = found.pair or FittedPair()
    # The record does not distinguish the best fit from its alternatives: the largest of their uncertainties counts, and
    # of their distances from it. An alternative that is far less certain has fitted a pole to the noise and is ignored.
    others = [one.pair for one in read if one.pair is not None]
    equals = [pair, *(one for one in others if one.pole_uncertainty <= _FAR_OFF * pair.pole_uncertainty)]
    spans = {
        f"{name}_uncertainty": max(
            max(getattr(one, f"{name}_uncertainty"), abs(getattr(one, name) - getattr(pair, name))) for one in equals
        )
        for name in ("pole", "decay", "stiffness")
    }
    pair = pair._replace(**spans)
    rate, share = trace.rate, 0.0 if mass_uncertainty is None else mass_uncertainty / mass
    k, b = rate**2 * pair.stiffness, -rate * pair.decay  # of 1 kg
    off_k, off_b = rate**2 * pair.stiffness_uncertainty, rate * pair.decay_uncertainty
    angular = math.sqrt(k) if k > 0 else math.nan
    off = off_k / (2.0 * angular**2)  # of the eigenfrequency, relative; the damping ratio is b / (2 angular)
    return Measurement(
        k=mass * k,
        b=mass * b,
        frequency_hz=angular / (2.0 * math.pi),
        damping_ratio=b / (2.0 * angular),
        frequency_uncertainty_hz=off * angular / (2.0 * math.pi),
        damping_ratio_uncertainty=math.hypot(off_b, off * b) / (2.0 * angular),
        k_uncertainty=mass * math.hypot(off_k, share * k),
        b_uncertainty=mass * math.hypot(off_b, share * b),
        pole=pair.pole,
        pole_uncertainty=pair.pole_uncertainty,
        poles=tuple(found.poles.tolist()),
        dominant=found.pair is not None,
        reason=found.reason,
        mass=mass,
        mass_uncertainty=mass_uncertainty,
        second_mode=found.second,
        order=best.order,
        samples=best.rows,
        residual_m=best.residual * float(trace.position_scale[channel]),
        trace=trace,
        dry_friction_n=_dry_friction(segments, best, sticks),
        seen_rate=seen_rate(trace),
    )


identify = measure_trace  # its former name, still public


def _read(segments: list[Segment], fits: list[tuple[Fit, Fit | None]]) -> list[Poles]:
    """Returns the poles of each fit. What begins a motion is over a few samples later, what the hand does may be, too:
    the number of samples that leaves the pair most certain is skipped."""
    best, least = list[Poles](), math.inf
    for at_begin, skipped in ((0, _RUN_UP), *((one, one) for one in range(_RUN_UP, -1, -1))):
        motion = _free_motion(segments, fits[0][0].order, at_begin, skipped)
        read = dominant_pairs(fits, motion, segments[0].stands)
        unsure = min((one.pair.unsure for one in read if one.pair is not None), default=math.inf)
        if not best or unsure < least:
            best, least = read, unsure
        if least < _SURE_ENOUGH:
            break
    return best


def _fitted(trace: Trace, channel: int, pressed: bool) -> tuple[list[Segment], list[tuple[Fit, Fit | None]], bool]:
    """Returns the usable segments, their fits as from `_fits`, and whether dry friction acts that these fits lack.
    Raises UsageError if there is no fit."""
    if not np.all(np.isfinite(trace.asked_force)):
        raise UsageError("the scene's force was not finite throughout: there is nothing to be identified")
    # A host that is often late leaves too few samples between two deadline misses: a rough fit is then better than
    # none. The same holds for a hand that never moves by many counts between its rests: rounding then counts as noise.
    counts, rows = trace.position_counts[:, channel].astype(float), trace.sample.size
    moved = float(np.ptp(counts)) if rows else 0.0
    loud = moved <= _FAINT_COUNTS or float(np.max(np.abs(np.diff(counts)), initial=0.0)) > _COARSE_COUNTS
    attempts = [(_SPOILT, loud), (_SPOILT & ~OFF_GRID, loud), *([(_SPOILT, False)] if pressed else [])]
    for spoilt, without_quiet in attempts:
        segments = _segments(trace, channel, spoilt, pressed, without_quiet)
        fits = _fits(segments, _DRIFTS)
        # Fits with a white force are tried only if the residual exceeds rounding: with more candidates, a wrong fit may
        # look more certain.
        if fits and (trace.sensed or fits[0][0].residual > _ROUNDED * ROUNDING):
            fits = _fits(segments, _DRIFTS + _SHAKEN)
        if fits:
            return _with_dry_friction(segments, fits)
    late, lost, limited = (int(np.count_nonzero(trace.flags & flag)) for flag in (LATE_FORCE, BRIDGED, LIMITED))
    if moved > _FAINT_COUNTS and late + lost > _MOST_SPOILT * rows:
        units = trace.report.units_of(channel)
        way = units(moved * float(trace.position_scale[channel]), "m", ".3g")
        raise UsageError(
            f"the hand moved by {way}, but of {rows} samples {late} had their force too late and {lost} followed lost "
            f"ones ({limited} were at the force limit): at no delay that stays the same a spring and damper is "
            "identified. `hapsim doctor` shows which rates are kept; a slower rate, or a faster port, leaves more time"
        )
    raise TooLittleMotionError(
        "too little motion was recorded to identify a spring and damper: record longer, or push harder (--push)"
    )


def _with_dry_friction(
    segments: list[Segment], fits: list[tuple[Fit, Fit | None]]
) -> tuple[list[Segment], list[tuple[Fit, Fit | None]], bool]:
    """Returns the same as `_fitted`: fits with dry friction if the motion shows it clearly, else `fits`.

    Between two turns dry friction is a constant force. If the pieces between the turns fit far better than the whole,
    dry friction acts, too, but the hand sticks too often to distinguish it from a spring."""
    # There is none if the best fit leaves only rounding and noise, and a force with the sign of the velocity does not
    # improve it. That test takes a tenth of the time of the fits between the turns.
    fit, counts = fits[0][0], max(ROUNDING, *(noise_of(one.position) for one in segments))
    rubbing = Regression(segments, (fit.drift,), ROUNDING, fit.order, with_slides=True).fit(fit.order, 0)
    if not (rubbing is None or rubbing.dry_clearly > _SUSPECTED or fit.residual > _SPOILT_FIT * counts):
        return segments, fits, False
    moving = [
        Segment(
            one.position[first:last], one.surplus[first:last], one.slides[first:last], stands=one.stands, own=one.own
        )
        for one in segments
        for first, last in _runs(~stands(one.position) & (np.abs(one.slides) > 0.999))
    ]
    pieces = _fits(moving, _DRIFTS + _SHAKEN, with_slides=True)
    rubbed = [one for one in pieces if one[0].dry_clearly > _SEEN]
    if rubbed:
        return moving, rubbed, False
    return segments, fits, bool(pieces) and pieces[0][0].residual < _FAR_BETTER * fit.residual


def _dry_friction(segments: list[Segment], fit: Fit, sticks: bool) -> float:
    """Returns the dry friction, N; NaN if no push shows how large it is."""
    if fit.dry_clearly == 0.0:
        return math.nan if sticks else 0.0
    pushed = max(float(np.max(np.abs(one.surplus))) for one in segments) > _PUSH_NEWTON
    return fit.dry if pushed and fit.dry > 0.0 else math.nan


def _runs(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Returns the index ranges of the runs of True."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _segments(trace: Trace, channel: int, spoilt: int, pressed: bool, loud: bool) -> list[Segment]:
    """Returns runs of consecutive samples without a `spoilt` flag, with as many rows as a regression needs. Positions
    are relative to the scene's zero force, or to the rest of a `pressed` hand. `loud`: only parts above rounding."""
    asked = trace.asked_force[:, channel]
    surplus = trace.force_counts[:, channel] * trace.force_scale[channel] - asked
    position = trace.position_counts[:, channel].astype(float)
    law = shortest_law(position, asked, surplus, following(trace))
    own = law.poles if law is not None and law.obeyed else np.zeros(0, complex)
    rest, known, stands_still = rest_by(position, law, pressed)
    surplus = surplus - np.median(surplus) if pressed else surplus
    position = position - rest
    found, rows = [], 0
    for whole in unbroken(trace, spoilt):
        for first, last in _loud(position, *whole) if loud else [whole]:
            end = min(last, first + _MOST_ROWS - rows)
            if end > first:
                found.append(
                    Segment(
                        position[first:end], surplus[first:end], slides(position[first:end]), known, stands_still, own
                    )
                )
                rows += end - first
    return found


def _free_motion(segments: list[Segment], order: int, at_begin: int, skipped: int) -> Floats:
    """Returns the positions of a stretch in which only the scene's force acted: the longest that is long enough for the
    poles of this order and not much quieter than the loudest. After the end of a motion no pole shows.
    `at_begin`, `skipped`: samples to leave out where a segment begins, and after a push, whose force acts late.
    """
    most = max((float(np.max(np.abs(segment.surplus))) for segment in segments), default=0.0)
    stretches = [np.empty(0)]
    for segment in segments:
        pushed = np.flatnonzero(np.abs(segment.surplus) > 0.01 * most) if most > _PUSH_NEWTON else np.empty(0, int)
        edges = np.concatenate([[-1], pushed, [segment.position.size]])
        widest = int(np.argmax(np.diff(edges)))
        begin = edges[widest] + 1 + (skipped if widest > 0 else at_begin)
        stretches.append(segment.position[begin : edges[widest + 1]])
    stretches = [one for one in stretches if one.size >= 2 * (order + 1)] or stretches
    loudest = max(float(one @ one) for one in stretches)
    return max((one for one in stretches if float(one @ one) >= _QUIETER * loudest), key=len)


def _loud(y: Floats, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yields the index ranges of y[first:last] that rise above the rounding, with short quiet spells between them."""
    step = np.abs(np.diff(y[first:last], prepend=y[first : first + 1]))
    loud = first + np.flatnonzero((step > _SLOW_COUNTS) & (np.abs(y[first:last]) > _FAINT_COUNTS))
    for part in np.split(loud, np.flatnonzero(np.diff(loud) > _QUIET_SPELL) + 1):
        if part.size:  # begins earlier, to include the push that starts the motion
            yield max(first, int(part[0]) - _RUN_UP), int(part[-1]) + 1


def _fits(
    segments: list[Segment], drifts: Sequence[complex], with_slides: bool = False
) -> list[tuple[Fit, Fit | None]]:
    """Returns the best fits, best first, all of one order, each with its alternative of the next order or None.

    The criterion chooses order and p. The open loop's p weighs the record: it hardly moves the poles, but determines
    their uncertainty. So every p that the record does not distinguish from the best is kept.
    """
    regression = Regression(segments, drifts, ROUNDING, with_slides=with_slides)
    if regression.most_order < _LEAST_ORDER:
        return []
    order = min(range(2, MOST_ORDER), key=regression.least_criterion)
    # Orders are compared on the rows that the largest leaves. If the motion ends soon or is in short pieces, the first
    # rows have most information: the next orders are compared on them.
    while True:
        regression = Regression(segments, drifts, ROUNDING, order + 1, with_slides)
        least = regression.least_criterion(order)
        if not math.isfinite(least):
            return []
        if order + 1 == MOST_ORDER or regression.least_criterion(order + 1) >= least:
            break
        order += 1
    criterion = regression.criterion[:, order]
    undecided = (at for at in np.argsort(criterion) if criterion[at] < least + _UNDECIDED)
    return [(fit, regression.fit(order + 1, at)) for at in undecided if (fit := regression.fit(order, at))]
