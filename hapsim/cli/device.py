"""`hapsim mock` and `hapsim ports`: devices, simulated and found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapsim.cli.options import Json, SceneFile, load
from hapsim.cli.output import complain, stderr, stdout


def mock(
    scene: SceneFile,
    link: Annotated[Path | None, typer.Option(metavar="PATH", help="Also give the port this name (a link).")] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Keep time as hardware does: before every program, where permitted.")
    ] = False,
    json: Json = False,
) -> None:
    """Serve the scene's mock device on a pseudo-terminal of its own; print its path; serve until told to stop."""
    from hapsim.cli.live import live_line
    from hapsim.device.mock.terminal import serve_until_stopped

    loaded = load(scene)
    with live_line(stderr()) as tell:
        serve_until_stopped(loaded, link, _announce_json if json else _announce, tell, realtime)


def ports(json: Json = False) -> None:
    """List the serial ports found."""
    from hapsim.device.serial_port import serial_ports

    found = serial_ports()
    if json:
        from hapsim.cli.as_json import document

        print(document({"ports": found}))
        return
    if not found:
        complain("No serial port was found. `hapsim mock SCENE` serves a device without hardware.")
        return

    show_ports(stdout(), found)


def _announce(path: str) -> None:
    print(path, flush=True)


def _announce_json(path: str) -> None:
    from hapsim.cli.as_json import document

    print(document({"port": path}), flush=True)


_NOT_KNOWN = "n/a"  # as pyserial says it


def show_ports(out: Console, ports: Iterable[Mapping[str, str]]) -> None:
    """What `hapsim ports` lists: where each port is, what it says of itself, and by what the system knows it."""
    table = Table(title="Serial ports", title_justify="left")
    table.add_column("port", overflow="fold", no_wrap=True)
    table.add_column("description", overflow="fold")
    table.add_column("hardware", overflow="fold")
    for port in ports:
        table.add_row(
            *(escape(port[key] if port[key] != _NOT_KNOWN else "") for key in ("port", "description", "hardware"))
        )
    out.print(table)
