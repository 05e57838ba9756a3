"""The last step, with the user's leave alone: short pushes to either side, and what the positions make of them.

Pushes are +F, -2F, +F: they leave neither speed nor displacement behind in a free mass. They begin one sample long, and
grow until the response stands out of the noise or the travel that was allowed is reached.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

from firmware_protocol import schema
from hapsim.bringup.probe.checks import Leave, Probing
from hapsim.bringup.probe.response import LAGS, Estimate, Row, estimate, rows_by_lag
from hapsim.bringup.probe.wire import Sample, Session
from hapsim.bringup.probe.wire import told as told_frame

STEP = "push"
_PATTERNS = 32  # at each length
_LONGEST_S = 3.0  # for those of one length
_SURE = 30.0  # standard deviations: then nothing longer is tried
_SEEN = 6.0  # standard deviations of a response that is one at all
_CLEAR = 0.03  # of the response: then its lags can be distinguished
_MASS_WITHIN = 0.25  # of the mass that was given: a hand is never the same
_SETTLE_S = 3.0
_TIME_TO_LIVE = 0  # samples: what comes too late is not acted on, and what was not renewed is zero


class TravelledError(Exception):
    """The device moved farther than the user allowed."""


class Pusher:
    """An armed device that is pushed on one channel, within the leave that was given."""

    def __init__(self, probing: Probing, session: Session, leave: Leave) -> None:
        device = probing.device
        self.session, self.leave = session, leave
        self.position_scale = device.position_scale[leave.channel]
        self.force_scale = device.force_scale[leave.channel]
        self.forces: dict[int, float] = {}
        """N, by the sample that they answer."""
        self._home: float | None = None

    def position(self, sample: Sample) -> float:
        """m."""
        return sample.counts[self.leave.channel] * self.position_scale

    def begin_here(self) -> None:
        """From here the travel is counted."""
        assert self.session.newest is not None
        self._home = self.position(self.session.newest)

    def push(self, sample: Sample, force: float, time_to_live: int = _TIME_TO_LIVE) -> None:
        """Answers a sample with a force in N. TravelledError, and no force, where the device has moved too far."""
        if self._home is not None and abs(self.position(sample) - self._home) > self.leave.travel:
            self.session.zero(sample)
            raise TravelledError
        force = min(max(force, -self.leave.force), self.leave.force)  # whoever asks
        counts = [0] * (self.leave.channel + 1)
        largest = 2**31 - 1  # of the wire's; rounded, the limit of some devices is one more
        counts[self.leave.channel] = min(max(math.trunc(force / self.force_scale), -largest), largest)
        self.forces[sample.n] = counts[self.leave.channel] * self.force_scale
        self.session.force(sample.n, counts, time_to_live if force else schema.MAX_TIME_TO_LIVE_SAMPLES)

    def settle(self, samples: int) -> bool:
        """Whether the device comes to rest by itself: 50 samples within a hundredth of the travel."""
        for _ in range(0, samples, 50):
            if not self.session.run(50, self.session.zero):
                return False
            recent = [self.position(sample) for sample in self.session.samples[-50:]]
            if max(recent) - min(recent) < max(0.01 * self.leave.travel, 2 * self.position_scale):
                return True
        return False

    def rows(self, first: int) -> list[Row]:
        """Of the samples from number `first` on."""
        samples = [sample for sample in self.session.samples if sample.n >= first]
        positions = {sample.n: self.position(sample) for sample in samples}
        return rows_by_lag(positions, self.forces, {sample.n: sample.fresh for sample in samples})


def what_will_be_done(probing: Probing, leave: Leave) -> str:
    """For the user, before anything is pushed."""
    device = probing.device
    force = min(leave.force, device.force_limit[leave.channel])
    return (
        f"Pushing channel {leave.channel} now: at most {force:g} N to either side in short pulses, some seconds long, "
        f"stopped where it moves more than {1e3 * leave.travel:g} mm. Let it move freely. Ctrl-C releases it."
    )


def probe_pushing(probing: Probing) -> bool:
    """Always goes on."""
    leave = probing.leave
    if leave is None:
        probing.leave_out(STEP, "no leave to push: --push N gives it, at most N newton to either side")
        return True
    session = probing.arm_by_device(STEP, min(probing.longest_watchdog, 500))
    if session is None:
        return True
    pusher = Pusher(probing, session, leave)
    try:
        if not pusher.settle(probing.samples_in(_SETTLE_S, 100, 20000)):
            why = "stopped" if session.ended else "it moves by itself"
            probing.leave_out(STEP, f"the device does not come to rest ({why}): hold it, or lay it down, and try again")
            return True
        _respond(probing, pusher)
    finally:
        session.disarm()
    return True


def _pattern(length: int, seed: int) -> Iterator[float]:
    """+, -, -, + and a rest, or the other way round, at random: 0 where nothing is pushed."""
    sides = random.Random(seed)
    for _ in range(_PATTERNS):
        side = sides.choice((1.0, -1.0))
        for sign in (side, -side, -side, side, 0.0, 0.0):
            yield from (sign,) * length
        yield from (0.0,) * sides.randrange(LAGS)


def _stages(probing: Probing, leave: Leave) -> Iterator[tuple[float, int]]:
    """Greater and greater pushes: a force in N, a length in samples."""
    force = min(leave.force, probing.device.force_limit[leave.channel])
    for share in (64, 16, 4):
        yield force / share, 1
    length = 1
    while length == 1 or 6 * length * _PATTERNS < probing.samples_in(_LONGEST_S, 200, 10000):
        yield force, length
        length *= 2


def _respond(probing: Probing, pusher: Pusher) -> None:
    """The greatest pushes tell; those that went too far tell nothing more."""
    best: Estimate | None = None
    told, went_too_far = "", False
    for force, length in _stages(probing, pusher.leave):
        if best is not None and best.significance > _SEEN and _reach(best, pusher, force, length) > 0.3:
            break
        if not pusher.settle(probing.samples_in(_SETTLE_S, 100, 20000)):
            break
        found, went_too_far = _pushed(pusher, force, length)
        if found is not None and (best is None or found.significance > best.significance):
            best, told = found, f"pushes of {force:.3g} N, {length} long"
        if went_too_far or (best is not None and _is_sure(best)):
            break
    if best is None or best.significance < _SEEN:
        _not_seen(probing, pusher, best, went_too_far)
        return
    _judge_sign(probing, best, told)
    _judge_delay(probing, best)
    _judge_mass(probing, best)
    probing.response = best.total * probing.device.rate_hz**2


def _is_sure(found: Estimate) -> bool:
    return found.significance > _SURE and float(max(found.deviations[:2])) < _CLEAR * abs(found.total)


def _not_seen(probing: Probing, pusher: Pusher, found: Estimate | None, went_too_far: bool) -> None:
    if went_too_far:
        why = f"it moved more than {1e3 * pusher.leave.travel:g} mm: stopped (--travel allows more, --push asks less)"
    elif pusher.session.ended is not None:
        why = f"the device stopped: {told_frame(pusher.session.ended)}"
    elif found is None:
        why = "too few of this host's forces were in time"
    else:
        why = "the positions show no response: try a greater --push, or let the device move freely"
    probing.leave_out(STEP, why)


def _reach(found: Estimate, pusher: Pusher, force: float, length: int) -> float:
    """How far such a push would go, as a share of the travel that is allowed."""
    return abs(found.total) * force * length**2 / pusher.leave.travel


def _pushed(pusher: Pusher, force: float, length: int) -> tuple[Estimate | None, bool]:
    """What such pushes show, and whether they went too far."""
    session = pusher.session
    assert session.newest is not None
    pusher.begin_here()
    begun = session.newest.n + 1
    signs = [0.0] * LAGS + list(_pattern(length, length)) + [0.0] * LAGS

    def answer(sample: Sample) -> None:
        """By the sample's number: where the host misses one, the pattern goes on as it would have."""
        pusher.push(sample, force * signs[min(max(sample.n - begun, 0), len(signs) - 1)])

    try:
        session.run(len(signs), answer)
    except TravelledError:
        return estimate(pusher.rows(begun)), True
    return estimate(pusher.rows(begun)), False


def _judge_sign(probing: Probing, found: Estimate, pushes: str) -> None:
    acceleration = found.total * probing.device.rate_hz**2
    unsure = 100 / found.significance
    told = f"1 N makes {acceleration:.4g} m/s² (± {unsure:.2g} %), from {found.rows} samples, {pushes}"
    if found.total < 0:
        told = f"inverted: {told}"
    look_at = (
        "the motor and the encoder: swap the motor's two wires, or reverse the encoder if the position falls when the "
        "hand moves the positive way; not both"
    )
    probing.judge("sign", found.total > 0, told, look_at)


def _judge_delay(probing: Probing, found: Estimate) -> None:
    shares, deviations = found.values / found.total, found.deviations / abs(found.total)
    told = "of the response, " + ", ".join(f"{share:z.2f} at {lag}" for lag, share in enumerate(shares)) + " samples"
    early = shares[0] > max(0.05, 5 * deviations[0])
    late = shares[1] < 0.1 and shares[1] + 5 * deviations[1] < 0.3
    if max(deviations[:2]) > 0.1:
        probing.not_seen("delay", f"{told}, but ± {max(deviations[:2]):.2f}: a greater --push shows more")
    elif early:
        look_at = (
            "FORCE is put out on arrival: keep it, and put it out at the next tick, before the position is measured"
        )
        probing.failed("delay", f"{told}: it begins within the sample that the force came in", look_at)
    elif late:
        look_at = (
            "the tick puts the force out before it measures, with no buffer between; a driver or a filter that is "
            "late belongs into the scene's `delay`"
        )
        probing.failed("delay", f"{told}: it begins a sample late", look_at)
    else:
        probing.passed("delay", told)


def _judge_mass(probing: Probing, found: Estimate) -> None:
    leave = probing.leave
    assert leave is not None
    mass = 1.0 / abs(found.total * probing.device.rate_hz**2)
    told = f"it responds like {mass:.4g} kg"
    if leave.mass is None:
        probing.not_seen("mass", f"{told}; --mass KG says what it ought to be")
        return
    factor = leave.mass / mass
    told += f": {factor:.3g} times the response of {leave.mass:g} kg"
    look_at = (
        "position_scale (an encoder's edges counted once, twice or four times; radius or diameter; mm), force_scale "
        "(torque constant, gear), or the mass that was given"
    )
    unsure = 3 / found.significance
    if unsure > _MASS_WITHIN:
        probing.not_seen("mass", f"{told}, but ± {100 * unsure:.0f} %: a greater --push shows more")
        return
    told += f" (within {100 * _MASS_WITHIN:g} %, and its uncertainty, is allowed)"
    kept = abs(math.log(factor)) < math.log1p(_MASS_WITHIN) + unsure
    if not kept:
        told += (
            f", as if positions were {factor:.3g} times too large, or forces {factor:.3g} times stronger than they say"
        )
    probing.judge("mass", kept, told, look_at)
