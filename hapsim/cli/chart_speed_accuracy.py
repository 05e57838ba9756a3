"""`hapsim chart speed-accuracy`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from hapsim.cli.chart_options import ChartOutput
from hapsim.cli.live import live_words
from hapsim.cli.options import names, numbers, option, require_positive
from hapsim.cli.output import say, stderr
from hapsim.errors import UsageError

_OBJECTS = "spring, contact, string-10, string-100, string-1000, stiff-string-100"


def speed_accuracy(
    *,
    objects: Annotated[
        list[str] | None, option("NAME", f"Objects, a list: {_OBJECTS} [default: all]", "--object")
    ] = None,
    schemes: Annotated[
        list[str] | None, option("NAME", "Schemes, a list such as cordis,exact [default: all]", "--scheme")
    ] = None,
    rates: Annotated[
        list[str] | None, option("HZ", "Sample rates, Hz, a list [default: 500 to 50000]", "--rates")
    ] = None,
    rounds: Annotated[int, option("N", "How often each is timed, in turns.")] = 5,
    peers: Annotated[
        Path | None, option("FILE.json", "Draw peers too, as tools/bench/schemes recorded them.", "--with")
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
    at = numbers("--rates", rates) or RATES
    for rate in at:
        require_positive("--rates", rate)
    if rounds < 1:
        raise UsageError(f"--rounds: found {rounds}, expected a whole number of at least 1")
    output.choose("speed-accuracy.svg")
    rows = [] if peers is None else peers_in(peers, [one.name for one in chosen])
    with live_words(stderr()) as tell:
        rows = compare(chosen, at, rounds, tell, by) + rows
    on_front = [row for front in fronts(rows).values() for row in front]
    output.write(lambda: columns(rows, on_front), lambda path: draw_speed_accuracy(chosen, rows, path))
    verdicts = {one.name: verdict(one, rows) for one in chosen}
    if not output.json:
        for sentence in verdicts.values():
            say(sentence)
    output.close({"objects": verdicts, "rows": [row.as_document() for row in rows]})
