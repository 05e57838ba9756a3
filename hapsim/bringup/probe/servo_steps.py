"""A servo: the armed format with hand forces and position commands; with the user's permission, how it stops.

For the braking the host moves the handle at a steady speed and then falls silent, with a short time to live and a long
watchdog: so the device reports how it comes to rest.
"""

from __future__ import annotations

from firmware_protocol import schema
from firmware_protocol.description import Servo
from hapsim.bringup.probe.probing import LONG_LIFE, Probing, Sample, Session, in_words
from hapsim.bringup.probe.pushing import STEP

_HELD = 100  # samples
_LIVES = 10  # samples: the time to live of the last commands
_SHARE = 0.25  # of the travel that is allowed: the commanded way; braking takes as much again at most
_LASTS_S, _RESTS_S = 0.5, 1.0
_FOLLOWS_NONE = f"no position commands are followed, or no hand force is sensed (register {schema.REG_SENSORS})"
_BESIDE, _COUNTS = 0.05, 3  # relative and in counts: of the way of a servo that overshoots a little


def probe_servo(probing: Probing) -> None:
    """Always goes on."""
    if not _follows(probing):
        probing.leave_out("servo", _FOLLOWS_NONE)
        return
    session = _arm(probing, "servo")
    if session is None:
        return
    going = session.run(_HELD, lambda sample: _command(session, sample, session.samples[0].counts))
    probing.judge_taken("commands", session, going, session.others, schema.REG_LIMITED)


def probe_braking(probing: Probing) -> None:
    """Always goes on. Comes after the pushes, whose permission it has."""
    leave, servo, device = probing.leave, probing.device.servo, probing.device
    if servo is None or leave is None or not _follows(probing):
        why = "not allowed to move it: see --push" if _follows(probing) else _FOLLOWS_NONE
        probing.not_seen("servo_brakes", why)
        return
    if (session := _arm(probing, STEP)) is None:
        return
    channel, commands = leave.channel, list[int]()
    silence = min(probing.samples_in(_RESTS_S, 40, 4000), device.max_watchdog_samples - _LIVES)
    scale, speed = device.position_scale[channel], _speed(servo, channel, leave.travel, probing.periods(silence))

    def go_on(sample: Sample) -> None:
        commands[:] = session.samples[0].counts[: device.channels]
        commands[channel] += round(speed / device.rate_hz / scale * sample.n)
        _command(session, sample, commands, _LIVES)

    going = session.run(probing.samples_in(_LASTS_S, 20, 2000), go_on)
    silent = going and session.run(silence, None)
    session.disarm()
    if not silent:
        probing.judge("servo_brakes", False, f"{in_words(session.ended)} after {len(session.samples)} positions")
        return
    places, last = [scale * sample.counts[channel] for sample in session.samples], scale * commands[channel]
    most = speed**2 / 2.0 / servo.braking[channel] + speed * probing.periods(_LIVES + 1)
    most, way, still = (1.0 + _BESIDE) * most + _COUNTS * scale, max(places) - last, _COUNTS * scale
    units, rests = probing.units_of(channel), max(places[-20:]) - min(places[-20:]) <= still
    found = f"commanded {units(last - places[0], 'mm', '.3g')} at {units(speed, 'm/s', '.3g')}, then silent: it went "
    found += f"{units(way, 'mm', '.3g')} on; {units(most, 'mm', '.3g')} at most is right"
    probing.judge("servo_brakes", rests and abs(way) <= most, found + ("" if rests else "; it does not rest"))


def _follows(probing: Probing) -> bool:
    return {"hand_force", "command"} <= {*probing.device.parts}


def _speed(servo: Servo, channel: int, travel: float, silence_s: float) -> float:
    """Returns a speed (m/s) that takes the allowed share of `travel`, and that the servo brakes in half the silence."""
    return min(_SHARE * travel / _LASTS_S, servo.speed_limit[channel], servo.braking[channel] * 0.5 * silence_s)


def _arm(probing: Probing, step: str) -> Session | None:
    return probing.arm_by_device(step, probing.device.max_watchdog_samples, parts=schema.ADMITTANCE)


def _command(session: Session, sample: Sample, counts: tuple[int, ...] | list[int], lives: int = LONG_LIFE) -> None:
    channels = session.wire.armed.channels
    session.force(sample.n, [0] * channels + [*counts[:channels]], lives)
