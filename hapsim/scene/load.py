"""Scene files -> `Scene`, or a `SceneError` that holds every fault of the file."""

import os

from pydantic import ValidationError

from hapsim.errors import SceneError

from .cross_checks import cross_check_issues
from .error_messages import findings_of
from .issue import Issue
from .partial_validation import sound_fields, sound_modules
from .scene import VERSION, Scene
from .yaml_document import Document
from .yaml_file import YamlFile

_FILE = YamlFile(SceneError, "a scene in YAML", "found nothing, expected a scene; `hapsim new` writes a first one")


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene of a file.

    Raises:
        SceneError: the file cannot be read or is not a scene; one line for each fault, in the file's order.
    """
    name = os.fsdecode(path)
    scene = parse_scene(_FILE.text_of(path), name)
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
    document = _FILE.document_of(text, name)
    scene, issues = _validate(document)
    faults = _FILE.located(issues, document)
    if scene is None or faults:
        raise _FILE.failure(name, faults)
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
