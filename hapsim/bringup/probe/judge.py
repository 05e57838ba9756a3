"""A device on a port, judged step by step; whatever happens, it is released at the end."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from firmware_protocol.description import Description
from hapsim.bringup.probe.armed_steps import probe_arming, probe_forces
from hapsim.bringup.probe.checks import STEPS, Check, Leave, Probing
from hapsim.bringup.probe.host_steps import probe_blocked, probe_host_paced, probe_watchdog
from hapsim.bringup.probe.pushed_limits import probe_lives
from hapsim.bringup.probe.pushing import probe_pushing, what_will_be_done
from hapsim.bringup.probe.set_up_steps import probe_conversation, probe_refusals, probe_registers
from hapsim.bringup.probe.wire import StoppedError, Wire
from hapsim.device.connection import Connection
from hapsim.device.serial_port import open_portable_port, open_serial_port
from hapsim.errors import DeviceError, UsageError

_PROBES: dict[str, tuple[Callable[[Probing], bool], ...]] = {
    "conversation": (probe_conversation,),
    "registers": (probe_registers,),
    "refusals": (probe_refusals,),
    "arming": (probe_arming,),
    "forces": (probe_forces,),
    "watchdog": (probe_watchdog,),
    "blocked": (probe_blocked,),
    "host": (probe_host_paced,),
    "push": (probe_pushing, probe_lives),
}
_ALWAYS = STEPS[:2]
"""Without which nothing else can be judged."""


@dataclass(frozen=True)
class Judgement:
    """What became of every check that was asked for."""

    port: str
    device: Description | None
    checks: tuple[Check, ...]
    released: bool
    """Whether the device said, at the end, that it is idle."""
    ended: str = ""
    """Why it ended early; empty where it did not."""
    interrupted: bool = False

    @property
    def failed(self) -> tuple[Check, ...]:
        return tuple(check for check in self.checks if check.result == "FAIL")

    @property
    def exit_status(self) -> int:
        return 130 if self.interrupted else 3 if self.failed or self.ended else 0


def steps_of(only: tuple[str, ...], until: str | None) -> tuple[str, ...]:
    """The steps that are asked for, and those that everything else takes. UsageError where there is no such step."""
    for option, names in (("--only", only), ("--until", (until,) if until else ())):
        for name in names:
            if name not in STEPS:
                raise UsageError(f"{option}: found '{name}', expected one of {', '.join(STEPS)}")
    last = STEPS.index(until) if until else len(STEPS) - 1
    wanted = tuple(step for i, step in enumerate(STEPS) if i <= last and (not only or step in only))
    return tuple(step for step in STEPS if step in wanted or step in _ALWAYS)


def probe(
    port: str,
    *,
    baud: int = 2_000_000,
    leave: Leave | None = None,
    steps: tuple[str, ...] = STEPS,
    on_step: Callable[[str, int, int], None] = lambda _step, _number, _of: None,
    say: Callable[[str], None] = lambda _sentence: None,
    on_wire: Callable[[Wire], None] = lambda _wire: None,
) -> Judgement:
    """Judges the device at a port against PROTOCOL.md. No force but zero is asked for without `leave`.

    `on_step(name, number, of)` hears of each step, `say` what will be done before the device is pushed; `on_wire` gets
    the wire, whose `stop` ends it. DeviceError where the port cannot be opened.
    """
    with contextlib.closing(_open(port, baud)) as connection:
        wire = Wire(connection)
        on_wire(wire)
        return judge(wire, leave=leave, steps=steps, on_step=on_step, say=say)


def judge(
    wire: Wire,
    *,
    leave: Leave | None = None,
    steps: tuple[str, ...] = STEPS,
    on_step: Callable[[str, int, int], None] = lambda _step, _number, _of: None,
    say: Callable[[str], None] = lambda _sentence: None,
) -> Judgement:
    """The same over a wire that is open already."""
    probing = Probing(wire, leave=leave)
    ended, interrupted, released = "", False, False
    try:
        _run(probing, steps, on_step, say)
    except StoppedError:
        interrupted, ended = True, "stopped by a signal"
    except DeviceError as error:
        ended = str(error)
    finally:
        with contextlib.suppress(DeviceError):
            released = wire.received > 0 and wire.release() is not None
    if ended:
        for step in steps:
            probing.leave_out(step, f"not reached: {ended}")
    return Judgement(wire.name, probing.description, probing.all_of(steps), released, ended, interrupted)


def _open(port: str, baud: int) -> Connection:
    return open_serial_port(port, baud) if sys.platform == "linux" else open_portable_port(port, baud)


def _run(
    probing: Probing, steps: tuple[str, ...], on_step: Callable[[str, int, int], None], say: Callable[[str], None]
) -> None:
    for step, run in _those(steps):
        on_step(step, steps.index(step) + 1, len(steps))
        if step == "push" and run is probe_pushing and probing.leave is not None:
            _require_channel(probing, probing.leave)
            say(what_will_be_done(probing, probing.leave))
        try:
            goes_on = run(probing)
        except DeviceError as error:
            look_at = "its hardware watchdog, which ends a tick that died or waits for room; a crash; the cable"
            probing.failed_next(step, f"the device went away here: {error}", look_at)
            raise
        if not goes_on:
            return


def _those(steps: tuple[str, ...]) -> Iterator[tuple[str, Callable[[Probing], bool]]]:
    for step in steps:
        for run in _PROBES[step]:
            yield step, run


def _require_channel(probing: Probing, leave: Leave) -> None:
    channels = probing.device.channels
    if not 0 <= leave.channel < channels:
        raise UsageError(f"--channel: found {leave.channel}, expected 0 to {channels - 1}: the device has {channels}")
