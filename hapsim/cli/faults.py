"""`hapsim faults`: faults on the wire, on purpose."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import Json, complain, load, seconds_above_zero, stderr, stdout
from hapsim.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from hapsim.bringup.faults import Injector, Script
    from hapsim.bringup.faults.relay import Relay


def faults(
    scripts: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCRIPT", help="Which faults happen when, in YAML; or the name of a shipped one."),
    ] = None,
    port: Annotated[str | None, typer.Option(metavar="DEV", help="The device's port.")] = None,
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="In place of a port: this scene's mock, started for it.")
    ] = None,
    path: Annotated[
        Path | None, typer.Option(metavar="NAME", help="Also give the port for the host this name (a link).")
    ] = None,
    baud: Annotated[int, typer.Option(min=1, max=100_000_000, help="Of the device's port, bit/s.")] = 2_000_000,
    seed: Annotated[int | None, typer.Option(min=0, max=2**32 - 1, help="In place of the script's.")] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", callback=seconds_above_zero, help="For so long; else until Ctrl-C.")
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the kinds of faults, and the scripts that ship.")] = False,
    json: Json = False,
) -> None:
    """Stand between a host and a device, pass everything on, and do to it what SCRIPT says.

    Prints the port for the host to open. At the end it tells what passed, how often each fault happened, and what
    reached the device: the largest force, the largest change of it, and how the last one ended.
    """
    if list_:
        _print_list(json)
        return
    read = _script(scripts or [])
    if (port is None) == (scene is None):
        found = "found neither --port nor --scene" if port is None else "found both --port and --scene"
        raise UsageError(f"{found}, expected one of them: the device's port, or a scene with a mock")
    from hapsim.bringup.faults import Injector
    from hapsim.device.port_name import free_name

    if path is None and any(fault.kind == "replug" for fault in read.faults):
        raise UsageError("--path: found none, expected a name for the port: replug puts it back under that name")
    injector = Injector(read, seed)
    free_name(path)
    with _device(port, scene, baud) as descriptor:
        relay, name, whole = _relayed(descriptor, injector, path, duration, complain if json else _announce)
    gone = None if whole else DeviceError(f"{port or scene}: the device went away (unplugged, or its port was closed)")
    _show(name, injector, relay, gone, json)
    if gone is not None:
        complain(gone)
        raise typer.Exit(gone.exit_status)


def _relayed(
    descriptor: int, injector: Injector, path: Path | None, duration: float | None, announce: Callable[[str], None]
) -> tuple[Relay, str, bool]:
    """(what passed it on, the port for the host, whether the device stayed)"""
    from hapsim.bringup.faults.relay import Relay
    from hapsim.cli.faults_table import passing_on
    from hapsim.cli.live import live_words
    from hapsim.running.signals import stopping_on_signals

    with Relay(descriptor, injector, path) as relay, stopping_on_signals(relay.stop):
        name = relay.name
        announce(name)
        with live_words(stderr()) as say:
            whole = relay.run(duration, lambda: say(passing_on(injector)))
        return relay, name, whole


def _show(name: str, injector: Injector, relay: Relay, gone: DeviceError | None, json: bool) -> None:
    from hapsim.cli.faults_table import faults_document, show_faults

    if json:
        from hapsim.cli.as_json import document

        print(document(faults_document(name, injector, relay.unread_bytes, relay.passing, gone)))
    else:
        show_faults(stdout(), injector, relay.unread_bytes, relay.passing)


def _print_list(json: bool) -> None:
    from hapsim.cli.faults_table import kinds_document, show_kinds
    from hapsim.scene.shipped import shipped_scripts

    if json:
        from hapsim.cli.as_json import document

        print(document(kinds_document(shipped_scripts())))
    else:
        show_kinds(stdout(), shipped_scripts())


def _script(names: list[str]) -> Script:
    """A file, or else a script that ships."""
    from hapsim.bringup.faults import load_script, parse_script
    from hapsim.scene.shipped import shipped_script, shipped_scripts

    if not names:
        raise UsageError("found no SCRIPT, expected one, or --list, which tells what there is")
    if len(names) > 1:
        raise UsageError(f"found {len(names)} scripts, {', '.join(names)}: expected one script at a time")
    name, ship = names[0], shipped_scripts()
    if name in ship and not Path(name).exists():
        return parse_script(shipped_script(name), name)
    try:
        return load_script(name)
    except UsageError as error:
        if os.path.lexists(name):
            raise
        raise UsageError(f"{error}. The scripts that ship: {', '.join(ship)}") from None


@contextlib.contextmanager
def _device(port: str | None, scene: str | None, baud: int) -> Iterator[int]:
    """The descriptor of the device's port."""
    from hapsim.device.serial_port import raw_port
    from hapsim.loop.system import require_linux

    require_linux(
        "faults on a pseudo-terminal", "a transport in memory takes them there (hapsim.bringup.faults.in_memory)"
    )
    with contextlib.ExitStack() as stack:
        if scene is not None:
            port = stack.enter_context(_mock(scene))
        yield stack.enter_context(raw_port(port or "", baud))


@contextlib.contextmanager
def _mock(scene: str) -> Iterator[str]:
    from hapsim.cli.live import live_line
    from hapsim.compiling.progress import Counted, on_compilation
    from hapsim.device.mock.assemble import assemble_mock
    from hapsim.device.mock.terminal import serving
    from hapsim.progress import Progress

    loaded = load(scene)
    with contextlib.ExitStack() as stack:
        with live_line(stderr()) as tell:
            counted = Counted(lambda name, share: tell(Progress("compiling", name, share=share)))
            with on_compilation(counted.add):
                path = stack.enter_context(serving(assemble_mock(loaded)))
        yield path


def _announce(name: str) -> None:
    print(name, flush=True)
