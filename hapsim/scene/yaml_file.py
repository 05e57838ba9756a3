"""A file in YAML -> a `Document`, or an error with a line for each fault: for scenes, and for other files.
pydantic's errors are reworded: found, expected, what to do."""

import codecs
import itertools
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from hapsim.errors import UsageError
from hapsim.units import LINEAR, Units

from .issue import Issue, LocatedIssue, Path, Place, as_argument, did_you_mean, nearest, one_of, quote
from .quantity import NAME_PATTERN, Expectation, expectation_of
from .schemas import KINDS, UNEXPECTED
from .written_units import QUANTITY, has_dimension
from .yaml_document import Document, YamlSyntaxError, compose, place_in, space_hint

#: The pydantic error type under which faults between the parts of a file report.
ACROSS = "across"

_NAMES = "the names of "
_COUNTED = re.compile(rf"{_NAMES}|two numbers|\[the least|a list of [0-9]")  # lists with a certain number of entries

MOST_BYTES = 4_000_000  # some 100 000 modules, which take half a minute to read; strings and membranes need no more


@dataclass(frozen=True)
class YamlFile:
    """Reader of one kind of file.

    Attributes:
        error: the exception raised for a faulty file.
        wanted: the expected content of the file, in words.
        nothing: the message for an empty file.
        shipped: returns the names of the shipped files, which are accepted in place of paths.
        most_bytes: of a file.
    """

    error: type[UsageError]
    wanted: str
    nothing: str
    shipped: Callable[[], Iterable[str]] = tuple
    most_bytes: int = MOST_BYTES

    def text_of(self, path: str | os.PathLike[str]) -> str:
        """The text of a file; `error` where it cannot be read, or is no UTF-8."""
        return self.decoded(self.content_of(path), os.fsdecode(path))

    def content_of(self, path: str | os.PathLike[str]) -> bytes:
        """The bytes of a file, one more than it may have at most; `error` where it cannot be read."""
        name = os.fsdecode(path)
        if not name:
            raise self.error(f"'': the name of the file is empty, expected that of a file with {self.wanted}")
        try:
            with FilePath(name).open("rb") as file:
                return file.read(self.most_bytes + 1)
        except (OSError, ValueError) as error:
            raise self.error(f"{name}: {self._unreadable(name, error)}") from None

    def decoded(self, content: bytes, name: str) -> str:
        """The text of bytes that errors call `name`; `error` where they are too many, or no UTF-8."""
        if len(content) > self.most_bytes:
            most = f"{self.most_bytes / 1e6:.0f} MB"
            raise self.error(f"{name}: found a file of more than {most}, expected {self.wanted} of at most {most}")
        try:
            return content.decode("utf-8")
        except UnicodeDecodeError as error:
            readable = content[: error.start].decode("utf-8")
            place = place_in(readable, len(readable))
            is_wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
            sentence = f"found the byte 0x{content[error.start]:02x}, expected text in UTF-8; "
            sentence += f"{'it looks like UTF-16: ' * is_wide}save the file as UTF-8"
            raise self.failure(name, [LocatedIssue(place, sentence)]) from None

    def document_of(self, text: str, name: str) -> Document:
        """The document of a text that errors call `name`; `error` where it is no YAML, or holds nothing."""
        try:
            root = compose(text)
        except YamlSyntaxError as error:
            raise self.failure(name, [LocatedIssue(*error.args)]) from None
        document = Document(root) if root else None
        if document and (document.data is not None or document.faults):
            return document
        raise self.failure(name, [LocatedIssue(Place(1, 1), self.nothing)])

    def located(self, issues: Iterable[Issue], document: Document) -> list[LocatedIssue]:
        """Returns the issues with their lines and columns, and the faults of the document itself."""
        known, found = {fault.place for fault in document.faults}, []
        for issue in issues:
            if issue.at_key or document.place(issue.path) not in known:  # else it could not even be read
                name = _label(issue.path)
                sentence = f"{name}: {issue.sentence}" if name else issue.sentence
                found.append(LocatedIssue(document.place(issue.path, issue.at_key), sentence))
        return found + document.faults

    def failure(self, name: str, faults: Iterable[LocatedIssue]) -> UsageError:
        """One line for each fault; one that an anchor brings to several places is reported once."""
        in_order = sorted(dict.fromkeys(faults), key=lambda fault: fault.place)
        lines = [f"{name}:{one.place.line}:{one.place.column}: {one.sentence}" for one in in_order]
        return self.error("\n".join(lines))

    def _unreadable(self, name: str, error: OSError | ValueError) -> str:
        match error:
            case FileNotFoundError():
                folder, wanted = os.path.split(name)
                with suppress(OSError):
                    there = os.listdir(folder) if folder else [*os.listdir("."), *self.shipped()]
                    near = _nearest_file(wanted, there)
                    hint = f"; did you mean {quote(near if folder else as_argument(near))}?" if near else ""
                    return f"no such file, expected {self.wanted}{hint}"
                return f"no such directory, expected {self.wanted}"
            case IsADirectoryError():
                return f"found a directory, expected a file with {self.wanted}"
            case PermissionError():
                return "this file may not be read, expected one that may; check its permissions"
            case OSError(strerror=reason):
                return f"this file cannot be read: {reason}"
            case _:
                return "this is not the name of a file"


def _nearest_file(wanted: str, there: Iterable[str]) -> str:
    """The file of the nearest name; "" if none is near. What most names have in common, how they end, makes none
    alike; of two that differ in it alone, the one that ends as it is wanted counts."""
    ending = os.path.splitext(wanted)[1]
    in_order = sorted(there, key=lambda name: (os.path.splitext(name)[1] == ending, name))
    by_stem = {os.path.splitext(name)[0]: name for name in in_order}
    return by_stem.get(nearest(os.path.splitext(wanted)[0], by_stem) or "", "")


def _label(path: Path) -> str:
    """Returns a value's name for an error: its key, with the index if it is in a list; "" for the whole file."""
    last = max((at for at, step in enumerate(path) if isinstance(step, str)), default=None)
    if last is None:
        return ""
    key = str(path[last])
    name = key if re.fullmatch(NAME_PATTERN, key) and len(key) <= 60 else quote(key)
    return name + "".join(f"[{step}]" for step in path[last + 1 :])


@dataclass(frozen=True)
class Layout:
    """Parts of a kind of file, for its error messages.

    Attributes:
        root: the class of the whole file.
        collection: the key of the table or list whose entries name their own type,
        tag: the key that names it,
        tagged: and the class of each type.
        entry: the expected value of an entry,
        mappings: and of the other mappings, by place.
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

    def unit(self, path: Path, data: Any) -> str:
        """Returns the unit, as for linear motion, that a number at `path` of `data` may have; "" if none."""
        place = path
        if len(path) > 2 and path[0] == self.collection:
            entry = data[self.collection][path[1]]
            kind = entry.get(self.tag) if isinstance(entry, dict) else None
            if not isinstance(kind, str) or kind not in self.tagged:
                return ""
            place = (*path[:2], kind, *path[2:])
        for length in range(len(place)):
            field = self.fields(place[:length]).get(str(place[length]))
            if field and (expectation := expectation_of(field)):
                units, last = expectation.units, path[-1]
                unit = units[last] if units[1:] and isinstance(last, int) and last < len(units) else units[0]
                return unit if has_dimension(unit) else ""
        return ""


def findings_of(
    error: ValidationError, document: Document, layout: Layout, units_at: Callable[[Path], Units] = lambda _: LINEAR
) -> list[Issue]:
    """Returns the faults within single parts; those between parts are left to `cross_check_issues`. A missing key is
    not mentioned where an unknown key beside it looks like that key misspelt. `units_at`: the units at a path."""
    raws = [raw for raw in error.errors(include_url=False) if raw["type"] != ACROSS]
    findings = [_Finding(raw, document, layout, units_at) for raw in raws]
    misspelt = {found.meant() for found in findings if found.kind == "extra_forbidden"}
    cut_off = {(*found.path[:-1], name) for found in findings for name in found.cut_off()}
    reported = [found for found in findings if found.kind != "missing" or (*found.place, found.key) not in misspelt]
    reported = [found for found in reported if found.kind != "extra_forbidden" or found.path not in cut_off]
    return [found.issue() for found in reported]


class _Finding:
    """One of pydantic's errors.

    Attributes:
        kind: pydantic's name for it.
        place, key: pydantic's way to the value: to what holds it, and the last step.
        path: the way through the file, which does not have pydantic's marks for the kind of a value.
    """

    def __init__(self, raw: Any, document: Document, layout: Layout, units_at: Callable[[Path], Units]) -> None:
        self._document, self._layout, self._units_at = document, layout, units_at
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
            return replace(issue, sentence=f"{issue.sentence}; omit the key for the default")
        return issue

    def meant(self) -> Path:
        """Returns where the key would stand that an unknown key seems to mean."""
        near = nearest(self.key.partition(":")[0], self._layout.fields(self.place))
        return (*self.place, near) if near else ()

    def cut_off(self) -> list[str]:
        """Returns the keys without a value behind this text in place of a list of names: a comma cut them off."""
        if not (self.kind == UNEXPECTED and self.context["of_motion"].startswith(_NAMES)):
            return []
        holder, keys = self.path[:-1], self._document.keys(self.path[:-1])
        behind = keys[keys.index(self.key) + 1 :] if self.key in keys else []
        return [*itertools.takewhile(lambda key: self._document.value((*holder, key)) is None, behind)]

    def _may_be_omitted(self) -> bool:
        if self.path == ("device",):  # only beside `devices`
            return False
        field = self._layout.fields(self.place).get(self.key)
        has_checked_default = field is not None and field.validate_default and field.default is None
        return field is not None and not field.is_required() and not has_checked_default

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
        expected = self._in_units(self.context["of_motion"], path) if self.kind == UNEXPECTED else mapping
        value = document.value(path)
        if isinstance(value, float) and not math.isfinite(value):
            expected = expected.replace("a number", "a finite number", 1)
        is_quantity = isinstance(value, str) and QUANTITY.match(value) and self._layout.unit(path, document.data)
        is_number = "number" in expected and not is_quantity
        hint = document.number_hint(path) if is_number or isinstance(value, list) else ""
        if "or such as" in expected and "plain decimals" in hint:
            hint = ""
        hint = space_hint(value) if "mapping" in expected and not hint else hint
        found = self.context.get("found") or document.found(path)
        if isinstance(value, str) and expected.startswith(_NAMES):
            names = ", ".join([value, *self.cut_off()])
            hint = f"; write a list in brackets: [{names}]" if "," in names else ""
        elif isinstance(value, list) and value and _COUNTED.match(expected):
            found = f"a list of {len(value)}"
        elif isinstance(value, str) and not hint:
            hint = did_you_mean(value, (one for one in re.split(r", | or ", expected) if one.isalpha()))
        return Issue(path, f"found {found}, expected {expected}{hint}")

    def _wrong_word(self, path: Path, words: Iterable[str]) -> Issue:
        value = self._document.value(path)
        hint = did_you_mean(value, words) if isinstance(value, str) else ""
        return Issue(path, f"found {self._document.found(path)}, expected {one_of(words)}{hint}")

    def _in_units(self, expected: str, path: Path) -> str:
        """Returns the expected value in the units at `path`, with both notations of an angle. What is found without a
        unit is compared without one of the file."""
        value, units = self._document.value(path), self._units_at(path)
        units = units if isinstance(value, str) and QUANTITY.match(value) else units.si
        angles = {"(‹m›)": "(rad; or such as 15 deg)", "(‹m/s›)": "(rad/s; or such as 10 deg/s)"}
        for of_a_line, of_an_angle in angles.items() if units.si.name("m") == "rad" else ():
            expected = expected.replace(of_a_line, of_an_angle)
        return units.filled(expected)

    def _wanted(self) -> str:
        """Returns the expected value of a missing key."""
        field = self._layout.fields(self.place)[self.key]
        found = [item.expected for item in field.metadata if isinstance(item, Expectation)]
        words = _words_of(field)
        return (
            *(self._in_units(one, self.path) for one in found),
            one_of(words) if words else self._layout.mapping_words(self.path),
        )[0]


def _words_of(field: FieldInfo) -> list[str]:
    """The words that a field takes, from ``Literal[...]`` or ``Literal[...] | None``."""
    options = [word for option in get_args(field.annotation) for word in get_args(option) or (option,)]
    return [word for word in options if isinstance(word, str)]


def _fields_of(part: type[BaseModel] | None) -> dict[str, FieldInfo]:
    return {field.alias or name: field for name, field in part.model_fields.items()} if part else {}
