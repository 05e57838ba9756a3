"""`hapsim mock`, `hapsim ports` and `hapsim sound`: devices, simulated and found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.markup import escape

from hapsim.cli.command_options import Json, SceneFile, flag, load, option
from hapsim.cli.live import live_line
from hapsim.cli.output import document, print_message, stderr, stdout, table, warn
from hapsim.errors import UsageError
from hapsim.loop.system import missing_calls

Link = Annotated[Path | None, option("PATH", "Symbolic link to create for the port.")]


def mock(
    scene: SceneFile,
    link: Link = None,
    realtime: bool = flag(
        "--realtime", "Request real-time priority for the mock, so that it keeps time as hardware does."
    ),
    listen: Annotated[
        str | None, option("ADDRESS", "Serve it at this address instead: tcp://HOST:PORT or udp://HOST:PORT.")
    ] = None,
    peer: Annotated[str | None, option("HOST", "The only machine that --listen answers.")] = None,
    json: Json = False,
) -> None:
    """Serve the scene's mock device on a pseudo-terminal until Ctrl-C, and print its path."""
    from hapsim.device.mock.assemble_mock import assemble_mock

    serve_at = None
    if (listen is None) != (peer is None) or (listen and link):
        raise UsageError("expected --listen ADDRESS and --peer HOST together, without --link, or neither of them")
    if listen is not None and peer is not None:
        from hapsim.device.mock.listening import listening

        serve_at = partial(listening, address=listen, peer=peer, refused=partial(warn, event="refused"))
    serve(partial(assemble_mock, load(scene)), link, realtime, json, serve_at=serve_at)


def serve(
    assemble: Callable[[], Any],
    link: Path | None,
    realtime: bool,
    json: bool,
    served: str = "the mock device",
    serve_at: Callable[..., Any] | None = None,
) -> None:
    """Serves the MOCK that `assemble` returns until Ctrl-C, and prints its path. `serve_at`: of
    `serve_until_stopped`."""
    from hapsim.device.mock.terminal import serve_until_stopped

    def announce(path: str) -> None:
        print(document({"port": path}) if json else path, flush=True)

    with live_line(stderr(), served=served) as show_progress:
        serve_until_stopped(assemble, link, announce, show_progress, realtime, serve_at)


def ports(json: Json = False) -> None:
    """List the serial ports."""
    from hapsim.device.ports import serial_ports

    found = serial_ports()
    if json:
        print(document({"ports": found}))
    elif found:
        show_ports(stdout(), found)
    else:
        without = (
            "`hapsim run SCENE` has a mock in memory" if missing_calls() else "`hapsim mock SCENE` serves a device"
        )
        print_message(f"No serial port was found. {without} without hardware.")


def sound(json: Json = False) -> None:
    """List the sound cards that `run --sound` can play on."""
    from hapsim.sound.play import output_devices

    found = output_devices()
    if json:
        print(document({"devices": [one._asdict() for one in found]}))
    elif found:
        rows = [
            (
                str(one.number),
                escape(one.name) + (" (default)" if one.is_default else ""),
                escape(one.system),
                str(one.outputs),
                f"{one.rate_hz:.6g}",
                f"{1e3 * one.latency_s:.3g}",
            )
            for one in found
        ]
        headings = ("number", "<name", "<system", "channels", "rate  Hz", "latency  ms")
        stdout().print(table("Sound cards", headings, rows))
    else:
        print_message("No sound card was found. `hapsim run SCENE --sound-file FILE.wav` writes a file without one.")


_NOT_KNOWN = "n/a"  # of pyserial


def show_ports(out: Console, ports: Iterable[Mapping[str, str]]) -> None:
    """Prints where each port is, its description, and the system's name for its hardware."""
    rows = (
        [escape("" if port[key] == _NOT_KNOWN else port[key]) for key in ("port", "description", "hardware")]
        for port in ports
    )
    out.print(table("Serial ports", ("<port", "<description", "<hardware"), rows))
