"""A script: which faults happen when, in YAML, with errors by file, line and column as scenes have them."""

from __future__ import annotations

import os
from typing import Annotated, get_args

from pydantic import Field, ValidationError

from hapsim.bringup.faults.device_faults import DeviceFault
from hapsim.bringup.faults.fault import Fault
from hapsim.bringup.faults.wire_faults import WireFault
from hapsim.errors import UsageError
from hapsim.scene.error_messages import Layout, findings_of
from hapsim.scene.part import Part
from hapsim.scene.quantity import count, version
from hapsim.scene.yaml_file import YamlFile

KINDS: dict[str, type[Fault]] = {
    fault.model_fields["kind"].default: fault for fault in get_args(WireFault) + get_args(DeviceFault)
}
"""The class of each `kind`, in the order in which `hapsim faults --list` prints them."""


class Script(Part):
    """What happens on the wire. The faults of a script act one after the other on every frame, in its order.

    Attributes:
        version: of the format, 1.
        seed: of everything random: the same seed and the same bytes make the same faults.
        faults: which, in the order of the file.
    """

    version: Annotated[int, version(1, "script")]
    seed: Annotated[int, count("Seed of everything random", 0, 2**32 - 1)] = 0
    faults: list[Annotated[WireFault | DeviceFault, Field(discriminator="kind")]] = Field(min_length=1)


_FILE = YamlFile(UsageError, "a script of faults in YAML", "found nothing, expected a script: version and faults")
_LAYOUT = Layout(
    Script,
    "faults",
    "kind",
    KINDS,
    "a mapping such as {kind: drop, probability: 0.001}",
    {(): "a mapping with version and faults", ("faults",): "a list of faults, at least one"},
)


def load_script(path: str | os.PathLike[str]) -> Script:
    """Returns the script of a file. Raises UsageError with one line for each error in it."""
    return parse_script(_FILE.text_of(path), os.fsdecode(path))


def parse_script(text: str, name: str = "<script>") -> Script:
    """Returns the script of a text in YAML that errors call `name`. Raises UsageError with one line for each error."""
    document = _FILE.document_of(text, name)
    script, issues = None, []
    try:
        script = Script.model_validate(document.data)
    except ValidationError as error:
        issues = findings_of(error, document, _LAYOUT)
    located = _FILE.located(issues, document)
    if script is None or located:
        raise _FILE.failure(name, located)
    return script
