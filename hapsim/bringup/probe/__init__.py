"""Judging a device against PROTOCOL.md, step by step, in the order in which its firmware is brought up.

The device is released at the end in any case.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from firmware_protocol.description import Description
from hapsim.bringup.probe.armed_steps import probe_arming, probe_forces
from hapsim.bringup.probe.host_steps import probe_blocked, probe_host_paced, probe_watchdog
from hapsim.bringup.probe.line_steps import probe_line_pushing, probe_lines
from hapsim.bringup.probe.probing import CHECKS, STEPS, Check, Leave, Probing, StoppedError, Wire
from hapsim.bringup.probe.pushed_limits import probe_lives
from hapsim.bringup.probe.pushing import probe_pushing, what_will_be_done
from hapsim.bringup.probe.servo_steps import probe_braking, probe_servo
from hapsim.bringup.probe.set_up_steps import probe_conversation, probe_refusals, probe_registers
from hapsim.bringup.probe.word_steps import probe_words
from hapsim.device.ports import open_portable_port, open_serial_port
from hapsim.errors import DeviceError, UsageError
from hapsim.scales import SCALES

__all__ = ["CHECKS", "STEPS", "Check", "Judgement", "Leave", "judge", "open_wire", "steps_of"]

_PROBES: tuple[tuple[str, Callable[[Probing], bool | None]], ...] = (
    ("conversation", probe_conversation),
    ("registers", probe_registers),
    ("refusals", probe_refusals),
    ("arming", probe_arming),
    ("forces", probe_forces),
    ("lines", probe_lines),
    ("words", probe_words),
    ("servo", probe_servo),
    ("watchdog", probe_watchdog),
    ("blocked", probe_blocked),
    ("host", probe_host_paced),
    ("push", probe_pushing),
    ("push", probe_lives),
    ("push", probe_line_pushing),
    ("push", probe_braking),
)
"""Function of each step. It returns False if no later step can be judged."""

_ALWAYS = STEPS[:2]
"""Steps that always run: no other step can be judged without them."""

OnStep = Callable[[str, int, int], None]
"""Called with the name of each step, its number, and of how many."""


@dataclass(frozen=True)
class Judgement:
    """The results of every check that was asked for."""

    port: str
    device: Description | None
    checks: tuple[Check, ...]
    released: bool
    """True if the device reported at the end that it is idle."""
    ended: str = ""
    """Reason for an early end, if there was one."""
    interrupted: bool = False

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.result == "FAIL")

    @property
    def exit_status(self) -> int:
        """0, 3 if a check failed or the device went away, or 130."""
        return 130 if self.interrupted else 3 if self.failed or self.ended else 0


def steps_of(only: tuple[str, ...], until: str | None) -> tuple[str, ...]:
    """Returns the requested steps, and those that every other needs. Raises UsageError if there is no such step."""
    for option, names in (("--only", only), ("--until", (until,) if until else ())):
        for name in names:
            if name not in STEPS:
                raise UsageError(f"{option}: found '{name}', expected one of {', '.join(STEPS)}")
    wanted = STEPS[: STEPS.index(until) + 1] if until else STEPS
    return tuple(step for step in STEPS if step in _ALWAYS or (step in wanted and (not only or step in only)))


@contextlib.contextmanager
def open_wire(port: str, baud: int = 2_000_000) -> Iterator[Wire]:
    """Opens the wire to the device at a port. Raises DeviceError if that is not possible."""
    opened = open_serial_port(port, baud) if sys.platform == "linux" else open_portable_port(port, baud)
    with contextlib.closing(opened) as connection:
        yield Wire(connection)


def judge(
    wire: Wire,
    *,
    leave: Leave | None = None,
    steps: tuple[str, ...] = STEPS,
    on_step: OnStep = lambda _step, _number, _of: None,
    announce: Callable[[str], None] = lambda _sentence: None,
) -> Judgement:
    """Judges a device against PROTOCOL.md, and releases it. Without `leave` no force but zero is sent.

    `announce` is called with what will be done before the device is pushed. The wire's `stop` ends it.
    """
    probing = Probing(wire, leave)
    ended, interrupted, released = "", False, False
    try:
        _run(probing, steps, on_step, announce)
    except StoppedError:
        interrupted, ended = True, "stopped by a signal"
    except DeviceError as error:
        ended = str(error)
    finally:
        with contextlib.suppress(DeviceError):
            released = wire.received > 0 and wire.release() is not None
    for step in steps:
        probing.leave_out(step, f"not reached: {ended}" if ended else "not reached")
    checks = tuple(probing.results[check.name] for check in CHECKS if check.step in steps)
    return Judgement(wire.name, probing.description, checks, released, ended, interrupted)


def _run(probing: Probing, steps: tuple[str, ...], on_step: OnStep, announce: Callable[[str], None]) -> None:
    for step, run in _PROBES:
        if step not in steps:
            continue
        on_step(step, steps.index(step) + 1, len(steps))
        if run is probe_pushing and probing.leave is not None:
            channel, channels = max(probing.leave.channels), probing.device.channels
            if channel >= channels:
                expected = f"0 to {channels - 1}: the device has {channels}"
                raise UsageError(
                    f"--{'pair' if probing.leave.pair else 'channel'}: found {channel}, expected {expected}"
                )
            channel = probing.leave.channel
            probing.leave.require(probing.units_of(channel))
            usual = SCALES[probing.device.motions[channel]].travel
            probing.leave = replace(probing.leave, travel=probing.leave.travel or usual)
            announce(what_will_be_done(probing, probing.leave))
        try:
            goes_on = run(probing) is not False
        except DeviceError as error:
            look_at = "its hardware watchdog, which ends a tick that died or waits for room; a crash; the cable"
            probing.fail_next(step, f"the device went away here: {error}", look_at)
            raise
        if not goes_on:
            return
