"""Measurements as Markdown and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from steadiness.record import spread

from hapsim.errors import UsageError
from hapsim.speed_accuracy.results import Object, Row, fronts, row_of_document, verdict
from speed.contenders import OURS
from speed.ratios import ratios_of

_LISTS = ("rows", "first_tick", "conditions")


def document_of(path: Path) -> dict[str, Any]:
    """Loads a file written by `save_json`."""
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise UsageError(f"--from: {path} holds no JSON: {error}") from None
    missing = {"machine", "rounds", "ratios", *_LISTS} - document.keys()
    if missing:
        raise UsageError(f"--from: {path} has no {', '.join(sorted(missing))}; expected what --json keeps")
    return document


def rows_of(document: dict[str, Any]) -> list[Row]:
    """The chart's."""
    return [row_of_document(row) for row in document["rows"]]


def save_json(document: dict[str, Any], path: Path) -> None:
    """Every number, a row a line."""
    rows = ",\n".join(f"    {json.dumps(row, ensure_ascii=False)}" for row in document["rows"])
    text = json.dumps({**document, "rows": []}, indent=2, ensure_ascii=False).removesuffix("[]\n}")
    path.write_text(f"{text}[\n{rows}\n  ]\n}}\n" if rows else f"{text}[]\n}}\n", encoding="utf-8")


def print_report(document: dict[str, Any], rows: Sequence[Row], objects: Sequence[Object]) -> None:
    """Everything that was measured, part by part."""
    print("\n".join(_heading(document)))
    for title, table in (
        ("What a sample costs, ns; above 1 the other one is quicker", _ratios(document["ratios"])),
        ("From a scene to its first tick, s: a string of 1000 masses with a hand", _first(document["first_tick"])),
        ("The front: nothing of hapsim's is cheaper and more accurate", _front(rows)),
        ("Beside the peers, at the highest rate", _peers(rows)),
    ):
        _print_table(title, list(table))
    for one in objects:
        print(f"- {verdict(one, rows)}")


def _print_table(title: str, lines: list[list[str]]) -> None:
    if len(lines) < 2:
        return
    print(f"\n**{title}**\n")
    for i, cells in enumerate(lines):
        print("| " + " | ".join(cells) + " |")
        if i == 0:
            print("|" + "---|" * len(cells))
    print()


def _heading(document: dict[str, Any]) -> Iterator[str]:
    machine = document["machine"]
    virtual = ", virtual" if machine["virtual"] else ""
    yield f"{machine['cpu']}{virtual}, {machine['cores']} cores, {machine['kernel']};"
    yield f"Python {machine['python']}, numba {machine['numba']}; C: {machine['c_compiler']}."
    yield f"Rounds, in which all take turns: {document['rounds']}. Median [least, most]."
    for sentence in document["conditions"]:
        yield f"- {sentence}"


def _ratios(measured: dict[str, dict[str, list[float]]]) -> Iterator[list[str]]:
    yield ["", "hapsim, ns", "beside", "ns", "hapsim / it", "it / hapsim"]
    for what, costs in measured.items():
        for who in costs:
            if who != OURS:
                cells = [spread(costs[name], ".3g") for name in (OURS, who)]
                there, back = (spread(ratios_of(costs, *pair), ".3g") for pair in ((OURS, who), (who, OURS)))
                yield [what.split(":")[0], cells[0], who, cells[1], there, back]


def _first(found: list[dict[str, dict[str, float]]]) -> Iterator[list[str]]:
    yield ["", "scene", "program", "compiling, and the tick", "all"]
    for which, words in (("cold", "nothing kept"), ("warm", "kept from before")):
        if found:
            yield [words] + [
                spread([one[which][part] for one in found], ".2g") for part in ("scene", "program", "tick", "all")
            ]


def _front(rows: Sequence[Row]) -> Iterator[list[str]]:
    yield ["object", "of", "scheme", "precision", "rate, Hz", "s a second", "error"]
    for (name, quantity), front in fronts(rows).items():
        for row in front:
            cost = spread(row.costs, ".2g")
            yield [name, quantity, row.method, row.precision, f"{row.rate_hz:g}", cost, f"{row.error:+.1e}"]


def _peers(rows: Sequence[Row]) -> Iterator[list[str]]:
    yield ["object", "who", "rate, Hz", "s a second", "error", ""]
    theirs = [row for row in rows if not row.ours]
    top = max((row.rate_hz for row in theirs), default=0.0)
    for name in dict.fromkeys(row.object for row in theirs):
        for row in (row for row in rows if row.object == name and row.rate_hz == top):
            if row.good or not row.ours:
                who = f"hapsim, {row.method}, {row.precision}" if row.ours else row.whose
                error = f"{row.error:+.1e}" if row.good else ""
                yield [name, who, f"{row.rate_hz:g}", spread(row.costs, ".2g"), error, row.note]
