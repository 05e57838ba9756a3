"""The sixth to eighth step: a host that falls silent, one that does not read, and one that paces the device.

A device counts samples, so the numbers tell whether its watchdog is in time. A transmitter that finds no room must not
stop the tick: the numbers of a device that went on jump, those of one that waited do not. How much the system takes
before a device finds no room is not known, so this writes more than a pseudo-terminal or a USB driver keeps.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.checks import Probing
from hapsim.bringup.probe.wire import LONG_LIFE, SET_UP, Heard, Sample, Session, told

_WATCHDOG = 40  # samples
_TOO_LATE = 3  # samples after it
_NO_WATCHDOG = (
    "n - heard > watchdog, looked at in every tick: force zero, STATUS latched. Without it nobody stops the force of a "
    "host that died"
)


def probe_watchdog(probing: Probing) -> bool:
    """Always goes on."""
    watchdog = min(_WATCHDOG, probing.longest_watchdog)
    session = probing.arm_by_device("watchdog", watchdog)
    if session is None:
        return True
    session.run(watchdog + _TOO_LATE + 1, None)
    if not _judge_latched(probing, session, watchdog, heard=-1):
        probing.wire.release()
        probing.leave_out("watchdog", "the device did not latch")
        return True
    _judge_latched_ignores(probing, session)
    _judge_disarm_latched(probing)
    _after_forces(probing, watchdog)
    return True


def _judge_latched(probing: Probing, session: Session, watchdog: int, heard: int) -> bool:
    """`heard`: the sample in which the last force came."""
    ended = session.ended
    last = session.newest.n if session.newest else 0
    due = heard + watchdog + 1
    since = "arming" if heard < 0 else f"sample {heard}"
    if ended is None:
        found = f"no FORCE since {since}, watchdog {watchdog}: still armed at sample {last}, without a STATUS"
        probing.failed("latches", found, _NO_WATCHDOG)
        return False
    n = last + (ended.number - last + 2) % schema.SAMPLE_MODULUS - 2
    found = f"no FORCE since {since}, watchdog {watchdog}: latched at sample {n} ({due} or {due + 1} is allowed)"
    kept = due <= n <= due + 1
    probing.judge("latches", kept, found, "n - heard > watchdog; heard = -1 at arming")
    right = (ended.state, ended.fault) == (schema.LATCHED, schema.HOST_QUIET)
    look_at = "the STATUS of a device that latches goes out before it switches to the set-up format"
    probing.judge("latched_status", right and ended.wire == session.format, told(ended), look_at)
    return True


def _judge_latched_ignores(probing: Probing, session: Session) -> None:
    wire = probing.wire
    newest = session.newest
    n = newest.n if newest is not None else 0
    before = wire.received
    wire.hear_for(max(0.05, probing.periods(5)))
    spoke = wire.received - before
    before_force = wire.register(schema.REG_ACCEPTED)
    for armed in (True, False):
        wire.send(wire.frame(schema.FORCE, n, schema.MAX_TIME_TO_LIVE_SAMPLES, armed=armed))
    answer, heard = wire.ask(wire.frame(schema.DESCRIBE, schema.REG_FAULT), lambda one: one.kind == schema.DESCRIPTION)
    others = [one for one in heard if one.kind != schema.DESCRIPTION]
    accepted = wire.register(schema.REG_ACCEPTED)
    kept = answer is not None and answer.wire == SET_UP and answer.word == schema.HOST_QUIET
    kept = kept and not others and spoke == 0 and accepted == before_force
    if spoke:
        found = f"{spoke} bytes after STATUS latched"
    elif others:
        found = f"FORCE while latched: {told(others[0])}"
    elif answer is None:
        found = "no answer to DESCRIBE in the set-up format"
    else:
        found = (
            f"register 7 reads {answer.word}, register 8 read {before_force} before two FORCE and {accepted} after them"
        )
    look_at = "latched: nothing but ARM arms it again, and the set-up format is spoken and listened to"
    probing.judge("latched_ignores", kept, found, look_at)


def _judge_disarm_latched(probing: Probing) -> None:
    wire = probing.wire
    answer, _ = wire.ask(wire.frame(schema.DISARM, 0), _is_status)
    kept = answer is not None and answer.wire == SET_UP
    kept = kept and answer is not None and (answer.state, answer.fault) == (schema.IDLE, schema.HOST_QUIET)
    probing.judge("disarm_latched", kept, told(answer), "DISARM is obeyed in every state and clears no fault")


def _is_status(one: Heard) -> bool:
    return one.kind == schema.STATUS


def _after_forces(probing: Probing, watchdog: int) -> None:
    """Latches once more, after forces; then arms the latched device."""
    session = probing.arm(schema.PACED_BY_DEVICE, watchdog)
    if session is None:
        look_at = "ARM is taken by an idle device and by a latched one"
        probing.failed("rearming", "ARM after the watchdog: not armed", look_at)
        return
    _judge_cleared(probing, session)
    session.run(20, session.zero)
    last = max(session.answered, default=-1)
    session.run(watchdog + _TOO_LATE + 20, None)
    # When the last force was in time, it is known in which sample it came.
    if last >= 0 and session.ended is not None and any(s.n == last + 1 and s.fresh for s in session.samples):
        _judge_latched(probing, session, watchdog, heard=last)
    elif session.ended is None:
        _judge_latched(probing, session, watchdog, heard=last)
        probing.wire.release()
        return
    again = probing.arm(schema.PACED_BY_DEVICE, watchdog)
    if again is None:
        probing.failed("rearming", "ARM while latched: not armed", "ARM is taken by a latched device too")
        return
    _judge_cleared(probing, again)
    answer = again.disarm()
    counters = [probing.wire.register(number) for number in range(schema.REG_FAULT, schema.REG_LIMITED + 1)]
    said = sum(not sample.fresh for sample in again.samples)
    names = ("fault", "accepted", "rejected", "held", "expired", "limited")
    found = ", ".join(f"{name} {count}" for name, count in zip(names, counters, strict=True))
    expected = [0, 0, counters[2], said, 0, 0]
    kept = answer is not None and counters == expected and counters[2] is not None and counters[2] <= 2
    look_at = "ARM sets fault and registers 8 to 12 to zero, and counts samples from 0"
    probing.judge("rearming", kept, f"after arming while latched: {found}", look_at)


def _judge_cleared(probing: Probing, session: Session) -> None:
    session.run(2, None)
    status = session.status
    first = session.samples[0].n if session.samples else None
    kept = status is not None and (status.number, status.fault) == (0, schema.NO_FAULT) and first == 0
    found = f"{told(status)}; first position {first}"
    look_at = "ARM after a fault: cleared, number 0, POSITION 0"
    if not kept:
        probing.failed("rearming", found, look_at)


_FILL_BYTES = 40_000  # a pseudo-terminal takes 20 480; a USB port stops at its driver's buffers, some 4 kB
_LONGEST_S = 8.0
_BEFORE = 100  # samples, by which the rate is known that the device keeps now: a simulated one may be held up
_WENT_ON = 0.7  # of the samples that went by, by the host's clock and that rate
_GUESSES = 6  # of the number, each a life behind the one before: a device may be slower than it was
_STEADY = 0.15  # of the rate: else the device, or this host, is held up by something else
_UNREAD = 1.5  # of the watchdog
_NEVER_WAIT = "a frame that finds no room is dropped, whole; nothing in the tick waits for the transmitter"


def probe_blocked(probing: Probing) -> bool:
    """Always goes on."""
    device = probing.device
    velocity = device.senses_velocity  # longer frames: filled sooner
    each = schema.frame_bytes(device.channels, to_device=False, velocity=velocity)
    samples = _FILL_BYTES // each
    if probing.periods(samples) > _LONGEST_S:
        lasts = probing.periods(samples)
        why = f"{samples} frames of {each} B at {device.rate_hz:g} Hz take {lasts:.3g} s: too long to fill what buffers"
        probing.leave_out("blocked", why)
        return True
    session = probing.arm_by_device("blocked", probing.longest_watchdog, velocity=velocity)
    if session is None:
        return True
    if not session.run(_BEFORE, session.zero) or not _tick_goes_on(probing, session, samples):
        probing.wire.release()
        probing.leave_out("blocked", "the device had stopped before, or did not come back")
        return True
    session.disarm()
    kept = _rate_before(session, session.samples[_BEFORE], device.rate_hz)
    _watchdog_while_blocked(probing, samples, kept, velocity=velocity)
    return True


def _tick_goes_on(probing: Probing, session: Session, samples: int) -> bool:
    """Writes zero forces without reading, guessing the numbers; then reads again."""
    wire, first = probing.wire, session.newest
    assert first is not None
    rate = _rate_before(session, first, probing.device.rate_hz)
    damaged, end = len(wire.damaged), wire.clock.now() + probing.periods(samples)
    while (now := wire.clock.now()) < end:
        guessed = first.n + round((now - first.at_s) * rate)
        for behind in range(_GUESSES):  # one of which lies within a life of where the device is
            session.force(max(guessed - LONG_LIFE // 3 - behind * LONG_LIFE, 0))
        wire.clock.sleep(min(probing.periods(50), 0.1))
    before = len(session.samples)
    _catch_up(session)
    if session.newest is None or len(session.samples) == before:
        probing.failed("tick_goes_on", f"after {samples} samples unread: nothing more came", _NEVER_WAIT)
        return False
    began = session.newest
    went_on = session.run(_BEFORE, session.zero)
    after = (session.newest.n - began.n) / max(session.newest.at_s - began.at_s, 1e-9)
    probing.steady = all(abs(kept / probing.device.rate_hz - 1.0) < _STEADY for kept in (rate, after))
    elapsed = (session.newest.at_s - first.at_s) * rate
    passed = session.newest.n - first.n
    numbers = [sample.n for sample in session.samples]
    lost = passed + 1 - sum(n >= first.n for n in numbers)
    found = f"{passed} samples in {elapsed:.0f} periods of the host's clock, {lost} dropped"
    if passed < _WENT_ON * elapsed and not probing.steady:
        why = f"{found}: but it kept {rate:.0f} Hz before and {after:.0f} Hz after, too unsteady to tell"
        probing.not_seen("tick_goes_on", why)
    elif passed < _WENT_ON * elapsed:
        stopped = f"{found}: the samples stopped while the host did not read"
        probing.failed("tick_goes_on", stopped, _NEVER_WAIT)
    elif not went_on and not probing.steady:
        why = f"{found}; then it stopped, but its rate was too unsteady to guess its numbers"
        probing.not_seen("tick_goes_on", why)
    elif not went_on:
        probing.failed("tick_goes_on", f"{found}; then no more positions", _NEVER_WAIT)
    elif lost:
        probing.passed("tick_goes_on", found)
    else:
        why = f"{found}: the system had room for all, the device was never short of it"
        probing.not_seen("tick_goes_on", why)
    _judge_whole(probing, len(wire.damaged) - damaged, lost)
    return went_on


def _rate_before(session: Session, newest: Sample, nominal: float) -> float:
    """Hz; not more than the nominal one."""
    oldest = session.samples[0]
    lasted = newest.at_s - oldest.at_s
    return min(nominal, (newest.n - oldest.n) / lasted) if lasted > 0 else nominal


def _catch_up(session: Session) -> None:
    """Takes what waits, and answers the newest position once there is nothing more."""
    while new := session.wire.hear(0.0):
        session.take(new)
    if session.newest is not None and session.ended is None:
        session.zero(session.newest)


def _judge_whole(probing: Probing, damaged: int, lost: int) -> None:
    if damaged:
        found = f"{damaged} pieces that are no frame, where {lost} frames were dropped"
        look_at = (
            "ask for room for a whole frame before its first byte is written; a frame that was begun is ended. (A "
            "driver that lost bytes by itself looks the same: does it happen without a pause too?)"
        )
        probing.failed("whole_frames", found, look_at)
    elif lost:
        probing.passed("whole_frames", f"{lost} frames dropped, no piece of one came")
    else:
        probing.not_seen("whole_frames", "nothing was dropped")


def _watchdog_while_blocked(probing: Probing, samples: int, kept_hz: float, *, velocity: bool) -> None:
    wire = probing.wire
    watchdog = min(round(0.9 * samples), probing.longest_watchdog)
    each = schema.frame_bytes(probing.device.channels, to_device=False, velocity=velocity)
    session = probing.arm(schema.PACED_BY_DEVICE, watchdog, velocity=velocity)
    if session is None:
        probing.not_seen("watchdog_blocked", "the device did not arm again")
        return
    wire.clock.sleep(_UNREAD * watchdog / kept_hz)
    while new := wire.hear(0.0):
        session.take(new)
    newest = session.newest.n if session.newest else 0
    # The STATUS may have found no room: a latched device answers in the set-up format.
    fault = wire.register(schema.REG_FAULT) if session.ended is None else session.ended.fault
    held = wire.register(schema.REG_HELD)
    wire.release()
    found = f"watchdog {watchdog}, {_UNREAD * watchdog:.0f} periods unread"
    look_at = f"the watchdog is counted in the tick. {_NEVER_WAIT[0].upper()}{_NEVER_WAIT[1:]}"
    if fault != schema.HOST_QUIET and not probing.steady:
        probing.not_seen("watchdog_blocked", f"{found}: not latched yet, but the rate is too unsteady to tell")
    elif fault != schema.HOST_QUIET:
        probing.failed("watchdog_blocked", f"{found}: not latched when the host read again", look_at)
    elif newest >= watchdog:
        probing.not_seen("watchdog_blocked", f"{found}: latched, but {watchdog} frames of {each} B found room")
    else:
        probing.passed(
            "watchdog_blocked",
            f"{found}: latched after {held} samples, of which the last {watchdog - newest} found no room",
        )


_ROUNDS = 100
_HOST_WATCHDOG_S = 0.06  # longer than this host is held up, as a rule
_EARLY = 0.9  # of the watchdog: what a clock may be off by, and then some


def probe_host_paced(probing: Probing) -> bool:
    """Always goes on."""
    if not probing.device.paces(schema.PACED_BY_HOST):
        probing.leave_out("host", "the device does not declare that the host may pace (bit 1 of register 3)")
        return True
    session = probing.arm(schema.PACED_BY_HOST, probing.longest_watchdog)
    if session is None:
        probing.failed("each_force", "ARM with pacing 1 is refused", "register 3 declares it (bit 1)")
        return True
    session.run(0, None)
    if _no_own_tick(probing, session):
        _exchange(probing, session)
    session.disarm()
    _judge_host_watchdog(probing)
    return True


def _no_own_tick(probing: Probing, session: Session) -> bool:
    session.take(
        probing.wire.hear_for(min(max(0.02, probing.periods(5)), 0.5 * probing.periods(probing.longest_watchdog)))
    )
    numbers = [sample.n for sample in session.samples]
    found = f"positions {', '.join(map(str, numbers[:5]))} before the first FORCE" if numbers else "no position 0"
    look_at = "paced by the host the sample timer makes no tick; POSITION 0 comes at arming"
    return probing.judge("no_own_tick", numbers == [0], found, look_at)


def _next(session: Session, n: int) -> float | None:
    """Answers sample n and waits for the next position: how long it took, None where it did not come."""
    before = len(session.samples)
    session.force(n)
    clock = session.wire.clock
    begun = clock.now()
    while len(session.samples) == before and session.ended is None and clock.now() - begun < session.patience_s:
        session.take(session.wire.hear(0.05))
    return session.samples[-1].at_s - begun if len(session.samples) == before + 1 else None


def _exchange(probing: Probing, session: Session) -> None:
    took = []
    look_at = "paced by the host, FORCE that is accepted ends the sample: output, n++, measure, send"
    for n in range(_ROUNDS):
        lasted = _next(session, n)
        newest = session.samples[-1]
        if lasted is None or newest.n != n + 1 or not newest.fresh:
            kind = "POSITION" if newest.fresh else "POSITION_HELD"
            last = f"the newest position is {kind} {newest.n}" if session.ended is None else told(session.ended)
            probing.failed("each_force", f"after FORCE {n}: {last}", look_at)
            return
        took.append(lasted)
    probing.passed("each_force", f"{_ROUNDS} forces, {_ROUNDS} positions, none held")
    period = f"a period is {probing.periods(1e3):.3g} ms"
    low, middle, high = 1e3 * np.quantile(took, (0.0, 0.5, 0.99))
    probing.passed(
        "round_trip",
        f"{low:.3g} ms at best, half below {middle:.3g} ms, 99 % below {high:.3g} ms; {period}",
    )
    again = _next(session, _ROUNDS - 1)
    newest = session.samples[-1]
    kept = again is not None and newest.n == _ROUNDS + 1 and not newest.fresh
    found = f"FORCE {_ROUNDS - 1} twice: {'POSITION' if newest.fresh else 'POSITION_HELD'} {newest.n}"
    probing.judge("same_force_again", kept, found, "fresh = heard == n && answered == n: a repeated force has age 1")


def _judge_host_watchdog(probing: Probing) -> None:
    watchdog = probing.samples_in(_HOST_WATCHDOG_S, 2, probing.longest_watchdog)
    nominal = probing.periods(watchdog)
    begun = probing.wire.clock.now()  # before the device is armed: it cannot be in time and seem early
    session = probing.arm(schema.PACED_BY_HOST, watchdog)
    if session is None:
        probing.failed("host_watchdog", "the device did not arm again", "ARM after DISARM")
        return
    while session.ended is None and probing.wire.clock.now() - begun < 5 * nominal + 1.0:
        session.take(probing.wire.hear(0.05))
    ended = session.ended
    look_at = "paced by the host no tick comes: the main loop looks at the time since the last accepted FORCE"
    if ended is None:
        found = f"watchdog {watchdog} ({nominal:.3g} s): no STATUS within {5 * nominal + 1.0:.3g} s"
        probing.failed("host_watchdog", found, look_at)
        probing.wire.release()
        return
    after = ended.at_s - begun
    right = (ended.state, ended.fault) == (schema.LATCHED, schema.HOST_QUIET)
    found = (
        f"watchdog {watchdog} ({1e3 * nominal:.3g} ms): {told(ended)}, after {1e3 * after:.3g} ms of the host's clock "
        f"({1e3 * _EARLY * nominal:.3g} ms or more is allowed: this host may read it late)"
    )
    probing.judge("host_watchdog", right and after > _EARLY * nominal, found, look_at)
