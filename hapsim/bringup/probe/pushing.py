"""The last step, only with the user's permission: short pushes to either side, and what the positions make of them.

Pushes are +F, -2F, +F: they leave neither speed nor displacement behind in a free mass. They begin one sample long, and
grow until the response stands out of the noise or the travel that was allowed is reached.

A force F[n] that answers sample n and acts from tick n + 1 on is that of sample n + 1; so of F[k], F[k-1], F[k-2] the
second difference at k of a device that keeps PROTOCOL.md, section 6, shows the second and the third, in equal parts
(the second alone, doubled, if it gives impulses). F[k], which came during the sample that k + 1 ends, shows in a device
that puts a force out on arrival.

The second difference of the position, x[k+1] - 2 x[k] + x[k-1], is T²/2m times the forces of the two samples around
k. Friction, a spring and a constant pull are regressed beside the forces, so that a device that moves by itself is
judged too.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Leave, Probing, Sample, Session, in_words
from hapsim.units import Units

STEP = "push"
_LAGS = 5
_PATTERNS = 32  # at each length
_LONGEST_S = 3.0  # for those of one length
# While no count changes, how far a free mass (kg; of a handle, where none is given) gets: of the travel, where one push
# is lost, in all the time of those of one length; or in counts, with one push, but that much of the travel at most.
_UNSEEN_MASS, _UNSEEN, _UNSEEN_COUNTS = 0.1, 0.3, 2.0
_SURE = 30.0  # standard deviations: then nothing longer is tried
_SEEN = 6.0  # standard deviations of a response that is one at all
_CLEAR = 0.03  # of the response: then its lags can be distinguished
_MASS_WITHIN = 0.25  # of the mass that was given: a hand is never the same
_ACCELERATION_WITHIN = 0.3  # of that of the positions: some sensors are coarse
TURNED = 15.0  # degrees: axes that are turned by less are right
_LARGEST_COUNT = 2**31 - 1  # of the wire's; rounded, the limit of some devices is one more


class TravelledError(Exception):
    """The device moved farther than the user allowed."""


class Pusher:
    """An armed device that is pushed on one channel, within the user's permission, and watched on it, or on a pair."""

    def __init__(self, probing: Probing, session: Session, leave: Leave) -> None:
        self.device = device = probing.device
        self.session, self.leave = session, leave
        self.limit = device.force_limit[leave.channel]
        """N, of the device."""
        self.force_scale = device.force_scale[leave.channel]
        self.forces: dict[int, float] = {}
        """N, by the sample that they answer."""
        self._rate_hz = device.rate_hz
        self._position_scale = device.position_scale[leave.channel]
        self._watched = leave.channels
        self.units = probing.units_of(leave.channel)
        travel, counts = leave.travel, _UNSEEN_COUNTS * self._position_scale
        way = max(_UNSEEN * travel / (6 * _PATTERNS), min(counts, _UNSEEN * travel))
        self.unseen = (leave.mass or _UNSEEN_MASS) * way
        """N·s²: force times the square of a push's length, at most, while no count changes."""
        self._settling = probing.samples_in(3.0, 100, 20000)
        self._home: NDArray[np.float64] | None = None
        self.sensed: Estimate | None = None
        """Gain of acceleration per force in the newest pushes, in m/s² per N."""

    def acceleration(self, sample: Sample) -> float:
        """Returns m/s², of a device that was armed to send accelerations alone."""
        channel, device = self.leave.channel, self.device
        return sample.counts[device.channels + channel] * device.acceleration_scale[channel]

    def position(self, sample: Sample) -> float:
        """Returns m."""
        return sample.counts[self.leave.channel] * self._position_scale

    def positions(self, sample: Sample) -> NDArray[np.float64]:
        """Returns m, of the channels of `Leave.channels`."""
        return np.array([sample.counts[c] * self.device.position_scale[c] for c in self._watched])

    def begin_here(self) -> None:
        """Counts the travel from the newest position on."""
        self._home = self.positions(self.session.samples[-1])

    def push(self, sample: Sample, force: float, time_to_live: int = 0) -> None:
        """Answers a sample with a force in N. Raises TravelledError, and sends no force, if the device has moved too
        far. By default a force that comes too late is not acted on, and one that is not renewed ends."""
        if self._home is not None and np.linalg.norm(self.positions(sample) - self._home) > self.leave.travel:
            self.session.zero(sample)
            raise TravelledError(f"it moved more than {self.units(self.leave.travel, 'mm', 'g')}: stopped")
        force = min(max(force, -self.leave.force), self.leave.force)
        count = min(max(math.trunc(force / self.force_scale), -_LARGEST_COUNT), _LARGEST_COUNT)
        self.forces[sample.n] = count * self.force_scale
        counts = [0] * self.leave.channel + [count]
        self.session.force(sample.n, counts, time_to_live if force else schema.MAX_TIME_TO_LIVE_SAMPLES)

    def settle(self) -> bool:
        """Returns whether the device comes to rest by itself: 50 samples within a hundredth of the travel."""
        for _ in range(0, self._settling, 50):
            if not self.session.run(50, self.session.zero):
                return False
            recent = np.array([self.positions(sample) for sample in self.session.samples[-50:]])
            if np.ptp(recent, axis=0).max() < max(0.01 * self.leave.travel, 2 * self._position_scale):
                return True
        return False

    @property
    def is_silent(self) -> bool:
        """True if the position has not changed by a count since arming although a force acted."""
        counts = {tuple(sample.counts[c] for c in self._watched) for sample in self.session.samples}
        return len(counts) == 1 and any(self.forces.values())

    def silence(self) -> str:
        """Returns that nothing changes, and what to do."""
        acted = [abs(force) for force in self.forces.values() if force]
        return (
            f"the position has not changed by one count for {len(acted) / self._rate_hz:.2g} s while force acts "
            f"({self.units(max(acted), 'N', '.3g')} at most){self._swapped()}: sensor or cable? "
            "Move the device by hand: if its position changes, it is held, or stuck by dry friction, and only "
            "then try a greater --push and --travel"
        )

    def _swapped(self) -> str:
        """Returns a clause that names another channel that moved while this one did not; "" if none did."""
        counts = np.array([sample.counts[: self.device.channels] for sample in self.session.samples])
        other = int(np.argmax(spans := np.ptp(counts, axis=0)))
        return f", but that of channel {other} has: are their wires exchanged? Else" if spans[other] > 1 else ""

    def why_stopped(self) -> str:
        """Returns why nothing more came of it."""
        ended = self.session.ended
        return f"the device stopped: {in_words(ended)}" if ended else "the device does not come to rest"

    def samples_from(self, first: int) -> dict[int, Sample]:
        """Returns the samples from number `first` on, by number."""
        return {sample.n: sample for sample in self.session.samples if sample.n >= first}


def what_will_be_done(probing: Probing, leave: Leave) -> str:
    """Returns a sentence for the user, before anything is pushed."""
    force, units = min(leave.force, probing.device.force_limit[leave.channel]), probing.units_of(leave.channel)
    return (
        f"Pushing {leave.named} now: at most {units(force, 'N', 'g')} to either side in short pulses, some "
        "seconds long, "
        f"stopped if it moves more than {units(leave.travel, 'mm', 'g')}. Let it move freely. Ctrl-C releases it."
    )


def probe_pushing(probing: Probing) -> None:
    """Always goes on."""
    leave = probing.leave
    if leave is None:
        probing.leave_out(
            STEP,
            f"not allowed to push: --push F allows pushes to either side of at most F {probing.units.name('newton')}",
        )
        return
    parts = schema.parts_of({"acceleration"} & {*probing.device.sensed})
    session = probing.arm_by_device(STEP, min(probing.device.max_watchdog_samples, 500), parts=parts)
    if session is None:
        return
    pushers = [Pusher(probing, session, replace(leave, channel=one)) for one in leave.channels]
    try:
        if pushers[0].settle():
            _respond(probing, pushers)
        else:
            why = "stopped" if session.ended else "it moves by itself"
            probing.leave_out(STEP, f"the device does not come to rest ({why}): hold it, or lay it down, and try again")
    finally:
        session.disarm()


def _pattern(length: int) -> Iterator[float]:
    """Yields +, -, -, + and a rest, or the other way round, at random, between rests as long as the lags."""
    yield from (0.0,) * _LAGS
    sides = random.Random(length)
    for _ in range(_PATTERNS):
        side = sides.choice((1.0, -1.0))
        for sign in (side, -side, -side, side, 0.0, 0.0):
            yield from (sign,) * length
        yield from (0.0,) * sides.randrange(_LAGS)
    yield from (0.0,) * _LAGS


def _stages(probing: Probing, pusher: Pusher) -> Iterator[tuple[float, int]]:
    """Yields greater and greater pushes: (a force in N, a length in samples)."""
    force = min(pusher.leave.force, pusher.limit)
    for share in (64, 16, 4):
        yield force / share, 1
    length = 1
    while length == 1 or 6 * length * _PATTERNS < probing.samples_in(_LONGEST_S, 200, 10000):
        if pusher.is_silent and force * probing.periods(length) ** 2 > pusher.unseen:
            return
        yield force, length
        length *= 2


def _respond(probing: Probing, pushers: Sequence[Pusher]) -> None:
    """Pushes each channel more and more until the response is clear, and judges the clearest ones."""
    each = []
    for pusher in pushers:
        answers, why = _answers(probing, pusher)
        if answers is None:
            probing.leave_out(STEP, why)
            return
        each.append(answers)
    (best, *_), units = (found := each[0]).estimates, pushers[0].units
    response = best.total * probing.device.rate_hz**2
    if len(pushers) > 1:
        matrix = np.array([[one.total for one in answers.estimates] for answers in each]).T * probing.device.rate_hz**2
        kept, words = turned_in_words(matrix, max(1.0 / one.clearest.significance for one in each), units)
    else:
        kept, words = best.total > 0, "" if best.total > 0 else "inverted: "
        words += f"{units(1.0, 'N')} makes {units(response, 'm/s²', '.4g')} (± {100 / best.significance:.2g} %)"
    probing.judge("sign", kept, f"{words}, from {best.rows} samples, {found.pushes}")
    if len(pushers) > 1 and not kept:
        probing.leave_out(STEP, "the axes of the pair are not right: see sign")
        return
    probing.response = response
    _judge_delay(probing, best)
    _judge_mass(probing, best, 1.0 / abs(probing.response))
    _judge_acceleration(probing, best, found.sensed)


def turned_in_words(response: NDArray[np.float64], unsure: float, units: Units) -> tuple[bool, str]:
    """Returns whether a pair pushes the right way, and how it is turned, in words.

    A motor that is right makes 1/M of a force, a symmetric matrix that turns it little. Motors that are turned by phi
    make R(phi)/M of it; the phi whose turn back leaves a symmetric matrix is that of the polar decomposition.

    Args:
        response: (m/s²)/N, of channel i to a push of channel j, shape (2, 2).
        unsure: its relative uncertainty.
    """
    (xx, xy), (yx, yy) = response.tolist()
    first, second = (" and ".join(units(one, "m/s²", ".3g") for one in column) for column in ((xx, yx), (xy, yy)))
    words = f"{units(1.0, 'N')} on the first channel makes {first}, on the second {second}"
    if xx * yy < xy * yx:
        axes = "the channels are exchanged"
        if abs(xx - yy) > abs(xy + yx):
            axes = f"the {'first' if xx < yy else 'second'} channel is inverted"
        return False, f"{axes}: {words}"
    degrees = math.degrees(math.atan2(yx - xy, xx + yy))
    tolerance = math.degrees(math.asin(min(unsure, 1.0)))
    return abs(degrees) <= TURNED + tolerance, f"turned by {degrees:z.0f}° (± {tolerance:.2g}°): {words}"


class Answers(NamedTuple):
    """The clearest response to pushes of a channel."""

    estimates: list[Estimate]
    """Response of the channel, or of each of the pair."""
    sensed: Estimate | None
    """Gain of the accelerations, from the same pushes."""
    pushes: str
    """In words."""

    @property
    def clearest(self) -> Estimate:
        """Response of the channel that shows it best."""
        return max(self.estimates, key=lambda one: one.significance)


def _answers(probing: Probing, pusher: Pusher) -> tuple[Answers | None, str]:
    """Pushes more and more until the response is clear; returns the clearest, or why there is none, in words."""
    best: Answers | None = None
    went_too_far = ""
    for force, length in _stages(probing, pusher):
        if best is not None and best.clearest.significance > _SEEN:
            reach = max(abs(one.total) for one in best.estimates) * force * length**2
            if reach > 0.3 * pusher.leave.travel:
                break
        if not pusher.settle():
            break
        found, went_too_far = _pushed(pusher, force, length)
        if found:
            answers = Answers(found, pusher.sensed, f"pushes of {pusher.units(force, 'N', '.3g')}, {length} long")
            best = max(best or answers, answers, key=lambda one: one.clearest.significance)
        if went_too_far or (best is not None and best.clearest.is_clear):
            break
    if best is not None and best.clearest.significance >= _SEEN:
        return best, ""
    if went_too_far:
        return None, f"{went_too_far} (--travel allows more, --push asks less)"
    if pusher.session.ended is not None:
        return None, pusher.why_stopped()
    if pusher.is_silent:
        return None, pusher.silence()
    if best is None:
        return None, "too few of this host's forces were in time"
    return None, "the positions show no response: try a greater --push, or let the device move freely"


def _pushed(pusher: Pusher, force: float, length: int) -> tuple[list[Estimate], str]:
    """Returns what such pushes show on the channel, or on each of the pair, and that they went too far, in words."""
    session = pusher.session
    pusher.begin_here()
    begun, too_far = session.samples[-1].n + 1, ""
    signs = list(_pattern(length))

    def answer(sample: Sample) -> None:
        """Pushes by the sample's number, so that the pattern continues after a missed sample."""
        pusher.push(sample, force * signs[min(max(sample.n - begun, 0), len(signs) - 1)])

    try:
        session.run(len(signs), answer)
    except TravelledError as error:
        too_far = str(error)
    samples = pusher.samples_from(begun)

    def by_lag(k: int) -> list[float] | None:
        """Forces that missed their deadline were not acted on, as POSITION_HELD says of the next sample."""
        if not all(j in samples for j in range(k - _LAGS, k + 2)):
            return None
        return [pusher.forces.get(n, 0.0) if samples[n + 1].fresh else 0.0 for n in range(k, k - _LAGS, -1)]

    if session.wire.armed.parts:
        sensed = {n: pusher.acceleration(sample) for n, sample in samples.items()}
        pusher.sensed = estimate({n: pusher.position(sample) for n, sample in samples.items()}, by_lag, sensed)
    places = {n: pusher.positions(sample) for n, sample in samples.items()}
    found = [estimate({n: one[i] for n, one in places.items()}, by_lag) for i in range(len(pusher.leave.channels))]
    return [one for one in found if one is not None], too_far


def _judge_delay(probing: Probing, found: Estimate) -> None:
    shares, deviations = found.values / found.total, found.deviations / abs(found.total)
    unsure = float(max(deviations[:2]))
    by_lag = ", ".join(f"{share:z.2f} at {lag}" for lag, share in enumerate(shares))
    words = f"of the response, {by_lag} samples"
    if unsure > 0.1:
        probing.not_seen("delay", f"{words}, but ± {unsure:.2f}: a greater --push shows more")
    elif shares[0] > max(0.05, 5 * deviations[0]):
        look_at = "FORCE is put out on arrival: keep it until the next tick, and put it out before it measures"
        probing.judge("delay", False, f"{words}: it begins within the sample that the force came in", look_at)
    elif shares[1] < 0.1 and shares[1] + 5 * deviations[1] < 0.3:
        probing.judge("delay", False, f"{words}: it begins a sample late")
    else:
        probing.judge("delay", True, words)


def _judge_mass(probing: Probing, found: Estimate, mass: float) -> None:
    """`mass`: kg, as it responds."""
    assert probing.leave is not None
    units = probing.units_of(probing.leave.channel)
    given, words = probing.leave.mass, f"it responds like {units(mass, 'kg', '.4g')}"
    if given is None:
        probing.not_seen("mass", f"{words}; --mass KG says what it ought to be")
        return
    factor, unsure = given / mass, 3 / found.significance
    words += f": {factor:.3g} times the response of {units(given, 'kg', 'g')}"
    if unsure > _MASS_WITHIN:
        probing.not_seen("mass", f"{words}, but ± {100 * unsure:.0f} %: a greater --push shows more")
        return
    words += f" (within {100 * _MASS_WITHIN:g} %, and its uncertainty, is allowed)"
    kept = abs(math.log(factor)) < math.log1p(_MASS_WITHIN) + unsure
    if not kept:
        words += f", as if positions were {factor:.3g} times too large, or forces as much stronger than they say"
    probing.judge("mass", kept, words)


def _judge_acceleration(probing: Probing, found: Estimate, sensed: Estimate | None) -> None:
    assert probing.leave is not None
    assert probing.response is not None
    if sensed is None:
        probing.not_seen("acceleration", f"no acceleration is sensed (register {schema.REG_SENSORS}, bit 0)")
        return
    units = probing.units_of(probing.leave.channel)
    ratio = sensed.total / probing.response
    unsure = 3 * math.hypot(1.0 / found.significance, sensed.sum_deviation / abs(probing.response))
    words = (
        f"{units(1.0, 'N')} makes {units(sensed.total, 'm/s²', '.4g')} there, {ratio:.3g} times that of the positions"
    )
    if unsure > _ACCELERATION_WITHIN:
        probing.not_seen("acceleration", f"{words}, but ± {100 * unsure:.0f} %: a greater --push shows more")
        return
    if sensed.significance < _SEEN:
        probing.judge("acceleration", False, f"{words}: it does not answer the pushes, which moved the device")
        return
    shares = sensed.values / sensed.total
    age = 1 if shares[2] > 0.5 else 0
    is_recent = float(shares[1] + shares[2]) > 1.0 - _ACCELERATION_WITHIN
    words += f"; acceleration_age: {age}" if is_recent else "; it is older than one force"
    kept = abs(ratio - 1.0) <= _ACCELERATION_WITHIN + unsure
    probing.judge("acceleration", kept and is_recent, words)


_PARTS = 8  # of the record: what their estimates differ by is the uncertainty


@dataclass(frozen=True)
class Estimate:
    """Coefficients of the forces, in m/N, and their standard deviations; shape (forces,)."""

    values: NDArray[np.float64]
    deviations: NDArray[np.float64]
    sum_deviation: float
    """Standard deviation of the values' sum."""
    rows: int

    @property
    def total(self) -> float:
        """The values' sum."""
        return float(self.values.sum())

    @property
    def is_clear(self) -> bool:
        """True if the lags can be distinguished, so that no longer push is needed."""
        return self.significance > _SURE and float(max(self.deviations[:2])) < _CLEAR * abs(self.total)

    @property
    def significance(self) -> float:
        """Sum over its standard deviation; 0 if no force moved the position by a count."""
        if self.sum_deviation > 0:
            return abs(self.total) / self.sum_deviation
        return np.inf if self.total else 0.0


def estimate(
    positions: Mapping[int, float],
    forces_of: Callable[[int], Sequence[float] | None],
    sensed: Mapping[int, float] | None = None,
) -> Estimate | None:
    """Returns the coefficients of the forces by least squares, their deviations by the jackknife (leaving out one part
    of the record after the other); None if there are too few rows, or a force that is zero in all of them.

    Args:
        positions: m, by sample.
        forces_of: returns the forces in N that may explain the second difference at a sample; None to pass it over.
        sensed: m/s², by sample: accelerations in place of the second differences.
    """
    rows = []
    for k in sorted(positions):
        forces = forces_of(k) if k - 1 in positions and k + 1 in positions else None
        if forces is not None:
            before, now, after = positions[k - 1], positions[k], positions[k + 1]
            # Across both sides: the rounding of a position enters this speed and the second difference independently.
            gained = after - 2 * now + before if sensed is None else sensed[k]
            rows.append((gained, before, 0.5 * (after - before), *forces))
    if len(rows) < 8 * _PARTS:
        return None
    table = np.array(rows)
    bend, drift, pushes = table[:, 0], table[:, 1:3] - table[:, 1:3].mean(axis=0), table[:, 3:]
    if not np.abs(pushes).max(axis=0).all():
        return None
    scale = np.abs(drift).max(axis=0)
    columns = np.column_stack([pushes, np.ones(len(rows)), drift / np.where(scale > 0, scale, 1.0)])

    def solve(left_out: NDArray[np.int64]) -> NDArray[np.float64]:
        kept, wanted = np.delete(columns, left_out, axis=0), np.delete(bend, left_out)
        return np.asarray(np.linalg.lstsq(kept, wanted, rcond=None)[0][: pushes.shape[1]], np.float64)

    parts = np.array([solve(part) for part in np.array_split(np.arange(len(rows)), _PARTS)])
    factor = np.sqrt(_PARTS - 1)
    nothing = np.empty(0, np.int64)
    return Estimate(solve(nothing), factor * parts.std(axis=0), float(factor * parts.sum(axis=1).std()), len(rows))
