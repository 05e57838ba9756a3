"""A script: which faults happen when, in YAML, with errors by file, line and column as scenes have them."""

from __future__ import annotations

import os
from typing import Annotated

from pydantic import Field, ValidationError

from hapsim.bringup.faults.kinds import KINDS, TypedFault
from hapsim.errors import UsageError
from hapsim.scene.error_messages import Layout, findings_of
from hapsim.scene.part import Part
from hapsim.scene.quantity import Count, Version
from hapsim.scene.yaml_file import YamlFile

VERSION = 1


class Script(Part):
    """What happens on the wire. The faults of a script act one after the other on every frame, in its order.

    Attributes:
        version: of the format, 1.
        seed: of everything that is left to chance: the same seed and the same bytes, the same faults.
        faults: which, in the order of the file.
    """

    version: Annotated[int, Version(VERSION, "script")]
    seed: Annotated[int, Count("Seed of what is left to chance", 0, 2**32 - 1)] = 0
    faults: list[TypedFault] = Field(min_length=1)


_FILE = YamlFile(UsageError, "a script of faults in YAML", "found nothing, expected a script: version and faults")
_LAYOUT = Layout(
    {(): Script},
    "faults",
    "kind",
    KINDS,
    "a mapping such as {kind: drop, probability: 0.001}",
    {(): "a mapping with version and faults", ("faults",): "a list of faults, at least one"},
)


def load_script(path: str | os.PathLike[str]) -> Script:
    """The script of a file. UsageError where it cannot be read or is none, with one line for each fault in it."""
    return parse_script(_FILE.text_of(path), os.fsdecode(path))


def parse_script(text: str, name: str = "<script>") -> Script:
    """The script of a text in YAML that errors call `name`. UsageError, one line for each fault in it."""
    document = _FILE.document_of(text, name)
    try:
        script = Script.model_validate(document.data)
        issues = []
    except ValidationError as error:
        script, issues = None, findings_of(error, document, _LAYOUT)
    faults = _FILE.located(issues, document)
    if script is None or faults:
        raise _FILE.failure(name, faults)
    return script
