"""The live values of a running scene in a file: what differs from the file, and writing it there.

Only what may change while a scene runs is written: a port of the command line, or the sensors of a measurement, is not.
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from hapsim.device.ports import state_directory
from hapsim.errors import SceneError, UsageError
from hapsim.recording.report_file import remove_older
from hapsim.running.live_parameters import parts_of
from hapsim.scene import Hand, Mock, Scene
from hapsim.scene.load import parse_scene, scene_from_document, text_of
from hapsim.scene.rewrite import document, require_rewritable, rewritten, write_text
from hapsim.scene.section import Table
from hapsim.scene.shipped import SCENES

ALL_VALUES = "# All values of a scene in SI units, written by hapsim.\n"
"""First line of a scene that could not be written as its file has it."""

_LIVE = ("modules", "sound", "scheme", "precision")
_OF_WHOLE = ("of", "between")  # keys of modules that are others in the scene at a port
_KEPT = re.compile(r"\d{8}T\d{6}\.\d{6}Z_.*\.yaml")
_PLAIN = re.compile(r"\w(?:[\w .+-]{0,98}[\w+-])?")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # names of Windows' devices
_MOST_LINES = 20  # of a difference


def live_in_file(scene: Scene) -> Scene:
    """Returns the scene of the file with the live values of `scene`, which may be that at one of its ports; one that
    was read from no text as it is."""
    if scene.origin is None:
        return scene
    own = scene.origin.scene
    if scene.at is not None:
        scene = _in_whole(scene, own, scene.at.device)
    live = {name: getattr(scene, name) for name in _LIVE}
    if not own.ports:
        return own.model_copy(update=live | {"mock": _with_hand(own.mock, scene.mock)})
    mocks = {name: _with_hand(own.mocks.get(name), scene.mocks.get(name)) for name in own.ports}
    return own.model_copy(update=live | {"mocks": {name: one for name, one in mocks.items() if one is not None}})


def _in_whole(scene: Scene, whole: Scene, device: str) -> Scene:
    """Returns the scene of all devices with the live values of that at the port of one."""
    modules = dict(whole.modules)
    for name in scene.modules.keys() & modules.keys() - {one.name for one in scene.away}:
        of_whole = {key: getattr(modules[name], key) for key in _OF_WHOLE if hasattr(modules[name], key)}
        modules[name] = scene.modules[name].model_copy(update=of_whole)
    mocks = whole.mocks if scene.mock is None else {**whole.mocks, device: scene.mock}
    sound = Table({**whole.sound, **scene.sound})
    return scene.model_copy(update={"modules": Table(modules), "sound": sound, "mocks": mocks})


def _with_hand(own: Mock | None, live: Mock | None) -> Mock | None:
    """Returns the mock of the file with the hand of the running one."""
    hand = (live or Mock()).hand
    return own if hand == (own or Mock()).hand else (own or Mock()).model_copy(update={"hand": hand})


def unsaved(scene: Scene) -> list[str]:
    """Returns the names of the live values that differ from the file: "touch.stiffness", or "touch" for a module that
    was added, removed or replaced. The hand that holds the mock does not count: a drag on the page leaves it
    anywhere."""
    if scene.origin is None:
        return []
    both = ({**parts_of(one), "": one} for one in (live_in_file(scene), scene.origin.scene))
    now, own = ({name: part for name, part in parts.items() if not isinstance(part, Hand)} for parts in both)
    return list(_differing(own, now))


def _differing(own: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    for name in {**own, **now}:
        before, after = own.get(name, ()), now.get(name, ())
        if type(before) is not type(after):
            yield name
        elif before != after:
            fields = _LIVE[2:] if isinstance(before, Scene) else [*dict(before)]
            yield from (f"{name}.{key}".lstrip(".") for key in fields if getattr(before, key) != getattr(after, key))


def merged(then: Scene, now: Scene, live: Scene) -> Scene:
    """Returns the scene of an edited file with those live values that the edit left alone.

    Args:
        then, now: of the file, before and after the edit.
        live: the running scene.

    Raises:
        SceneError: edit and live values do not go together.
    """
    found = _merged(*(one.document for one in (then, now, live)))
    if found == now.document:
        return now
    made = scene_from_document(found, now)
    return now.model_copy(update={name: getattr(made, name) for name in Scene.model_fields})


def _merged(then: Any, now: Any, live: Any) -> Any:
    if now == then:
        return live
    each = then, now, live
    if not all(isinstance(one, dict) for one in each) or len({one.get("type") for one in each}) > 1:
        return now
    keys = {**now, **live}
    return {key: value for key in keys if (value := _merged(then.get(key), now.get(key), live.get(key))) is not None}


def save(scene: Scene, path: str | os.PathLike[str] | None = None) -> Scene:
    """Writes the live values of a scene into its own file, or, with `path`, the scene into a new one. Returns the scene
    of the file. Raises UsageError, with the file as it was, as `Session.save` describes."""
    own = scene.path
    if path is None and own is None:
        raise UsageError("the scene was read from no file of its own: name a file to save it in")
    target = os.fspath(own or "" if path is None else path)
    _require_outside_package(target)
    if own is not None and (path is None or os.path.realpath(target) == os.path.realpath(own)):
        text = _saved_in_own(scene, own)
    elif os.path.lexists(target):
        raise UsageError(f"{target}: the file exists; it was not touched")
    elif not os.path.isdir(os.path.dirname(target) or "."):
        raise UsageError(f"{target}: no such directory")
    else:
        text = whole_text(scene, os.path.dirname(target))
        write_text(target, text)
    return parse_scene(text, target, os.path.dirname(target)).read_from(target)


def path_named(name: str, directory: Path) -> Path:
    """Returns the file of a name that somebody else chose, in this directory. Raises UsageError for more than a plain
    name."""
    stem = name.removesuffix(".yaml")
    if not _PLAIN.fullmatch(stem) or _RESERVED.fullmatch(stem):
        raise UsageError(f"found the name {name!r}, expected a plain one without a directory, such as softer.yaml")
    return directory / f"{stem}.yaml"


def whole_text(scene: Scene, folder: str | None) -> str:
    """Returns the text of a scene's file with its live values; `all_values` where a value cannot be written in its
    place, or `folder` lacks a file that the text names."""
    try:
        text = _rewritten(scene)
        parse_scene(text, folder=folder)
        return text
    except (SceneError, UsageError):
        return all_values(live_in_file(scene))


def all_values(scene: Scene) -> str:
    """Returns a text with all values of a scene, in SI units and without the comments of its file."""
    return ALL_VALUES + scene.to_yaml()


def _rewritten(scene: Scene) -> str:
    if scene.origin is None:
        raise UsageError("the scene was read from no text")
    origin = scene.origin
    return rewritten(origin.text, document(live_in_file(scene)), scene.path or "the scene", origin.folder)


def _saved_in_own(scene: Scene, path: str) -> str:
    """Writes the live values into the scene's own file. Returns its text."""
    require_rewritable(path)
    require_unchanged(scene, path)
    text = _rewritten(scene)
    if scene.origin is not None and text != scene.origin.text:
        write_text(path, text)
    return text


def require_unchanged(scene: Scene, path: str) -> None:
    """UsageError if the file was changed since the scene was read from it; the message shows what changed."""
    before, now = scene.origin.text if scene.origin else "", text_of(path)
    if before == now:
        return
    lines = list(difflib.unified_diff(before.splitlines(), now.splitlines(), "as read", "now", n=0, lineterm=""))
    more = [f"… and {len(lines) - _MOST_LINES} lines more"] if len(lines) > _MOST_LINES else []
    raise UsageError(
        "\n".join(
            [f"{path}: nothing was written: the file was changed since it was read:", *lines[:_MOST_LINES], *more]
        )
        + "\nSave under another name, or run with --watch, which takes such changes into the running scene"
    )


def _require_outside_package(target: str) -> None:
    package = os.path.realpath(SCENES.parent)
    if os.path.commonpath([package, os.path.realpath(target)]) == package:
        raise UsageError(f"{target}: this is a part of hapsim itself and is not written: save under another name")


class Kept(NamedTuple):
    """Unsaved values that were kept at the end of a run."""

    names: list[str]
    path: Path
    """File with the whole scene."""
    command: str
    """Shell command that writes them into the scene's file; if that was changed meanwhile, one that compares both."""
    is_changed: bool
    """True if the file was changed meanwhile."""


def keep_unsaved(scene: Scene, name: str) -> Kept | None:
    """Keeps a scene whose live values differ from its file in $XDG_STATE_HOME/hapsim/unsaved; None where none does.
    `name`: of the scene. Only the newest stay. Raises OSError and UsageError where it cannot be written."""
    if not (names := unsaved(scene)):
        return None
    directory = state_directory() / "unsaved"
    directory.mkdir(parents=True, exist_ok=True)
    stem = Path(scene.path or name).stem
    path = directory / f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}_{stem}.yaml"
    origin = scene.origin
    write_text(path, whole_text(scene, origin.folder if origin else None))
    remove_older(directory, _KEPT)
    target, is_changed = scene.path or f"{stem}.yaml", False
    if scene.path is not None and os.path.exists(scene.path):
        try:
            require_unchanged(scene, scene.path)
        except UsageError:
            is_changed = True
    writes, compares = ("copy", "fc") if os.name == "nt" else ("cp", "diff")
    return Kept(names, path, shlex.join([compares if is_changed else writes, str(path), target]), is_changed)
