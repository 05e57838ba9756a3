"""Still with the user's leave: how long a force lives, and that the device cuts one that is too great."""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.checks import Leave, Probing
from hapsim.bringup.probe.pushing import STEP, Pusher, TravelledError
from hapsim.bringup.probe.response import Estimate, Row, estimate
from hapsim.bringup.probe.wire import Sample, Session
from hapsim.bringup.probe.wire import told as told_frame

_LIFE = 6  # samples that a force acts, with a time to live of one less
_SILENCE = 10  # samples more without a FORCE
_PUSHES = 24
_HOST_PUSHES = 6
_HOST_LIFE_S = 0.04  # long beside what this host is held up, as a rule
_HOST_WAIT = 3.0  # lives
_HOST_ON = 1.5  # lives: nearer to one than to all of the silence, of which friction takes its share
_TOO_GREAT = 1.2  # of the limit
_TRIES = 10  # until one such force was in time
_ON, _UNSURE = 0.35, 0.15  # of the response: acting; too uncertain to tell


def probe_lives(probing: Probing) -> bool:
    """Always goes on."""
    leave = probing.leave
    if leave is None or probing.response is None:
        return True
    watchdog = min(probing.longest_watchdog, 500)
    if watchdog < 4 * _SILENCE:
        probing.not_seen("time_to_live", f"a watchdog of {watchdog} samples is too short for it")
        return True
    session = probing.arm_by_device(STEP, watchdog)
    if session is None:
        return True
    pusher = Pusher(probing, session, leave)
    try:
        _push_and_be_silent(probing, pusher)
        _push_too_much(probing, pusher)
    except TravelledError:
        for name in ("time_to_live", "limit_cut"):
            probing.not_seen(name, f"it moved more than {1e3 * leave.travel:g} mm: stopped")
    finally:
        session.disarm()
    _judge_limited(probing, pusher)
    _by_the_host(probing, leave)
    return True


def _force(probing: Probing, leave: Leave) -> float:
    """N; such that a force that goes on for all of the silence stays well within the travel."""
    assert probing.response is not None
    lasts = probing.periods(_LIFE + _SILENCE)
    gentle = 0.3 * leave.travel / (abs(probing.response) * lasts**2)
    return min(leave.force, probing.device.force_limit[leave.channel], gentle)


def _push_and_be_silent(probing: Probing, pusher: Pusher) -> None:
    """A push, then nothing until it must have ended; the opposite push after it."""
    session = pusher.session
    if not pusher.settle(probing.samples_in(3.0, 100, 20000)) or session.newest is None:
        probing.not_seen("time_to_live", "the device does not come to rest")
        return
    pusher.begin_here()
    force = _force(probing, pusher.leave)
    begun = session.newest.n
    for i in range(_PUSHES):
        side = (1.0, -1.0, -1.0, 1.0)[i % 4]
        pusher.push(session.newest, side * force, _LIFE - 1)
        if not session.run(_LIFE + _SILENCE, None) or not session.run(4, lambda sample: pusher.push(sample, 0.0)):
            probing.not_seen("time_to_live", _why_stopped(session))
            return
    found = estimate(_lives(pusher, begun))
    _judge_life(probing, found)


def _lives(pusher: Pusher, begun: int) -> list[Row]:
    """Second differences, and of each push its first half, its second half, and what ought to be over."""
    by_number = {sample.n: sample for sample in pusher.session.samples if sample.n >= begun}
    rows = []
    for n, force in pusher.forces.items():
        following = by_number.get(n + 1)
        if n < begun or force == 0.0 or following is None or not following.fresh:
            continue
        acts = [_part_of(k - n - 1, force) for k in range(n, n + _LIFE + _SILENCE)]
        for k in range(n + 1, n + _LIFE + _SILENCE):
            around = [by_number.get(k + i) for i in (-1, 0, 1)]
            if all(around):
                x0, x1, x2 = (pusher.position(sample) for sample in around if sample is not None)
                now, before = acts[k - n], acts[k - n - 1]
                forces = tuple(0.5 * (a + b) for a, b in zip(now, before, strict=True))
                rows.append(Row(x2 - 2 * x1 + x0, forces, (x0, x1 - x0)))
    return rows


def _part_of(since: int, force: float) -> tuple[float, float, float]:
    """`since`: samples since the force began to act."""
    half = _LIFE // 2
    return (
        force if 0 <= since < half else 0.0,
        force if half <= since < _LIFE else 0.0,
        force if since >= _LIFE else 0.0,
    )


def _judge_life(probing: Probing, found: Estimate | None) -> None:
    if found is None:
        probing.not_seen("time_to_live", "too few of this host's forces were in time")
        return
    first = found.values[0]
    second, after = found.values[1:] / first
    unsure = float(np.max(found.deviations) / abs(first))
    told = (
        f"time to live {_LIFE - 1}: {second:z.2f} of the force in the last samples of its life, {after:z.2f} after it"
    )
    told += f" (± {unsure:.2f})"
    if unsure > _UNSURE:
        probing.not_seen("time_to_live", f"{told}: a greater --push shows more")
    elif after > _ON:
        look_at = "the tick: n > expires puts out zero, expires = answered + time_to_live"
        probing.failed("time_to_live", f"{told}: it goes on", look_at)
    elif second < 1 - _ON:
        told += ": it ends too early (an actuator that gives impulses does that, and may)"
        probing.failed("time_to_live", told, "the tick holds the force until n > expires")
    else:
        probing.passed("time_to_live", f"{told}; from {1 - _ON:g} up and up to {_ON:g} are allowed")


def _why_stopped(session: Session) -> str:
    return f"the device stopped: {told_frame(session.ended)}" if session.ended else "the positions ceased"


def _push_too_much(probing: Probing, pusher: Pusher) -> None:
    """Forces above the limit, where the leave is as great as they are: a device that does not cut puts out all of it.

    Again, until one of them was in time: one that was late says nothing.
    """
    leave = pusher.leave
    limit = probing.device.force_limit[leave.channel]
    if leave.force < (1 - 1e-5) * _TOO_GREAT * limit:  # which is what the sentence asks for
        probing.not_seen("limit_cut", f"this takes --push {_TOO_GREAT * limit:g}: {_TOO_GREAT:g} times the limit")
        return
    if _TOO_GREAT * limit > pusher.force_scale * (2**31 - 1):
        probing.not_seen("limit_cut", "32 bits of counts carry no force above the limit")
        return
    for _ in range(_TRIES):
        if not pusher.settle(probing.samples_in(3.0, 100, 20000)):
            break
        pusher.begin_here()
        _push_four(pusher, _TOO_GREAT * limit)
        if _too_great(pusher, limit)[1]:
            return


def _push_four(pusher: Pusher, force: float) -> None:
    sides = iter((1.0, -1.0, -1.0, 1.0))
    pusher.session.run(4, lambda sample: pusher.push(sample, next(sides, 0.0) * force))
    pusher.session.run(4, pusher.session.zero)


def _too_great(pusher: Pusher, limit: float) -> tuple[int, int]:
    """How many forces were above the limit, and how many of them were in time, as the position after each says."""
    fresh = {sample.n: sample.fresh for sample in pusher.session.samples}
    asked = [n for n, force in pusher.forces.items() if abs(force) > limit]
    return len(asked), sum(fresh.get(n + 1, False) for n in asked)


def _judge_limited(probing: Probing, pusher: Pusher) -> None:
    limit = probing.device.force_limit[pusher.leave.channel]
    asked, in_time = _too_great(pusher, limit)
    if not asked:
        why = "the device does not come to rest" if pusher.session.ended is None else _why_stopped(pusher.session)
        probing.not_seen("limit_cut", why)
        return
    limited = probing.wire.register(schema.REG_LIMITED)
    found = f"{asked} forces of {_TOO_GREAT * limit:g} N, {in_time} of them in time: register 12 counts {limited}"
    if not (in_time or limited):
        probing.not_seen("limit_cut", found)
        return
    kept = limited is not None and in_time <= limited <= asked
    look_at = "each channel of a FORCE that is acted on is cut to its limit before it becomes the command; limited++"
    probing.judge("limit_cut", kept, found, look_at)


def _by_the_host(probing: Probing, leave: Leave) -> None:
    """The host pushes, falls silent for several lives, and then asks for the position."""
    if not probing.device.paces(schema.PACED_BY_HOST):
        probing.not_seen("host_time_to_live", "the device does not declare that the host may pace")
        return
    life = probing.samples_in(_HOST_LIFE_S, 2, schema.MAX_TIME_TO_LIVE_SAMPLES + 1)
    if probing.longest_watchdog < 2 * _HOST_WAIT * life:
        probing.not_seen("host_time_to_live", "the longest watchdog is too short for it")
        return
    session = probing.arm(schema.PACED_BY_HOST, probing.longest_watchdog)
    if session is None:
        probing.not_seen("host_time_to_live", "the device did not arm paced by the host")
        return
    pusher = Pusher(probing, session, leave)
    try:
        session.run(0, None)
        lasted = _lasted(probing, pusher, life)
    except TravelledError:
        probing.not_seen("host_time_to_live", f"it moved more than {1e3 * leave.travel:g} mm: stopped")
        return
    finally:
        session.disarm()
    _judge_host_life(probing, lasted, probing.periods(life))


def _lasted(probing: Probing, pusher: Pusher, life: int) -> list[float]:
    """For how long each push acted, s: what speed it left, over what it makes in a second."""
    assert probing.response is not None
    session, soon = pusher.session, probing.periods(life)
    wait = _HOST_WAIT * soon
    force = min(pusher.leave.force, 0.3 * pusher.leave.travel / (abs(probing.response) * wait**2))
    if not _comes_to_rest(pusher, wait):
        return []
    pusher.begin_here()
    lasted = []
    for i in range(_HOST_PUSHES):
        signed = math.copysign(force, (1, -1, -1, 1)[i % 4])
        steps = ((0.0, soon), (signed, wait), (0.0, soon), (0.0, 0.0))
        if not all(_step(pusher, push, lasts, life - 1) for push, lasts in steps):
            return []
        # Each position is measured as its force begins to act.
        x = session.samples[-4:]
        before, after = _speed(pusher, x[0], x[1]), _speed(pusher, x[2], x[3])
        lasted.append((after - before) / (signed * probing.response))
    return lasted


def _comes_to_rest(pusher: Pusher, wait: float) -> bool:
    """As a simulated device may begin with a flick; within 3 s."""
    for _ in range(round(3.0 / wait) + 1):
        if not _step(pusher, 0.0, wait, 0):
            return False
        before, now = pusher.session.samples[-2:]
        if abs(pusher.position(now) - pusher.position(before)) < 0.02 * pusher.leave.travel and now.n > 1:
            return True
    return False


def _step(pusher: Pusher, force: float, wait_s: float, time_to_live: int) -> bool:
    """One sample paced by the host: it begins with the force, and the next step ends it, so long after. False where no
    position came."""
    session: Session = pusher.session
    before = len(session.samples)
    pusher.push(session.samples[-1], force, time_to_live)
    end = session.wire.clock.now() + session.patience_s
    while len(session.samples) == before and session.ended is None and session.wire.clock.now() < end:
        session.take(session.wire.hear(0.05))
    came = len(session.samples) == before + 1
    if came:
        session.take(session.wire.hear_for(wait_s))
    return came


def _speed(pusher: Pusher, one: Sample, other: Sample) -> float:
    return (pusher.position(other) - pusher.position(one)) / (other.at_s - one.at_s)


def _judge_host_life(probing: Probing, lasted: list[float], life_s: float) -> None:
    if not lasted:
        probing.not_seen("host_time_to_live", "the device did not come to rest, or no position for a FORCE")
        return
    middle = float(np.median(lasted))
    told = (
        f"time to live {1e3 * life_s:.3g} ms, silence of {_HOST_WAIT:g} times that: it acted for {1e3 * middle:.3g} ms "
        f"(up to {_HOST_ON:g} times its time to live is allowed, and shorter is safe)"
    )
    look_at = "paced by the host no tick ends a force: the main loop looks at the time since the last accepted FORCE"
    if middle < 0.3 * life_s:
        probing.not_seen("host_time_to_live", f"{told}: the device does not move as it did before")
    else:
        probing.judge("host_time_to_live", middle < _HOST_ON * life_s, told, look_at)
