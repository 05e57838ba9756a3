"""What pydantic found wrong, in our own sentences: what was found, what was expected, what to do."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from .issue import Issue, Path, did_you_mean, nearest, one_of, quote
from .modules import MODULE_TYPES
from .quantity import KINDS, UNEXPECTED, Expectation
from .scene import ACROSS, Scene
from .yaml_document import Document, space_hint


@dataclass(frozen=True)
class Layout:
    """Which parts a kind of file has, for the words about what is wrong in them.

    Attributes:
        root: the class of the whole file.
        collection: the key of the table or list whose entries say by themselves which part they are,
        tag: by this key,
        tagged: and the class of each of its values.
        entry: what is expected where an entry should be,
        mappings: and where another mapping should be, by its place.
    """

    root: type[BaseModel]
    collection: str
    tag: str
    tagged: Mapping[str, type[BaseModel]]
    entry: str
    mappings: Mapping[Path, str]

    def mapping_words(self, path: Path) -> str:
        """Returns what a mapping at `path` is expected to be."""
        is_entry = len(path) == 2 and path[0] == self.collection
        return self.entry if is_entry else self.mappings.get(path, "a mapping")

    def fields(self, place: Path) -> dict[str, FieldInfo]:
        """Returns the fields of the part at `place`, as pydantic locates it, by their keys in the file; else none."""
        part: type[BaseModel] | None = self.root
        if place[:1] == (self.collection,):
            part, place = (self.tagged[str(place[2])] if len(place) > 2 else None), place[3:]
        steps = iter(place)
        for key in steps:
            field = _fields_of(part).get(str(key))
            options = [field.annotation, *get_args(field.annotation)] if field else []  # a part, or it ``| None``
            if field and get_origin(field.annotation) is Mapping:
                next(steps, None)  # a name
            part = next((one for one in options if isinstance(one, type) and issubclass(one, BaseModel)), None)
        return _fields_of(part)


_SCENE = Layout(
    Scene,
    "modules",
    "type",
    MODULE_TYPES,
    "a mapping such as {type: mass, mass: 0.01}",
    {
        (): "a mapping with version, rate, device and modules",
        ("modules",): "a mapping from names to modules",
        ("sound",): "a mapping from names to pick-ups",
    },
)


def findings_of(error: ValidationError, document: Document, layout: Layout = _SCENE) -> list[Issue]:
    """Returns the faults within single parts; those between parts are left to `cross_check_issues`.

    A missing key is not mentioned where an unknown key beside it looks like that key misspelt.
    """
    raws = [raw for raw in error.errors(include_url=False) if raw["type"] != ACROSS]
    findings = [_Finding(raw, document, layout) for raw in raws]
    misspelt = {found.meant() for found in findings if found.kind == "extra_forbidden"}
    heard = [found for found in findings if found.kind != "missing" or (*found.place, found.key) not in misspelt]
    return [found.issue() for found in heard]


class _Finding:
    """One of pydantic's errors.

    Attributes:
        kind: pydantic's name for it.
        place, key: pydantic's way to the value: to what holds it, and the last step.
        path: the way through the file, which does not have pydantic's marks for the kind of a value.
    """

    def __init__(self, raw: Any, document: Document, layout: Layout) -> None:
        self._document, self._layout = document, layout
        self.kind: str = raw["type"]
        self.context: dict[str, Any] = raw.get("ctx", {})
        location: Path = tuple(step for step in raw["loc"] if step not in KINDS)
        self.place, self.key = location[:-1], str(location[-1]) if location else ""
        self.path = location[:2] + location[3:] if location[:1] == (layout.collection,) else location

    def issue(self) -> Issue:
        """Returns the error in our words."""
        issue = self._issue()
        is_emptied = issue.path == self.path and not issue.at_key and self._document.value(self.path) is None
        if is_emptied and self._may_be_omitted():
            return replace(issue, sentence=f"{issue.sentence}; leave the key out for the default")
        return issue

    def meant(self) -> Path:
        """Returns where the key would stand that an unknown key seems to mean."""
        near = nearest(self.key.partition(":")[0], self._layout.fields(self.place))
        return (*self.place, near) if near else ()

    def _may_be_omitted(self) -> bool:
        field = self._layout.fields(self.place).get(self.key)
        return field is not None and not field.is_required()

    def _issue(self) -> Issue:
        match self.kind:
            case "union_tag_not_found":
                tag = self._layout.tag
                near = nearest(tag, self._document.keys(self.path))
                hint = f"; is {quote(near)} meant to be '{tag}'?" if near else ""
                return Issue(self.path, f"'{tag}' is missing, expected {one_of(self._layout.tagged)}{hint}", True)
            case "union_tag_invalid":
                return self._wrong_word((*self.path, self._layout.tag), self._layout.tagged)
            case "literal_error":
                return self._wrong_word(self.path, _words_of(self._layout.fields(self.place)[self.key]))
            case "missing":
                return Issue(self.path[:-1], f"{quote(self.key)} is missing, expected {self._wanted()}", True)
            case "extra_forbidden":
                keys = list(self._layout.fields(self.place))
                hint = space_hint(self.key) or did_you_mean(self.key, keys)
                return Issue(self.path, f"unknown key, expected {one_of(keys)}{hint}", True)
        if self.kind == UNEXPECTED and self.key == "[key]":  # pydantic's mark for a key of `modules`
            return Issue(self.path, f"not a name, expected {self.context['expected']}", True)
        return self._wrong_value()

    def _wrong_value(self) -> Issue:
        path, document = self.path + tuple(self.context.get("at", ())), self._document
        mapping = "a text" if self.kind == "string_type" else self._layout.mapping_words(path)
        expected = self.context["expected"] if self.kind == UNEXPECTED else mapping
        value = document.value(path)
        if isinstance(value, float) and not math.isfinite(value):
            expected = expected.replace("a number", "a finite number", 1)
        hint = document.number_hint(path) if "number" in expected else ""
        hint = space_hint(value) if "mapping" in expected and not hint else hint
        return Issue(path, f"found {self.context.get('found') or document.found(path)}, expected {expected}{hint}")

    def _wrong_word(self, path: Path, words: Iterable[str]) -> Issue:
        value = self._document.value(path)
        hint = did_you_mean(value, words) if isinstance(value, str) else ""
        return Issue(path, f"found {self._document.found(path)}, expected {one_of(words)}{hint}")

    def _wanted(self) -> str:
        """What a missing key is to hold."""
        field = self._layout.fields(self.place)[self.key]
        expectations = [item.expected for item in field.metadata if isinstance(item, Expectation)]
        words = _words_of(field)
        return (*expectations, one_of(words) if words else self._layout.mapping_words(self.path))[0]


def _words_of(field: FieldInfo) -> list[str]:
    """The words that a field takes, from ``Literal[...]`` or ``Literal[...] | None``."""
    options = [word for option in get_args(field.annotation) for word in get_args(option) or (option,)]
    return [word for word in options if isinstance(word, str)]


def _fields_of(part: type[BaseModel] | None) -> dict[str, FieldInfo]:
    return {field.alias or name: field for name, field in part.model_fields.items()} if part else {}
