"""The sixth step: a host that falls silent. The device counts samples, so the numbers tell whether it is in time."""

from __future__ import annotations

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing
from hapsim.bringup.probe.session import Session
from hapsim.bringup.probe.wire import SET_UP, Heard, told

STEP = "watchdog"
_WATCHDOG = 40  # samples
_TOO_LATE = 3  # samples after it
_NO_WATCHDOG = (
    "n - heard > watchdog, looked at in every tick: force zero, STATUS latched. Without it nobody stops the force of a "
    "host that died"
)


def probe_watchdog(probing: Probing) -> bool:
    """Always goes on."""
    watchdog = min(_WATCHDOG, probing.longest_watchdog)
    session = probing.arm_by_device(STEP, watchdog)
    if session is None:
        return True
    session.run(watchdog + _TOO_LATE + 1, None)
    if not _judge_latched(probing, session, watchdog, heard=-1):
        probing.wire.release()
        probing.findings.leave(STEP, "the device did not latch")
        return True
    _judge_ignored(probing, session)
    _judge_disarm(probing)
    _after_forces(probing, watchdog)
    return True


def _judge_latched(probing: Probing, session: Session, watchdog: int, heard: int) -> bool:
    """`heard`: the sample in which the last force came."""
    findings, ended = probing.findings, session.ended
    last = session.newest.n if session.newest else 0
    due = heard + watchdog + 1
    since = "arming" if heard < 0 else f"sample {heard}"
    if ended is None:
        found = f"no FORCE since {since}, watchdog {watchdog}: still armed at sample {last}, without a STATUS"
        findings.failed("latches", found, _NO_WATCHDOG)
        return False
    n = last + (ended.number - last + 2) % schema.SAMPLE_MODULUS - 2
    found = f"no FORCE since {since}, watchdog {watchdog}: latched at sample {n} ({due} or {due + 1} is allowed)"
    kept = due <= n <= due + 1
    findings.judge("latches", kept, found, "n - heard > watchdog; heard = -1 at arming")
    right = (ended.state, ended.fault) == (schema.LATCHED, schema.HOST_QUIET)
    look_at = "the STATUS of a device that latches goes out before it switches to the set-up format"
    findings.judge("latched_status", right and ended.wire == session.format, told(ended), look_at)
    return True


def _judge_ignored(probing: Probing, session: Session) -> None:
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
    probing.findings.judge("latched_ignores", kept, found, look_at)


def _judge_disarm(probing: Probing) -> None:
    wire = probing.wire
    answer, _ = wire.ask(wire.frame(schema.DISARM, 0), _is_status)
    kept = answer is not None and answer.wire == SET_UP
    kept = kept and answer is not None and (answer.state, answer.fault) == (schema.IDLE, schema.HOST_QUIET)
    probing.findings.judge("disarm_latched", kept, told(answer), "DISARM is obeyed in every state and clears no fault")


def _is_status(one: Heard) -> bool:
    return one.kind == schema.STATUS


def _after_forces(probing: Probing, watchdog: int) -> None:
    """Latches once more, after forces; then arms the latched device."""
    session = probing.arm(schema.PACED_BY_DEVICE, watchdog)
    if session is None:
        look_at = "ARM is taken by an idle device and by a latched one"
        probing.findings.failed("rearming", "ARM after the watchdog: not armed", look_at)
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
        probing.findings.failed("rearming", "ARM while latched: not armed", "ARM is taken by a latched device too")
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
    probing.findings.judge("rearming", kept, f"after arming while latched: {found}", look_at)


def _judge_cleared(probing: Probing, session: Session) -> None:
    session.run(2, None)
    status = session.status
    first = session.samples[0].n if session.samples else None
    kept = status is not None and (status.number, status.fault) == (0, schema.NO_FAULT) and first == 0
    found = f"{told(status)}; first position {first}"
    look_at = "ARM after a fault: cleared, number 0, POSITION 0"
    if not kept:
        probing.findings.failed("rearming", found, look_at)
