"""The commands `hapsim chart …`, a file each. They parse, call, and show; pictures are worked out and drawn in
`hapsim/chart`."""

from __future__ import annotations

import typer

from hapsim.cli.chart_felt import felt
from hapsim.cli.chart_plane import plane
from hapsim.cli.chart_speed_accuracy import speed_accuracy
from hapsim.cli.chart_table1 import table1
from hapsim.cli.chart_trace import trace
from hapsim.cli.chart_transparency import transparency
from hapsim.cli.help_text import help_text

app = typer.Typer(
    name="chart",
    help="Draw what the hand feels: pictures as a paper prints them, and their numbers.",
    no_args_is_help=True,
)
for _command in (plane, transparency, table1, speed_accuracy, felt, trace):
    app.command(_command.__name__.replace("_", "-"), help=help_text(_command))(_command)
