"""The commands `hapsim chart …`, a file each. They parse, call, and show; pictures are worked out and drawn in
`hapsim/chart`."""

from __future__ import annotations

import typer

from hapsim.commands.chart_felt import felt
from hapsim.commands.chart_plane import plane
from hapsim.commands.chart_speed_accuracy import speed_accuracy
from hapsim.commands.chart_table1 import table1
from hapsim.commands.chart_trace import trace
from hapsim.commands.chart_transparency import transparency
from hapsim.commands.help_text import help_text

app = typer.Typer(
    name="chart",
    help="Draw what the hand feels: pictures as a paper prints them, and their numbers.",
    no_args_is_help=True,
)
for _command in (plane, transparency, table1, speed_accuracy, felt, trace):
    app.command(_command.__name__.replace("_", "-"), help=help_text(_command))(_command)
