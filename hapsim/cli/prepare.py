"""`hapsim schema`, `compile` and `service`: what comes before a run."""

from __future__ import annotations

import json as json_text
from typing import Annotated

import typer

from hapsim.cli.live import live_line, unkept, warn_if_elsewhere
from hapsim.cli.live_options import LiveOptions
from hapsim.cli.options import Json, Port, SceneFile, Watch, flag, load, require_file
from hapsim.cli.output import complain, document, say, stderr, warn
from hapsim.errors import UsageError
from hapsim.number_format import plural
from hapsim.prediction import predict
from hapsim.running.compile_ahead import prepare
from hapsim.running.requirements import why_not_armed
from hapsim.running.service import closed_to_service, unit_for, unit_name
from hapsim.scene import scene_schema


def schema() -> None:
    """Print the JSON schema of scenes, for editors that complete and check YAML."""
    print(json_text.dumps(scene_schema(), indent=2))


def compile_(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENE]…", help="Compile what these scenes need [default: what any scene needs]"),
    ] = None,
    json: Json = False,
) -> None:
    """Compile ahead of the first run. No device is touched.

    The code is kept in ~/.cache/hapsim, or where --cache DIR or HAPSIM_CACHE in the environment says.
    """
    loaded = [load(path) for path in scenes or ()]
    with live_line(stderr(), warns_of_unkept=False) as tell:
        prepared = prepare(loaded, tell)
    kept = prepared.directory
    if json:
        directory = None if kept is None else str(kept)
        print(document({"functions": prepared.functions, "seconds": prepared.seconds, "directory": directory}))
    elif prepared.functions:
        compiled = f"Compiled {plural(prepared.functions, 'function')} in {prepared.seconds:.1f} s"
        say(f"{compiled}; kept in {kept}" if kept else compiled)
    else:
        say(f"Nothing to compile: everything is kept in {kept}")
    if prepared.problem:
        warn(unkept(prepared.problem), "unkept")
    if prepared.problem or warn_if_elsewhere(kept):
        raise typer.Exit(UsageError.exit_status)


def service(
    scene: SceneFile,
    port: Port = None,
    user: Annotated[bool, flag("--user", "For your own service manager, which grants less.")] = False,
    watch: Watch = False,
    sound: Annotated[bool, flag("--sound", "Play the scene's sound, on a card of ALSA.")] = False,
    *,
    live: LiveOptions,
    json: Json = False,
) -> None:
    """Print a systemd unit that runs SCENE, waits for its device and reports its status to the service manager."""
    require_file(scene, "SCENE")
    loaded = load(scene, port)
    on = loaded.device.port
    if on is None:
        raise UsageError(f"{scene}: a service drives a device: found no port, expected --port, or one in the scene")
    words, record_dir = live.words(), live.record_dir
    text = unit_for(scene, on, of_user=user, watch=watch, sound=sound, live=words, record_dir=record_dir)
    name = unit_name(on)
    if refusal := why_not_armed(scene, loaded, predict(loaded, with_margins=False)):
        warn(f"`hapsim run` will refuse this scene, and the service ends with status 2. {refusal}", "service")
    if not user and (closed := closed_to_service(scene)):
        warn(closed, "service")
    if json:
        print(document({"name": name, "unit": text}))
        return
    print(text, end="")
    folder, control = ("~/.config/systemd/user", "systemctl --user") if user else ("/etc/systemd/system", "systemctl")
    complain(f"Save it as {folder}/{name}, then `{control} daemon-reload` and `{control} enable --now {name}`.")
