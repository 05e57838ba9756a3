"""Processor time of a simulated second of a string, and the error of its modes, for each peer.

    PYTHONPATH=. python -m speed.peers [--string 100] [--rate 10000] [--modes 1 3 10] [--rounds 3]
                                         [--only WORD ...] [--spring] [--json]

The string weighs 5 g and its pitch is 20 Hz, with a damping ratio of 1e-4. `--only` selects the peers whose names have
one of the words. `--spring` measures a hand on one spring in C instead.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from typing import Any

from hapsim.speed_accuracy.strings import StringOfMasses
from speed.peers import every_peer
from speed.peers.c_spring import CSpring
from speed.peers.rows import row_of


def main() -> int:
    arguments = _arguments()
    rows = _spring_rows(arguments) if arguments.spring else _string_rows(arguments)
    if arguments.json:
        print(json.dumps(list(rows), indent=1))
        return 0
    for row in rows:
        print(_line(row), flush=True)
    return 0


def _string_rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    string = StringOfMasses.tuned(arguments.string)
    modes = [mode for mode in arguments.modes if mode <= string.masses]
    for peer in every_peer():
        if not arguments.only or any(word in peer.name for word in arguments.only):
            yield row_of(peer, string, arguments.rate, modes, arguments.rounds)


def _spring_rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for how, name in (
        ("run", "C spring"),
        ("run_called", "C spring, its scene behind a pointer"),
        ("run_free", "C spring, many ticks at once"),
    ):
        spring = CSpring(2000.0, 2.0, arguments.rate, how)
        yield {
            "peer": name,
            "masses": 0,
            "rate_hz": arguments.rate,
            "precision": "double",
            "cost_s_per_s": spring.cost(arguments.rounds),
            "frequencies_hz": [],
            "errors": [],
            "preparation_s": spring.preparation_s,
            "note": "",
        }


def _line(row: dict[str, Any]) -> str:
    """ns for a sample, and each mode's error."""
    cost = min(row["cost_s_per_s"], default=math.nan) / row["rate_hz"] * 1e9
    errors = " ".join("      --" if error is None else f"{error:+8.1e}" for error in row["errors"])
    made = "" if row["preparation_s"] is None else f"made in {row['preparation_s']:.2f} s"
    return f"{row['peer']:28} {cost:12.1f} ns/sample  {errors}  {made} {row['note']}".rstrip()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "speed.peers", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--string", type=int, default=100, metavar="MASSES")
    parser.add_argument("--rate", type=float, default=10_000.0, metavar="HZ")
    parser.add_argument("--modes", type=int, nargs="+", default=[1, 3, 10])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD")
    parser.add_argument("--spring", action="store_true")
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
