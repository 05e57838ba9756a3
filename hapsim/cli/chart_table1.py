"""`hapsim chart table1`: the paper's Table 1, predicted and run."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from hapsim.cli.arguments import Json, say_written, stderr, stdout
from hapsim.cli.chart_options import (
    Channel,
    Data,
    Picture,
    SceneFile,
    correction_asked_for,
    hands_asked_for,
    print_json,
    save_rows,
    writable,
)


def table1(
    scene: SceneFile,
    channel: Channel = None,
    as_scene: Annotated[
        bool,
        typer.Option(
            "--as-scene", help="With the scene's hold, delay, friction and damping, in place of the paper's ideal loop."
        ),
    ] = False,
    correction: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="poles, predictor; left out: none, with --as-scene the scene's own."),
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Couple the hand's mass with real and simulated springs (the paper's Table 1), predicted and run on the mock."""
    from hapsim.chart.hand import described
    from hapsim.chart.table1 import draw_table1
    from hapsim.chart.table1 import table1 as table1_of
    from hapsim.cli.live import live_line

    picture = writable(picture, data, json, "table1.svg")
    hand, _ = hands_asked_for(scene, channel, {}, as_written=True)
    corrected = correction_asked_for(correction, scene if as_scene else None)
    with live_line(stderr()) as tell:
        worked_out = table1_of(hand, as_scene=as_scene, correction=corrected, on_progress=tell)
    save_rows(worked_out.columns(), data)
    if picture is not None:
        tuned = f"K = {worked_out.K:.6g} N/m, k = {worked_out.k:.6g} N/m, correction: {corrected}"
        draw_table1(worked_out, f"{tuned}; {described(worked_out.configuration)}", picture)
    if json:
        columns = worked_out.columns()
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        found = {"scene": scene, "correction": corrected, "k": worked_out.k, "K": worked_out.K, "couplings": rows}
        print_json(found, picture, data)
        return
    stdout().print(_table(worked_out))
    say_written(picture, data)


def _table(worked_out: Any) -> Any:
    from rich.table import Table

    table = Table(title="Table 1: a mass on real springs k and simulated springs K", title_justify="left")
    for heading in ("", "k  N/m", "K  N/m", "predicted  Hz", "measured  Hz", "off by", "of I"):
        table.add_column(heading, justify="right" if heading else "left")
    for one in worked_out.couplings.values():
        table.add_row(
            one.numeral,
            f"{one.configuration.stiffness:.6g}",
            f"{one.K:.6g}",
            f"{one.predicted_hz:.9g}",
            f"{one.measured_hz:.9g}",
            f"{one.off_by:+.0e}",
            f"{worked_out.relative(one.numeral):.7f}",
        )
    return table
