"""What hapsim writes: sentences and tables for people, JSON documents and lines of JSON (`run --log json`) for scripts.

The keys of a document are a contract with scripts. A value that does not exist is null, never NaN. A line of JSON has
`time` (UTC), `level` (info, warning, error), `event`, `message` and `fields`. At most one line a second is written of
each event and what it is about; the next one, or the last line of all, counts in `left_out` those skipped.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, TextIO

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hapsim.errors import HapsimError

Level = Literal["info", "warning", "error"]

_PLACE = re.compile(r"\S.*?:\d+:\d+:")  # file:line:column; the file's name may have spaces
_INDENT = "    "  # of the second and further lines
_NO_SPACE = "\0"  # stands for a space at which no line breaks
_PERIOD_S = 1.0


def document(value: dict[str, Any]) -> str:
    """Returns the text of one JSON document."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def failure_document(failure: HapsimError | None) -> dict[str, Any]:
    """Returns the keys that say how a command failed; none if it did not."""
    return {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}


def pick(source: Any, *names: str) -> dict[str, Any]:
    """Returns attributes of an object by their names; None for each if there is no object."""
    return {name: None if source is None else getattr(source, name) for name in names}


def plain(value: Any) -> Any:
    """Returns only what JSON has: complex numbers as [re, im], infinities and NaN as null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, complex):
        value = value.real, value.imag
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def stdout() -> Console:
    """Returns a rich console on standard output."""
    from rich.console import Console

    return Console(highlight=False)


def stderr() -> Console:
    """Returns a rich console on standard error."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", **options: Any
) -> Table:
    """Returns a rich table without the columns that have a heading and no values. A column stands left if its heading
    is empty or begins with "<", else right."""
    from rich.table import Table

    rows = list(rows)
    made = Table(title=title or None, title_justify="left", caption=caption or None, **options)
    shown = [i for i, heading in enumerate(headings) if not (heading and rows) or any(row[i] for row in rows)]
    for heading in (headings[i] for i in shown):
        made.add_column(heading.removeprefix("<"), justify="left" if heading[:1] in ("", "<") else "right")
    for row in rows:
        made.add_row(*(row[i] for i in shown))
    return made


def say(sentences: object, stream: TextIO | None = None, indent: str = _INDENT) -> None:
    """Prints sentences to `stream` [default: standard output], broken at words on a terminal.

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
        """Writes a line, or counts it as dropped. `about`: distinguishes it from others of its event."""
        key = event, about
        with self._lock:
            now = self._clock()
            if key in self._last and now - self._last[key] < _PERIOD_S:
                self._left_out[key] = self._left_out.get(key, 0) + 1
                return
            self._last = {one: at for one, at in self._last.items() if now - at < _PERIOD_S} | {key: now}
            self._write_line(level, event, message, fields, self._left_out.pop(key, 0))

    def close(self) -> None:
        """Writes for each event how many of its lines were dropped since its last one."""
        with self._lock:
            for (event, _), count in self._left_out.items():
                self._write_line("info", event, f"{count} more of these were dropped", {}, count)
            self._left_out.clear()

    def _write_line(self, level: Level, event: str, message: str, fields: dict[str, Any], left_out: int) -> None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "level": level, "event": event, "message": message, "fields": plain(fields)}
        self._write(json.dumps(line | ({"left_out": left_out} if left_out else {}), allow_nan=False) + "\n")


_log: JsonLog | None = None


def log_as_json(wanted: bool) -> None:
    """Writes everything on standard error as JSON, or as sentences again."""
    global _log  # noqa: PLW0603 (standard error is the whole process's, too)
    if _log is not None:
        _log.close()
    _log = JsonLog(lambda line: print(line, end="", file=sys.stderr, flush=True)) if wanted else None


def json_log() -> JsonLog | None:
    """Returns the log; None if standard error is for people."""
    return _log


def complain(problem: object, event: str = "failed", level: Level = "error", label: str = "", **fields: Any) -> None:
    """Prints a problem or an event on standard error. `label`: stands before it where people read. `fields`: in the
    log."""
    if _log is not None:
        _log.say(level, event, str(problem), about=str(problem), **fields)
    else:
        say(f"{label}{problem}", sys.stderr)


def warn(warning: object, event: str) -> None:
    """Prints a warning on standard error."""
    complain(warning, event, "warning", "Warning: ")
