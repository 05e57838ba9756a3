"""A file in YAML -> a `Document`, or an error with a line for each fault: for scenes, and for other files."""

import codecs
import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path as FilePath

from hapsim.errors import UsageError

from .issue import Issue, LocatedIssue, Path, Place, as_argument, nearest, quote
from .quantity import NAME_PATTERN
from .yaml_document import Document, YamlSyntaxError, compose, place_in

MOST_BYTES = 4_000_000  # some 100 000 modules, which take half a minute to read; strings and membranes need no more


@dataclass(frozen=True)
class YamlFile:
    """How files of one kind are read.

    Attributes:
        error: what is raised where a file is wrong.
        wanted: what is expected in the file, in words.
        nothing: what to say of an empty one.
        shipped: returns the names of those that ship, which serve as names of files.
    """

    error: type[UsageError]
    wanted: str
    nothing: str
    shipped: Callable[[], Iterable[str]] = tuple

    def text_of(self, path: str | os.PathLike[str]) -> str:
        """The text of a file; `error` where it cannot be read, or is no UTF-8."""
        name = os.fsdecode(path)
        if not name:
            raise self.error(f"'': the name of the file is empty, expected that of a file with {self.wanted}")
        try:
            with FilePath(name).open("rb") as file:
                content = file.read(MOST_BYTES + 1)
        except (OSError, ValueError) as error:
            raise self.error(f"{name}: {self._unreadable(name, error)}") from None
        return self.decoded(content, name)

    def decoded(self, content: bytes, name: str) -> str:
        """The text of bytes that errors call `name`; `error` where they are too many, or no UTF-8."""
        if len(content) > MOST_BYTES:
            most = f"{MOST_BYTES / 1e6:.0f} MB"
            raise self.error(f"{name}: found a file of more than {most}, expected {self.wanted} of at most {most}")
        try:
            return content.decode("utf-8")
        except UnicodeDecodeError as error:
            readable = content[: error.start].decode("utf-8")
            place = place_in(readable, len(readable))
            sentence = f"found the byte 0x{content[error.start]:02x}, expected text in UTF-8"
            if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                sentence += "; it looks like UTF-16: save the file as UTF-8"
            raise self.failure(name, [LocatedIssue(place, sentence)]) from None

    def document_of(self, text: str, name: str) -> Document:
        """The document of a text that errors call `name`; `error` where it is no YAML, or holds nothing."""
        try:
            root = compose(text)
        except YamlSyntaxError as error:
            raise self.failure(name, [error.args[0]]) from None
        document = Document(root) if root else None
        if document and (document.data is not None or document.faults):
            return document
        raise self.failure(name, [LocatedIssue(Place(1, 1), self.nothing)])

    def located(self, issues: Iterable[Issue], document: Document) -> list[LocatedIssue]:
        """Where in the file the issues are, and the faults of the document itself."""
        known = {fault.place for fault in document.faults}
        told = [_located(issue, document) for issue in issues if not _follows(issue, document, known)]
        return told + document.faults

    def failure(self, name: str, faults: Iterable[LocatedIssue]) -> UsageError:
        """One line for each fault; one that an anchor brings to several places is reported once."""
        lines = [
            f"{name}:{fault.place.line}:{fault.place.column}: {fault.sentence}"
            for fault in sorted(dict.fromkeys(faults), key=lambda fault: fault.place)
        ]
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


def _follows(issue: Issue, document: Document, known: set[Place]) -> bool:
    """A value that could not even be read is reported for that alone."""
    return not issue.at_key and document.place(issue.path) in known


def _located(issue: Issue, document: Document) -> LocatedIssue:
    name = _label(issue.path)
    sentence = f"{name}: {issue.sentence}" if name else issue.sentence
    return LocatedIssue(document.place(issue.path, issue.at_key), sentence)


def _label(path: Path) -> str:
    """How an error names a value: its key, with the index if it is in a list; nothing for the whole file."""
    last = max((at for at, step in enumerate(path) if isinstance(step, str)), default=None)
    if last is None:
        return ""
    key = str(path[last])
    name = key if re.fullmatch(NAME_PATTERN, key) and len(key) <= 60 else quote(key)
    return name + "".join(f"[{step}]" for step in path[last + 1 :])
