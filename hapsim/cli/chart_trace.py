"""`hapsim chart trace`: what was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import Json, say_written
from hapsim.cli.chart_options import Data, Picture, print_json, writable
from hapsim.cli.sentences import say
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.recording.trace import Trace


def trace(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A record, .npz or .trace, what is left of one, or a report file."),
    ],
    last: Annotated[
        float | None, typer.Option(metavar="S", help="Draw the last so many seconds; left out: all of it.")
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw what was recorded: position and force over time, and which forces were late, cut, withheld or
    never sent."""
    from hapsim.chart.figure import save_columns
    from hapsim.chart.recorded import columns_of, draw_trace, seconds_of
    from hapsim.cli.as_json import report_document
    from hapsim.recording.trace import load_trace

    if last is not None and not 0 < last < float("inf"):
        raise UsageError(f"--last: found {last:g}, expected a finite number of seconds above 0")
    picture = writable(picture, data, json, "trace.svg")
    recorded = load_trace(file)
    if recorded.sample.size == 0:
        raise UsageError(f"{file}: there is no row in it to be drawn")
    if last is not None:
        time = seconds_of(recorded)
        recorded = recorded.since(int((time < time[-1] - last).sum()))
    if data is not None:
        save_columns(columns_of(recorded), data)
    about = f"{file.name}: {_what_is_drawn(recorded)}"
    if picture is not None:
        draw_trace(recorded, about, picture)
    if json:
        drawn = {"trace": str(file), "rows": recorded.sample.size, "report": report_document(recorded.report)}
        print_json(drawn, picture, data)
        return
    say(about)
    say_written(picture, data)


def _what_is_drawn(recorded: Trace) -> str:
    drawn, report = recorded.sample.size, recorded.report
    if report.knows_ticks:
        return f"{drawn} of {report.ticks} ticks, {report.ending}"
    return report.ending if drawn == report.ticks else f"{drawn} ticks drawn; {report.ending}"
