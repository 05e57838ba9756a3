"""What comes before a first run: `hapsim new`, `hapsim schema`, `hapsim compile`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.arguments import Json, load, stderr
from hapsim.cli.sentences import say
from hapsim.errors import UsageError


def new(path: Annotated[Path, typer.Argument(help="Where to write it.")] = Path("scene.yaml")) -> None:
    """Write a first scene to begin from."""
    from hapsim.scene.shipped import shipped_scene

    if path.exists():
        raise UsageError(f"{path}: there is a file already, and it stays as it is; name another")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")
    path.write_text(shipped_scene("first_touch.yaml"), encoding="utf-8")
    say(f"Wrote {path}. Next:")
    for command in ("check", "measure"):
        print(f"  hapsim {command} {shlex.quote(str(path))}")  # whole, however long: it is to be copied


def schema() -> None:
    """Print the scene's JSON schema, for editors that complete and check YAML."""
    import json as json_text

    from hapsim.scene import scene_schema

    print(json_text.dumps(scene_schema(), indent=2))


def compile_(
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="[SCENE]…", help="What these need; left out: what any scene could.")
    ] = None,
    json: Json = False,
) -> None:
    """Compile now what would be compiled at a first start; it is kept, and nothing is armed or moved."""
    from hapsim.cli.live import live_line
    from hapsim.running.prepare import prepare

    loaded = [load(path) for path in scenes or ()]
    with live_line(stderr()) as tell:
        prepared = prepare(loaded, tell)
    if json:
        from hapsim.cli.as_json import document

        kept = None if prepared.directory is None else str(prepared.directory)
        print(document({"functions": prepared.functions, "seconds": prepared.seconds, "directory": kept}))
    elif prepared.directory is None:
        say("Compiled, but there is no place to keep it: set XDG_CACHE_HOME to a directory that can be written to.")
    elif prepared.functions:
        say(f"Compiled {prepared.functions} functions in {prepared.seconds:.1f} s; kept in {prepared.directory}")
    else:
        say(f"Nothing to compile: everything is kept in {prepared.directory}")
