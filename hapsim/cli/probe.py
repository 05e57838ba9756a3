"""`hapsim probe`."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import typer

from hapsim.bringup.probe import Leave, judge, open_wire, steps_of
from hapsim.cli.command_options import Json, argument, option, require_positive, require_units
from hapsim.cli.live import live_words
from hapsim.cli.output import document, print_message, set_output_units, stderr, stdout
from hapsim.device.known_motors import note_motors
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.number_format import plural
from hapsim.stopping import stopping_on_signals
from hapsim.units import Units

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.bringup.probe import Judgement


def probe(
    port: str = argument("PORT", "Serial port of the device. `hapsim ports` lists the ports.", default=...),
    baud: int = option("B", "Baud rate of the device's port, bit/s.", default=2_000_000),
    push: float | None = option("N", "Largest push, such as 0.5 (N or N·m) or 50mN [default: zero force]", unit="N"),
    travel: float | None = option(
        "M", "With --push: largest travel, such as 10mm. Beyond it the push stops [default: 5 mm or 0.2 rad]", unit="m"
    ),
    mass: float | None = option(
        "KG", "With --push: moving mass with the hand, such as 200g. Tests force and position scales.", unit="kg"
    ),
    channel: int = option(None, "With --push: channel to push.", default=0),
    pair: str | None = option(
        "X,Y", "With --push: both channels of a hand in the plane, such as 0,1. Pushes each, and finds turned axes"
    ),
    only: list[str] | None = option("STEP", "Run this step only. May be repeated."),
    until: str | None = option("STEP", "Run the steps up to this one [default: all steps]"),
    json: Json = False,
) -> None:
    """Test the device at PORT against the protocol, check by check.

    Steps, in order: conversation, registers, refusals, arming, forces, lines, words, servo (position commands),
    watchdog, blocked (the host stops reading), host (the host paces the loop), push. Without --push, only zero force is
    sent. Step words turns every digital output on for a moment. The exit status is 3 if a check fails. A check that
    could not run does not count as a failure.
    """
    leave = _leave(push, travel, mass, channel, pair)
    steps = steps_of(tuple(only or ()), until)
    require_positive("--baud", baud)
    with live_words(stderr()) as show, open_wire(port, baud) as wire:

        def stop() -> None:
            wire.stop = True

        with stopping_on_signals(stop):
            judgement = judge(
                wire,
                leave=leave,
                steps=steps,
                on_step=lambda step, number, of: show(f"{step}: step {number} of {of}"),
                announce=print_message,
            )
    if leave is not None:
        note_motor(port, leave.pair or (leave.channel,), judgement)
    if judgement.device is not None:
        set_output_units(Units.of(judgement.device.motions))
    if json:
        print(document(_judgement_document(judgement)))
    else:
        show_judgement(stdout(), judgement)
    if judgement.exit_status:
        raise typer.Exit(judgement.exit_status)


def note_motor(port: str, channels: Sequence[int], judgement: Judgement) -> None:
    """Keeps that the motors of these channels, which were pushed, are right; forgets it if the probe failed."""
    pushed = {check.name: check.result for check in judgement.checks if check.step == "push"}
    is_right = pushed.get("sign") == "pass" and "FAIL" not in pushed.values()
    if is_right or judgement.failed:
        note_motors(port, channels, are_right=is_right)


def _leave(
    push: float | None, travel: float | None, mass: float | None, channel: int, pair: str | None
) -> Leave | None:
    """Returns the permitted pushes; None for zero force only. Raises UsageError."""
    for name, value in (("--push", push), ("--travel", travel), ("--mass", mass)):
        require_positive(name, value)
    if channel < 0:
        raise UsageError(f"--channel: found {channel}, expected 0 or more")
    if push is None and mass is not None:
        raise UsageError("--mass needs --push: only a push shows the mass")
    if push is None and pair is not None:
        raise UsageError("--pair needs --push: only pushes show how the axes are turned")
    if push is None:
        return None
    both = _pair(pair) if pair is not None else ()
    first = both[0] if both else channel
    return Leave(push, travel or 0.0, first, mass, both, lambda units: require_units(units, push, travel, mass))


def _pair(text: str) -> tuple[int, ...]:
    """Returns both channels of a pair. Raises UsageError."""
    parts = [part.strip() for part in text.split(",")]
    channels = tuple(int(one) for one in parts if one.isdecimal())
    if len(parts) != 2 or len(set(channels)) != 2:
        raise UsageError(f"--pair: found {text}, expected two channels, such as 0,1")
    return channels


_STYLE = {"pass": "green", "FAIL": "bold red", "not seen": "yellow"}
_INDENT = " " * 10


def show_judgement(out: Console, judgement: Judgement) -> None:
    """Prints every check by its step, and the conclusion."""
    device = judgement.device
    if device is not None:
        facts = f"{plural(device.channels, 'channel')}, {device.rate_hz:g} Hz"
        _print(out, f"{judgement.port}: '{device.name}', {facts}", style="bold")
    step = why = ""
    for check in judgement.checks:
        if check.step != step:
            step, why = check.step, ""
            out.print()
            _print(out, step, style="bold")
        out.print(f"{check.result:<10}", style=_STYLE[check.result], end="")
        found = "for the same reason" if check.result == "not seen" and check.found == why else check.found
        why = check.found if check.result == "not seen" else ""
        _print(out, f"{check.name} (§ {check.section}): {found}", "", _INDENT)
        if check.result == "FAIL":
            _print(out, check.expected, f"{_INDENT}expected: ")
        if check.look_at:
            _print(out, check.look_at, f"{_INDENT}look at:  ")
    out.print()
    _print(out, _conclusion(judgement))


def _print(out: Console, text: str, label: str = "", hanging: str = "", style: str = "") -> None:
    """Prints a paragraph. `hanging`: text that already stands on its first line."""
    width = max(min(out.width, 120), 40)
    for line in text.split("\n"):
        first = label or hanging
        wrapped = textwrap.fill(
            line, width, initial_indent=first, subsequent_indent=" " * len(first), break_long_words=False
        )
        out.print(wrapped[len(hanging) :], markup=False, soft_wrap=True, style=style)


def _counts(judgement: Judgement) -> dict[str, int]:
    return {result: sum(check.result == result for check in judgement.checks) for result in _STYLE}


def _conclusion(judgement: Judgement) -> str:
    count = _counts(judgement)
    sentences = [f"{count['pass']} passed, {count['FAIL']} failed, {count['not seen']} not seen."]
    if judgement.failed:
        sentences.append(f"Begin with {judgement.failed[0].name}: what comes after it may follow from it.")
    if judgement.ended:
        sentences.append(f"It ended early: {judgement.ended}.")
    if not judgement.released:
        sentences.append("The device did not confirm that it is idle. Switch off its power: its force may not be zero.")
    return " ".join(sentences)


def _judgement_document(judgement: Judgement) -> dict[str, Any]:
    """Returns the document of `hapsim probe --json`."""
    counted = zip(("passed", "failed", "not_seen"), _counts(judgement).values(), strict=True)
    return {
        **pick(judgement, "port device checks"),
        **dict(counted),
        **pick(judgement, "released ended_early=ended? exit_status"),
    }
