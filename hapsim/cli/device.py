"""`hapsim mock` and `hapsim ports`: devices, simulated and found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.arguments import Json, SceneFile, complain, load, stderr, stdout


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
    from hapsim.cli.tables import show_ports

    show_ports(stdout(), found)


def _announce(path: str) -> None:
    print(path, flush=True)


def _announce_json(path: str) -> None:
    from hapsim.cli.as_json import document

    print(document({"port": path}), flush=True)
