"""What hapsim writes for people: sentences, or lines of JSON in their place (`run --log json`).

A line of JSON has `time` (UTC), `level` (info, warning, error), `event`, `message` and `fields`. Of one event about one
thing a line comes at most once a second; the next one, or the last line of all, counts in `left_out` those skipped.
"""

from __future__ import annotations

import json
import os
import re
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, TextIO

if TYPE_CHECKING:
    from rich.console import Console

Level = Literal["info", "warning", "error"]

_PLACE = re.compile(r"\S.*?:\d+:\d+:")  # file:line:column; the file's name may have spaces
_INDENT = "    "  # of the second and further lines
_NO_SPACE = "\0"  # stands for a space at which no line breaks
_PERIOD_S = 1.0


def stdout() -> Console:
    """Returns a rich console on standard output."""
    from rich.console import Console

    return Console(highlight=False)


def stderr() -> Console:
    """Returns a rich console on standard error."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def say(sentences: object, stream: TextIO | None = None, indent: str = _INDENT) -> None:
    """Prints sentences to `stream` [default: standard output] On a terminal they break at words.

    rich would also break a long path, which has to stay whole to be copied.
    """
    stream = stream or sys.stdout
    print(fitted(str(sentences), _columns(stream), indent), file=stream)


def fitted(text: str, columns: int | None, indent: str = _INDENT) -> str:
    """Returns `text` with lines longer than `columns` broken at spaces; unchanged if `columns` is None.

    A longer word stays whole, and so does the place, file:line:column, that a line begins with.
    """
    if columns is None:
        return text
    return "\n".join(_fitted(line, columns, indent) if len(line) > columns else line for line in text.split("\n"))


def _fitted(line: str, columns: int, indent: str) -> str:
    if place := _PLACE.match(line):
        line = place.group().replace(" ", _NO_SPACE) + line[place.end() :]
    broken = textwrap.fill(
        line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False, tabsize=4
    )
    return broken.replace(_NO_SPACE, " ")


def _columns(stream: TextIO) -> int | None:
    """Returns the width of the terminal; None if the stream is none."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or None
    except (OSError, ValueError):
        return None


class JsonLog:
    """Lines of JSON, from any thread."""

    def __init__(self, write: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        """`write`: takes a line with its end. `clock`: s."""
        self._write, self._clock = write, clock
        self._lock = threading.Lock()
        self._last: dict[tuple[str, str], float] = {}
        self._left_out: dict[tuple[str, str], int] = {}

    def say(self, level: Level, event: str, message: str, about: str = "", **fields: Any) -> None:
        """Writes a line, or counts it as left out. `about`: what tells it from others of its event."""
        key = event, about
        with self._lock:
            now = self._clock()
            if key in self._last and now - self._last[key] < _PERIOD_S:
                self._left_out[key] = self._left_out.get(key, 0) + 1
                return
            self._last = {one: at for one, at in self._last.items() if now - at < _PERIOD_S} | {key: now}
            self._write_line(level, event, message, fields, self._left_out.pop(key, 0))

    def close(self) -> None:
        """Writes how many lines were left out since the last one of their kind."""
        with self._lock:
            for (event, _), count in self._left_out.items():
                self._write_line("info", event, f"{count} more of these were left out", {}, count)
            self._left_out.clear()

    def _write_line(self, level: Level, event: str, message: str, fields: dict[str, Any], left_out: int) -> None:
        from hapsim.cli.as_json import plain

        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "level": level, "event": event, "message": message, "fields": plain(fields)}
        if left_out:
            line["left_out"] = left_out
        self._write(json.dumps(line, allow_nan=False) + "\n")


_log: JsonLog | None = None


def use_json_log() -> None:
    """Writes everything on standard error as JSON, until `use_sentences`."""
    global _log  # noqa: PLW0603 (standard error is the whole process's, too)

    def write(line: str) -> None:
        sys.stderr.write(line)
        sys.stderr.flush()

    _log = JsonLog(write)


def use_sentences() -> None:
    """Writes sentences again."""
    global _log  # noqa: PLW0603
    if _log is not None:
        _log.close()
    _log = None


def json_log() -> JsonLog | None:
    """Returns the log; None if people read."""
    return _log


def complain(problem: object, event: str = "failed", level: Level = "error") -> None:
    """Prints an error or a warning on standard error."""
    if _log is not None:
        _log.say(level, event, str(problem), about=str(problem))
    else:
        say(f"Warning: {problem}" if level == "warning" else problem, sys.stderr)
