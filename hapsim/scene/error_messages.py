"""What pydantic found wrong, in our own sentences: what was found, what was expected, what to do."""

from collections.abc import Iterable
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from .device import Device
from .document import Document
from .issue import Issue, Path, did_you_mean, nearest, one_of, quote
from .mock import Initial, Mock
from .modules import MODULE_TYPES
from .quantity import UNEXPECTED, Expectation
from .scene import ACROSS, Scene

_PARTS: dict[Path, type[BaseModel]] = {
    (): Scene,
    ("device",): Device,
    ("mock",): Mock,
    ("mock", "initial"): Initial,
}


def findings_of(error: ValidationError, document: Document) -> list[Issue]:
    """The faults within single parts; those between parts are left to `cross_check_issues`.

    A missing key is not mentioned where an unknown key beside it looks like that key misspelt.
    """
    details = [_Detail(raw) for raw in error.errors(include_url=False) if raw["type"] != ACROSS]
    misspelt = {detail.meant() for detail in details if detail.kind == "extra_forbidden"}
    return [
        detail.issue(document)
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

    def __init__(self, raw: Any) -> None:
        self.kind: str = raw["type"]
        self.context: dict[str, Any] = raw.get("ctx", {})
        location: Path = raw["loc"]
        self.place, self.key = location[:-1], str(location[-1]) if location else ""
        self.path = location[:2] + location[3:] if location[:1] == ("modules",) else location

    def issue(self, document: Document) -> Issue:
        """The error in our words."""
        match self.kind:
            case "union_tag_not_found":
                return _no_type(self.path, document)
            case "union_tag_invalid":
                return _wrong_word((*self.path, "type"), MODULE_TYPES, document)
            case "literal_error":
                return _wrong_word(self.path, self._words(), document)
            case "missing" | "extra_forbidden":
                return self._about_key()
        if self.kind == UNEXPECTED and self.key == "[key]":  # pydantic's mark for a key of `modules`
            return Issue(self.path, f"not a name, expected {self.context['expected']}", True)
        return self._about_value(document)

    def _about_key(self) -> Issue:
        if self.kind == "missing":
            return Issue(self.path[:-1], f"{quote(self.key)} is missing, expected {self._wanted()}", True)
        keys = self._known_keys()
        hint = did_you_mean(self.key, keys)
        return Issue(self.path, f"unknown key, expected {one_of(keys)}{hint}", True)

    def meant(self) -> Path:
        """Where the key would stand that an unknown key seems to mean."""
        near = nearest(self.key, self._known_keys())
        return (*self.place, near) if near else ()

    def _about_value(self, document: Document) -> Issue:
        path = self.path
        if self.kind == UNEXPECTED:
            path += tuple(self.context["at"])
            expected = self.context["expected"]
        else:
            expected = "a text" if self.kind == "string_type" else _mapping_words(path)
        hint = document.number_hint(path) if "number" in expected else ""
        return Issue(path, f"found {document.found(path)}, expected {expected}{hint}")

    def _part(self) -> type[BaseModel]:
        """The class of the part that holds the value."""
        if self.place in _PARTS:
            return _PARTS[self.place]
        part: type[BaseModel] = MODULE_TYPES[str(self.place[2])]
        for key in self.place[3:]:
            part = _part_in(part.model_fields[str(key)].annotation)
        return part

    def _known_keys(self) -> list[str]:
        return list(self._part().model_fields)

    def _wanted(self) -> str:
        """What a missing key is to hold."""
        wishes = [item for item in self._part().model_fields[self.key].metadata if isinstance(item, Expectation)]
        return wishes[0].expected() if wishes else _mapping_words(self.path)

    def _words(self) -> list[str]:
        """The words that a field takes, from ``Literal[...]`` or ``Literal[...] | None``."""
        annotation = self._part().model_fields[self.key].annotation
        options = [word for option in get_args(annotation) for word in get_args(option) or (option,)]
        return [word for word in options if isinstance(word, str)]


def _part_in(annotation: Any) -> type[BaseModel]:
    """The part that a field holds, from its class or from that class ``| None``."""
    options = get_args(annotation) or (annotation,)
    return next(option for option in options if isinstance(option, type) and issubclass(option, BaseModel))


def _no_type(path: Path, document: Document) -> Issue:
    near = nearest("type", document.keys(path))
    hint = f"; is {quote(near)} meant to be 'type'?" if near else ""
    return Issue(path, f"'type' is missing, expected {one_of(MODULE_TYPES)}{hint}", True)


def _wrong_word(path: Path, words: Iterable[str], document: Document) -> Issue:
    value = document.value(path)
    hint = did_you_mean(value, words) if isinstance(value, str) else ""
    return Issue(path, f"found {document.found(path)}, expected {one_of(words)}{hint}")


def _mapping_words(path: Path) -> str:
    match path:
        case ():
            return "a mapping with version, rate, device and modules"
        case ("modules",):
            return "a mapping from names to modules"
        case ("modules", _):
            return "a mapping such as {type: mass, mass: 0.01}"
        case _:
            return "a mapping"
