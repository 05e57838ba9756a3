"""`hapsim chart felt`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from hapsim.cli.chart_options import ChartOutput, HandOptions
from hapsim.cli.output import say, stdout
from hapsim.number_format import percent

if TYPE_CHECKING:
    from hapsim.chart.felt import FeltChart


def felt(
    hand: HandOptions,
    *,
    mass: Annotated[float | None, typer.Option(metavar="M", help="Mass of hand and handle, kg.")] = None,
    normalised: Annotated[
        bool, typer.Option("--normalised", help="The paper's units; --mass and --rate default to 1.")
    ] = False,
    output: ChartOutput,
) -> None:
    """Draw which desired stiffness and damping the hand feels, with each correction.

    Options of the hand take precedence over the scene's values (configs/README.md has an example).
    """
    from hapsim.chart.felt import draw_felt, felt_chart
    from hapsim.chart.hand import described

    output.require_writable("felt.svg")
    masses = [] if mass is None else [mass]
    if normalised:
        hand, masses = hand.normalised(masses)
    chosen, _ = hand.hands(masses[0] if masses else None, as_written=True)
    chart = felt_chart(chosen)
    if output.data is not None:
        output.save_rows(chart.columns())
    if output.picture is not None:
        draw_felt(chart, described(chosen.configuration, normalised=normalised), output.picture)
    if not output.json:
        stdout().print(_table(chart))
        say(
            f"Limit of any controller: {percent(chart.limit, 3)}, the motions below half the rate; samples do not "
            "distinguish faster ones. Where no (K, B) is felt as desired, hapsim simulates the nearest, which counts "
            "here as not felt."
        )
    output.close({"scene": hand.scene, **chart.summary()} if output.json else {})


def _table(chart: FeltChart) -> Any:
    from hapsim.chart.felt import WITHIN

    table = Table(title="Share of the plane felt within", title_justify="left")
    table.add_column("correction")
    for within in WITHIN:
        table.add_column(percent(within, 3), justify="right")
    for name, felt in chart.felt.items():
        table.add_row(name, *(percent(felt.share(within), 3) for within in WITHIN))
    return table
