"""`hapsim faults`."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from hapsim.bringup.faults import KINDS, Injector, load_script, parse_script
from hapsim.bringup.faults.relay import PassingTimes, Relay
from hapsim.cli.as_json import document
from hapsim.cli.live import live_line, live_words
from hapsim.cli.options import Baud, Json, load, seconds
from hapsim.cli.output import complain, stderr, stdout
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.device.port_name import free_name
from hapsim.device.serial_port import raw_port
from hapsim.errors import DeviceError, RunError, UsageError
from hapsim.loop.system import require_linux
from hapsim.progress import Progress
from hapsim.scene.shipped import shipped_script, shipped_scripts
from hapsim.stopping import stopping_on_signals

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
    baud: Baud = 2_000_000,
    seed: Annotated[int | None, typer.Option(min=0, max=2**32 - 1, help="In place of the script's.")] = None,
    duration: Annotated[float | None, seconds("Duration in seconds [default: until Ctrl-C]")] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the kinds of faults, and the scripts that ship.")] = False,
    json: Json = False,
) -> None:
    """Inject faults: relay between host and device and apply SCRIPT.

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

    with Relay(descriptor, injector, path) as relay, stopping_on_signals(relay.stop):
        name = relay.name
        announce(name)
        with live_words(stderr()) as say:
            whole = relay.run(duration, lambda: say(passing_on(injector)))
        return relay, name, whole


def _show(name: str, injector: Injector, relay: Relay, gone: DeviceError | None, json: bool) -> None:

    if json:
        print(document(faults_document(name, injector, relay.unread_bytes, relay.passing, gone)))
    else:
        show_faults(stdout(), injector, relay.unread_bytes, relay.passing)


def _print_list(json: bool) -> None:

    if json:
        print(document(kinds_document(shipped_scripts())))
    else:
        show_kinds(stdout(), shipped_scripts())


def _script(names: list[str]) -> Script:
    """A file, or else a script that ships."""

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

    require_linux(
        "faults on a pseudo-terminal", "a transport in memory takes them there (hapsim.bringup.faults.in_memory)"
    )
    with contextlib.ExitStack() as stack:
        if scene is not None:
            port = stack.enter_context(_mock(scene))
        yield stack.enter_context(raw_port(port or "", baud))


@contextlib.contextmanager
def _mock(scene: str) -> Iterator[str]:

    loaded = load(scene)
    with contextlib.ExitStack() as stack:
        with live_line(stderr()) as tell:
            counted = Counted(lambda name, share: tell(Progress("compiling", name, share=share)))
            with on_compilation(counted.add):
                path = stack.enter_context(serving(assemble_mock(loaded)))
        yield path


def _announce(name: str) -> None:
    print(name, flush=True)


_WAYS = {True: "to the device", False: "from the device"}


def show_kinds(out: Console, scripts: Sequence[str]) -> None:
    """Every kind of fault with its sentence."""
    table = Table("kind", "what happens", title="Faults", title_justify="left")
    for kind, fault in KINDS.items():
        table.add_row(kind, fault.__doc__)
    out.print(table)
    out.print(f"Scripts that ship: {', '.join(scripts)}.")


def kinds_document(scripts: Sequence[str]) -> dict[str, Any]:
    """The same for JSON."""
    return {"kinds": {kind: fault.__doc__ for kind, fault in KINDS.items()}, "scripts": list(scripts)}


def passing_on(injector: Injector) -> str:
    """What passed until now, for a live line."""
    frames = sum(traffic.frames_in for traffic in injector.passed.values())
    return f"passing on: {frames} frames, {sum(count for _, count in injector.counts)} faults · Ctrl-C ends it"


def show_faults(out: Console, injector: Injector, unread_bytes: int, passing: PassingTimes) -> None:
    """What passed, how long that took, what was done to it, and what reached the device."""
    table = Table("", "frames in", "frames out", "bytes in", "bytes out", title="What passed", title_justify="left")
    for way, name in _WAYS.items():
        traffic = injector.passed[way]
        table.add_row(name, *map(str, (traffic.frames_in, traffic.frames_out, traffic.bytes_in, traffic.bytes_out)))
    out.print(table)
    if unread_bytes:
        out.print(f"{unread_bytes} bytes of the device were fetched by no host.")
    if passing.count:
        median, most = (f"{1e3 * (passing.quantile_s(share) or 0.0):.2g} ms" for share in (0.5, 0.99))
        out.print(
            f"Passing a frame on took {median} in the median, and at most {most} for 99 % of them, beside what a fault "
            "held up."
        )
    out.print("What was done to it", style="italic")  # not as a title, which breaks where the table is narrow
    table = Table("", "fault", "when", "how often")
    for fault in injector.happened:
        table.add_row(str(fault.place), fault.kind, fault.when, f"{fault.times} {fault.counted}")
    out.print(table)
    for sentence in _of_the_device(injector):
        out.print(sentence)


def _of_the_device(injector: Injector) -> list[str]:
    witness = injector.witness
    if not witness.all.count:
        return ["No force reached the device."]
    told = [
        f"{witness.all.count} forces reached the device, at most {_newtons(witness.all.largest)}, from one to the next "
        f"at most {_newtons(witness.all.largest_change)}."
    ]
    since = witness.since_fault
    if since.count:
        told.append(
            f"Since the first fault {since.count} of them, at most {_newtons(since.largest)}, from one to the next at "
            f"most {_newtons(since.largest_change)}."
        )
    release = witness.release()
    if release is not None:
        how = {
            "disarm": "by the host's DISARM",
            "device": "by the device itself",
            "time to live": "when its time to live was over, where the device keeps PROTOCOL.md, section 6",
            "lockstep": "when the simulated device has heard nothing for so long (PROTOCOL.md, section 7)",
        }[release.by]
        told.append(f"The last one ended after {1e3 * release.after_last_force_s:.3g} ms, {how}.")
    return told


def _newtons(force: float) -> str:
    return "a force of unknown scale" if math.isnan(force) else f"{force:.4g} N"


def faults_document(
    name: str, injector: Injector, unread_bytes: int, passing: PassingTimes, failure: RunError | None
) -> dict[str, Any]:
    """The same for JSON, and how it failed, where it did."""
    witness, release = injector.witness, injector.witness.release()
    return {
        "port": name,
        **{_WAYS[way].replace(" the", "").replace(" ", "_"): asdict(injector.passed[way]) for way in _WAYS},
        "unread_bytes": unread_bytes,
        "passed_on": {"frames": passing.count, "p50_s": passing.quantile_s(0.5), "p99_s": passing.quantile_s(0.99)},
        "faults": [fault._asdict() for fault in injector.happened],
        "samples": injector.samples + 1,
        "forces": _forces(witness.all),
        "forces_since_fault": _forces(witness.since_fault),
        "release": None if release is None else asdict(release),
    } | ({} if failure is None else {"error": str(failure), "exit_status": failure.exit_status})


def _forces(forces: Any) -> dict[str, Any]:
    return {"count": forces.count, "largest_N": forces.largest, "largest_change_N": forces.largest_change}
