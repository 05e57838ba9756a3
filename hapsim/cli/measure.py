"""`hapsim measure`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.arguments import (
    Data,
    Files,
    Json,
    MockFlag,
    Port,
    Record,
    SceneFile,
    TransportOption,
    Unstable,
    seconds_above_zero,
    transport_kind,
)
from hapsim.errors import UsageError


def measure(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    channel: Annotated[
        int | None,
        typer.Option(help="The channel whose hand is rung, or whose impedance is shown; left out: the first, or all."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            callback=seconds_above_zero,
            help="Seconds; left out: about two, or with --impedance eight for each channel.",
        ),
    ] = None,
    impedance: Annotated[
        bool,
        typer.Option("--impedance", help="Measure the driving-point impedance over frequency, in place of k and b."),
    ] = False,
    travel: Annotated[
        float | None,
        typer.Option(metavar="M", help="With --impedance: how far a hand is moved at most, about, in m: 0.001."),
    ] = None,
    z_width: Annotated[
        bool,
        typer.Option("--z-width", help="With --impedance: put the stiffest passive wall in the scene's place, too."),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the ring-down, or the impedance: .svg, .png, .pdf.")
    ] = None,
    data: Data = None,
    record: Record = None,
    unstable: Unstable = False,
    json: Json = False,
) -> None:
    """Ring the hand, identify the spring and damper that it felt, and set them beside the prediction.

    It pushes the hand: now and then, to one side and the other, with up to a quarter of the scene's force_limit.
    With --impedance it excites each channel in turn by many frequencies at once, with as much.
    """
    kind, files = transport_kind(mock, transport, port), Files(picture, data, record)
    if impedance:
        from hapsim.cli.measure_impedance import measure_impedance

        measure_impedance(scene, port, kind, channel, duration, travel, z_width, files, unstable, json)
        return
    if travel is not None or z_width:
        raise UsageError("--travel and --z-width go with --impedance: it is missing")
    from hapsim.cli.measure_pair import measure_pair

    measure_pair(scene, port, kind, channel, duration, files, unstable, json)
