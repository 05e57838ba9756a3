"""`hapsim probe`."""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from hapsim.bringup.probe import Leave, steps_of
from hapsim.bringup.probe import probe as judge
from hapsim.cli.as_json import document
from hapsim.cli.live import live_words
from hapsim.cli.options import Json
from hapsim.cli.output import complain, stderr, stdout
from hapsim.device.known_devices import is_new
from hapsim.errors import UsageError
from hapsim.stopping import stopping_on_signals

if TYPE_CHECKING:
    from hapsim.bringup.probe import Check, Judgement, Leave
    from hapsim.bringup.probe.wire import Wire


def probe(
    port: Annotated[str, typer.Argument(metavar="PORT", help="The device's serial port (`hapsim ports` lists them).")],
    baud: Annotated[int, typer.Option(metavar="B", help="Bit/s, where the port has a speed of its own.")] = 2_000_000,
    push: Annotated[
        float | None,
        typer.Option(metavar="N", help="Allow pushes of at most N newton, for example 0.5 [default: zero force only]."),
    ] = None,
    travel: Annotated[
        float, typer.Option(metavar="M", help="With --push: stop where the device moves farther, in m.")
    ] = 0.005,
    mass: Annotated[
        float | None, typer.Option(metavar="KG", help="With --push: what is moved, hand included, for the scales.")
    ] = None,
    channel: Annotated[int, typer.Option(help="With --push: the channel that is pushed.")] = 0,
    only: Annotated[list[str] | None, typer.Option(metavar="STEP", help="This step alone; may be repeated.")] = None,
    until: Annotated[str | None, typer.Option(metavar="STEP", help="The steps up to this one.")] = None,
    json: Json = False,
) -> None:
    """Judge the device at PORT against the protocol, check by check, in the order of bringing up a firmware.

    Steps: conversation, registers, refusals, arming, forces, watchdog, blocked, host, push. Without --push no force but
    zero is asked for. Exit status 3 where a check fails; what was not seen is no failure.
    """

    leave = _leave(push, travel, mass, channel)
    steps = steps_of(tuple(only or ()), until)
    if baud <= 0:
        raise UsageError(f"--baud: found {baud}, expected a number above 0")
    wires: list[Wire] = []

    def stop() -> None:
        for wire in wires:
            wire.stop = True

    with step_line(stderr()) as tell, stopping_on_signals(stop):
        judgement = judge(port, baud=baud, leave=leave, steps=steps, on_step=tell, say=complain, on_wire=wires.append)
    if any(check.name == "sign" and check.result in ("pass", "FAIL") for check in judgement.checks):
        is_new(port)  # from now on not
    if json:
        print(document(judgement_document(judgement)))
    else:
        show_judgement(stdout(), judgement)
    if judgement.exit_status:
        raise typer.Exit(judgement.exit_status)


def _leave(push: float | None, travel: float, mass: float | None, channel: int) -> Leave | None:

    for option, value in (("--push", push), ("--travel", travel), ("--mass", mass)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UsageError(f"{option}: found {value:g}, expected a finite number above 0")
    if channel < 0:
        raise UsageError(f"--channel: found {channel}, expected 0 or more")
    if push is None:
        if mass is not None:
            raise UsageError("--mass: found no --push, expected the leave to push: a mass shows in no other way")
        return None
    return Leave(push, travel, channel, mass)


_STYLE = {"pass": "green", "FAIL": "bold red", "not seen": "yellow"}
_INDENT = " " * 10


@contextlib.contextmanager
def step_line(error: Console) -> Iterator[Callable[[str, int, int], None]]:
    """A function to tell each step to: its name, its number, and of how many."""
    with live_words(error) as say:
        yield lambda step, number, of: say(f"{step}: step {number} of {of}")


def show_judgement(out: Console, judgement: Judgement) -> None:
    """Every check by its step, and what it comes to."""
    device = judgement.device
    if device is not None:
        words = f"{device.channels} channel{'s' if device.channels > 1 else ''}, {device.rate_hz:g} Hz"
        _print(out, "", f"{judgement.port}: '{device.name}', {words}", "bold")
    step = ""
    for check in judgement.checks:
        if check.step != step:
            step = check.step
            _print(out, "", f"\n{step}", "bold")
        _show_check(out, check)
    out.print()
    _print(out, "", _conclusion(judgement))


def _show_check(out: Console, check: Check) -> None:
    name = f"{check.name} (§ {check.section})"
    out.print(f"{check.result:<10}", style=_STYLE[check.result], end="")
    lines = textwrap.wrap(f"{name}: {check.found}", _width(out) - len(_INDENT), break_long_words=False)
    out.print(f"\n{_INDENT}".join(lines), markup=False, soft_wrap=True)
    if check.result == "FAIL":
        _print(out, "expected: ", check.expected)
    if check.look_at:
        _print(out, "look at:  ", check.look_at)


def _width(out: Console) -> int:
    return max(min(out.width, 120), 40)


def _print(out: Console, label: str, text: str, style: str = "") -> None:
    indent = _INDENT + label if label else ""
    hanging = " " * len(indent)
    for line in text.split("\n"):
        wrapped = textwrap.fill(
            line, _width(out), initial_indent=indent, subsequent_indent=hanging, break_long_words=False
        )
        out.print(wrapped, markup=False, soft_wrap=True, style=style)


def _conclusion(judgement: Judgement) -> str:
    count = {result: sum(check.result == result for check in judgement.checks) for result in _STYLE}
    told = f"{count['pass']} passed, {count['FAIL']} failed, {count['not seen']} not seen."
    if judgement.failed:
        told += f" Begin with {judgement.failed[0].name}: what comes after it may follow from it."
    if judgement.ended:
        told += f" It ended early: {judgement.ended}."
    if not judgement.released:
        told += " The device did not say that it is idle: take its power, before you trust its force to be zero."
    return told


def judgement_document(judgement: Judgement) -> dict[str, Any]:
    """What `hapsim probe --json` prints."""
    return {
        "port": judgement.port,
        "device": None if judgement.device is None else asdict(judgement.device),
        "checks": [asdict(check) for check in judgement.checks],
        "passed": sum(check.result == "pass" for check in judgement.checks),
        "failed": len(judgement.failed),
        "not_seen": sum(check.result == "not seen" for check in judgement.checks),
        "released": judgement.released,
        "ended_early": judgement.ended or None,
        "exit_status": judgement.exit_status,
    }
