"""`hapsim doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.arguments import (
    Data,
    Json,
    MockFlag,
    Port,
    Realtime,
    complain,
    load,
    require_files_writable,
    say_written,
    stderr,
    stdout,
    transport_kind,
)
from hapsim.errors import UsageError
from hapsim.stopping import INTERRUPTED, pass_over


def doctor(
    scene: Annotated[
        str | None, typer.Argument(metavar="[SCENE]", help="Its device is tried; left out: the mock.")
    ] = None,
    port: Port = None,
    mock: MockFlag = False,
    seconds: Annotated[
        float, typer.Option(metavar="S", help="For each of its measurements; a longer one sees rarer gaps.")
    ] = 2.0,
    rates: Annotated[
        list[str] | None, typer.Option(metavar="HZ,…", help="Left out: 1000,2000,4000,10000 and the scene's.")
    ] = None,
    realtime: Realtime = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the wake-up latencies: .svg, .png, .pdf.")
    ] = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Tell how steady this machine is for a haptic loop, which rates it keeps, and what would help.

    A device that is tried is sent no force but zero: the scene runs without its links, every force cut.
    """
    from hapsim.cli.doctor_table import examination_document, examination_line, show_examination
    from hapsim.cli.options import numbers
    from hapsim.doctor.examine import RATES_HZ, examine

    if port is not None and scene is None:
        raise UsageError("--port: found no SCENE, expected the scene whose device is at that port")
    require_files_writable(picture, data)
    with examination_line(stderr()) as tell:
        found = examine(
            None if scene is None else load(scene, port),
            seconds=seconds,
            rates=tuple(numbers("--rates", rates)) or RATES_HZ,
            realtime=realtime,
            transport=transport_kind(mock, None, port),
            on_progress=tell,
        )
    if found.stopped:
        pass_over()  # what is left takes no time worth stopping for
    if picture is not None or data is not None:
        from hapsim.chart.figure import save_rows
        from hapsim.chart.steadiness import columns, draw_steadiness, steadiness

        curves = steadiness(found)
        if data is not None:
            save_rows(columns(curves), data)
        if picture is not None:
            draw_steadiness(curves, f"How steady this machine is: {found.scene}, {seconds:g} s each", picture)
    if json:
        from hapsim.cli.as_json import document

        print(document(examination_document(found)))
    else:
        show_examination(stdout(), found)
        say_written(picture, data)
    if found.stopped:
        complain(f"hapsim: {found.stopped}")
        raise typer.Exit(INTERRUPTED)
    if found.device_failed is not None:
        complain(found.device_failed.failure)
        raise typer.Exit(found.device_failed.exit_status)
