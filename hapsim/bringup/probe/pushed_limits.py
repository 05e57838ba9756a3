"""Still with the user's permission: how long a force lives, and that the device clips one that is too great."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Leave, Probing
from hapsim.bringup.probe.pushing import STEP, Estimate, Pusher, TravelledError, estimate

_LIFE = 6  # samples that a force acts, with a time to live of one less
_SILENCE = 10  # samples more without a FORCE
_PUSHES = 24
_SIDES = (1.0, -1.0, -1.0, 1.0)
_HOST_PUSHES = 12
_HOST_LIFE_S = 0.04  # long beside what this host is held up, as a rule
_HOST_WAIT = 3.0  # lives
_HOST_ON = 1.5  # lives: nearer to one than to all of the silence
_MOVED = 0.1  # of a life: below that, friction or a hand hides when a force ended
_TOO_GREAT = 1.2  # of the limit
_TRIES = 10  # until one such force was in time
_ON, _UNSURE = 0.35, 0.15  # of the response: acting; too uncertain to tell


def probe_lives(probing: Probing) -> None:
    """Always goes on."""
    leave, response = probing.leave, probing.response
    if leave is None or response is None:
        return
    watchdog = min(probing.device.max_watchdog_samples, 500)
    if watchdog < 4 * _SILENCE:
        probing.not_seen("time_to_live", f"a watchdog of {watchdog} samples is too short for it")
        return
    session = probing.arm_by_device(STEP, watchdog)
    if session is None:
        return
    pusher = Pusher(probing, session, leave)
    # A force that goes on for all of the silence stays well within the travel.
    gentle = 0.3 * leave.travel / (abs(response) * probing.periods(_LIFE + _SILENCE) ** 2)
    try:
        _push_and_be_silent(probing, pusher, min(leave.force, pusher.limit, gentle))
        _push_too_much(probing, pusher)
    except TravelledError as error:
        probing.not_seen(("time_to_live", "limit_cut"), str(error))
    finally:
        session.disarm()
    _judge_limited(probing, pusher)
    _by_the_host(probing, leave, response)


def _push_and_be_silent(probing: Probing, pusher: Pusher, force: float) -> None:
    """A push, then nothing until it must have ended; the opposite push after it."""
    session = pusher.session
    if not pusher.settle():
        probing.not_seen("time_to_live", pusher.why_stopped())
        return
    pusher.begin_here()
    begun = session.samples[-1].n
    for i in range(_PUSHES):
        pusher.push(session.samples[-1], _SIDES[i % 4] * force, _LIFE - 1)
        if not session.run(_LIFE + _SILENCE, None) or not session.run(4, lambda sample: pusher.push(sample, 0.0)):
            probing.not_seen("time_to_live", pusher.why_stopped())
            return
    _judge_life(probing, _response_by_age(pusher, begun))


def _response_by_age(pusher: Pusher, begun: int) -> Estimate | None:
    """Returns the response to the first half of each push, to its second half, and to what ought to be over."""
    samples = pusher.samples_from(begun)
    ages = (range(_LIFE // 2), range(_LIFE // 2, _LIFE), range(_LIFE, _LIFE + _SILENCE))
    acting: dict[int, Sequence[float]] = {}
    for n, force in pusher.forces.items():
        if force and n + 1 in samples and samples[n + 1].fresh:
            acting |= {n + 1 + age: [force * (age in part) for part in ages] for age in range(-1, ages[-1].stop - 1)}

    def by_age(k: int) -> list[float] | None:
        if k not in acting or k - 1 not in acting:
            return None
        return [0.5 * (now + before) for now, before in zip(acting[k], acting[k - 1], strict=True)]

    return estimate({n: pusher.position(sample) for n, sample in samples.items()}, by_age)


def _judge_life(probing: Probing, found: Estimate | None) -> None:
    if found is None:
        probing.not_seen("time_to_live", "too few of this host's forces were in time")
        return
    first, deviation = float(found.values[0]), float(np.max(found.deviations))
    if abs(first) <= deviation:
        probing.not_seen("time_to_live", "these pushes hardly moved it: a greater --push shows more")
        return
    second, after = found.values[1:] / first
    unsure = deviation / abs(first)
    shares = f"{second:z.2f} of the force in the last samples of its life, {after:z.2f} after it (± {unsure:.2f})"
    words = f"time to live {_LIFE - 1}: {shares}"
    if unsure > _UNSURE:
        probing.not_seen("time_to_live", f"{words}: a greater --push shows more")
        return
    kept = after <= _ON and second >= 1 - _ON
    allowed = f"; from {1 - _ON:g} up and up to {_ON:g} are allowed"
    early = ": it ends too early (an actuator that gives impulses does that, and may)"
    probing.judge("time_to_live", kept, words + (allowed if kept else ": it goes on" if after > _ON else early))


def _push_too_much(probing: Probing, pusher: Pusher) -> None:
    """Sends forces above the limit, if that much is allowed: a device that does not clip puts out all of it. Repeats
    that until one of them was in time: one that was late says nothing."""
    force = _TOO_GREAT * pusher.limit
    if pusher.leave.force < (1 - 1e-5) * force:  # which is what the sentence asks for
        probing.not_seen("limit_cut", f"this takes --push {force:g}: {_TOO_GREAT:g} times the limit")
        return
    if force > pusher.force_scale * (2**31 - 1):
        probing.not_seen("limit_cut", "32 bits of counts carry no force above the limit")
        return
    for _ in range(_TRIES):
        if not pusher.settle():
            break
        pusher.begin_here()
        sides = iter(_SIDES)
        pusher.session.run(4, lambda sample: pusher.push(sample, next(sides, 0.0) * force))  # noqa: B023
        pusher.session.run(4, pusher.session.zero)
        if _too_great(pusher)[1]:
            return


def _too_great(pusher: Pusher) -> tuple[int, int]:
    """Returns how many forces were above the limit, and how many of these acted in time, by the next position."""
    fresh = {sample.n: sample.fresh for sample in pusher.session.samples}
    asked = [n for n, force in pusher.forces.items() if abs(force) > pusher.limit]
    return len(asked), sum(fresh.get(n + 1, False) for n in asked)


def _judge_limited(probing: Probing, pusher: Pusher) -> None:
    asked, in_time = _too_great(pusher)
    if not asked:
        probing.not_seen("limit_cut", pusher.why_stopped())
        return
    limited = probing.wire.register(schema.REG_LIMITED)
    force = _TOO_GREAT * pusher.limit
    found = (
        f"{asked} forces of {pusher.units(force, 'N', 'g')}, {in_time} of them in time: register 12 counts {limited}"
    )
    if in_time or limited:
        probing.judge("limit_cut", limited is not None and in_time <= limited <= asked, found)
    else:
        probing.not_seen("limit_cut", found)


def _by_the_host(probing: Probing, leave: Leave, response: float) -> None:
    """The host pushes, falls silent for several lives, and then asks for the position."""
    life = probing.samples_in(_HOST_LIFE_S, 2, schema.MAX_TIME_TO_LIVE_SAMPLES + 1)
    session, why = None, "the device does not declare that the host may pace"
    if probing.device.paces(schema.PACED_BY_HOST):
        why = "the longest watchdog is too short for it"
        if probing.device.max_watchdog_samples >= 2 * _HOST_WAIT * life:
            why = "the device did not arm paced by the host"
            session = probing.arm(schema.PACED_BY_HOST, probing.device.max_watchdog_samples)
    if session is None:
        probing.not_seen("host_time_to_live", why)
        return
    life_s = probing.periods(life)
    try:
        session.run(0, None)
        lasted = _lasted(Pusher(probing, session, leave), response, life, life_s)
    except TravelledError as error:
        probing.not_seen("host_time_to_live", str(error))
        return
    finally:
        session.disarm()
    _judge_host_life(probing, lasted, life_s)


def _lasted(pusher: Pusher, response: float, life: int, life_s: float) -> tuple[float, float] | None:
    """Returns how long a push acted, in s, by the speed that is left of it over what it makes in a second: one that the
    host ended after one life, and one left to end by itself. Friction takes the same share of both. None if the device
    does not come to rest, or did not answer."""
    wait_s = _HOST_WAIT * life_s
    force = min(pusher.leave.force, 0.3 * pusher.leave.travel / (abs(response) * wait_s**2))
    if not _comes_to_rest(pusher, wait_s):
        return None
    pusher.begin_here()
    causes, speeds = [], []
    for i in range(_HOST_PUSHES):
        signed, is_left = math.copysign(force, _SIDES[i % 4]), i % 4 >= 2
        push = ((signed, wait_s),) if is_left else ((signed, life_s), (0.0, wait_s - life_s))
        steps = ((0.0, life_s), *push, (0.0, life_s), (0.0, 0.0))
        if not all(_step(pusher, step_force, lasts_s, life - 1) for step_force, lasts_s in steps):
            return None
        # Each position is measured as its force begins to act.
        samples = pusher.session.samples[-len(steps) :]
        x, t = [pusher.position(sample) for sample in samples], [sample.at_s for sample in samples]
        made = signed * response
        # Of the speed before, friction leaves a share: the same of every push.
        causes.append([(x[1] - x[0]) / (t[1] - t[0]), 0.0 if is_left else made, made if is_left else 0.0])
        speeds.append((x[-1] - x[-2]) / (t[-1] - t[-2]))
    _, ended_s, left_s = np.linalg.lstsq(np.array(causes), np.array(speeds), rcond=None)[0]
    return float(ended_s), float(left_s)


def _comes_to_rest(pusher: Pusher, wait_s: float) -> bool:
    """Returns whether it rests within 3 s: a simulated device may begin with a flick."""
    for _ in range(round(3.0 / wait_s) + 1):
        if not _step(pusher, 0.0, wait_s, 0):
            return False
        before, now = pusher.session.samples[-2:]
        if abs(pusher.position(now) - pusher.position(before)) < 0.02 * pusher.leave.travel and now.n > 1:
            return True
    return False


def _step(pusher: Pusher, force: float, wait_s: float, time_to_live: int) -> bool:
    """Makes one sample paced by the host, from the force to the next step. Returns whether a position came."""
    session, count = pusher.session, len(pusher.session.samples)
    pusher.push(session.samples[-1], force, time_to_live)
    session.next_positions()
    came = len(session.samples) == count + 1
    if came:
        session.take(session.wire.receive_for(wait_s))
    return came


def _judge_host_life(probing: Probing, lasted: tuple[float, float] | None, life_s: float) -> None:
    if lasted is None:
        probing.not_seen("host_time_to_live", "the device did not come to rest, or no position for a FORCE")
        return
    ended_s, left_s = lasted
    if ended_s < _MOVED * life_s:
        words = f"a push that ended after {1e3 * life_s:.3g} ms left the speed of one of {1e3 * ended_s:.3g} ms"
        probing.not_seen("host_time_to_live", f"{words}: the device does not move as it did before")
        return
    words = (
        f"time to live {1e3 * life_s:.3g} ms, silence of {_HOST_WAIT:g} times that: it acted {left_s / ended_s:.3g} "
        f"times as long as a push that was ended then (up to {_HOST_ON:g} times is allowed, and shorter is safe)"
    )
    probing.judge("host_time_to_live", left_s < _HOST_ON * ended_s, words)
