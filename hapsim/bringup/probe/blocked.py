"""The seventh step: a host that does not read. The device's transmitter finds no room; its tick must not wait for that.

The numbers tell what happened meanwhile: of a device that went on they jump, of one that waited they go on where they
were. How much the system takes before a device finds no room is not known: more than this step writes into it, and
nothing was seen.
"""

from __future__ import annotations

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing
from hapsim.bringup.probe.session import LONG_LIFE, Sample, Session

STEP = "blocked"
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
        probing.findings.leave(STEP, why)
        return True
    session = probing.arm_by_device(STEP, probing.longest_watchdog, velocity=velocity)
    if session is None:
        return True
    if not session.run(_BEFORE, session.zero) or not _tick_goes_on(probing, session, samples):
        probing.wire.release()
        probing.findings.leave(STEP, "the device had stopped before, or did not come back")
        return True
    if session.disarm() is None:
        probing.wire.release()
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
        probing.findings.failed("tick_goes_on", f"after {samples} samples unread: nothing more came", _NEVER_WAIT)
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
        probing.findings.not_seen("tick_goes_on", why)
    elif passed < _WENT_ON * elapsed:
        stopped = f"{found}: the samples stopped while the host did not read"
        probing.findings.failed("tick_goes_on", stopped, _NEVER_WAIT)
    elif not went_on and not probing.steady:
        why = f"{found}; then it stopped, but its rate was too unsteady to guess its numbers"
        probing.findings.not_seen("tick_goes_on", why)
    elif not went_on:
        probing.findings.failed("tick_goes_on", f"{found}; then no more positions", _NEVER_WAIT)
    elif lost:
        probing.findings.passed("tick_goes_on", found)
    else:
        why = f"{found}: the system had room for all, the device was never short of it"
        probing.findings.not_seen("tick_goes_on", why)
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
        probing.findings.failed("whole_frames", found, look_at)
    elif lost:
        probing.findings.passed("whole_frames", f"{lost} frames dropped, no piece of one came")
    else:
        probing.findings.not_seen("whole_frames", "nothing was dropped")


def _watchdog_while_blocked(probing: Probing, samples: int, kept_hz: float, *, velocity: bool) -> None:
    findings, wire = probing.findings, probing.wire
    watchdog = min(round(0.9 * samples), probing.longest_watchdog)
    each = schema.frame_bytes(probing.device.channels, to_device=False, velocity=velocity)
    session = probing.arm(schema.PACED_BY_DEVICE, watchdog, velocity=velocity)
    if session is None:
        findings.not_seen("watchdog_blocked", "the device did not arm again")
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
        findings.not_seen("watchdog_blocked", f"{found}: not latched yet, but the rate is too unsteady to tell")
    elif fault != schema.HOST_QUIET:
        findings.failed("watchdog_blocked", f"{found}: not latched when the host read again", look_at)
    elif newest >= watchdog:
        findings.not_seen("watchdog_blocked", f"{found}: latched, but {watchdog} frames of {each} B found room")
    else:
        findings.passed(
            "watchdog_blocked",
            f"{found}: latched after {held} samples, of which the last {watchdog - newest} found no room",
        )
