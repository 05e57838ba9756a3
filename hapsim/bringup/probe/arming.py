"""The fourth step: armed, paced by itself, at zero force: numbers, rate, jitter, and what an armed device ignores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing, status_found
from hapsim.bringup.probe.session import Session, arm_frame
from hapsim.bringup.probe.wire import ARMED, SET_UP, told

STEP = "arming"
_TOLERANCE = 0.01  # of the rate: what a damper's force is off by, too
_WINDOWS = 24
_BURSTS = 100.0  # times the rate: what comes so fast has waited, and came in one piece


def probe_arming(probing: Probing) -> bool:
    """Whether the device arms and sends positions."""
    session = probing.arm_by_device(STEP, probing.longest_watchdog)
    if session is None:
        if probing.device.paces(schema.PACED_BY_DEVICE):
            look_at = "the tests of ARM: schema hash, pacing, watchdog; a fault of the device's own (6)"
            probing.findings.failed("arm", "no STATUS armed within 1 s", look_at)
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
    probing.findings.judge("arm", kept, status_found(session), look_at)


def _judge_first(probing: Probing, session: Session) -> bool:
    if session.samples:
        first = session.samples[0]
        kept = first.n == 0 and first.fresh
        kind = "POSITION" if first.fresh else "POSITION_HELD"
        look_at = "POSITION 0 is measured at arming and sent after STATUS; the first tick is a period later"
        probing.findings.judge("first_position", kept, f"{kind} {first.n}, in the armed format", look_at)
        return True
    if session.others:
        found = f"no position in the armed format, but {told(session.others[0])}"
    elif session.wire.damaged:
        found = f"no position, but {len(session.wire.damaged)} pieces that are a frame in no format"
    else:
        found = "nothing after STATUS armed"
    channels = probing.device.channels
    look_at = f"the armed format of {channels} channels: {channels} words, its start value, its check; the sample timer"
    probing.findings.failed("first_position", found, look_at)
    return False


def _judge_numbers(probing: Probing, session: Session, going: bool) -> None:
    numbers = [sample.n for sample in session.samples]
    steps = np.diff(numbers)
    if session.ended is not None:
        found = f"after position {numbers[-1]}: {told(session.ended)}"
        probing.findings.failed("numbers", found, "are FORCE frames decoded while armed? One was sent for every sample")
    elif not going:
        found = f"nothing more after position {numbers[-1]}"
        probing.findings.failed("numbers", found, "the sample timer, and a transmitter that stalls")
    elif (wrong := np.flatnonzero(steps != 1)).size:
        at = int(wrong[0])
        found = f"{wrong.size} of {steps.size} steps are not 1; the first: {numbers[at]}, then {numbers[at + 1]}"
        probing.findings.failed("numbers", found, _why_gaps(probing))
    else:
        probing.findings.passed("numbers", f"0 to {numbers[-1]}, each one more")


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
    findings, nominal = probing.findings, probing.device.rate_hz
    numbers = np.array([sample.n for sample in session.samples])
    at_s = np.array([sample.at_s for sample in session.samples])
    if numbers.size < 4 * _WINDOWS:
        findings.not_seen("rate_kept", f"only {numbers.size} samples came")
        findings.not_seen("jitter", f"only {numbers.size} samples came")
        return
    rate = rate_of(numbers, at_s, nominal)
    if not 0.0 < rate.hz < _BURSTS * nominal:
        findings.not_seen("rate_kept", "the positions came in bursts: this host, or the device, is held up too often")
        findings.not_seen("jitter", "the positions came in bursts")
        return
    off = rate.hz / nominal - 1.0
    found = f"{rate.hz:.6g} ± {rate.uncertainty:.1g} Hz, {100 * off:+z.2f} % from register 4 ({nominal:g} Hz)"
    if rate.uncertainty > 0.5 * _TOLERANCE * nominal:
        findings.not_seen("rate_kept", f"{found}: this host is too unsteady to tell 1 %")
    else:
        look_at = "the sample timer's divider, the clock that it counts, registers 4 and 5; by this host's clock"
        findings.judge("rate_kept", abs(off) <= _TOLERANCE, f"{found}; {100 * _TOLERANCE:g} % is allowed", look_at)
    intervals = 1e3 * np.diff(at_s) / np.diff(numbers)
    low, middle, high = np.quantile(intervals, (0.01, 0.5, 0.99))
    findings.passed(
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
    probing.findings.judge("ignores_when_armed", kept, found, look_at)


def _judge_disarm(probing: Probing, session: Session) -> None:
    wire = session.wire
    answer = session.disarm()
    after = wire.hear_for(max(0.05, probing.periods(5)))
    kept = answer is not None and answer.wire == SET_UP and not after
    found = told(answer) + (f"; after it {told(after[0])}" if after else "")
    look_at = "DISARM in the armed format: force zero, idle, the set-up format, and only then STATUS"
    if not probing.findings.judge("disarm_armed", kept, found, look_at):
        wire.release()


def _judge_velocities(probing: Probing) -> None:
    if not probing.device.senses_velocity:
        probing.findings.not_seen("velocities", "no velocity is sensed (register 38)")
        return
    session = probing.arm(schema.PACED_BY_DEVICE, probing.longest_watchdog, velocity=True)
    if session is None:
        look_at = "bit 7 of ARM's argument, beside the pacing in bits 6 to 0"
        probing.findings.failed("velocities", "ARM with velocities is refused", look_at)
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
    probing.findings.judge("velocities", kept, found, look_at)
    if session.disarm() is None:
        probing.wire.release()
