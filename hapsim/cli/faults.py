"""`hapsim faults`."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.bringup.faults import KINDS, Injector, load_script, parse_script
from hapsim.bringup.faults.relay import Relay
from hapsim.cli import output
from hapsim.cli.command_options import Baud, Json, argument, flag, load, option, seconds
from hapsim.cli.live import live_line, live_words
from hapsim.cli.output import document, failure_document, output_units, print_message, stderr, stdout, table
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.device.ports import free_name, raw_port
from hapsim.documents import pick
from hapsim.errors import DeviceError, RunError, UsageError
from hapsim.loop.counts import Progress
from hapsim.loop.histogram import Spread
from hapsim.loop.system import require_linux
from hapsim.scene.shipped import shipped_script, shipped_scripts
from hapsim.stopping import stopping_on_signals

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.bringup.faults import Script


def faults(
    scripts: list[str] | None = argument("SCRIPT", "Script of faults in YAML, or a name printed by --list."),
    port: str | None = option("DEV", "Serial port of the device."),
    scene: str | None = option("SCENE", "Scene whose mock is used in place of a device."),
    path: Path | None = option("NAME", "Symbolic link to create for the port of the host."),
    baud: Baud = 2_000_000,
    seed: int | None = option(None, "Seed of the random faults [default: the script's]", min=0, max=2**32 - 1),
    duration: float | None = seconds("Duration in seconds [default: until Ctrl-C]"),
    list_: bool = flag("--list", "List the kinds of faults and the shipped scripts."),
    json: Json = False,
) -> None:
    """Inject faults: relay between host and device and apply SCRIPT.

    hapsim prints the port for the host to open. At the end it reports the traffic, how often each fault occurred, and
    the forces that reached the device: the largest force, the largest change, and the end of the last force.
    """
    if list_:
        _print_list(json)
        return
    script = _script(scripts or [])
    if (port is None) == (scene is None):
        found = "found neither --port nor --scene" if port is None else "found both --port and --scene"
        raise UsageError(f"{found}, expected one of them: the device's port, or a scene with a mock")
    if path is None and any(fault.kind == "replug" for fault in script.faults):
        raise UsageError("--path: found none, expected a name for the port: replug puts it back under that name")
    injector = Injector(script, seed)
    free_name(path)
    with (
        _device(port, scene, baud) as descriptor,
        Relay(descriptor, injector, path) as relay,
        stopping_on_signals(relay.stop),
    ):
        name = relay.name
        if json:
            print_message(name)
        else:
            print(name, flush=True)
        with live_words(stderr()) as show:
            is_whole = relay.run(duration, lambda: show(passing_on(injector)))
    gone = DeviceError(f"{port or scene}: the device went away (unplugged, or its port was closed)")
    failure = None if is_whole else gone
    if json:
        print(document(faults_document(name, injector, relay.unread_bytes, relay.delays.spread(), failure)))
    else:
        show_faults(stdout(), injector, relay.unread_bytes, relay.delays.spread())
    output.exit_if_failed(failure)


def _print_list(json: bool) -> None:
    kinds, scripts = {kind: fault.__doc__ or "" for kind, fault in KINDS.items()}, list(shipped_scripts())
    if json:
        print(document({"kinds": kinds, "scripts": scripts}))
    else:
        stdout().print(table("Faults", ("<kind", "<what happens"), kinds.items()))
        stdout().print(f"Shipped scripts: {', '.join(scripts)}.")


def _script(names: list[str]) -> Script:
    """Returns the script of a file, a shipped script, or one fault of this kind with its defaults."""
    if not names:
        raise UsageError("found no SCRIPT, expected one, or --list, which lists them")
    if len(names) > 1:
        raise UsageError(f"found {len(names)} scripts, {', '.join(names)}: expected one script at a time")
    name, ship = names[0], shipped_scripts()
    if name in ship and not Path(name).exists():
        return parse_script(shipped_script(name), name)
    if name in KINDS and not Path(name).exists():
        return parse_script(f"version: 1\nfaults: [{{kind: {name}}}]", name)
    try:
        return load_script(name)
    except UsageError as error:
        if os.path.lexists(name):
            raise
        raise UsageError(f"{error}. Shipped scripts: {', '.join(ship)}") from None


@contextlib.contextmanager
def _device(port: str | None, scene: str | None, baud: int) -> Iterator[int]:
    """Yields the descriptor of the device's port."""
    instead = "a transport in memory takes them there (hapsim.bringup.faults.in_memory)"
    require_linux("faults on a pseudo-terminal", instead)
    loaded = None if scene is None else load(scene)
    with contextlib.ExitStack() as stack:
        if loaded is not None:
            with live_line(stderr()) as show_progress:
                counted = Counted(lambda name, share: show_progress(Progress("compiling", name, share=share)))
                with on_compilation(counted.add):
                    port = stack.enter_context(serving(assemble_mock(loaded)))
        yield stack.enter_context(raw_port(port or "", baud))


_WAYS = {True: "to the device", False: "from the device"}


def passing_on(injector: Injector) -> str:
    """Returns the traffic until now, for a live line."""
    frames = sum(traffic.frames_in for traffic in injector.passed.values())
    return f"passing on: {frames} frames, {sum(count for _, count in injector.counts)} faults · Ctrl-C ends it"


def show_faults(out: Console, injector: Injector, unread_bytes: int, delays: Spread) -> None:
    """Prints the traffic, its latency, the faults, and the forces that reached the device."""
    rows = [
        (name, *map(str, (traffic.frames_in, traffic.frames_out, traffic.bytes_in, traffic.bytes_out)))
        for name, traffic in ((name, injector.passed[way]) for way, name in _WAYS.items())
    ]
    out.print(table("What passed", ("", "frames in", "frames out", "bytes in", "bytes out"), rows))
    if unread_bytes:
        out.print(f"{unread_bytes} bytes of the device were not read by any host.")
    if delays.count:
        median, most = (f"{1e3 * (one or 0.0):.2g} ms" for one in (delays.p50, delays.p99))
        out.print(f"Latency of a frame, without the delays of faults: {median} in the median, at most {most} for 99 %.")
    happened = [(str(one.place), one.kind, one.when, f"{one.times} {one.counted}") for one in injector.happened]
    out.print(table("What was done to it", ("", "<fault", "<when", "<how often"), happened))
    for sentence in _at_the_device(injector):
        out.print(sentence)


def _at_the_device(injector: Injector) -> Iterator[str]:
    """Yields the forces that reached the device, and the end of the last one."""
    witness = injector.witness
    every, since = witness.all, witness.since_fault
    if not every.count:
        yield "No force reached the device."
        return
    yield (
        f"{every.count} forces reached the device, at most {_newtons(every.largest)}, from one to the next at most "
        f"{_newtons(every.largest_change)}."
    )
    if since.count:
        yield (
            f"Since the first fault {since.count} of them, at most {_newtons(since.largest)}, from one to the next at "
            f"most {_newtons(since.largest_change)}."
        )
    if (release := witness.release()) is not None:
        how = {
            "disarm": "by the host's DISARM",
            "device": "by the device itself",
            "time to live": "when its time to live was over, if the device follows PROTOCOL.md, section 6",
            "lockstep": "when the simulated device has received nothing for that long (PROTOCOL.md, section 7)",
        }[release.by]
        yield f"The last one ended after {1e3 * release.after_last_force_s:.3g} ms, {how}."


def _newtons(force: float) -> str:
    return "a force of unknown scale" if math.isnan(force) else output_units()(force, "N", ".4g")


def faults_document(
    name: str, injector: Injector, unread_bytes: int, delays: Spread, failure: RunError | None
) -> dict[str, Any]:
    """Returns the document of `hapsim faults --json`, with the failure if there is one."""
    return {
        "port": name,
        "to_device": injector.passed[True],
        "from_device": injector.passed[False],
        "unread_bytes": unread_bytes,
        "passed_on": pick(delays, "frames=count p50_s=p50 p99_s=p99"),
        "faults": injector.happened,
        "samples": injector.samples + 1,
        **pick(injector.witness, "forces=all forces_since_fault=since_fault"),
        "release": injector.witness.release(),
    } | failure_document(failure)
