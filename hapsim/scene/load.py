"""Scene files -> `Scene`, or a `SceneError` that holds every fault of the file."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path as FilePath

from pydantic import ValidationError

from hapsim.errors import SceneError

from .cross_checks import cross_check_issues
from .document import Document
from .error_messages import findings_of
from .issue import Issue, LocatedIssue, Path, Place, did_you_mean, quote
from .partial_validation import sound_fields, sound_modules
from .quantity import Name
from .scene import VERSION, Scene
from .syntax import YamlSyntaxError, compose, place_in


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene of a file.

    Raises:
        SceneError: the file cannot be read or is not a scene; one line for each fault, in the file's order.
    """
    name = os.fsdecode(path)
    try:
        content = FilePath(name).read_bytes()
    except (OSError, ValueError) as error:
        raise SceneError(f"{name}: {_unreadable(name, error)}") from None
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        readable = content[: error.start].decode("utf-8")
        place = place_in(readable, len(readable))
        sentence = f"found the byte 0x{content[error.start]:02x}, expected text in UTF-8"
        raise _scene_error(name, [LocatedIssue(place, sentence)]) from None
    scene = parse_scene(text, name)
    scene._path = name
    return scene


def parse_scene(text: str, name: str = "<scene>") -> Scene:
    """The scene of a text in YAML.

    Args:
        text: the YAML.
        name: what errors call it.

    Raises:
        SceneError: the text is not a scene; one line for each fault, in the text's order.
    """
    try:
        root = compose(text)
    except YamlSyntaxError as error:
        raise _scene_error(name, [error.fault]) from None
    document = Document(root) if root is not None else None
    if document is None or (document.data is None and not document.faults):
        nothing = LocatedIssue(Place(1, 1), "found nothing, expected a scene; `hapsim new` writes a first one")
        raise _scene_error(name, [nothing])
    scene, issues = _validate(document)
    known = {fault.place for fault in document.faults}
    faults = [_fault(issue, document) for issue in issues if not _follows(issue, document, known)]
    faults += document.faults
    if scene is None or faults:
        raise _scene_error(name, faults)
    return scene


def _validate(document: Document) -> tuple[Scene | None, list[Issue]]:
    """The scene of a document and nothing, or no scene and what is wrong with it."""
    try:
        return Scene.model_validate(document.data), []
    except ValidationError as error:
        data = document.data if isinstance(document.data, dict) else {}
        issues = findings_of(error, document)
        other_version = data.get("version")
        if type(other_version) is int and other_version != VERSION:
            # Another format: what else seems wrong may be right in it.
            return None, [issue for issue in issues if issue.path == ("version",)]
        around = sound_modules(data.get("modules"))
        return None, issues + cross_check_issues(around, sound_fields(data, issues), data.get("precision"))


def _follows(issue: Issue, document: Document, known: set[Place]) -> bool:
    """A value that could not even be read is reported for that alone."""
    return not issue.at_key and document.place(issue.path) in known


def _fault(issue: Issue, document: Document) -> LocatedIssue:
    name = _label(issue.path)
    sentence = f"{name}: {issue.sentence}" if name else issue.sentence
    return LocatedIssue(document.place(issue.path, issue.at_key), sentence)


def _label(path: Path) -> str:
    """How an error names a value: its key, with the index if it is in a list; nothing for the whole scene."""
    names = [step for step in path if isinstance(step, str)]
    if not names:
        return ""
    name = names[-1] if Name.PATTERN.fullmatch(names[-1]) and len(names[-1]) <= 60 else quote(names[-1])
    return name + "".join(f"[{step}]" for step in path if isinstance(step, int))


def _scene_error(name: str, faults: Iterable[LocatedIssue]) -> SceneError:
    """One line for each fault; one that an anchor brings to several places is reported once."""
    lines = [
        f"{name}:{fault.place.line}:{fault.place.column}: {fault.sentence}"
        for fault in sorted(dict.fromkeys(faults), key=lambda fault: fault.place)
    ]
    return SceneError("\n".join(lines))


def _unreadable(name: str, error: OSError | ValueError) -> str:
    match error:
        case FileNotFoundError():
            folder, wanted = os.path.split(name)
            with suppress(OSError):
                hint = did_you_mean(wanted, os.listdir(folder or "."))
                return f"no such file, expected a scene in YAML{hint}"
            return "no such directory, expected a scene in YAML"
        case IsADirectoryError():
            return "found a directory, expected a file with a scene in YAML"
        case PermissionError():
            return "this file may not be read, expected one that may; check its permissions"
        case OSError(strerror=reason):
            return f"this file cannot be read: {reason}"
        case _:
            return "this is not the name of a file"
