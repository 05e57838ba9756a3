"""The fourth and fifth step, at zero force: an armed device's numbers, rate and jitter, and how it takes forces.

What is judged is what the numbers prove: a sample that was not answered before its end was read cannot have had its
answer. A host that is late proves nothing against a device.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.checks import Probing, status_found
from hapsim.bringup.probe.wire import ARMED, SET_UP, Sample, Session, arm_frame, told

_TOLERANCE = 0.01  # of the rate: what a damper's force is off by, too
_WINDOWS = 24
_BURSTS = 100.0  # times the rate: what comes so fast has waited, and came in one piece


def probe_arming(probing: Probing) -> bool:
    """Whether the device arms and sends positions."""
    session = probing.arm_by_device("arming", probing.longest_watchdog)
    if session is None:
        if probing.device.paces(schema.PACED_BY_DEVICE):
            look_at = "the tests of ARM: schema hash, pacing, watchdog; a fault of the device's own (6)"
            probing.failed("arm", "no STATUS armed within 1 s", look_at)
        return not probing.device.paces(schema.PACED_BY_DEVICE)
    _judge_status(probing, session)
    session.run(0, session.zero)
    if not _judge_first(probing, session):
        probing.wire.release()
        return False
    going = session.run(probing.samples_in(1.2, 192, 4000), session.zero)
    _judge_numbers(probing, session, going)
    _judge_rate(probing, session)
    _judge_ignored(probing, session)
    _judge_disarm(probing, session)
    _judge_velocities(probing)
    return True


def _judge_status(probing: Probing, session: Session) -> None:
    status = session.status
    kept = status is not None and (status.wire, status.number, status.fault) == (SET_UP, 0, schema.NO_FAULT)
    look_at = "STATUS goes out before the format is switched, with number 0 and the fault cleared"
    probing.judge("arm", kept, status_found(session), look_at)


def _judge_first(probing: Probing, session: Session) -> bool:
    if session.samples:
        first = session.samples[0]
        kept = first.n == 0 and first.fresh
        kind = "POSITION" if first.fresh else "POSITION_HELD"
        look_at = "POSITION 0 is measured at arming and sent after STATUS; the first tick is a period later"
        probing.judge("first_position", kept, f"{kind} {first.n}, in the armed format", look_at)
        return True
    if session.others:
        found = f"no position in the armed format, but {told(session.others[0])}"
    elif session.wire.damaged:
        found = f"no position, but {len(session.wire.damaged)} pieces that are a frame in no format"
    else:
        found = "nothing after STATUS armed"
    channels = probing.device.channels
    look_at = f"the armed format of {channels} channels: {channels} words, its start value, its check; the sample timer"
    probing.failed("first_position", found, look_at)
    return False


def _judge_numbers(probing: Probing, session: Session, going: bool) -> None:
    numbers = [sample.n for sample in session.samples]
    steps = np.diff(numbers)
    if session.ended is not None:
        found = f"after position {numbers[-1]}: {told(session.ended)}"
        probing.failed("numbers", found, "are FORCE frames decoded while armed? One was sent for every sample")
    elif not going:
        found = f"nothing more after position {numbers[-1]}"
        probing.failed("numbers", found, "the sample timer, and a transmitter that stalls")
    elif (wrong := np.flatnonzero(steps != 1)).size:
        at = int(wrong[0])
        found = f"{wrong.size} of {steps.size} steps are not 1; the first: {numbers[at]}, then {numbers[at + 1]}"
        probing.failed("numbers", found, _why_gaps(probing))
    else:
        probing.passed("numbers", f"0 to {numbers[-1]}, each one more")


def _why_gaps(probing: Probing) -> str:
    device = probing.device
    count = schema.frame_bytes(device.channels, to_device=False)
    needed = 10 * count * device.rate_hz
    return f"dropped for want of room: {device.rate_hz:g} Hz × {count} B take {needed:.0f} baud on a UART; or n++ twice"


@dataclass(frozen=True)
class Rate:
    """A rate, by the host's clock, and how sure it is (Hz, three standard deviations)."""

    hz: float
    uncertainty: float


def rate_of(numbers: np.ndarray, at_s: np.ndarray, nominal_hz: float) -> Rate:
    """The rate of samples that arrive late now and then and early never.

    In each of several windows the slope between its least late samples; of all windows the median: a host, or a
    simulated device, that was held up once makes one window wrong.
    """
    late = at_s - numbers / nominal_hz
    slopes = []
    for window in np.array_split(np.arange(numbers.size), _WINDOWS):
        third = window.size // 3
        first, last = window[:third], window[-third:]
        a, b = first[np.argmin(late[first])], last[np.argmin(late[last])]
        slopes.append((late[b] - late[a]) / (numbers[b] - numbers[a]))
    middle = float(np.median(slopes))
    spread = 1.4826 * float(np.median(np.abs(np.asarray(slopes) - middle)))
    uncertainty = 3.0 * 1.2533 * spread / np.sqrt(len(slopes))
    hz = 1.0 / (1.0 / nominal_hz + middle)
    return Rate(hz, float(hz * hz * uncertainty))


def _judge_rate(probing: Probing, session: Session) -> None:
    nominal = probing.device.rate_hz
    numbers = np.array([sample.n for sample in session.samples])
    at_s = np.array([sample.at_s for sample in session.samples])
    if numbers.size < 4 * _WINDOWS:
        probing.not_seen("rate_kept", f"only {numbers.size} samples came")
        probing.not_seen("jitter", f"only {numbers.size} samples came")
        return
    rate = rate_of(numbers, at_s, nominal)
    if not 0.0 < rate.hz < _BURSTS * nominal:
        probing.not_seen("rate_kept", "the positions came in bursts: this host, or the device, is held up too often")
        probing.not_seen("jitter", "the positions came in bursts")
        return
    off = rate.hz / nominal - 1.0
    found = f"{rate.hz:.6g} ± {rate.uncertainty:.1g} Hz, {100 * off:+z.2f} % from register 4 ({nominal:g} Hz)"
    if rate.uncertainty > 0.5 * _TOLERANCE * nominal:
        probing.not_seen("rate_kept", f"{found}: this host is too unsteady to tell 1 %")
    else:
        look_at = "the sample timer's divider, the clock that it counts, registers 4 and 5; by this host's clock"
        probing.judge("rate_kept", abs(off) <= _TOLERANCE, f"{found}; {100 * _TOLERANCE:g} % is allowed", look_at)
    intervals = 1e3 * np.diff(at_s) / np.diff(numbers)
    low, middle, high = np.quantile(intervals, (0.01, 0.5, 0.99))
    probing.passed(
        "jitter", f"1 % of the intervals below {low:.3g} ms, half below {middle:.3g} ms, 99 % below {high:.3g} ms"
    )


def _judge_ignored(probing: Probing, session: Session) -> None:
    wire = session.wire
    newest, damaged, others = session.newest, len(wire.damaged), len(session.others)
    before = newest.n if newest is not None else 0
    questions = (
        wire.frame(schema.DESCRIBE, schema.REG_SCHEMA, armed=True),
        wire.frame(schema.DESCRIBE, schema.REG_SCHEMA),
        wire.frame(schema.ARM, 1, schema.PACED_BY_DEVICE, [schema.SCHEMA_HASH], armed=True),
        arm_frame(wire, schema.PACED_BY_DEVICE, 1),
    )
    for question in questions:
        wire.send(question)
    went_on = session.run(20, session.zero)
    kept = went_on and len(session.others) == others and len(wire.damaged) == damaged
    if len(session.others) > others:
        found = f"the device answers: {told(session.others[others])}"
    elif session.ended is not None:
        found = f"the device stops: {told(session.ended)}"
    elif not went_on:
        found = f"no position after {before}"
    elif not kept:
        found = f"{len(wire.damaged) - damaged} pieces that are no frame"
    else:
        found = "DESCRIBE and ARM in both formats: no answer, positions go on"
    look_at = "an armed device acts on FORCE and DISARM alone, and reads the armed format alone"
    probing.judge("ignores_when_armed", kept, found, look_at)


def _judge_disarm(probing: Probing, session: Session) -> None:
    wire = session.wire
    answer = session.disarm()
    after = wire.hear_for(max(0.05, probing.periods(5)))
    kept = answer is not None and answer.wire == SET_UP and not after
    found = told(answer) + (f"; after it {told(after[0])}" if after else "")
    look_at = "DISARM in the armed format: force zero, idle, the set-up format, and only then STATUS"
    if not probing.judge("disarm_armed", kept, found, look_at):
        wire.release()


def _judge_velocities(probing: Probing) -> None:
    if not probing.device.senses_velocity:
        probing.not_seen("velocities", "no velocity is sensed (register 38)")
        return
    session = probing.arm(schema.PACED_BY_DEVICE, probing.longest_watchdog, velocity=True)
    if session is None:
        look_at = "bit 7 of ARM's argument, beside the pacing in bits 6 to 0"
        probing.failed("velocities", "ARM with velocities is refused", look_at)
        return
    going = session.run(50, session.zero)
    wrong = [one for one in session.others if one.wire in (ARMED, SET_UP)]
    words = len(session.samples[0].counts) if session.samples else 0
    kept = going and not wrong
    found = f"{len(session.samples)} positions of {words} words"
    if wrong:
        found = f"{told(wrong[0])}, without velocities"
    elif not going:
        found += ", and no more; " + (told(session.ended) if session.ended else f"{len(probing.wire.damaged)} damaged")
    look_at = "the start value with the velocity mark, the check by the longest payload, two words for each channel"
    probing.judge("velocities", kept, found, look_at)
    session.disarm()


_ANSWERED, _WITHHELD = 200, 20  # samples
_OLD, _FUTURE, _DAMAGED = 5, 3, 4  # frames
_LEFT_IN_TIME = 0.25  # of a period: an answer that left so early ought to be there before the sample ends


def probe_forces(probing: Probing) -> bool:
    """Always goes on."""
    watchdog = probing.longest_watchdog
    if watchdog <= 2 * _WITHHELD:
        probing.leave_out("forces", f"a watchdog of {watchdog} samples ends what this step does")
        return True
    session = probing.arm_by_device("forces", watchdog)
    if session is None:
        return True
    going = session.run(_ANSWERED, session.zero) and session.run(_WITHHELD, None) and session.run(20, session.zero)
    going = going and _send_what_is_refused(session) and session.run(20, session.zero)
    if not going or session.disarm() is None:
        last = told(session.ended) if session.ended else "no more positions"
        probing.failed("accepted", f"before the end: {last}", "whether the device decodes FORCE while armed")
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
        probing.passed("in_time", found)
    elif len(prompt) < 10:
        probing.not_seen("in_time", f"{found}; this host answers too late for {probing.device.rate_hz:g} Hz")
    else:
        look_at = (
            "age = (n - number) & 4095 with n the newest sample that was sent; what gathers bytes on the way (FTDI's "
            "latency timer: 16 ms as delivered), the baud rate (section 11)"
        )
        probing.failed("in_time", found, look_at)


def _judge_withheld(probing: Probing, session: Session) -> None:
    pairs = [(one, after) for one, after in _samples_after(session) if one.n not in session.answered]
    wrong = [after for _, after in pairs if after.fresh]
    found = f"{len(pairs)} samples were not answered: {len(pairs) - len(wrong)} POSITION_HELD"
    if wrong:
        found += f", {len(wrong)} POSITION, the first: {wrong[0].n}"
    look_at = "fresh = heard == n && answered == n, settled at the tick before n++"
    probing.judge("withheld", not wrong and len(pairs) > 0, found, look_at)


def _judge_age(probing: Probing, session: Session) -> None:
    ages, age = [], 0
    for sample in session.samples[1:_ANSWERED]:
        age = 1 if sample.fresh else age + 1
        ages.append(age)
    share = 100.0 * np.mean(np.asarray(ages) == 1)
    probing.passed(
        "age",
        f"1 in {share:.3g} % of {len(ages)} answered samples, at most {max(ages)}: as this host answers, in Python",
    )


def _judge_counters(probing: Probing, session: Session) -> None:
    read = probing.wire.register
    accepted, rejected, held = read(schema.REG_ACCEPTED), read(schema.REG_REJECTED), read(schema.REG_HELD)
    expired, limited = read(schema.REG_EXPIRED), read(schema.REG_LIMITED)
    too_old = _OLD + _FUTURE
    found = f"{expired}, where {_OLD} were too old and {_FUTURE} from the future"
    look_at = "age > time_to_live: expired++ and return, before anything else is changed"
    # A host that is held up for 256 samples sends one that is too old itself.
    late = 0 if expired is None else max(expired - too_old, 0)
    probing.judge("expired", expired is not None and expired >= too_old and late <= 3, found, look_at)
    found = f"{accepted}, where {session.sent} were sent" + (f" and {late} came too late" if late else "")
    probing.judge("accepted", accepted == session.sent - late, found, "accepted++ for each FORCE acted on, 0 at arming")
    found = f"{rejected}, where {_DAMAGED} were sent damaged"
    kept = rejected is not None and _DAMAGED <= rejected <= _DAMAGED + 2
    probing.judge("rejected", kept, found, "crc + length + form errors of the device's receiver, 0 at arming")
    said = sum(not sample.fresh for sample in session.samples)
    missing = session.samples[-1].n + 1 - len(session.samples)
    kept = held is not None and said <= held <= said + missing
    probing.judge(
        "held", kept, f"{held}, where {said} POSITION_HELD came", "held++ at each tick that is not fresh, 0 at arming"
    )
    probing.judge("not_limited", limited == 0, f"{limited}", "limited++ only where a force is cut; 0 at arming")
