"""Other values for the device of a scene's file, and nothing else of the file changed: not a comment, not a space.

Text is replaced only where a YAML node has a value; a YAML writer would lay out the whole file anew. The new text is
parsed and compared with the intended scene.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from hapsim.errors import SceneError, UsageError
from hapsim.units import Motion, Units
from hapsim.whole_file import whole_file

from .device import Device
from .drive import SIDES, Transmission
from .load import parse_scene
from .quantity import Expectation, expectation_of
from .scene import Scene
from .values import Known, Span, per_channel
from .written_units import QUANTITY, UnitError, has_dimension, in_si, like
from .yaml_document import compose

_PER_CHANNEL = ("mass", "friction", "stiffness", "motor_lag")
_INNER = "transmission"

#: Numbers and words as text, or measured numbers, by keys of `device`, such as mass or transmission.stiffness.
Values = Mapping[str, str | Known]


def rewrite_device(path: str, values: Values, channel: int) -> dict[str, str]:
    """Writes `values` into the `device` section of a scene's file; where channels may differ, for `channel` alone. The
    file is replaced as a whole, or stays as it is. Returns the text that the file then has for each value.

    Raises:
        UsageError: the file cannot be written, is no scene any more, or says these values in a way (an anchor, a merge)
            in which they cannot be changed without changing something else.
    """
    place = Path(os.path.realpath(path))
    require_rewritable(path)
    text = place.read_bytes().decode("utf-8")
    rewritten = device_rewritten(text, values, channel, path)
    with whole_file(place) as file:
        file.write_bytes(rewritten.encode("utf-8"))
    device = _entry(compose(rewritten), "device")
    nodes = {key: _entry(_section(device, key), _name(key)) for key in values}
    return {key: rewritten[node.start_mark.index : _end(node)] for key, node in nodes.items() if node is not None}


def require_rewritable(path: str) -> None:
    """UsageError where the file could not be written: better before a run than after it."""
    place = Path(os.path.realpath(path))
    if not os.access(place, os.W_OK) or not os.access(place.parent, os.W_OK):
        raise UsageError(f"{path}: this file cannot be written; check its permissions and those of its directory")


def device_rewritten(text: str, values: Values, channel: int, name: str = "<scene>") -> str:
    """Returns the text with these values. Raises as `rewrite_device`; `name`: what errors call the text."""
    folder = os.path.dirname(name)
    before = parse_scene(text, name, folder)
    written = {key: _entries(before, key, value, channel) for key, value in values.items()}
    after = _spliced(text, written, channel, before.device.motions(before.channels)[channel])
    wanted = {key: _as_values(entries) for key, entries in written.items() if key == _name(key)}
    if inner := {_name(key): _as_values(entries) for key, entries in written.items() if key != _name(key)}:
        wanted[_INNER] = Transmission(**dict(before.device.transmission or ()) | inner)
    expected = before.model_copy(update={"device": before.device.model_copy(update=wanted)})
    with contextlib.suppress(SceneError):
        if after is not None and parse_scene(after, name, folder).model_dump() == expected.model_dump():
            return after
    lines = ", ".join(f"{key}: {value}" for key, value in values.items())
    raise UsageError(
        f"{name}: nothing was written: its device section says a value by an anchor or a merge, which stands for other "
        f"places too. Write it yourself, under device: {lines}"
    )


def _entries(scene: Scene, key: str, value: str | Known, channel: int) -> list[Any]:
    """Returns the device's new entries for `key`: one value, or one per channel where channels may differ."""
    name, own = _name(key), scene.device.transmission
    if key == name not in _PER_CHANNEL or scene.channels == 1:
        return [value]
    if key != name and own is None:  # without a motor's mass the other channels stay as they are
        return [value if i == channel or name != "motor_mass" else "0" for i in range(scene.channels)]
    if key == "mass" and scene.device.mass_matrix(scene.channels) is not None:
        raise UsageError(
            f"{scene.path or 'the scene'}: nothing was written: device.mass is a matrix, of which one measured mass is "
            "no entry. Measure each of its entries, and write them yourself"
        )
    each: list[Any] = list(per_channel(getattr(scene.device if key == name else own, name), scene.channels))
    each[channel] = value
    return each


def _as_text(entries: list[Any], key: str, old: yaml.Node | None, text: str, channel: int) -> str:
    """Returns the entries as the file writes them, in the units of the `old` ones in `text`. In a list only the entry
    of `channel` is new; the others stay as they are written."""
    if not isinstance(old, yaml.SequenceNode) or len(old.value) != len(entries):
        texts = [_entry_text(entry, key, old) for entry in entries]
    else:
        texts = [text[one.start_mark.index : _end(one)] for one in old.value]
        texts[channel] = _entry_text(entries[channel], key, old.value[channel])
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


def _entry_text(entry: object, key: str, old: yaml.Node | None) -> str:
    """Returns a number or a mapping as text, with the unit of the `old` one if that has a unit."""
    quantity, expected = next(_quantities_in(old), ""), _expectation(key)
    if not quantity or expected is None or isinstance(entry, Span):
        return str(entry)
    if isinstance(entry, Known):
        each = (f"{name}: {like(quantity, str(value), expected.unit)}" for name, value in entry.model_dump().items())
        return f"{{{', '.join(each)}}}"
    return like(quantity, str(entry), expected.unit)


def _expectation(key: str) -> Expectation | None:
    return expectation_of((Device if key == _name(key) else Transmission).model_fields[_name(key)])


def _quantities_in(node: yaml.Node | None) -> Iterator[str]:
    """Yields the texts with a unit in a value: a number, a mapping or a list of numbers, or more."""
    if isinstance(node, yaml.ScalarNode):
        yield from [node.value] if QUANTITY.match(node.value) else []
    elif isinstance(node, yaml.MappingNode | yaml.SequenceNode):
        for each in node.value:
            yield from _quantities_in(each[1] if isinstance(node, yaml.MappingNode) else each)


def _example(quantities: list[str], key: str, motion: Motion) -> yaml.Node | None:
    """Returns a quantity whose unit suits a new entry: the first of its dimension in the file, or the SI unit if all
    are of others; None if the file has no units."""
    if not quantities or (expected := _expectation(key)) is None or not has_dimension(expected.unit):
        return None
    for one in quantities:
        with contextlib.suppress(UnitError):
            in_si(one, expected.unit, [motion])
            return yaml.ScalarNode("", one)
    return yaml.ScalarNode("", f"1 {Units.of([motion]).name(expected.unit)}")


def _as_values(entries: list[Any]) -> object:
    values = tuple(float(entry) if isinstance(entry, str) and entry not in SIDES else entry for entry in entries)
    return values[0] if len(values) == 1 else values


def _spliced(text: str, values: Mapping[str, list[Any]], channel: int, motion: Motion) -> str | None:
    """The text with the values in their places; None where a place is not to be found. `motion`: of the channel."""
    scene = compose(text)
    device, quantities = _entry(scene, "device"), list(_quantities_in(scene))
    mass = _entry(device, "mass")
    if not isinstance(device, yaml.MappingNode) or mass is None:
        return None
    edits, section_text = [], []
    for key, entries in values.items():
        section, name = _section(device, key), _name(key)
        node = _entry(section, name)
        value = _as_text(entries, key, node or _example(quantities, key, motion), text, channel)
        if isinstance(section, yaml.MappingNode):
            beside = mass if section is device else section.value[0][1]
            edits.append(_replaced(text, node, value) if node else _inserted(text, section, beside, f"{name}: {value}"))
        else:
            section_text.append(f"{name}: {value}")
    if section_text:
        edits.append(_inserted(text, device, mass, f"{_INNER}: {{{', '.join(section_text)}}}"))
    for begin, end, new in sorted(edits, key=lambda edit: edit[0], reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _name(key: str) -> str:
    """Returns the key within its section."""
    return key.removeprefix(f"{_INNER}.")


def _section(device: yaml.Node | None, key: str) -> yaml.Node | None:
    """Returns the section of a key: the device's, or its transmission."""
    return device if key == _name(key) else _entry(device, _INNER)


def _entry(mapping: yaml.Node | None, key: str) -> yaml.Node | None:
    """The value that a mapping has of its own under `key`."""
    if not isinstance(mapping, yaml.MappingNode):
        return None
    return next((value for name, value in mapping.value if name.value == key), None)


def _end(node: yaml.Node) -> int:
    """Returns the index after a value's text. A block mapping ends with its last entry, not at the next key."""
    last: yaml.Node = node.value[-1][1] if isinstance(node, yaml.MappingNode) and not node.flow_style else node
    return int(last.end_mark.index)


def _replaced(text: str, node: yaml.Node, new: str) -> tuple[int, int, str]:
    """(from, to, what stands there then); a comment behind it stays in its column, if there is room."""
    begin, end = node.start_mark.index, _end(node)
    rest = text[end:].split("\n", 1)[0]
    gap = len(rest) - len(rest.lstrip(" "))
    if not rest.lstrip(" ").startswith("#"):
        return begin, end, new
    return begin, end + gap, new + " " * max(2, gap - (len(new) - (end - begin)))


def _inserted(text: str, device: yaml.MappingNode, mass: yaml.Node, entry: str) -> tuple[int, int, str]:
    """(where, where, an entry after that of the mass): in the same line in braces, otherwise in a line of its own."""
    end = _end(mass)
    if device.flow_style:
        return end, end, f", {entry}"
    key = next(name for name, value in device.value if value is mass)
    margin = " " * key.start_mark.column
    until = text.find("\n", end)
    if until < 0:
        return len(text), len(text), f"\n{margin}{entry}"
    newline = "\r\n" if text[until - 1] == "\r" else "\n"
    return until + 1, until + 1, f"{margin}{entry}{newline}"
