"""`hapsim probe`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import Json, complain, stderr, stdout
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.bringup.probe import Leave
    from hapsim.bringup.probe.wire import Wire


def probe(
    port: Annotated[str, typer.Argument(metavar="PORT", help="The device's serial port (`hapsim ports` lists them).")],
    baud: Annotated[int, typer.Option(metavar="B", help="Bit/s, where the port has a speed of its own.")] = 2_000_000,
    push: Annotated[
        float | None,
        typer.Option(metavar="N", help="Allow pushing, with at most N newton; left out: zero force alone. Try 0.5."),
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
    from hapsim.bringup.probe import probe as judge
    from hapsim.bringup.probe import steps_of
    from hapsim.cli.probe_table import judgement_document, show_judgement, step_line
    from hapsim.device.known_devices import is_new
    from hapsim.running.signals import stopping_on_signals

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
        from hapsim.cli.as_json import document

        print(document(judgement_document(judgement)))
    else:
        show_judgement(stdout(), judgement)
    if judgement.exit_status:
        raise typer.Exit(judgement.exit_status)


def _leave(push: float | None, travel: float, mass: float | None, channel: int) -> Leave | None:
    from hapsim.bringup.probe import Leave

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
