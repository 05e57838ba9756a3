"""`hapsim chart trace`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.chart_options import ChartOutput
from hapsim.cli.options import option, require_positive
from hapsim.cli.output import say, speak_in
from hapsim.errors import UsageError
from hapsim.recording.trace import load_trace
from hapsim.units import Units

if TYPE_CHECKING:
    from hapsim.recording.trace import Trace


def trace(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A trace (.npz, .trace), the part that a crash left, or a report file."),
    ],
    *,
    last: Annotated[float | None, option("S", "Draw the last S seconds only [default: all]")] = None,
    output: ChartOutput,
) -> None:
    """Draw a recorded trace: position and force over time.

    It marks the forces that were late, clipped, withheld or never sent.
    """
    from hapsim.chart.trace import columns_of, draw_trace, seconds_of

    require_positive("--last", last, "seconds")
    output.choose("trace.svg")
    recorded = load_trace(file)
    speak_in(Units(recorded.report.motion))
    if recorded.sample.size == 0:
        raise UsageError(f"{file}: it has no rows to draw")
    if last is not None:
        time = seconds_of(recorded)
        recorded = recorded.since(int((time < time[-1] - last).sum()))
    about = f"{file.name}: {_about(recorded)}"
    output.write(lambda: columns_of(recorded), lambda path: draw_trace(recorded, about, path))
    if not output.json:
        say(about)
    output.close({"trace": str(file), "rows": recorded.sample.size, "report": asdict(recorded.report)})


def _about(recorded: Trace) -> str:
    drawn, report = recorded.sample.size, recorded.report
    if report.knows_ticks:
        return f"{drawn} of {report.ticks} ticks, {report.ending}"
    return report.ending if drawn == report.ticks else f"{drawn} ticks drawn; {report.ending}"
