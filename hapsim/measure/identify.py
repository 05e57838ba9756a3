"""Identification: what spring and damper the hand met, read from what was recorded and from nothing else.

It never sees a prediction, nor the scene's stiffness and damping: only the positions and forces on the wire, the
sample period, and the mass to which the answer refers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import BRIDGED, HELD, UNSENT
from hapsim.loop.trace import Trace
from hapsim.measure.pair import Pair, dominant_pair
from hapsim.measure.regression import Fit, Segment, fit

_ROUNDING = 1.0 / math.sqrt(12.0)  # standard deviation of rounding to whole counts
_MOST_ROWS = 6000
_FAINT_COUNTS = 40.0  # a smaller position, or a smaller step from one sample to the next, and the rounding is no
_SLOW_COUNTS = 8.0  # longer like noise: it follows the motion
_MOST_ORDER = 9
_DRIFTS = tuple(
    1.0 - d for d in (0, 3e-4, 1e-3, 3e-3, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 1.0)
)
_FAR_OFF = 5.0  # a fit that is this much less certain than the best one is no rival of it
_UNDECIDED = 12.0  # by so much may the criterion of two fits differ without telling which is right


@dataclass(frozen=True)
class Measurement:
    """What the hand met, each value with the standard uncertainty that the identification states."""

    k: float
    """N/m."""
    b: float
    """N·s/m, real friction included."""
    frequency_hz: float
    """Eigenfrequency sqrt(k/m) / 2 pi."""
    damping_ratio: float
    k_uncertainty: float
    b_uncertainty: float
    pole: complex
    """z-plane, the one of the pair with the larger modulus, in the upper half."""
    pole_uncertainty: float
    poles: tuple[complex, ...]
    """All that the record shows, by decreasing modulus; the faster a pole, the less it is known."""
    dominant: bool
    """False where the slowest poles are not those of a spring and damper; the values above are then NaN."""
    reason: str
    """Why not."""
    mass: float
    order: int
    samples: int
    residual_m: float
    """Standard deviation of what the fit leaves, in m: the rounding of the position where all is well."""


def identify(trace: Trace, mass: float, channel: int = 0) -> Measurement:
    """The spring and damper that `mass` kg on `channel` met during the trace. UsageError where nothing moves."""
    segments = _segments(trace, channel)
    fits = _fits(segments)
    if not fits:
        raise UsageError(
            "too little motion was recorded to identify a spring and damper: record longer, or excite more strongly"
        )
    longest = max(segments, key=lambda segment: segment.position.size)
    found = [(best, dominant_pair(best, others, longest.position)) for best, others in fits]
    # Of the fits that are equally good the one that claims least, unless it took the noise for a pole.
    most = _FAR_OFF * _claimed_uncertainty(found[0][1][0])
    plausible = [entry for entry in found if _claimed_uncertainty(entry[1][0]) <= most]
    best, (pair, poles, reason) = max(plausible or found[:1], key=lambda entry: _claimed_uncertainty(entry[1][0]))
    return _measurement(pair, poles, reason, best, mass, trace.rate, float(trace.position_scale[channel]))


def _claimed_uncertainty(pair: Pair | None) -> float:
    return -1.0 if pair is None else pair.poles_uncertainty[0]


def _measurement(
    pair: Pair | None,
    poles: NDArray[np.complex128],
    reason: str,
    best: Fit,
    mass: float,
    rate: float,
    scale: float,
) -> Measurement:
    if pair is None:
        k = b = k_uncertainty = b_uncertainty = pole_uncertainty = math.nan
        pole = complex(math.nan, math.nan)
    else:
        k, b = mass * rate**2 * pair.stiffness, -mass * rate * pair.decay
        k_uncertainty = mass * rate**2 * pair.stiffness_uncertainty
        b_uncertainty = mass * rate * pair.decay_uncertainty
        pole, pole_uncertainty = pair.poles[0], pair.poles_uncertainty[0]
    return Measurement(
        k=k,
        b=b,
        frequency_hz=math.sqrt(k / mass) / (2.0 * math.pi) if k > 0 else math.nan,
        damping_ratio=b / (2.0 * math.sqrt(k * mass)) if k > 0 else math.nan,
        k_uncertainty=k_uncertainty,
        b_uncertainty=b_uncertainty,
        pole=pole,
        pole_uncertainty=pole_uncertainty,
        poles=tuple(poles.tolist()),
        dominant=pair is not None,
        reason=reason,
        mass=mass,
        order=best.order,
        samples=best.rows,
        residual_m=best.residual * scale,
    )


def _segments(trace: Trace, channel: int) -> list[Segment]:
    """Runs of consecutive samples that were all answered in time, counted from where the scene asks for no force."""
    position = trace.position_counts[:, channel].astype(float)
    asked = trace.asked_force[:, channel]
    surplus = trace.force_counts[:, channel] * trace.force_scale[channel] - asked
    rest = _rest(position, asked)
    found = []
    for first, last in _unbroken(trace):
        y = position[first:last] - rest
        heard = _heard_until(y)
        found.append(Segment(y[:heard], surplus[first : first + heard]))
    return [segment for segment in found if segment.position.size > 0]


def _unbroken(trace: Trace) -> Iterator[tuple[int, int]]:
    """Index ranges without a gap: no sample missing, each force sent and in time."""
    flags = trace.flags
    broken = (np.diff(trace.sample, prepend=trace.sample[:1] - 1) != 1) | (flags & (HELD | BRIDGED) != 0)
    broken[1:] |= flags[:-1] & UNSENT != 0
    starts = np.flatnonzero(broken | (np.arange(broken.size) == 0))
    for first, last in zip(starts, np.append(starts[1:], broken.size), strict=True):
        yield int(first), int(min(last, first + _MOST_ROWS))


def _heard_until(y: NDArray[np.float64]) -> int:
    """How many samples pass before the motion is lost in the rounding."""
    moving = np.abs(np.diff(y, prepend=y[:1])) > _SLOW_COUNTS
    loud = np.flatnonzero(moving & (np.abs(y) > _FAINT_COUNTS))
    return int(loud[-1]) + 1 if loud.size else 0


def _rest(position: NDArray[np.float64], asked: NDArray[np.float64]) -> float:
    """Where the asked force is zero, in counts: exact for a hand on springs and dampers to the ground, whose force is
    linear in the two newest positions; the middle of the motion where the scene has masses of its own."""
    if position.size < 8:
        return 0.0
    now, before = position[1:], position[:-1]
    scale = float(np.max(np.abs(position))) or 1.0
    columns = np.column_stack([now / scale, (now - before) / scale, np.ones_like(now)])
    law, *_ = np.linalg.lstsq(columns, asked[1:], rcond=None)
    missed = np.max(np.abs(asked[1:] - columns @ law))
    if missed > 1e-9 * np.max(np.abs(asked)):
        return float(np.median(position))
    return float(-law[2] / law[0] * scale) if abs(law[0]) > 1e-9 * abs(law[1]) else 0.0


def _fits(segments: list[Segment]) -> list[tuple[Fit, list[Fit]]]:
    """Fits for which the record speaks, best first, each with what might as well have been chosen in its place.

    The order is the criterion's choice. The open loop's p weighs the record; it hardly moves the poles, but it decides
    how certain they look: every p that the record does not tell from the best is kept.
    """
    with_surplus = any(np.any(segment.surplus) for segment in segments)

    def attempt(order: int, drift: float) -> list[Fit]:
        found = fit(segments, order, drift, with_surplus, _ROUNDING)
        return [] if found is None else [found]

    profile = [found for drift in _DRIFTS for found in attempt(6, drift)]
    profile = profile or [found for drift in _DRIFTS for found in attempt(3, drift)]
    if not profile:
        return []
    profile.sort(key=_criterion)
    drifts = [found.drift for found in profile if found.criterion < profile[0].criterion + _UNDECIDED]
    orders = [found for order in range(2, _MOST_ORDER) for found in attempt(order, drifts[0])]
    order = min(orders, key=_criterion).order
    return [(found, attempt(order + 1, drift)) for drift in drifts for found in attempt(order, drift)]


def _criterion(found: Fit) -> float:
    return found.criterion
