"""Cost and error of a simulated second: hapsim's schemes next to C, Faust, MuJoCo and SciPy.

    tools/bench/schemes [--rounds 5] [--quick] [--only PART ...] [--object NAME ...]
                        [--json FILE] [--data FILE.csv] [--picture FILE] [--from FILE.json]

chart      the objects of `hapsim chart speed-accuracy`, by hapsim's schemes and precisions and, for strings without
           bending, by the peers
ratios     cost of a sample, hapsim's over C's, Faust's and MuJoCo's: strings with and without a hand, a network, one
           spring; the forces of all are compared first
first      from a scene to its first tick: a string of 1000 masses, with and without compiled code in the cache

The participants take turns, round by round. Faust's compiler may take two minutes for each long string before it gives
up; its builds are kept. HAPSIM_PEERS_PYTHON names a Python with MuJoCo (speed/peers/__init__.py). `--from` draws and
prints the results saved by `--json`.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from pathlib import Path
from typing import Any

from steadiness.machine import awake, describe_machine, processor_time

from hapsim.chart.figure import require_writable, save_rows
from hapsim.chart.speed_accuracy import draw_speed_accuracy
from hapsim.documents import plain
from hapsim.errors import HapsimError, UsageError
from hapsim.speed_accuracy.comparison import RATES, Comparison, objects_named
from hapsim.speed_accuracy.objects import RingingString
from hapsim.speed_accuracy.results import Row, columns, fronts
from speed.first_tick import cold_and_warm
from speed.peer_rows import PeerRows
from speed.ratios import Ratios
from speed.reference.build import compiler_words
from speed.report import document_of, print_report, rows_of, save_json

_PARTS = ("chart", "ratios", "first")
_QUICK_RATES = (1000.0, 50_000.0)
_MOST_FIRST = 3  # rounds: each compiles anew


def main() -> int:
    arguments = _arguments()
    try:
        for path, endings in ((arguments.json, (".json",)), (arguments.data, (".csv",))):
            require_writable(path, endings)
        require_writable(arguments.picture)
        document = document_of(arguments.kept) if arguments.kept else _measure(arguments)
    except (HapsimError, OSError) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, UsageError | OSError) else 1
    rows = rows_of(document)
    objects = objects_named({row.object for row in rows}) if rows else []
    print_report(document, rows, objects)
    if arguments.json:
        save_json(document, arguments.json)
    if arguments.data:
        save_rows(columns(rows, [row for front in fronts(rows).values() for row in front]), arguments.data)
    if arguments.picture and rows:
        draw_speed_accuracy(objects, rows, arguments.picture)
    return 0


def _measure(arguments: argparse.Namespace) -> dict[str, Any]:
    rounds, rates = (1, _QUICK_RATES) if arguments.quick else (arguments.rounds, RATES)
    about: dict[str, Any] = {"rounds": rounds, "conditions": [], "ratios": {}, "first_tick": [], "rows": []}
    with awake() as power, contextlib.ExitStack() as open_ones:
        about = {"machine": describe_machine(compiler_words())} | about
        before = processor_time()
        comparison, peers, ratios = None, None, None
        if "chart" in arguments.only:
            objects = objects_named(arguments.object)
            comparison = Comparison(objects, rates, _log)
            open_ones.callback(comparison.close)
            peers = PeerRows(
                [one for one in objects if isinstance(one, RingingString) and not one.string.bending], rates, _log
            )
            about["conditions"] += peers.skipped
        if "ratios" in arguments.only:
            ratios = Ratios(_log)
            about["conditions"] += ratios.agreed
        for number in range(rounds):
            begin = time.monotonic()
            _round(number, comparison, peers, ratios, about, arguments.only)
            _log(f"round {number + 1} of {rounds} took {time.monotonic() - begin:.0f} s")
        rows: list[Row] = (comparison.rows() if comparison else []) + (peers.rows() if peers else [])
        about["rows"] = [plain(row) for row in rows]
        about["ratios"] = ratios.measured if ratios else {}
        stolen, every = (now - then for now, then in zip(processor_time(), before, strict=True))
        about["conditions"] += [
            power,
            f"of the processors' time {100.0 * stolen / every:.1f} % went to other machines on the same host",
        ]
    return about


def _round(
    number: int,
    comparison: Comparison | None,
    peers: PeerRows | None,
    ratios: Ratios | None,
    about: dict[str, Any],
    parts: list[str],
) -> None:
    if ratios is not None:
        _log(f"round {number + 1}: ratios")
        ratios.round()
    if comparison is not None:
        _log(f"round {number + 1}: hapsim")
        comparison.round()
    if peers is not None:
        peers.round(lambda words: _log(f"round {number + 1}: {words}"))
    if "first" in parts and number < _MOST_FIRST:
        _log(f"round {number + 1}: from a scene to its first tick")
        cold, warm = cold_and_warm()
        about["first_tick"].append({"cold": cold, "warm": warm})


def _log(words: str) -> None:
    """A sign of life."""
    print(words, file=sys.stderr, flush=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "tools/bench/schemes", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="one round at two rates: whether it works, no figures")
    parser.add_argument("--only", nargs="+", choices=_PARTS, default=list(_PARTS), metavar="PART")
    parser.add_argument("--object", nargs="+", default=[], metavar="NAME", help="of the chart [default: all]")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every number, and what it was measured on")
    parser.add_argument("--data", type=Path, metavar="FILE.csv", help="every number of the chart")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument("--from", dest="kept", type=Path, metavar="FILE.json", help="measure nothing")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"--rounds: found {arguments.rounds}, expected a whole number of at least 1")
    return arguments


if __name__ == "__main__":
    sys.exit(main())
