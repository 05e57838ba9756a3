"""The third step: what the device must not take."""

from __future__ import annotations

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing
from hapsim.bringup.probe.session import arm_frame
from hapsim.bringup.probe.wire import SET_UP, told

_CLOCKS = {schema.PACED_BY_DEVICE: "by the device", schema.PACED_BY_HOST: "by the host", schema.LOCKSTEP: "in lockstep"}


def probe_refusals(probing: Probing) -> bool:
    """Always goes on: whatever armed by mistake was released."""
    device, wire = probing.device, probing.wire
    good = schema.PACED_BY_DEVICE if device.paces(schema.PACED_BY_DEVICE) else schema.PACED_BY_HOST
    other_schema = arm_frame(wire, good, 1, word=schema.SCHEMA_HASH ^ 1)
    _refused(probing, "wrong_schema", "a schema hash with one bit flipped", other_schema, schema.WRONG_SCHEMA)
    for pacing in (*_CLOCKS, 3, 0x7F):
        if pacing > schema.LOCKSTEP or not device.paces(pacing):
            what = f"pacing {pacing} ({_CLOCKS.get(pacing, 'unknown')})"
            _refused(probing, "wrong_pacing", what, arm_frame(wire, pacing, 1), schema.WRONG_PACING)
    for watchdog in dict.fromkeys((0, device.max_watchdog_samples + 1, 4095)):
        frame = arm_frame(wire, good, watchdog)
        _refused(probing, "wrong_watchdog", f"watchdog {watchdog}", frame, schema.WRONG_WATCHDOG)
    if device.senses_velocity:
        probing.findings.not_seen("wrong_sensing", "the device senses velocity on every channel: nothing to refuse")
    else:
        frame = arm_frame(wire, good, 1, velocity=True)
        _refused(probing, "wrong_sensing", "velocities asked for", frame, schema.WRONG_SENSING)
    _disarms(probing)
    return True


def _refused(probing: Probing, name: str, what: str, frame: bytes, fault: int) -> None:
    wire, findings = probing.wire, probing.findings
    answer, _ = wire.ask(frame, lambda one: one.kind == schema.STATUS)
    kept = answer is not None and (answer.wire, answer.number) == (SET_UP, 0)
    kept = kept and answer is not None and (answer.state, answer.fault) == (schema.IDLE, fault)
    look_at = f"the test of ARM for fault {fault} ({schema.FAULTS[fault]}), and what STATUS says beside it"
    others = f"{before}, " if kept and (before := findings.found(name)) else ""
    findings.judge(name, kept, f"{others}{what}" if kept else f"{what}: {told(answer)}", look_at)
    if answer is not None and answer.state == schema.ARMED:
        findings.failed("stays_idle", f"{what}: armed all the same", "ARM is to be refused before anything is changed")
        wire.release()
        return
    _stays(probing, what, fault)


def _stays(probing: Probing, what: str, fault: int) -> None:
    """A device that sent a position has armed, whatever it said."""
    value, heard = probing.wire.ask(
        probing.wire.frame(schema.DESCRIBE, schema.REG_FAULT),
        lambda one: one.kind == schema.DESCRIPTION and one.number == schema.REG_FAULT,
    )
    more = [one for one in heard if one.kind in (schema.POSITION, schema.POSITION_HELD)]
    kept = value is not None and value.word == fault and not more
    if more:
        found = f"{told(more[0])} after {what} was refused"
    elif value is None:
        found = f"no answer to DESCRIBE after {what} was refused"
    else:
        found = f"register 7 reads {value.word} after {what} was refused"
    if not kept:
        look_at = "a refusal sets the fault, and neither state, format nor force"
        probing.findings.failed("stays_idle", found, look_at)
        probing.wire.release()
    else:
        probing.findings.passed(
            "stays_idle", "answers DESCRIBE after each refusal, sends no position; register 7 has the fault"
        )


def _disarms(probing: Probing) -> None:
    wire = probing.wire
    before = wire.register(schema.REG_FAULT)
    answer, _ = wire.ask(wire.frame(schema.DISARM, 0), lambda one: one.kind == schema.STATUS)
    kept = answer is not None and (answer.wire, answer.state, answer.fault) == (SET_UP, schema.IDLE, before)
    look_at = "DISARM is obeyed and answered in every state; only ARM clears the fault"
    probing.findings.judge("disarm_idle", kept, f"{told(answer)}; register 7 read {before}", look_at)
