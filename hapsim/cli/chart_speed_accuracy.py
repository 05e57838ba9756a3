"""`hapsim chart speed-accuracy`: what a simulated second costs against its error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.arguments import Json, say_written, stderr
from hapsim.cli.chart_options import (
    Data,
    Picture,
    print_json,
    save_rows,
    writable,
)
from hapsim.cli.options import names, numbers
from hapsim.cli.sentences import say
from hapsim.errors import UsageError

_OBJECTS = "spring, contact, string-10, string-100, string-1000, stiff-string-100"


def speed_accuracy(
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", metavar="NAME", help=f"{_OBJECTS}; several, spring,contact; left out: all."),
    ] = None,
    schemes: Annotated[
        list[str] | None,
        typer.Option("--scheme", metavar="NAME", help="Schemes: several, cordis,exact; left out: all."),
    ] = None,
    rates: Annotated[
        list[str] | None,
        typer.Option("--rates", metavar="HZ", help="Sample rates, Hz: several, 1000,10000; left out: 500 to 50000."),
    ] = None,
    rounds: Annotated[int, typer.Option(metavar="N", help="How often each is timed; all take turns.")] = 5,
    peers: Annotated[
        Path | None,
        typer.Option("--with", metavar="FILE.json", help="Peers on the same axes, as tools/bench/schemes kept them."),
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw what a simulated second costs against how far it is from the continuous object: objects, schemes, rates."""
    from hapsim.chart.speed_accuracy import draw_speed_accuracy
    from hapsim.cli.live import live_words
    from hapsim.speed_accuracy.comparison import RATES, compare, objects_named
    from hapsim.speed_accuracy.results import columns, fronts, peers_in, schemes_named, verdict

    chosen, by = objects_named(names(objects)), schemes_named(names(schemes))
    at = _rates(numbers("--rates", rates)) or RATES
    if rounds < 1:
        raise UsageError(f"--rounds: found {rounds}, expected a whole number of at least 1")
    picture = writable(picture, data, json, "speed-accuracy.svg")
    rows = [] if peers is None else peers_in(peers, [one.name for one in chosen])
    with live_words(stderr()) as tell:
        rows = compare(chosen, at, rounds, tell, by) + rows
    save_rows(columns(rows, [row for front in fronts(rows).values() for row in front]), data)
    if picture is not None:
        draw_speed_accuracy(chosen, rows, picture)
    told = {one.name: verdict(one, rows) for one in chosen}
    if json:
        print_json({"objects": told, "rows": [row.as_document() for row in rows]}, picture, data)
        return
    for sentence in told.values():
        say(sentence)
    say_written(picture, data)


def _rates(found: list[float]) -> list[float]:
    for rate in found:
        if not 0.0 < rate < float("inf"):
            raise UsageError(f"--rates: found {rate:g}, expected a finite number above 0")
    return found
