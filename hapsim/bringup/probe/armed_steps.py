"""The fourth and fifth step, at zero force: an armed device's numbers, rate and jitter, and how it takes forces.

The numbers of the samples are the evidence: a sample that was not answered before its end was read cannot have had its
answer. A host that is late proves nothing against a device.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.frames import SETUP
from hapsim.bringup.probe.probing import Probing, Session, in_words

_TOLERANCE = 0.01  # of the rate; the force of a damper is off by as much
_WINDOWS = 24
_BURSTS = 100.0  # times the rate: what comes so fast has waited, and came in one piece


def probe_arming(probing: Probing) -> bool:
    """Returns whether the device sends positions, or does not pace itself."""
    session = probing.arm_by_device("arming", probing.device.max_watchdog_samples)
    if session is None and not probing.device.paces(schema.PACED_BY_DEVICE):
        return True
    if session is None:
        look_at = "the tests of ARM: schema hash, pacing, watchdog; a fault of the device's own (6)"
        return probing.judge("arm", False, "no STATUS armed within 1 s", look_at)
    status = session.status
    kept = status is not None and (status.wire, status.number, status.fault) == (SETUP, 0, schema.NO_FAULT)
    probing.judge("arm", kept, in_words(status))
    session.run(0, session.zero)
    if not session.samples:
        frame = session.ended or next(iter(session.others), None)
        other = f"but {in_words(frame)}" if frame else "nor another frame"
        found = f"no position in the armed format, {other}; {len(session.wire.damaged)} pieces that are no frame"
        words = f"{probing.device.channels} channels: {probing.device.channels} words"
        look_at = f"the armed format of {words}, its start value, its check; the sample timer"
        if frame and frame.fault == schema.HARDWARE:
            look_at = "the sensor's wires and supply, and the magnet of a magnetic one: the device's own fault (6)"
        probing.judge("first_position", False, found, look_at)
        probing.wire.release()
        return False
    first = session.samples[0]
    probing.judge("first_position", first.n == 0 and first.fresh, f"{first.in_words()}, in the armed format")
    going = session.run(probing.samples_in(1.2, 192, 4000), session.zero)
    _judge_numbers(probing, session, going)
    _judge_rate(probing, session)
    _judge_ignored(probing, session)
    answer = session.disarm()
    after = probing.wire.receive_for(max(0.05, probing.periods(5)))
    found = in_words(answer) + (f"; after it {in_words(after[0])}" if after else "")
    if not probing.judge("disarm_armed", answer is not None and answer.wire == SETUP and not after, found):
        probing.wire.release()
    for part in (part for part in schema.SENSED if part.name in _NAMES):
        _judge_part(probing, part)
    return True


def _judge_numbers(probing: Probing, session: Session, going: bool) -> bool:
    numbers = [sample.n for sample in session.samples]
    steps = np.diff(numbers)
    wrong = np.flatnonzero(steps != 1)
    if not going:
        came = in_words(session.ended) if session.ended else "nothing more"
        return probing.judge("numbers", False, f"after position {numbers[-1]}: {came}")
    if not wrong.size:
        return probing.judge("numbers", True, f"0 to {numbers[-1]}, each one more")
    first, device = int(wrong[0]), probing.device
    found = f"{wrong.size} of {steps.size} steps are not 1; the first: {numbers[first]}, then {numbers[first + 1]}"
    size = schema.frame_bytes(device.channels, to_device=False)
    baud = f"{device.rate_hz:g} Hz × {size} B take {10 * size * device.rate_hz:.0f} baud on a UART"
    return probing.judge("numbers", False, found, f"frames dropped for want of room: {baud}; or n++ twice")


def rate_of(numbers: NDArray[np.int64], at_s: NDArray[np.float64], nominal_hz: float) -> tuple[float, float]:
    """Returns the rate by the host's clock, and three of its standard deviations, in Hz, of samples that arrive late
    now and then and early never.

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
    period = 1.0 / nominal_hz + middle
    hz = 1.0 / period if period > 0.0 else math.inf  # all of them at once
    return hz, float(hz * hz * 3.0 * 1.2533 * spread / np.sqrt(len(slopes)))


def _judge_rate(probing: Probing, session: Session) -> None:
    names, nominal = ("rate_kept", "jitter"), probing.device.rate_hz
    numbers = np.array([sample.n for sample in session.samples])
    at_s = np.array([sample.at_s for sample in session.samples])
    if numbers.size < 4 * _WINDOWS:
        probing.not_seen(names, f"only {numbers.size} samples came")
        return
    if not np.diff(numbers).all():
        probing.not_seen(names, "some samples have the number of the one before: see numbers")
        return
    intervals = 1e3 * np.diff(at_s) / np.diff(numbers)
    low, middle, high = np.quantile(intervals, (0.01, 0.5, 0.99))
    jitter = f"1 % of the intervals below {low:.3g} ms, half below {middle:.3g} ms, 99 % below {high:.3g} ms"
    hz, uncertainty = rate_of(numbers, at_s, nominal)
    found = f"{hz:.6g} ± {uncertainty:.1g} Hz, {100 * (hz / nominal - 1.0):+z.2f} % from register 4 ({nominal:g} Hz)"
    if not 0.0 < hz < _BURSTS * nominal:
        probing.not_seen(names, "the positions came in bursts: this host, or the device, is held up too often")
        return
    probing.judge("jitter", True, jitter)
    if uncertainty > 0.5 * _TOLERANCE * nominal:
        probing.not_seen("rate_kept", f"{found}: this host is too unsteady to tell 1 %")
    else:
        kept = abs(hz / nominal - 1.0) <= _TOLERANCE
        probing.judge("rate_kept", kept, f"{found}; {100 * _TOLERANCE:g} % is allowed")


def _judge_ignored(probing: Probing, session: Session) -> None:
    wire = session.wire
    before, damaged, others = session.samples[-1].n, len(wire.damaged), len(session.others)
    for armed in (True, False):
        wire.send(wire.frame(schema.DESCRIBE, schema.REG_SCHEMA, armed=armed))
    wire.send(wire.frame(schema.ARM, 1, schema.PACED_BY_DEVICE, [schema.SCHEMA_HASH], armed=True))
    wire.send(wire.arm_frame(schema.PACED_BY_DEVICE, 1))
    went_on = session.run(20, session.zero)
    came = [in_words(one) for one in (*session.others[others:], session.ended) if one]
    pieces = len(wire.damaged) - damaged
    found = f"DESCRIBE and ARM in both formats: {', '.join(came) or 'no answer'}, {pieces} pieces that are no frame; "
    found += "positions go on" if went_on else f"no position after {before}"
    probing.judge("ignores_when_armed", went_on and not came and not pieces, found)


_NAMES = {"velocity": "velocities", "acceleration": "accelerations"}


def _judge_part(probing: Probing, part: schema.Part) -> None:
    """Arms the device with a part and those before it that it senses."""
    name, sensed = _NAMES[part.name], probing.device.sensed
    if part.name not in sensed:
        register = part.scale_register if not part.declared_by else schema.REG_SENSORS
        probing.not_seen(name, f"no {part.name} is sensed (register {register})")
        return
    parts = schema.parts_of(sensed[: sensed.index(part.name) + 1])
    session = probing.arm(schema.PACED_BY_DEVICE, probing.device.max_watchdog_samples, parts=parts)
    if session is None:
        look_at = f"bit {part.bit.bit_length() - 1} of ARM's argument, beside the pacing in bits 1 and 0"
        probing.judge(name, False, f"ARM with {name} is refused", look_at)
        return
    going = session.run(50, session.zero)
    wrong = [one for one in session.others if one.wire.parts != parts]
    words = len(session.samples[0].counts) if session.samples else 0
    other = in_words(wrong[0] if wrong else session.ended) if wrong or session.ended else "nothing else"
    found = f"{len(session.samples)} positions of {words} words; {other}"
    probing.judge(name, going and not wrong, found)
    session.disarm()


_ANSWERED, _WITHHELD = 200, 20  # samples
_OLD, _FUTURE, _DAMAGED = 5, 3, 4  # frames
_LEFT_IN_TIME = 0.25  # of a period: an answer that left so early ought to be there before the sample ends


def probe_forces(probing: Probing) -> None:
    """Always goes on."""
    watchdog = probing.device.max_watchdog_samples
    if watchdog <= 2 * _WITHHELD:
        probing.leave_out("forces", f"a watchdog of {watchdog} samples ends what this step does")
        return
    session = probing.arm_by_device("forces", watchdog)
    if session is None:
        return
    going = session.run(_ANSWERED, session.zero) and session.run(_WITHHELD, None) and session.run(20, session.zero)
    going = going and _send_what_is_refused(session) and session.run(20, session.zero)
    if not going or session.disarm() is None:
        last = in_words(session.ended) if session.ended else "no more positions"
        look_at = "whether the device decodes FORCE while armed"
        probing.judge("accepted", False, f"before the end: {last}", look_at)
        probing.wire.release()
        return
    _judge_samples(probing, session)
    ages, age = [], 0
    for sample in session.samples[1:_ANSWERED]:
        age = 1 if sample.fresh else age + 1
        ages.append(age)
    share = 100.0 * ages.count(1) / len(ages)
    found = f"1 in {share:.3g} % of {len(ages)} answered samples, at most {max(ages)}: as this host answers, in Python"
    probing.judge("age", True, found)
    _judge_counters(probing, session)


def _send_what_is_refused(session: Session) -> bool:
    """Sends FORCE frames that are too old, from the future, or damaged, one a sample, as a host sends them: none is
    acted on, none feeds the watchdog. Returns whether the samples went on."""
    wire = session.wire
    for i in range(_OLD + _FUTURE + _DAMAGED):
        n = session.samples[-1].n
        if i < _OLD:
            frame = wire.frame(schema.FORCE, n - 200 - i, 20, armed=True)
        elif i < _OLD + _FUTURE:
            frame = wire.frame(schema.FORCE, n + 1000 + i, schema.MAX_TIME_TO_LIVE_SAMPLES, armed=True)
        else:
            damaged = bytearray(wire.frame(schema.FORCE, n, 20, armed=True))
            damaged[-2 - i % 2] ^= 0x01
            frame = bytes(damaged)
        wire.send(frame)
        if not session.run(1, None):
            return False
    return True


def _judge_samples(probing: Probing, session: Session) -> None:
    """Judges how samples end that were answered, and how those that were not."""
    pairs = zip(session.samples, session.samples[1:], strict=False)
    following = [(one, after) for one, after in pairs if after.n == one.n + 1]
    answered = [(one, after) for one, after in following if one.n in session.sent_at_s]
    fresh = sum(after.fresh for _, after in answered)
    prompt = sum(session.sent_at_s[one.n] - one.at_s < probing.periods(_LEFT_IN_TIME) for one, _ in answered)
    found = f"{fresh} of {len(answered)} samples that were answered ended with POSITION"
    if not fresh and prompt < 10:
        probing.not_seen("in_time", f"{found}; this host answers too late for {probing.device.rate_hz:g} Hz")
    else:
        probing.judge("in_time", fresh > 0, found)
    withheld = [after for one, after in following if one.n not in session.sent_at_s]
    wrong = [after.n for after in withheld if after.fresh]
    found = f"{len(withheld)} samples were not answered: {len(withheld) - len(wrong)} POSITION_HELD"
    found += f", {len(wrong)} POSITION, the first: {wrong[0]}" if wrong else ""
    if withheld:
        probing.judge("withheld", not wrong, found)
    else:
        probing.not_seen("withheld", f"{found}: the numbers of the samples do not follow each other")


def _judge_counters(probing: Probing, session: Session) -> None:
    read = probing.wire.register
    accepted, rejected, held = read(schema.REG_ACCEPTED), read(schema.REG_REJECTED), read(schema.REG_HELD)
    expired, limited = read(schema.REG_EXPIRED), read(schema.REG_LIMITED)
    # A host that is held up for 256 samples sends one that is too old itself.
    late = 0 if expired is None else max(expired - _OLD - _FUTURE, 0)
    found = f"{expired}; {_OLD} were too old and {_FUTURE} from the future"
    probing.judge("expired", expired is not None and expired >= _OLD + _FUTURE and late <= 3, found)
    found = f"{accepted}; {session.sent} were sent" + (f" and {late} came too late" if late else "")
    probing.judge("accepted", accepted == session.sent - late, found)
    kept = rejected is not None and _DAMAGED <= rejected <= _DAMAGED + 2
    probing.judge("rejected", kept, f"{rejected}; {_DAMAGED} were sent damaged")
    held_samples = sum(not sample.fresh for sample in session.samples)
    missing = session.samples[-1].n + 1 - len(session.samples)
    kept = held is not None and held_samples <= held <= held_samples + missing
    probing.judge("held", kept, f"{held}; {held_samples} POSITION_HELD came")
    probing.judge("not_limited", limited == 0, f"{limited}")
