"""Ranges of live values, which a slider shows: ``stiffness: {value: 2 N/mm, range: [0, 5 N/mm]}``.

`take_ranges` puts each such value in the place of its mapping before anything is validated, so that nothing else knows
of ranges. `read_ranges` validates their ends as the value itself. A value may leave its range: its field has the
bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from hapsim.units import Units

from .issue import Issue, Path, did_you_mean, one_of
from .mock import Hand
from .modules import MODULE_TYPES
from .schemas import FROM_FILE
from .section import Section
from .sound_channels import PickUp
from .yaml_document import Document

_KEYS = ("value", "range")
_ENDS = "[the least, the most]"
_SECTIONS: dict[str, Callable[[str, Any], Any]] = {
    "modules": lambda _, part: MODULE_TYPES.get(str(part.get("type"))),
    "sound": lambda *_: PickUp,
    "mock": lambda name, _: Hand if name == "hand" else None,
}
"""The class of a part by its name and data, for each section with live values; None if it is unknown or has none."""

Ranged = Mapping[Path, tuple[Any, dict[str, Any]]]
"""Class of the part, and mapping, of each value with a range, by its path."""


def take_ranges(data: object) -> Ranged:
    """Puts the values of a scene's `data` that stand beside a range in the places of their mappings."""
    found = {
        (section, name, key): (kind, part, mapping)
        for section, kind_of in _SECTIONS.items()
        for name, part in _mapping(_mapping(data).get(section)).items()
        if (kind := kind_of(name, _mapping(part)))
        for key, mapping in _mapping(part).items()
        if {"range", "value"} & _mapping(mapping).keys() and "uncertainty" not in mapping
        if key in {field.alias or of for of, field in kind.model_fields.items()}
    }
    for (*_, key), (_, part, mapping) in found.items():  # afterwards: an anchor brings one part to several paths
        part[key] = mapping.get("value", mapping)
    return {path: (kind, mapping) for path, (kind, _, mapping) in found.items()}


def read_ranges(
    ranged: Ranged, document: Document, units_at: Callable[[Path], Units]
) -> tuple[dict[Path, tuple[float, float]], list[Issue]]:
    """Returns the ranges that `take_ranges` found, in SI units by path, and what is wrong with them."""
    ranges: dict[Path, tuple[float, float]] = {}
    issues: list[Issue] = []
    for path, (kind, mapping) in ranged.items():
        found: list[Any] = [*_faults_of_shape(kind, path, mapping, document)]
        found = found or [
            _end(kind, (*path, "range", i), end, document, units_at) for i, end in enumerate(mapping["range"])
        ]
        faults = [one for one in found if isinstance(one, Issue)]
        if not faults:
            low, high = ranges[path] = (found[0], found[1])
            if not low < high:
                first, last = (document.found((*path, "range", i)) for i in (0, 1))
                expected = "the least before the most; swap them" if low > high else "two different ends"
                faults = [Issue((*path, "range"), f"found {first} before {last}, expected {expected}")]
        issues += faults
    return ranges, issues


def _mapping(value: Any) -> dict[Any, Any]:
    return value if isinstance(value, dict) else {}


def _faults_of_shape(kind: Any, path: Path, mapping: dict[str, Any], document: Document) -> Iterator[Issue]:
    """Yields what is wrong with a mapping, apart from its numbers."""
    if path[-1] not in kind.live:
        word = kind.model_fields["type"].default if "type" in kind.model_fields else kind.type
        live = f"{' and '.join(kind.live)} can" if kind.live else "nothing can"
        yield Issue(path, f"found a range, expected the value alone: of a {word} {live} change while the scene runs")
    elif unknown := [key for key in mapping if key not in _KEYS]:
        hint = did_you_mean(unknown[0], _KEYS)
        yield Issue((*path, unknown[0]), f"unknown key, expected {one_of(_KEYS)}{hint}", at_key=True)
    elif missing := [key for key in _KEYS if key not in mapping]:
        yield Issue(path, f"'{missing[0]}' is missing, expected {{value: a number, range: {_ENDS}}}")
    elif not isinstance(ends := mapping["range"], list) or len(ends) != 2:
        found = f"a list of {len(ends)}" if isinstance(ends, list) else document.found((*path, "range"))
        yield Issue((*path, "range"), f"found {found}, expected {_ENDS}, two numbers")


def _end(kind: Any, path: Path, end: Any, document: Document, units_at: Callable[[Path], Units]) -> float | Issue:
    """Returns an end of a range in SI units, or what is wrong with it."""
    expected = "a number"
    try:
        if isinstance(value := adapter_of(kind, str(path[-3])).validate_python(end, context=FROM_FILE), float):
            return value
    except ValidationError as error:
        context = error.errors(include_url=False)[0].get("ctx", {})
        expected = str(context.get("of_motion", expected)).partition(", or ")[0]
    hint = document.number_hint(path) if expected.startswith("a number") else ""
    return Issue(path, f"found {document.found(path)}, expected {units_at(path).si.filled(expected)}{hint}")


def with_range(values: dict[str, Any]) -> dict[str, Any]:
    """Returns the JSON schema of a live value that may have a range. `values`: that of the value alone."""
    about = {key: values[key] for key in ("title", "description", "default") if key in values}
    plain = {key: one for key, one in values.items() if key not in about}
    ends = {"type": "array", "items": {"type": ["number", "string"]}, "minItems": 2, "maxItems": 2}
    both = {"type": "object", "properties": {"value": plain, "range": ends}, "required": list(_KEYS)}
    return {"anyOf": [*plain.get("anyOf", [plain]), both | {"additionalProperties": False}]} | about


@cache
def adapter_of(kind: type[Section], field: str) -> TypeAdapter[Any]:
    """Returns what validates a field of a part alone."""
    return TypeAdapter(kind.model_fields[field].rebuild_annotation())
