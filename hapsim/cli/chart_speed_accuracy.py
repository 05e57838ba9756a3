"""`hapsim chart speed-accuracy`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.chart_options import ChartOutput
from hapsim.cli.live import live_words
from hapsim.cli.options import names, numbers
from hapsim.cli.output import say, stderr
from hapsim.errors import UsageError

_OBJECTS = "spring, contact, string-10, string-100, string-1000, stiff-string-100"


def speed_accuracy(
    *,
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", metavar="NAME", help=f"Objects, a list: {_OBJECTS} [default: all]"),
    ] = None,
    schemes: Annotated[
        list[str] | None,
        typer.Option("--scheme", metavar="NAME", help="Schemes, a list such as cordis,exact [default: all]"),
    ] = None,
    rates: Annotated[
        list[str] | None,
        typer.Option("--rates", metavar="HZ", help="Sample rates, Hz, a list [default: 500 to 50000]"),
    ] = None,
    rounds: Annotated[int, typer.Option(metavar="N", help="How often each is timed, in turns.")] = 5,
    peers: Annotated[
        Path | None,
        typer.Option("--with", metavar="FILE.json", help="Draw peers too, as tools/bench/schemes recorded them."),
    ] = None,
    output: ChartOutput,
) -> None:
    """Draw the cost of a simulated second against the error: objects, schemes, rates.

    The error is the distance from the continuous object.
    """
    from hapsim.chart.speed_accuracy import draw_speed_accuracy
    from hapsim.speed_accuracy.comparison import RATES, compare, objects_named, schemes_named
    from hapsim.speed_accuracy.results import columns, fronts, peers_in, verdict

    chosen, by = objects_named(names(objects)), schemes_named(names(schemes))
    at = _above_zero(numbers("--rates", rates)) or RATES
    if rounds < 1:
        raise UsageError(f"--rounds: found {rounds}, expected a whole number of at least 1")
    output.require_writable("speed-accuracy.svg")
    rows = [] if peers is None else peers_in(peers, [one.name for one in chosen])
    with live_words(stderr()) as tell:
        rows = compare(chosen, at, rounds, tell, by) + rows
    output.save_rows(columns(rows, [row for front in fronts(rows).values() for row in front]))
    if output.picture is not None:
        draw_speed_accuracy(chosen, rows, output.picture)
    verdicts = {one.name: verdict(one, rows) for one in chosen}
    if not output.json:
        for sentence in verdicts.values():
            say(sentence)
    output.close({"objects": verdicts, "rows": [row.as_document() for row in rows]})


def _above_zero(found: list[float]) -> list[float]:
    for rate in found:
        if not 0.0 < rate < float("inf"):
            raise UsageError(f"--rates: found {rate:g}, expected a finite number above 0")
    return found
