"""`hapsim status`."""

from __future__ import annotations

import json as standard_json
from pathlib import Path
from typing import Annotated, Any

import typer

from hapsim.cli.arguments import Json, stdout
from hapsim.errors import UsageError


def status(
    where: Annotated[
        str | None,
        typer.Argument(metavar="[PORT|PATH]", help="The port of a running hapsim, or its socket; else the only one."),
    ] = None,
    json: Json = False,
) -> None:
    """Ask a `hapsim run --status` how it is doing."""
    from hapsim.cli.status_table import show_status
    from hapsim.running.status import ask

    path = _path_of(where)
    document = _document(path, ask(path))
    if json:
        print(standard_json.dumps(document, indent=2))
    else:
        show_status(stdout(), document)


def _path_of(where: str | None) -> Path:
    from hapsim.running.status import answers, sockets

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
