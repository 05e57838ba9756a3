"""The records as Markdown tables, as CSV and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hapsim.chart.figure import save_rows
from steadiness.parts import COMPUTE, EXCHANGES, LATE, WAKEUPS
from steadiness.record import COMPILED, CYCLICTEST, PORTABLE, C, Record, Records, as_row, from_row, spread


def print_report(about: dict[str, Any], records: Records) -> None:
    """Everything that was measured, part by part."""
    print("\n".join(_heading(about)))
    for part, rows in _TABLES.items():
        if records.cases(part):
            print(f"\n**{_TITLES[part]}**\n")
            for i, cells in enumerate(rows(records)):
                print("| " + " | ".join(cells) + " |")
                if i == 0:
                    print("|" + "---|" * len(cells))
            print("".join(f"\n{sentence}" for sentence in _early_ends(records, part)))


def save_json(about: dict[str, Any], records: Records, path: Path) -> None:
    """Every number, and what it was measured on."""
    document = about | {"measurements": [as_row(record) for record in records.all]}
    lines = json.dumps(document | {"measurements": []}, indent=2, ensure_ascii=False).removesuffix("[]\n}")
    rows = ",\n".join(f"    {json.dumps(row, ensure_ascii=False)}" for row in document["measurements"])
    path.write_text(f"{lines}[\n{rows}\n  ]\n}}\n", encoding="utf-8")


def load_json(path: Path) -> tuple[dict[str, Any], Records]:
    """The reverse of `save_json`."""
    about = json.loads(path.read_text(encoding="utf-8"))
    return about, Records([from_row(row) for row in about.pop("measurements")])


def save_csv(records: Records, path: Path) -> None:
    """Every number, a row each."""
    rows = [as_row(record) for record in records.all]
    names = list(as_row(Record(records.all[0].case, 0, "", "", 0.0)))
    save_rows({name: [row[name] for row in rows] for name in names}, path)


def _heading(about: dict[str, Any]) -> Iterator[str]:
    machine = about["machine"]
    virtual = ", virtual" if machine["virtual"] else ""
    yield f"{machine['cpu']}{virtual}, {machine['cores']} cores, {machine['kernel']};"
    yield f"Python {machine['python']}, numba {machine['numba']}; C: {machine['c_compiler']}."
    yield f"Rounds, in which all take turns: {about['rounds']}; {about['seconds']:g} s each. Median [least, most]."
    for sentence in about["conditions"]:
        yield f"- {sentence}"


def _compute(records: Records) -> Iterator[list[str]]:
    yield ["", f"{C}, ns", f"{COMPILED}, ns", "compiled / C"]
    for case in records.cases(COMPUTE):
        cells = [spread(records.values(case, peer, "ns_per_exchange"), ".1f") for peer in (C, COMPILED)]
        yield ["decode to encode", *cells, spread(records.ratios(case, COMPILED, C, "ns_per_exchange"), ".2f")]


def _exchanges(records: Records) -> Iterator[list[str]]:
    quantity = "exchanges_per_second"
    yield ["load", f"{C}, 1/s", f"{COMPILED}, 1/s", f"{PORTABLE}, 1/s", "compiled / C", "compiled / portable"]
    for case in records.cases(EXCHANGES):
        cells = [spread(records.values(case, peer, quantity), ".0f") for peer in (C, COMPILED, PORTABLE)]
        ratios = [spread(records.ratios(case, COMPILED, peer, quantity), ".3g") for peer in (C, PORTABLE)]
        yield [case.load, *cells, *ratios]


def _wakeups(records: Records) -> Iterator[list[str]]:
    peers = (C, COMPILED, CYCLICTEST)
    yield ["scheduling", "rate, Hz", "µs late", *peers, "compiled / C", "compiled / cyclictest"]
    for case in records.cases(WAKEUPS):
        for name in ("p50", "p99", "max"):
            quantity = f"{name}_us"
            cells = [spread(records.values(case, peer, quantity), ".1f") for peer in peers]
            ratios = [spread(records.ratios(case, COMPILED, peer, quantity), ".2f") for peer in (C, CYCLICTEST)]
            yield [case.scheduling, str(case.rate_hz), name, *cells, *ratios]


def _late(records: Records) -> Iterator[list[str]]:
    peers = (C, COMPILED, PORTABLE)
    quantities = {
        "deadline misses, %": ("late_percent", ".2f"),
        "oldest force, samples": ("oldest_force_samples", ".0f"),
        "exchange, p99, µs": ("exchange_p99_us", ".0f"),
    }
    yield ["load", "", *peers, "compiled / C"]
    for case in records.cases(LATE):
        for name, (quantity, form) in quantities.items():
            cells = [spread(records.values(case, peer, quantity), form) for peer in peers]
            yield [case.load, name, *cells, spread(records.ratios(case, COMPILED, C, quantity), ".2f")]


def _early_ends(records: Records, part: str) -> Iterator[str]:
    """Yields the early ends of loops, which a table of rates does not show."""
    for case in records.cases(part):
        for peer in (C, COMPILED, PORTABLE):
            ended = records.values(case, peer, "ended_early")
            if any(ended):
                yield f"{peer}, {case.load}: {sum(ended):.0f} of {len(ended)} runs ended before their time."


_TITLES = {
    COMPUTE: "What an exchange costs without a line, statistics included; above 1 the C loop is quicker",
    EXCHANGES: "Exchanges per second over a pseudo-terminal, the device in a process of its own; above 1 the compiled "
    "loop is quicker",
    WAKEUPS: "Wake-up latency of a program that sleeps on a grid; below 1 the compiled loop is the earlier",
    LATE: "Forces that came too late for the device, at its own 1 kHz",
}
_TABLES = {COMPUTE: _compute, EXCHANGES: _exchanges, WAKEUPS: _wakeups, LATE: _late}
