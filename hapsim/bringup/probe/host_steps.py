"""The sixth to eighth step: a host that falls silent, one that does not read, and one that paces the device.

A device counts samples, so the numbers show whether its watchdog is in time. A transmitter that finds no room must not
stop the tick: the numbers of a device that went on jump, those of one that waited do not. How much the system takes
before a device finds no room is not known, so this writes more than a pseudo-terminal or a USB driver keeps.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from firmware_protocol.client import Received
from firmware_protocol.frames import SETUP
from hapsim.bringup.probe.probing import LONG_LIFE, Probing, Session, in_words

_WATCHDOG = 40  # samples
_TOO_LATE = 3  # samples after it


def probe_watchdog(probing: Probing) -> None:
    """Always goes on."""
    watchdog = min(_WATCHDOG, probing.device.max_watchdog_samples)
    session = probing.arm_by_device("watchdog", watchdog)
    if session is None:
        return
    session.run(watchdog + _TOO_LATE + 1, None)
    _judge_latched(probing, session, watchdog, last_force=-1)
    if session.ended is None:
        probing.wire.release()
        probing.leave_out("watchdog", "the device did not latch")
        return
    _judge_ignores(probing, session.samples[-1].n if session.samples else 0)
    answer, _ = probing.wire.ask(probing.wire.frame(schema.DISARM, 0), schema.STATUS)
    answered = answer and (answer.wire, answer.state, answer.fault)
    probing.judge("disarm_latched", answered == (SETUP, schema.IDLE, schema.HOST_QUIET), in_words(answer))
    _judge_rearming(probing, watchdog)


def _has_latched(status: Received) -> bool:
    return (status.state, status.fault) == (schema.LATCHED, schema.HOST_QUIET)


def _judge_latched(probing: Probing, session: Session, watchdog: int, last_force: int) -> None:
    """`last_force`: the sample in which the last force came."""
    last = session.newest.n if session.newest else 0
    due = last_force + watchdog + 1
    found = f"no FORCE since {'arming' if last_force < 0 else f'sample {last_force}'}, watchdog {watchdog}: "
    if session.ended is None:
        probing.judge("latches", False, f"{found}still armed at sample {last}, without a STATUS")
        return
    n = last + (session.ended.number - last + 2) % schema.SAMPLE_MODULUS - 2
    probing.judge("latches", due <= n <= due + 1, f"{found}latched at sample {n} ({due} or {due + 1} is allowed)")
    in_format = session.ended.wire == probing.wire.armed
    probing.judge("latched_status", in_format and _has_latched(session.ended), in_words(session.ended))


def _judge_ignores(probing: Probing, n: int) -> None:
    """`n`: the last sample."""
    wire = probing.wire
    before = wire.received
    wire.receive_for(max(0.05, probing.periods(5)))
    late = wire.received - before
    accepted = wire.register(schema.REG_ACCEPTED)
    for armed in (True, False):
        wire.send(wire.frame(schema.FORCE, n, schema.MAX_TIME_TO_LIVE_SAMPLES, armed=armed))
    answer, frames = wire.ask(wire.frame(schema.DESCRIBE, schema.REG_FAULT), schema.DESCRIPTION)
    others = [one for one in frames if one.kind != schema.DESCRIPTION]
    after = wire.register(schema.REG_ACCEPTED)
    answered = answer and (answer.wire, answer.word)
    kept = answered == (SETUP, schema.HOST_QUIET) and not others and late == 0 and accepted == after
    found = f"{late} bytes after STATUS; {in_words(answer)}, after two FORCE; register 8 read {accepted}, then {after}"
    probing.judge("latched_ignores", kept, found + "".join(f"; {in_words(one)}" for one in others[:1]))


def _judge_rearming(probing: Probing, watchdog: int) -> None:
    """Arms an idle device, has it latch once more after forces, and arms it while it is latched."""
    session = _armed_anew(probing, watchdog, "after the watchdog")
    if session is None:
        return
    session.run(20, session.zero)
    last = max(session.sent_at_s, default=-1)
    session.run(watchdog + _TOO_LATE + 20, None)
    in_time = last >= 0 and any(sample.n == last + 1 and sample.fresh for sample in session.samples)
    if in_time or session.ended is None:  # a late force came in an unknown sample
        _judge_latched(probing, session, watchdog, last_force=last)
    if session.ended is None:
        probing.wire.release()
        return
    again = _armed_anew(probing, watchdog, "while latched")
    if again is None:
        return
    answer = again.disarm()
    counters = [probing.wire.register(number) for number in range(schema.REG_FAULT, schema.REG_LIMITED + 1)]
    rejected, held = counters[2], sum(not sample.fresh for sample in again.samples)
    names = ("fault", "accepted", "rejected", "held", "expired", "limited")
    found = ", ".join(f"{name} {count}" for name, count in zip(names, counters, strict=True))
    kept = counters == [0, 0, rejected, held, 0, 0] and rejected is not None and rejected <= 2
    probing.judge("rearming", answer is not None and kept, f"after arming while latched: {found}")


def _armed_anew(probing: Probing, watchdog: int, when: str) -> Session | None:
    """Arms a device that has latched before; notes what is not as after power-up. Returns None if it did not arm."""
    session = probing.arm(schema.PACED_BY_DEVICE, watchdog)
    if session is None:
        probing.judge("rearming", False, f"ARM {when}: not armed")
        return None
    session.run(2, None)
    status, first = session.status, session.samples[0].n if session.samples else None
    if status is None or (status.number, status.fault, first) != (0, schema.NO_FAULT, 0):
        probing.judge("rearming", False, f"ARM {when}: {in_words(status)}; first position {first}")
    return session


_FILL_BYTES = 40_000  # a pseudo-terminal takes 20 480; a USB port stops at its driver's buffers, some 4 kB
_LONGEST_S = 8.0
_BEFORE = 100  # samples, by which the rate is known that the device keeps now: a simulated one may be held up
_WENT_ON = 0.7  # of the samples that passed, by the host's clock and that rate
_GUESSES = 6  # of the number, each a life behind the one before: a device may be slower than it was
_STEADY = 0.15  # of the rate: else the device, or this host, is held up by something else
_UNREAD = 1.5  # of the watchdog


def probe_blocked(probing: Probing) -> None:
    """Always goes on."""
    device = probing.device
    parts = schema.parts_of(device.sensed) & schema.MOTION_BITS  # longer frames: filled sooner
    size = schema.frame_bytes(device.channels, to_device=False, parts=parts)
    samples = _FILL_BYTES // size
    if (lasts := probing.periods(samples)) > _LONGEST_S:
        why = f"{samples} frames of {size} B at {device.rate_hz:g} Hz take {lasts:.3g} s: too long to fill what buffers"
        probing.leave_out("blocked", why)
        return
    session = probing.arm_by_device("blocked", probing.device.max_watchdog_samples, parts=parts)
    if session is None:
        return
    going = session.run(_BEFORE, session.zero)
    rate_hz = 0.0
    if going:
        oldest, newest = session.samples[0], session.samples[-1]
        lasted_s = newest.at_s - oldest.at_s
        rate_hz = min(device.rate_hz, (newest.n - oldest.n) / lasted_s) if lasted_s > 0 else device.rate_hz
    is_steady = going and _judge_tick(probing, session, samples, rate_hz)
    if not going or is_steady is None:
        probing.wire.release()
        probing.leave_out("blocked", "the device had stopped before, or did not come back")
        return
    session.disarm()
    watchdog = min(round(0.9 * samples), probing.device.max_watchdog_samples)
    _judge_watchdog_blocked(probing, watchdog, rate_hz, is_steady, parts)


def _judge_tick(probing: Probing, session: Session, samples: int, rate_hz: float) -> bool | None:
    """Does not read for this many samples, then reads again. Returns whether the device kept its rate, as far as that
    can be seen; None if it did not come back. `rate_hz`: that it kept before."""
    wire, first = probing.wire, session.samples[-1]
    damaged = len(wire.damaged)
    _write_unread(session, probing.periods(samples), rate_hz, min(probing.periods(50), 0.1))
    session.take_waiting()
    if session.samples[-1] is first:
        probing.judge("tick_goes_on", False, f"after {samples} samples unread: nothing more came")
        return None
    began = session.samples[-1]
    if session.ended is None:
        session.zero(began)
    went_on = session.run(_BEFORE, session.zero)
    newest = session.samples[-1]
    after_hz = (newest.n - began.n) / max(newest.at_s - began.at_s, 1e-9)
    is_steady = all(abs(kept / probing.device.rate_hz - 1.0) < _STEADY for kept in (rate_hz, after_hz))
    elapsed, passed = (newest.at_s - first.at_s) * rate_hz, newest.n - first.n
    lost = passed + 1 - sum(sample.n >= first.n for sample in session.samples)
    found = f"{passed} samples in {elapsed:.0f} periods of the host's clock, {lost} dropped"
    if stopped := passed < _WENT_ON * elapsed:
        found += "; the samples stopped while the host did not read"
    elif not went_on:
        found += "; then no more positions"
    if (stopped or not went_on) and not is_steady:
        rates = f"{rate_hz:.0f} Hz before and {after_hz:.0f} Hz after"
        probing.not_seen("tick_goes_on", f"{found}: but it kept {rates}, too unsteady to tell")
    elif stopped or not went_on or lost:
        probing.judge("tick_goes_on", went_on and not stopped, found)
    else:
        probing.not_seen("tick_goes_on", f"{found}: the system had room for all, the device was never short of it")
    if pieces := len(wire.damaged) - damaged:
        probing.judge("whole_frames", False, f"{pieces} pieces that are no frame; {lost} frames were dropped")
    elif lost:
        probing.judge("whole_frames", True, f"{lost} frames dropped, no piece of one came")
    else:
        probing.not_seen("whole_frames", "nothing was dropped")
    return is_steady if went_on else None


def _write_unread(session: Session, seconds: float, rate_hz: float, pause_s: float) -> None:
    """Sends zero forces without reading, guessing the numbers."""
    clock, first = session.wire.clock, session.samples[-1]
    end = clock.monotonic() + seconds
    while (now := clock.monotonic()) < end:
        guessed = first.n + round((now - first.at_s) * rate_hz)
        for behind in range(_GUESSES):  # one of which lies within a life of where the device is
            session.force(max(guessed - LONG_LIFE // 3 - behind * LONG_LIFE, 0))
        clock.sleep(pause_s)


def _judge_watchdog_blocked(probing: Probing, watchdog: int, rate_hz: float, is_steady: bool, parts: int) -> None:
    wire = probing.wire
    session = probing.arm(schema.PACED_BY_DEVICE, watchdog, parts=parts)
    if session is None:
        probing.not_seen("watchdog_blocked", "the device did not arm again")
        return
    wire.clock.sleep(_UNREAD * watchdog / rate_hz)
    session.take_waiting()
    newest = session.newest.n if session.newest else 0
    # The STATUS may have found no room: a latched device answers in the set-up format.
    fault = wire.register(schema.REG_FAULT) if session.ended is None else session.ended.fault
    held = wire.register(schema.REG_HELD)
    wire.release()
    found = f"watchdog {watchdog}, {_UNREAD * watchdog:.0f} periods unread: "
    if fault != schema.HOST_QUIET and not is_steady:
        probing.not_seen("watchdog_blocked", f"{found}not latched yet, but the rate is too unsteady to tell")
    elif fault != schema.HOST_QUIET:
        probing.judge("watchdog_blocked", False, f"{found}not latched when the host read again")
    elif newest >= watchdog:
        probing.not_seen("watchdog_blocked", f"{found}latched, but {watchdog} frames found room")
    else:
        dropped = f"of which the last {watchdog - newest} found no room"
        probing.judge("watchdog_blocked", True, f"{found}latched after {held} samples, {dropped}")


_ROUNDS = 100
_HOST_WATCHDOG_S = 0.06  # longer than this host is held up, as a rule
_EARLY = 0.9  # of the watchdog: more than a clock is off by


def probe_host_paced(probing: Probing) -> None:
    """Always goes on."""
    if not probing.device.paces(schema.PACED_BY_HOST):
        probing.leave_out("host", "the device does not declare that the host may pace (bit 1 of register 3)")
        return
    session = probing.arm(schema.PACED_BY_HOST, probing.device.max_watchdog_samples)
    if session is None:
        probing.judge("each_force", False, "ARM with pacing 1 is refused", "register 3 declares it (bit 1)")
        return
    session.run(0, None)
    quiet_s = min(max(0.02, probing.periods(5)), 0.5 * probing.periods(probing.device.max_watchdog_samples))
    session.take(probing.wire.receive_for(quiet_s))
    numbers = [sample.n for sample in session.samples]
    found = f"positions {', '.join(map(str, numbers[:5]))} before the first FORCE" if numbers else "no position 0"
    if probing.judge("no_own_tick", numbers == [0], found):
        _exchange(probing, session)
    session.disarm()
    _judge_host_watchdog(probing)


def _exchange(probing: Probing, session: Session) -> None:
    """Answers one position after the other, and the last one twice."""
    times_s = []
    for n in range(_ROUNDS):
        count = len(session.samples)
        session.force(n)
        session.next_positions()
        newest = session.samples[-1]
        if len(session.samples) != count + 1 or newest.n != n + 1 or not newest.fresh:
            last = in_words(session.ended) if session.ended else f"the newest position is {newest.in_words()}"
            probing.judge("each_force", False, f"after FORCE {n}: {last}")
            return
        times_s.append(newest.at_s - session.sent_at_s[n])
    probing.judge("each_force", True, f"{_ROUNDS} forces, {_ROUNDS} positions, none held")
    low, middle, high = 1e3 * np.quantile(times_s, (0.0, 0.5, 0.99))
    found = f"{low:.3g} ms at best, half below {middle:.3g} ms, 99 % below {high:.3g} ms"
    probing.judge("round_trip", True, f"{found}; a period is {probing.periods(1e3):.3g} ms")
    session.force(_ROUNDS - 1)
    session.next_positions()
    newest = session.samples[-1]
    kept = (len(session.samples), newest.n, newest.fresh) == (_ROUNDS + 2, _ROUNDS + 1, False)
    probing.judge("same_force_again", kept, f"FORCE {_ROUNDS - 1} twice: {newest.in_words()}")


def _judge_host_watchdog(probing: Probing) -> None:
    wire, watchdog = probing.wire, probing.samples_in(_HOST_WATCHDOG_S, 2, probing.device.max_watchdog_samples)
    nominal_s = probing.periods(watchdog)
    longest_s = 5 * nominal_s + 1.0
    begun = wire.clock.monotonic()  # before the device is armed: it cannot be in time and seem early
    session = probing.arm(schema.PACED_BY_HOST, watchdog)
    if session is None:
        probing.judge("host_watchdog", False, "the device did not arm again", "ARM after DISARM")
        return
    while session.ended is None and wire.clock.monotonic() - begun < longest_s:
        session.take(wire.receive(0.05))
    found = f"watchdog {watchdog} ({1e3 * nominal_s:.3g} ms): "
    if session.ended is None:
        probing.judge("host_watchdog", False, f"{found}no STATUS within {longest_s:.3g} s")
        wire.release()
        return
    after_s = session.ended.at_s - begun
    found += f"{in_words(session.ended)}, after {1e3 * after_s:.3g} ms of the host's clock "
    found += f"({1e3 * _EARLY * nominal_s:.3g} ms or more is allowed: this host may read it late)"
    probing.judge("host_watchdog", _has_latched(session.ended) and after_s > _EARLY * nominal_s, found)
