"""`hapsim new`, `scenes`, `files`, `schema`, `compile` and `service`: shipped files, and preparations for a run."""

from __future__ import annotations

import json as json_text
import os
from pathlib import Path

import typer
from rich.markup import escape

import firmware_protocol
import hapsim
from hapsim.cli.command_options import (
    Json,
    Port,
    SceneFile,
    Watch,
    argument,
    flag,
    load,
    option,
    require_file,
    require_watchable,
)
from hapsim.cli.live import LiveOptions, live_line, not_cached, warn_if_elsewhere
from hapsim.cli.output import document, print_line, print_message, stderr, warn
from hapsim.errors import UsageError
from hapsim.number_format import plural
from hapsim.scene.issue import as_argument, command_line
from hapsim.scene.shipped import (
    SCENES,
    shipped_board,
    shipped_boards,
    shipped_scene,
    shipped_scene_path,
    shipped_scenes,
)
from hapsim.scene.smartknob import scene_from_smartknob
from hapsim.whole_file import whole_file


def new(
    path: Path = argument(None, "File to write.", default=Path("scene.yaml")),
    from_: str | None = option(
        "NAME", "Shipped scene to copy. `hapsim scenes` lists them [default: first_touch]", "--from"
    ),
    board: str | None = option("NAME", "Board whose first scene is copied, such as hapkit.", "--board"),
    smartknob: Path | None = option("FILE", "SmartKnob configuration (JSON) to make a scene of.", "--from-smartknob"),
) -> None:
    """Write a scene file to start from."""

    given = {"--from": from_, "--board": board, "--from-smartknob": smartknob}
    if len(named := [name for name, value in given.items() if value is not None]) > 1:
        raise UsageError(f"{' and '.join(named)}: each says what to write, expected one of them")
    if board is not None and board not in shipped_boards():
        raise UsageError(f"--board: found {board!r}, expected one of {', '.join(shipped_boards())}")
    if from_ is not None and shipped_scene_path(from_) is None:
        raise UsageError(f"--from: found {from_!r}, expected one of {', '.join(shipped_scenes())}")
    if os.path.lexists(path):
        raise UsageError(f"{path}: the file exists and is not replaced; name another")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")
    unsaid: list[str] = []
    if smartknob is not None:
        text, unsaid = scene_from_smartknob(smartknob)
    else:
        text = shipped_scene(from_ or "first_touch") if board is None else shipped_board(board)
    with whole_file(path) as file:
        file.write_text(text, encoding="utf-8")
    for sentence in unsaid:
        print_line(f"Not in the scene: {escape(sentence)}.")
    print_line(f"Wrote {path}. Next:")
    for command in ("check", "measure"):
        print(f"  hapsim {command} {command_line(as_argument(str(path)))}")  # unbroken, so that it can be copied


def scenes(json: Json = False) -> None:
    """List the scenes that ship with hapsim."""

    known = shipped_scenes()
    if json:
        print(document({name: {"path": str(SCENES / f"{name}.yaml"), "title": title} for name, title in known.items()}))
        return
    for name, title in known.items():
        print_line(f"{name:24}{title}", indent=" " * 24)
    print_line("`hapsim check NAME` and the other commands find them by name; `hapsim new --from NAME` copies one.")


def files(json: Json = False) -> None:
    """Print the paths of the scenes, the protocol's header, the firmware and the pages."""

    product, protocol = Path(hapsim.__file__).parent, Path(firmware_protocol.__file__).parent
    places = {
        "scenes": SCENES,
        "header": protocol / "hapsim_protocol.h",
        "firmware": protocol / "firmware",
        "protocol": protocol / "PROTOCOL.md",
        "porting": protocol / "PORTING.md",
        "using": product / "USING.md",
        "manual": product / "hapsim.1",
        "scene keys": SCENES / "README.md",
        "modules": product / "cordis" / "MODULES.md",
        "stability": product / "STABILITY.md",
        "theory": product / "theory" / "README.md",
        "methods": product / "METHODS.md",
        "architecture": product / "README.md",
    }
    if json:
        print(document({name.replace(" ", "_"): str(path) for name, path in places.items()}))
        return
    for name, path in places.items():
        print(f"{name:12} {path}")  # unbroken, so that it can be copied


def schema() -> None:
    """Print the JSON schema of scenes, for editors that complete and check YAML."""
    from hapsim.scene import scene_schema

    print(json_text.dumps(scene_schema(), indent=2))


def compile_(
    scenes: list[str] | None = argument("[SCENE]…", "Scenes to compile for [default: whatever any scene needs]"),
    json: Json = False,
) -> None:
    """Compile ahead of the first run. No device is touched.

    The code is kept in ~/.cache/hapsim, or in the directory that --cache or the variable HAPSIM_CACHE names.
    """
    from hapsim.running.compile_ahead import prepare

    loaded = [load(path) for path in scenes or ()]
    with live_line(stderr(), warn_not_cached=False) as show_progress:
        prepared = prepare(loaded, show_progress)
    kept = prepared.directory
    if json:
        directory = None if kept is None else str(kept)
        print(document({"functions": prepared.functions, "seconds": prepared.seconds, "directory": directory}))
    elif prepared.functions:
        compiled = f"Compiled {plural(prepared.functions, 'function')} in {prepared.seconds:.1f} s"
        print_line(f"{compiled}; kept in {kept}" if kept else compiled)
    else:
        print_line(f"Nothing to compile: everything is kept in {kept}")
    if prepared.problem:
        warn(not_cached(prepared.problem), "unkept")
    if prepared.problem or warn_if_elsewhere(kept):
        raise typer.Exit(UsageError.exit_status)


def service(
    scene: SceneFile,
    port: Port = None,
    user: bool = flag("--user", "Print a unit for your own service manager, which grants fewer privileges."),
    watch: Watch = False,
    sound: bool = flag("--sound", "Play the scene's sound on an ALSA sound card."),
    *,
    live: LiveOptions,
    json: Json = False,
) -> None:
    """Print a systemd unit that runs SCENE, waits for its device and reports its status to the service manager."""
    from hapsim.loop.system import require_linux
    from hapsim.prediction import predict
    from hapsim.running.requirements import refusal_to_arm
    from hapsim.running.service import service_access_problem, unit_for, unit_name

    require_linux("a service of systemd", "`hapsim run SCENE --reconnect` waits for the device; start it as a program")
    require_file(scene, "SCENE")
    loaded = load(scene, port)
    require_watchable(loaded, watch)
    on = loaded.device.port
    if on is None:
        raise UsageError(f"{scene}: a service drives a device: found no port, expected --port, or one in the scene")
    words, record_dir = live.words(), live.record_dir
    text = unit_for(
        scene,
        on,
        of_user=user,
        watch=watch,
        sound=sound,
        live=words,
        record_dir=record_dir,
        device=loaded.device_name,
    )
    name = unit_name(on)
    if refusal := refusal_to_arm(scene, loaded, predict(loaded, with_margins=False)):
        warn(f"`hapsim run` will refuse this scene, and the service ends with status 2. {refusal}", "service")
    if not user and (closed := service_access_problem(scene)):
        warn(closed, "service")
    if json:
        print(document({"name": name, "unit": text}))
        return
    print(text, end="")
    folder, control = ("~/.config/systemd/user", "systemctl --user") if user else ("/etc/systemd/system", "systemctl")
    print_message(f"Save it as {folder}/{name}, then `{control} daemon-reload` and `{control} enable --now {name}`.")
