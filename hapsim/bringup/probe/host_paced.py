"""The eighth step: paced by the host. Each FORCE makes the tick; only the watchdog has the device's own clock."""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing
from hapsim.bringup.probe.session import Session
from hapsim.bringup.probe.wire import told

STEP = "host"
_ROUNDS = 100
_WATCHDOG_S = 0.06  # longer than this host is held up, as a rule
_EARLY = 0.9  # of the watchdog: what a clock may be off by, and then some


def probe_host_paced(probing: Probing) -> bool:
    """Always goes on."""
    if not probing.device.paces(schema.PACED_BY_HOST):
        probing.findings.leave(STEP, "the device does not declare that the host may pace (bit 1 of register 3)")
        return True
    session = probing.arm(schema.PACED_BY_HOST, probing.longest_watchdog)
    if session is None:
        probing.findings.failed("each_force", "ARM with pacing 1 is refused", "register 3 declares it (bit 1)")
        return True
    session.run(0, None)
    if _no_own_tick(probing, session):
        _exchange(probing, session)
    if session.disarm() is None:
        probing.wire.release()
    _judge_watchdog(probing)
    return True


def _no_own_tick(probing: Probing, session: Session) -> bool:
    session.take(
        probing.wire.hear_for(min(max(0.02, probing.periods(5)), 0.5 * probing.periods(probing.longest_watchdog)))
    )
    numbers = [sample.n for sample in session.samples]
    found = f"positions {', '.join(map(str, numbers[:5]))} before the first FORCE" if numbers else "no position 0"
    look_at = "paced by the host the sample timer makes no tick; POSITION 0 comes at arming"
    return probing.findings.judge("no_own_tick", numbers == [0], found, look_at)


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
    findings, took = probing.findings, []
    look_at = "paced by the host, FORCE that is accepted ends the sample: output, n++, measure, send"
    for n in range(_ROUNDS):
        lasted = _next(session, n)
        newest = session.samples[-1]
        if lasted is None or newest.n != n + 1 or not newest.fresh:
            kind = "POSITION" if newest.fresh else "POSITION_HELD"
            last = f"the newest position is {kind} {newest.n}" if session.ended is None else told(session.ended)
            findings.failed("each_force", f"after FORCE {n}: {last}", look_at)
            return
        took.append(lasted)
    findings.passed("each_force", f"{_ROUNDS} forces, {_ROUNDS} positions, none held")
    period = f"a period is {probing.periods(1e3):.3g} ms"
    low, middle, high = 1e3 * np.quantile(took, (0.0, 0.5, 0.99))
    findings.passed(
        "round_trip",
        f"{low:.3g} ms at best, half below {middle:.3g} ms, 99 % below {high:.3g} ms; {period}",
    )
    again = _next(session, _ROUNDS - 1)
    newest = session.samples[-1]
    kept = again is not None and newest.n == _ROUNDS + 1 and not newest.fresh
    found = f"FORCE {_ROUNDS - 1} twice: {'POSITION' if newest.fresh else 'POSITION_HELD'} {newest.n}"
    findings.judge("same_force_again", kept, found, "fresh = heard == n && answered == n: a repeated force has age 1")


def _judge_watchdog(probing: Probing) -> None:
    findings = probing.findings
    watchdog = probing.samples_in(_WATCHDOG_S, 2, probing.longest_watchdog)
    nominal = probing.periods(watchdog)
    begun = probing.wire.clock.now()  # before the device is armed: it cannot be in time and seem early
    session = probing.arm(schema.PACED_BY_HOST, watchdog)
    if session is None:
        findings.failed("host_watchdog", "the device did not arm again", "ARM after DISARM")
        return
    while session.ended is None and probing.wire.clock.now() - begun < 5 * nominal + 1.0:
        session.take(probing.wire.hear(0.05))
    ended = session.ended
    look_at = "paced by the host no tick comes: the main loop looks at the time since the last accepted FORCE"
    if ended is None:
        found = f"watchdog {watchdog} ({nominal:.3g} s): no STATUS within {5 * nominal + 1.0:.3g} s"
        findings.failed("host_watchdog", found, look_at)
        probing.wire.release()
        return
    after = ended.at_s - begun
    right = (ended.state, ended.fault) == (schema.LATCHED, schema.HOST_QUIET)
    found = (
        f"watchdog {watchdog} ({1e3 * nominal:.3g} ms): {told(ended)}, after {1e3 * after:.3g} ms of the host's clock "
        f"({1e3 * _EARLY * nominal:.3g} ms or more is allowed: this host may read it late)"
    )
    findings.judge("host_watchdog", right and after > _EARLY * nominal, found, look_at)
