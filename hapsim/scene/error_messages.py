"""What pydantic found wrong, in our own sentences: what was found, what was expected, what to do."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from .device import Device
from .issue import Issue, Path, did_you_mean, nearest, one_of, quote
from .mock import Hand, Initial, Mock
from .modules import MODULE_TYPES
from .quantity import UNEXPECTED, Expectation
from .scene import ACROSS, Scene
from .yaml_document import Document, space_hint


@dataclass(frozen=True)
class Layout:
    """Which parts a kind of file has, for the words about what is wrong in them.

    Attributes:
        parts: the class of each part that has a place of its own.
        collection: the key of the table or list whose entries say by themselves which part they are,
        tag: by this key,
        tagged: and the class of each of its values.
        entry: what is expected where an entry should be,
        mappings: and where another mapping should be, by its place.
    """

    parts: Mapping[Path, type[BaseModel]]
    collection: str
    tag: str
    tagged: Mapping[str, type[BaseModel]]
    entry: str
    mappings: Mapping[Path, str]

    def mapping_words(self, path: Path) -> str:
        """What a mapping at `path` is expected to be."""
        is_entry = len(path) == 2 and path[0] == self.collection
        return self.entry if is_entry else self.mappings.get(path, "a mapping")


_SCENE = Layout(
    {(): Scene, ("device",): Device, ("mock",): Mock, ("mock", "initial"): Initial, ("mock", "hand"): Hand},
    "modules",
    "type",
    MODULE_TYPES,
    "a mapping such as {type: mass, mass: 0.01}",
    {
        (): "a mapping with version, rate, device and modules",
        ("modules",): "a mapping from names to modules",
    },
)


def findings_of(error: ValidationError, document: Document, layout: Layout = _SCENE) -> list[Issue]:
    """Returns the faults within single parts; those between parts are left to `cross_check_issues`.

    A missing key is not mentioned where an unknown key beside it looks like that key misspelt.
    """
    raws = [raw for raw in error.errors(include_url=False) if raw["type"] != ACROSS]
    details = [_Detail(raw, document, layout) for raw in raws]
    misspelt = {detail.meant() for detail in details if detail.kind == "extra_forbidden"}
    return [
        detail.issue()
        for detail in details
        if not (detail.kind == "missing" and (*detail.place, detail.key) in misspelt)
    ]


class _Detail:
    """One of pydantic's errors.

    Attributes:
        kind: pydantic's name for it.
        place, key: pydantic's way to the value: to what holds it, and the last step.
        path: the way through the file, which does not have pydantic's mark for the type of a module.
    """

    def __init__(self, raw: Any, document: Document, layout: Layout) -> None:
        self._document, self._layout = document, layout
        self.kind: str = raw["type"]
        self.context: dict[str, Any] = raw.get("ctx", {})
        location: Path = raw["loc"]
        self.place, self.key = location[:-1], str(location[-1]) if location else ""
        self.path = location[:2] + location[3:] if location[:1] == (layout.collection,) else location

    def issue(self) -> Issue:
        """Returns the error in our words."""
        issue = self._issue()
        if issue.path == self.path and not issue.at_key and self._is_emptied():
            return replace(issue, sentence=f"{issue.sentence}; leave the key out for the default")
        return issue

    def meant(self) -> Path:
        """Returns where the key would stand that an unknown key seems to mean."""
        near = nearest(self.key.partition(":")[0], self._fields())
        return (*self.place, near) if near else ()

    def _is_emptied(self) -> bool:
        """Whether nothing stands behind a key that may be left out."""
        in_part = self.place in self._layout.parts or len(self.place) > 2
        field = self._fields().get(self.key) if in_part else None
        return field is not None and not field.is_required() and self._document.value(self.path) is None

    def _issue(self) -> Issue:
        match self.kind:
            case "union_tag_not_found":
                return self._no_tag()
            case "union_tag_invalid":
                return self._wrong_word((*self.path, self._layout.tag), self._layout.tagged)
            case "literal_error":
                return self._wrong_word(self.path, self._words())
            case "missing":
                sentence = f"{quote(self.key)} is missing, expected {self._wanted()}"
                return Issue(self.path[:-1], sentence, at_key=True)
            case "extra_forbidden":
                keys = list(self._fields())
                hint = space_hint(self.key) or did_you_mean(self.key, keys)
                return Issue(self.path, f"unknown key, expected {one_of(keys)}{hint}", at_key=True)
        if self.kind == UNEXPECTED and self.key == "[key]":  # pydantic's mark for a key of `modules`
            return Issue(self.path, f"not a name, expected {self.context['expected']}", at_key=True)
        return self._about_value()

    def _about_value(self) -> Issue:
        path, document = self.path, self._document
        if self.kind == UNEXPECTED:
            path += tuple(self.context["at"])
            expected = self.context["expected"]
        else:
            expected = "a text" if self.kind == "string_type" else self._layout.mapping_words(path)
        hint = document.number_hint(path) if "number" in expected else ""
        hint = space_hint(document.value(path)) if "mapping" in expected and not hint else hint
        found = self.context.get("found") or document.found(path)
        return Issue(path, f"found {found}, expected {expected}{hint}")

    def _no_tag(self) -> Issue:
        tag = self._layout.tag
        near = nearest(tag, self._document.keys(self.path))
        hint = f"; is {quote(near)} meant to be '{tag}'?" if near else ""
        return Issue(self.path, f"'{tag}' is missing, expected {one_of(self._layout.tagged)}{hint}", at_key=True)

    def _wrong_word(self, path: Path, words: Iterable[str]) -> Issue:
        value = self._document.value(path)
        hint = did_you_mean(value, words) if isinstance(value, str) else ""
        return Issue(path, f"found {self._document.found(path)}, expected {one_of(words)}{hint}")

    def _fields(self) -> dict[str, FieldInfo]:
        """The fields of the part that holds the value, by their keys in the file."""
        if self.place in self._layout.parts:
            return _fields_of(self._layout.parts[self.place])
        fields = _fields_of(self._layout.tagged[str(self.place[2])])
        for key in self.place[3:]:
            annotation = fields[str(key)].annotation  # a part, or that part ``| None``
            options = get_args(annotation) or (annotation,)
            fields = _fields_of(next(one for one in options if isinstance(one, type) and issubclass(one, BaseModel)))
        return fields

    def _wanted(self) -> str:
        """What a missing key is to hold."""
        wishes = [item for item in self._fields()[self.key].metadata if isinstance(item, Expectation)]
        if wishes:
            return wishes[0].expected()
        words = self._words()
        return one_of(words) if words else self._layout.mapping_words(self.path)

    def _words(self) -> list[str]:
        """The words that a field takes, from ``Literal[...]`` or ``Literal[...] | None``."""
        annotation = self._fields()[self.key].annotation
        options = [word for option in get_args(annotation) for word in get_args(option) or (option,)]
        return [word for word in options if isinstance(word, str)]


def _fields_of(part: type[BaseModel]) -> dict[str, FieldInfo]:
    return {field.alias or name: field for name, field in part.model_fields.items()}
