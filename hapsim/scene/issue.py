"""Errors of a scene, located by their keys (`Issue`) or by line and column of the file (`LocatedIssue`)."""

import difflib
import shlex
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass

#: Keys and indices that lead from the top of the scene to a value: ``("modules", "touch", "between", 0)``.
Path = tuple[str | int, ...]

#: Among more names than these the nearest is not looked for: it would take minutes in a large generated file.
MOST_COMPARED = 500


@dataclass(frozen=True)
class Issue:
    """One fault of a scene.

    Attributes:
        path: leads to the value at fault.
        sentence: what was found and what was expected.
        at_key: the key of that value is at fault, not the value.
    """

    path: Path
    sentence: str
    at_key: bool = False


@dataclass(frozen=True, order=True)
class Place:
    """A position in the file, counted from 1 as editors do."""

    line: int
    column: int


@dataclass(frozen=True, order=True)
class LocatedIssue:
    """One fault of a file, and where it is."""

    place: Place
    sentence: str


def quote(text: str) -> str:
    """The text in quotes, on one line, cut where it grows long, with unprintable characters escaped."""
    longest = 60
    return repr(text if len(text) <= longest else text[: longest - 1] + "…")


def as_argument(file: str) -> str:
    """The name of a file as a command takes it: one that begins with "-" would be an option."""
    return f"./{file}" if file.startswith("-") else file


def command_line(*words: str) -> str:
    """The words of a command, quoted for this system's shell. To Windows' cmd.exe a single quote is a letter."""
    return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


def with_article(key: str) -> str:
    """A key after its indefinite article."""
    return f"an {key}" if key[0] in "aeiou" else f"a {key}"


def one_of(words: Iterable[str]) -> str:
    """The words as a choice: "this, that or another"."""
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that ``word`` most likely means, or nothing if none is near."""
    by_lower = {name.lower(): name for name in known}
    if len(by_lower) > MOST_COMPARED:
        return None
    close = difflib.get_close_matches(word[:60].lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[close[0]] if close else None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a sentence that offers the nearest known word, or nothing."""
    near = nearest(word, known)
    return f"; did you mean {quote(near)}?" if near else ""
