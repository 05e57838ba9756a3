"""`hapsim status`."""

from __future__ import annotations

import json as standard_json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from hapsim.cli.options import Json
from hapsim.cli.output import fitted, stdout
from hapsim.errors import UsageError
from hapsim.running.status import answers, ask, sockets


def status(
    where: Annotated[
        str | None,
        typer.Argument(metavar="[PORT|PATH]", help="The port of a running hapsim, or its socket; else the only one."),
    ] = None,
    json: Json = False,
) -> None:
    """Ask a `hapsim run --status` how it is doing."""

    path = _path_of(where)
    document = _document(path, ask(path))
    if json:
        print(standard_json.dumps(document, indent=2))
    else:
        show_status(stdout(), document)


def _path_of(where: str | None) -> Path:

    if where is not None and Path(where).is_socket():
        return Path(where)
    found = [path for path in sockets(where) if answers(path)]
    if len(found) == 1:
        return found[0]
    what = f"of {where}" if where else "to this user"
    if not found:
        raise UsageError(
            f"no running hapsim was found that tells its status {what}: start it with `hapsim run --status auto`"
        )
    paths = ", ".join(map(str, found))
    raise UsageError(f"several tell their status {what}: {paths}: name one of them")


def _document(path: Path, told: str) -> dict[str, Any]:
    try:
        document = standard_json.loads(told)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: what answers there is not a hapsim: found {told[:40]!r}") from error
    if not isinstance(document, dict):
        raise UsageError(f"{path}: what answers there is not a hapsim: found {told[:40]!r}")
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
    "nominal_rate_hz": "rate asked for  Hz",
    "ticks": "ticks",
    "force_n": "force  N",
    "position_m": "position  m",
    "age_samples": "age of the force  samples",
    "deadline_misses": "deadline misses",
    "limited_ticks": "ticks at the force limit",
    "estimated_mass_kg": "estimated mass  kg",
    "estimated_mass_uncertainty_kg": "its uncertainty  kg",
    "mass_explained": "motion explained",
}
_WIDEST = 25


def show_status(out: Console, document: Mapping[str, object]) -> None:
    """A row for each value that there is. On a terminal a sentence breaks at its words; a path in it stays whole, so
    that it can be copied. What this hapsim has no label for goes by its key."""
    rows = [(_LABELS.get(key, key), _told(key, document[key])) for key in _in_order(document) if _says(key, document)]
    width = min(max((len(label) for label, _ in rows), default=0), _WIDEST)
    for label, value in rows:
        row = f"{_shown(label):<{width}}  {_shown(value)}"
        row = fitted(row, out.width if out.is_terminal else None, indent=" " * (width + 2))
        out.print(row, soft_wrap=True, markup=False, emoji=False, highlight=False)


def _in_order(document: Mapping[str, object]) -> list[str]:
    return [key for key in _LABELS if key in document] + [key for key in document if key not in _LABELS]


def _says(key: str, document: Mapping[str, object]) -> bool:
    value = document[key]
    if key == "released" and value is None:
        return document.get("phase") in ("waiting", "ended")
    if isinstance(value, list | tuple):
        return any(one is not None for one in value)
    return value is not None and value != ""


def _told(key: str, value: object) -> str:
    if key == "released":
        return "not known" if value is None else "confirmed" if value is True else "not confirmed"
    return _value(value)


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        return " ".join(map(_value, value))
    if value is None:
        return "–"
    return f"{value + 0.0:.6g}" if isinstance(value, float) else str(value)  # + 0.0: no minus before a zero


def _shown(text: str) -> str:
    """On one row, and without what a terminal would obey."""
    return "".join(one if one.isprintable() else " " if one.isspace() else "?" for one in text)
