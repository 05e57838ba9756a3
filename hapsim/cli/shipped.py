"""`hapsim new`, `scenes` and `files`: what ships with hapsim, and where it is."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Annotated

import typer

import firmware_protocol
import hapsim
from hapsim.cli.options import Json
from hapsim.cli.output import document, say
from hapsim.errors import UsageError
from hapsim.scene.issue import as_argument
from hapsim.scene.shipped import (
    SCENES,
    shipped_board,
    shipped_boards,
    shipped_scene,
    shipped_scene_path,
    shipped_scenes,
)
from hapsim.whole_file import whole_file


def new(
    path: Annotated[Path, typer.Argument(help="Where to write it.")] = Path("scene.yaml"),
    from_: Annotated[
        str | None,
        typer.Option(
            "--from", metavar="NAME", help="Copy this scene; `hapsim scenes` lists them [default: first_touch]"
        ),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option("--board", metavar="NAME", help="Copy the first scene of this device, such as hapkit."),
    ] = None,
) -> None:
    """Write a first scene to begin with."""

    if from_ is not None and board is not None:
        raise UsageError("--from and --board: each names a scene to copy, expected one of them")
    if board is not None and board not in shipped_boards():
        raise UsageError(f"--board: found {board!r}, expected one of {', '.join(shipped_boards())}")
    if from_ is not None and shipped_scene_path(from_) is None:
        raise UsageError(f"--from: found {from_!r}, expected one of {', '.join(shipped_scenes())}")
    if os.path.lexists(path):
        raise UsageError(f"{path}: the file exists and is not replaced; name another")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")
    with whole_file(path) as file:
        text = shipped_scene(from_ or "first_touch") if board is None else shipped_board(board)
        file.write_text(text, encoding="utf-8")
    say(f"Wrote {path}. Next:")
    for command in ("check", "measure"):
        print(
            f"  hapsim {command} {shlex.quote(as_argument(str(path)))}"
        )  # on one line, however long: it is to be copied


def scenes(json: Json = False) -> None:
    """List the scenes that ship with hapsim."""

    known = shipped_scenes()
    if json:
        print(document({name: {"path": str(SCENES / f"{name}.yaml"), "title": title} for name, title in known.items()}))
        return
    for name, title in known.items():
        say(f"{name:24}{title}", indent=" " * 24)
    say("`hapsim check NAME` and the other commands find them by name; `hapsim new --from NAME` copies one.")


def files(json: Json = False) -> None:
    """Print where the scenes, the protocol's header, the firmware and the pages are."""

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
        "architecture": product / "README.md",
    }
    if json:
        print(document({name.replace(" ", "_"): str(path) for name, path in places.items()}))
        return
    for name, path in places.items():
        print(f"{name:12} {path}")  # on one line, however long: it is to be copied
