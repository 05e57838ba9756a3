"""The fifth step: how forces are taken, all of them zero: in time, withheld, too old, damaged; and the counters.

What is judged is what the numbers prove: a sample that was not answered before its end was read cannot have had its
answer. A host that is late proves nothing against a device.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing
from hapsim.bringup.probe.session import Sample, Session
from hapsim.bringup.probe.wire import told

STEP = "forces"
_ANSWERED, _WITHHELD = 200, 20  # samples
_OLD, _FUTURE, _DAMAGED = 5, 3, 4  # frames
_LEFT_IN_TIME = 0.25  # of a period: an answer that left so early ought to be there before the sample ends


def probe_forces(probing: Probing) -> bool:
    """Always goes on."""
    watchdog = probing.longest_watchdog
    if watchdog <= 2 * _WITHHELD:
        probing.findings.leave(STEP, f"a watchdog of {watchdog} samples ends what this step does")
        return True
    session = probing.arm_by_device(STEP, watchdog)
    if session is None:
        return True
    going = session.run(_ANSWERED, session.zero) and session.run(_WITHHELD, None) and session.run(20, session.zero)
    going = going and _send_what_is_refused(session) and session.run(20, session.zero)
    if not going or session.disarm() is None:
        last = told(session.ended) if session.ended else "no more positions"
        probing.findings.failed("accepted", f"before the end: {last}", "whether the device decodes FORCE while armed")
        probing.wire.release()
        return True
    _judge_in_time(probing, session)
    _judge_withheld(probing, session)
    _judge_age(probing, session)
    _judge_counters(probing, session)
    return True


def _send_what_is_refused(session: Session) -> bool:
    """FORCE frames that are too old, from the future, or damaged, one a sample, as a host sends them: none is acted on,
    none feeds the watchdog. Whether the samples went on."""
    wire = session.wire
    for i in range(_OLD + _FUTURE + _DAMAGED):
        newest = session.newest
        assert newest is not None
        if i < _OLD:
            frame = wire.frame(schema.FORCE, newest.n - 200 - i, 20, armed=True)
        elif i < _OLD + _FUTURE:
            frame = wire.frame(schema.FORCE, newest.n + 1000 + i, schema.MAX_TIME_TO_LIVE_SAMPLES, armed=True)
        else:
            damaged = bytearray(wire.frame(schema.FORCE, newest.n, 20, armed=True))
            damaged[-2 - i % 2] ^= 0x01
            frame = bytes(damaged)
        wire.send(frame)
        if not session.run(1, None):
            return False
    return True


def _samples_after(session: Session) -> list[tuple[Sample, Sample]]:
    """Each position with the next one."""
    return [
        (one, after) for one, after in zip(session.samples, session.samples[1:], strict=False) if after.n == one.n + 1
    ]


def _judge_in_time(probing: Probing, session: Session) -> None:
    pairs = [(one, after) for one, after in _samples_after(session) if one.n in session.answered]
    fresh = sum(after.fresh for _, after in pairs)
    margin = probing.periods(_LEFT_IN_TIME)
    prompt = [after for one, after in pairs if session.sent_at_s[one.n] - one.at_s < margin]
    found = f"{fresh} of {len(pairs)} samples that were answered ended with POSITION"
    if fresh:
        probing.findings.passed("in_time", found)
    elif len(prompt) < 10:
        probing.findings.not_seen("in_time", f"{found}; this host answers too late for {probing.device.rate_hz:g} Hz")
    else:
        look_at = (
            "age = (n - number) & 4095 with n the newest sample that was sent; what gathers bytes on the way (FTDI's "
            "latency timer: 16 ms as delivered), the baud rate (section 11)"
        )
        probing.findings.failed("in_time", found, look_at)


def _judge_withheld(probing: Probing, session: Session) -> None:
    pairs = [(one, after) for one, after in _samples_after(session) if one.n not in session.answered]
    wrong = [after for _, after in pairs if after.fresh]
    found = f"{len(pairs)} samples were not answered: {len(pairs) - len(wrong)} POSITION_HELD"
    if wrong:
        found += f", {len(wrong)} POSITION, the first: {wrong[0].n}"
    look_at = "fresh = heard == n && answered == n, settled at the tick before n++"
    probing.findings.judge("withheld", not wrong and len(pairs) > 0, found, look_at)


def _judge_age(probing: Probing, session: Session) -> None:
    ages, age = [], 0
    for sample in session.samples[1:_ANSWERED]:
        age = 1 if sample.fresh else age + 1
        ages.append(age)
    share = 100.0 * np.mean(np.asarray(ages) == 1)
    probing.findings.passed(
        "age",
        f"1 in {share:.3g} % of {len(ages)} answered samples, at most {max(ages)}: as this host answers, in Python",
    )


def _judge_counters(probing: Probing, session: Session) -> None:
    findings, read = probing.findings, probing.wire.register
    accepted, rejected, held = read(schema.REG_ACCEPTED), read(schema.REG_REJECTED), read(schema.REG_HELD)
    expired, limited = read(schema.REG_EXPIRED), read(schema.REG_LIMITED)
    too_old = _OLD + _FUTURE
    found = f"{expired}, where {_OLD} were too old and {_FUTURE} from the future"
    look_at = "age > time_to_live: expired++ and return, before anything else is changed"
    # A host that is held up for 256 samples sends one that is too old itself.
    late = 0 if expired is None else max(expired - too_old, 0)
    findings.judge("expired", expired is not None and expired >= too_old and late <= 3, found, look_at)
    found = f"{accepted}, where {session.sent} were sent" + (f" and {late} came too late" if late else "")
    findings.judge(
        "accepted", accepted == session.sent - late, found, "accepted++ for each FORCE acted on, 0 at arming"
    )
    found = f"{rejected}, where {_DAMAGED} were sent damaged"
    kept = rejected is not None and _DAMAGED <= rejected <= _DAMAGED + 2
    findings.judge("rejected", kept, found, "crc + length + form errors of the device's receiver, 0 at arming")
    said = sum(not sample.fresh for sample in session.samples)
    missing = session.samples[-1].n + 1 - len(session.samples)
    kept = held is not None and said <= held <= said + missing
    findings.judge(
        "held", kept, f"{held}, where {said} POSITION_HELD came", "held++ at each tick that is not fresh, 0 at arming"
    )
    findings.judge("not_limited", limited == 0, f"{limited}", "limited++ only where a force is cut; 0 at arming")
