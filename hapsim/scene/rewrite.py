"""Other values in the text of a scene, and nothing else of it changed: not a comment, not a space.

Text is replaced only where a YAML node has a value; a YAML writer would lay out the whole file anew. The new text is
parsed and compared with the intended scene.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath
from typing import Any

import yaml

from hapsim.errors import SceneError, UsageError
from hapsim.units import MOTIONS
from hapsim.whole_file import whole_file

from .admittance import Servo
from .drive import SIDES, Transmission
from .issue import Path
from .load import fields_at, parse_scene
from .mock import Mock
from .scene import Scene
from .values import Known, per_channel
from .written_units import QUANTITY, UnitError, in_si, like
from .yaml_document import compose

_PER_CHANNEL = ("mass", "friction", "stiffness", "motor_lag")
_INNER: dict[str, Any] = {"transmission": Transmission, "servo": Servo}
_PARTS: tuple[Path, ...] = ((), ("modules",), ("sound",))
_COMMENT = re.compile(r"([^\n\r]*?)( +)(?=#)")
_MARKS = re.compile(r"(?:[&!]\S*\s+)+")
_WORD = re.compile(r"(?!(?:y|n|yes|no|on|off|true|false|null)\Z)[A-Za-z_][\w.-]*\Z", re.IGNORECASE)
_ROUNDS = 3  # a value may follow from one that was written, such as the turn of a curve from its points

#: Numbers and words as text, or measured numbers, by keys of `device`, such as mass or transmission.stiffness.
Values = Mapping[str, str | Known]


def rewrite_device(path: str, values: Values, channel: int, name: str | None = None) -> dict[str, str]:
    """Writes `values` into the `device` section of a scene's file, or into that of the device of this name; where
    channels may differ, for `channel` alone. The file is replaced as a whole, or stays as it is. Returns the text that
    the file then has for each value.

    Raises:
        UsageError: the file cannot be written, is no scene any more, or says these values in a way (an anchor, a merge)
            in which they cannot be changed without changing something else.
    """
    require_rewritable(path)
    text = device_rewritten(FilePath(path).read_bytes().decode("utf-8"), values, channel, path, name)
    write_text(path, text)
    root, places = compose(text), {key: _split(key) for key in values}
    device = _entry(root, "device") if name is None else _entry(_entry(root, "devices"), name)
    nodes = {key: _entry(_entry(device, inner) if inner else device, own) for key, (inner, own) in places.items()}
    return {key: text[node.start_mark.index : _end(node)] for key, node in nodes.items() if node is not None}


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a file as a whole, or leaves it as it is. UsageError where it cannot be written."""
    with whole_file(path) as file:
        file.write_bytes(text.encode("utf-8"))


def require_rewritable(path: str | os.PathLike[str]) -> None:
    """UsageError where the file could not be written: better before a run than after it."""
    place = FilePath(os.path.realpath(path))
    if not place.exists():
        raise UsageError(f"{path}: the file is gone: save under another name")
    if not os.access(place, os.W_OK) or not os.access(place.parent, os.W_OK):
        raise UsageError(f"{path}: this file cannot be written; check its permissions and those of its directory")


def device_rewritten(text: str, values: Values, channel: int, name: str = "<scene>", device: str | None = None) -> str:
    """Returns the text with these values. Raises as `rewrite_device`; `name`: what errors call the text."""
    folder = os.path.dirname(name)
    whole = parse_scene(text, name, folder)
    before = whole if device is None else whole.with_others_held(device)
    own = {key: _as_values(_entries(before, key, value, channel)) for key, value in values.items()}
    for section, kind in _INNER.items():
        if inner := {last: own.pop(key) for key in values for within, last in [_split(key)] if within == section}:
            own[section] = kind(**dict(getattr(before.device, section) or ()) | inner)
    changed = before.device.model_copy(update=own)
    update = {"device": changed} if device is None else {"devices": dict(whole.devices) | {device: changed}}
    wanted = whole.model_copy(update=update)
    return rewritten(text, document(wanted), name, folder)


def document(scene: Scene) -> dict[str, Any]:
    """Returns a scene as a document in which every mock has a section, too."""
    mocks = {name: scene.mocks.get(name, Mock()) for name in scene.ports}
    return scene.model_copy(update={"mocks": mocks} if mocks else {"mock": scene.mock or Mock()}).document


def rewritten(text: str, wanted: dict[str, Any], name: str, folder: str | None) -> str:
    """Returns the text of a scene with the values of another one in their places.

    Args:
        text: of a scene, which errors call `name`; `folder`: of the files that it names.
        wanted: the `document` of the other scene.

    Raises:
        UsageError: a value stands for others too (an anchor, a merge), or the other scene lacks parts of this one.
    """
    scene, after, first = parse_scene(text, name, folder), text, None
    for _ in range(_ROUNDS):
        now = document(scene)
        if now == wanted and [*now["modules"]] == [*wanted["modules"]]:
            return after
        edits = _Edits(after, scene, now, wanted)
        first = first or edits
        after = edits.made()
        try:
            scene = parse_scene(after, name, folder)
        except SceneError:
            break
    raise UsageError(f"{name}: nothing was written: {first.why_refused() if first else ''}")


class _Edits:
    """The edits of a text that bring the values of its scene, `now`, to those of `wanted`: documents."""

    def __init__(self, text: str, scene: Scene, now: dict[str, Any], wanted: dict[str, Any]) -> None:
        root = compose(text)
        self._text, self._field_at = text, fields_at(scene, wanted)
        self._all = list(_quantities_in(root))
        self._uses = Counter(map(id, _nodes_in(root)))
        self._edits: dict[tuple[int, int], str] = {}
        self._values: dict[Path, str] = {}  # new text by path,
        self._shared: list[Path] = []  # those that stand for other places,
        self._lacking: list[Path] = []  # and parts that `wanted` lacks
        if root is not None:
            self._change(root, now, wanted, (), False)

    def made(self) -> str:
        """Returns the text with the edits."""
        text = self._text
        for (begin, end), new in sorted(self._edits.items(), reverse=True):
            rest = text[end:] if begin == end else _comment_in_place(text[end:], len(new) - (end - begin))
            text = text[:begin] + new + rest
        return text

    def why_refused(self) -> str:
        """Returns why the edits do not lead to the wanted scene, and what to do."""
        if self._lacking:
            return f"its {_dotted(self._lacking[0])} is no part of the scene any more, and no part is removed"
        paths = self._shared or self._values
        lines = "; ".join(f"{_dotted(path)}: {self._values[path]}" for path in paths)
        by = "stands by an anchor or a merge" if self._shared else "may stand by an anchor or a merge"
        return f"a value {by}, which has it in other places too. Write it yourself: {lines}"

    def _change(self, node: yaml.Node, old: Any, new: Any, path: Path, is_shared: bool) -> None:
        """Notes the edits of the value of a node. `is_shared`: it stands for other places, too."""
        if old == new:
            return
        is_shared = is_shared or self._uses[id(node)] > 1
        if isinstance(node, yaml.MappingNode) and isinstance(old, dict) and isinstance(new, dict):
            if path in _PARTS:
                self._lacking += [(*path, key) for key in old if key not in new]
            if path in _PARTS or (old.keys() <= new.keys() and old.get("type") == new.get("type")):
                self._change_mapping(node, old, new, path, is_shared)
                return
        elif isinstance(node, yaml.MappingNode) and _entry(node, "range") is not None:
            node = _entry(node, "value") or node
        elif isinstance(node, yaml.SequenceNode) and _are_lists(len(node.value), old, new):
            for i, (entry, before, after) in enumerate(zip(node.value, old, new, strict=True)):
                self._change(entry, before, after, (*path, i), is_shared)
            return
        self._note(path, self._written(new, path, list(_quantities_in(node)), False), is_shared)
        begin, end = node.start_mark.index, _end(node)
        if marks := _MARKS.match(self._text, begin, end):  # an anchor stays
            begin = marks.end()
        self._edits[begin, end] = self._values[path]

    def _change_mapping(self, node: yaml.MappingNode, old: Any, new: Any, path: Path, is_shared: bool) -> None:
        before = ""  # the last key that the file has
        for key, value in new.items():
            if (entry := _entry(node, key)) is not None:
                self._change(entry, old.get(key), value, (*path, key), is_shared)
                before = key
            elif old.get(key) != value:
                here = (*path, key)
                self._note(here, self._written(_difference(old.get(key), value), here, self._all, True), is_shared)
                at, text = _inserted(self._text, node, before, f"{_word(key)}: {self._values[here]}")
                self._edits[at, at] = self._edits.get((at, at), "") + text

    def _note(self, path: Path, text: str, is_shared: bool) -> None:
        self._values[path] = text
        self._shared += [path] * is_shared

    def _written(self, value: Any, path: Path, near: list[str], is_new: bool) -> str:
        """Returns a value as text: a quantity with the unit of the first in `near` that suits it; a new one with the SI
        unit where all are of others."""
        if isinstance(value, dict):
            each = (f"{_word(key)}: {self._written(one, (*path, key), near, is_new)}" for key, one in value.items())
            return f"{{{', '.join(each)}}}"
        if isinstance(value, list):
            return f"[{', '.join(self._written(one, (*path, i), near, is_new) for i, one in enumerate(value))}]"
        if isinstance(value, bool | str):
            return _word(value) if isinstance(value, str) else json.dumps(value)
        number = repr(value).removesuffix(".0")
        unit, units = self._field_at(path)
        for one in near if unit else ():
            with contextlib.suppress(UnitError):
                in_si(one, unit, units.motions or MOTIONS)
                return like(one, number, unit)
        return f"{number} {units.si.name(unit)}" if unit and near and is_new and units.motions else number


def _entries(scene: Scene, key: str, value: str | Known, channel: int) -> list[Any]:
    """Returns the device's new entries for `key`: one value, or one per channel where channels may differ."""
    section, name = _split(key)
    own = getattr(scene.device, section) if section else scene.device
    if (not section and name not in _PER_CHANNEL) or scene.channels == 1:
        return [value]
    if section and own is None:  # without a motor's mass the other channels stay as they are
        return [value if i == channel or name != "motor_mass" else "0" for i in range(scene.channels)]
    if key == "mass" and scene.device.mass_matrix(scene.channels) is not None:
        raise UsageError(
            f"{scene.path or 'the scene'}: nothing was written: device.mass is a matrix, of which one measured mass is "
            "no entry. Measure each of its entries, and write them yourself"
        )
    each: list[Any] = list(per_channel(getattr(own, name), scene.channels))
    each[channel] = value
    return each


def _as_values(entries: list[Any]) -> Any:
    values = tuple(float(entry) if isinstance(entry, str) and entry not in SIDES else entry for entry in entries)
    return values[0] if len(values) == 1 else values


def _split(key: str) -> tuple[str, str]:
    """Returns the section of `device` that a key is in, "" for itself, and the key there."""
    section, _, name = key.rpartition(".")
    return section, name


def _word(text: str) -> str:
    return text if _WORD.match(text) else json.dumps(text, ensure_ascii=False)


def _dotted(path: Path) -> str:
    return ".".join(map(str, path))


def _are_lists(length: int, *values: object) -> bool:
    return all(isinstance(one, list) and len(one) == length for one in values)


def _difference(old: Any, new: Any) -> Any:
    """Returns the values of a mapping that differ from those of an old one; anything else than a mapping as it is."""
    if not isinstance(old, dict) or not isinstance(new, dict):
        return new
    return {key: _difference(old.get(key), value) for key, value in new.items() if old.get(key) != value}


def _nodes_in(node: yaml.Node | None) -> Iterator[yaml.Node]:
    """Yields the nodes below a node; one with an alias as often as it stands there, what is below it once."""
    seen, rest = set[int](), [node] if node else []
    while rest:
        yield (one := rest.pop())
        if id(one) not in seen and not isinstance(one, yaml.ScalarNode):
            rest += itertools.chain(*one.value) if isinstance(one, yaml.MappingNode) else one.value
        seen.add(id(one))


def _quantities_in(node: yaml.Node | None) -> Iterator[str]:
    """Yields the texts with a unit in a value: a number, a mapping or a list of numbers, or more."""
    if isinstance(node, yaml.ScalarNode):
        yield from [node.value] if QUANTITY.match(node.value) else []
    elif isinstance(node, yaml.MappingNode | yaml.SequenceNode):
        for each in node.value:
            yield from _quantities_in(each[1] if isinstance(node, yaml.MappingNode) else each)


def _entry(mapping: yaml.Node | None, key: str) -> yaml.Node | None:
    """The value that a mapping has of its own under `key`."""
    if not isinstance(mapping, yaml.MappingNode):
        return None
    return next((value for name, value in mapping.value if name.value == key), None)


def _end(node: yaml.Node) -> int:
    """Returns the index after a value's text. A block ends with its last entry, not at the next key."""
    if isinstance(node, yaml.MappingNode) and not node.flow_style:
        return _end_of_entry(*node.value[-1])
    last = node.value[-1] if isinstance(node, yaml.SequenceNode) and not node.flow_style else None
    if last is not None and last.start_mark.index >= node.start_mark.index:
        return _end(last)
    return int(node.end_mark.index)


def _end_of_entry(key: yaml.Node, value: yaml.Node) -> int:
    """Returns the index after an entry's text, or after its key where the value is an alias."""
    return _end(value) if value.start_mark.index >= key.end_mark.index else int(key.end_mark.index)


def _comment_in_place(rest: str, longer: int) -> str:
    """Returns what follows a value, with the comment of its line in its column where the value became `longer`, if
    there is room."""
    found = _COMMENT.match(rest)
    if found is None:
        return rest
    gap = len(found[2])
    return f"{found[1]}{' ' * max(min(gap, 2), gap - longer)}{rest[found.end() :]}"


def _inserted(text: str, mapping: yaml.MappingNode, before: str, entry: str) -> tuple[int, str]:
    """Returns the place and the text of a new entry. It follows the entry of the key `before`, or the last one if there
    is none; in braces it stands in the same line, otherwise in a line of its own."""
    if not mapping.value:
        return mapping.start_mark.index + 1, entry
    key, value = next((one for one in mapping.value if one[0].value == before), mapping.value[-1])
    end = _end_of_entry(key, value)
    if mapping.flow_style:
        is_alias = value.start_mark.index < key.end_mark.index
        return (key.start_mark.index, f"{entry}, ") if is_alias else (end, f", {entry}")
    margin = " " * key.start_mark.column
    until = text.find("\n", end)
    if until < 0:
        return len(text), f"\n{margin}{entry}"
    newline = "\r\n" if text[until - 1] == "\r" else "\n"
    return until + 1, f"{margin}{entry}{newline}"
