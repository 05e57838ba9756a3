"""`hapsim status`."""

from __future__ import annotations

import json as standard_json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from hapsim.cli.command_options import Json, argument
from hapsim.cli.output import fitted, stdout
from hapsim.errors import UsageError
from hapsim.loop.counts import words_at
from hapsim.number_format import number
from hapsim.running.status import is_served, request_status, sockets
from hapsim.units import Units


def status(
    where: str | None = argument("[PORT|PATH]", "Port or socket of the running hapsim [default: the only one]"),
    json: Json = False,
) -> None:
    """Show the status of a running hapsim that was started with --status."""
    path = _path_of(where)
    document = _document(path, request_status(path))
    if json:
        print(standard_json.dumps(document, indent=2))
    else:
        show_status(stdout(), document)


def _path_of(where: str | None) -> Path:
    if where is not None and Path(where).is_socket():
        return Path(where)
    found = [path for path in sockets(where) if is_served(path)]
    if len(found) == 1:
        return found[0]
    what = f"of {where}" if where else "to this user"
    if not found:
        raise UsageError(
            f"no running hapsim was found that reports its status {what}: start it with `hapsim run --status auto`"
        )
    raise UsageError(f"several report their status {what}: {', '.join(map(str, found))}. Name one of them")


def _document(path: Path, text: str) -> dict[str, Any]:
    try:
        document = standard_json.loads(text)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise UsageError(f"{path}: the answer is not from hapsim: found {text[:40]!r}")
    return document


_LABELS = {
    "pid": "process",
    "scene": "scene",
    "port": "port",
    "phase": "phase",
    "armed_since": "armed since",
    "reconnections": "reconnections",
    "lost": "device lost",
    "news": "news",
    "released": "force released",
    "duration_s": "time  s",
    "rate_hz": "rate  Hz",
    "nominal_rate_hz": "nominal rate  Hz",
    "ticks": "ticks",
    "force_n": "force  ‹N›",
    "position_m": "position  ‹m›",
    "age_samples": "age of the force  samples",
    **words_at("status"),
}
_WIDEST = 25


def show_status(out: Console, document: Mapping[str, object]) -> None:
    """Prints a row for each value that there is; a value without a label goes by its key. On a terminal a sentence
    breaks at its words, and a path in it stays whole."""
    keys = [*(key for key in _LABELS if key in document), *(key for key in document if key not in _LABELS)]
    units = Units.parse(document.get("motion"))
    values = {units.filled(_LABELS[key]) if key in _LABELS else key: _value(key, document) for key in keys}
    rows = {label: value for label, value in values.items() if value}
    width = min(max(map(len, rows), default=0), _WIDEST)
    for label, value in rows.items():
        row = f"{_shown(label):<{width}}  {_shown(value)}"
        row = fitted(row, out.width if out.is_terminal else None, indent=" " * (width + 2))
        out.print(row, soft_wrap=True, markup=False, emoji=False, highlight=False)


def _value(key: str, document: Mapping[str, object]) -> str:
    """Returns a value in words; "" where there is none."""
    value = document[key]
    if key == "released":
        unknown = "not known" if document.get("phase") in ("waiting", "ended") else ""
        return unknown if value is None else "confirmed" if value is True else "not confirmed"
    if isinstance(value, list | tuple):
        is_empty = all(one is None for one in value)
        return "" if is_empty else " ".join("–" if one is None else _word(one) for one in value)
    return "" if value is None else _word(value)


def _word(value: object) -> str:
    return number(value) if isinstance(value, float) else str(value)


def _shown(text: str) -> str:
    """Returns the text on one row, and without what a terminal would obey."""
    return "".join(one if one.isprintable() else " " if one.isspace() else "?" for one in text)
