"""Output of hapsim: sentences and tables for people, JSON documents and lines of JSON (`run --log json`) for scripts.

The keys of a document are a contract with scripts. A value that does not exist is null, never NaN. A line of JSON has
`time` (UTC), `level` (info, warning, error), `event`, `message` and `fields`. At most one line a second is written
for each event and its subject; `left_out` of the next one, or of the last line of all, counts the dropped lines.
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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, TextIO

import typer

from hapsim.documents import plain
from hapsim.number_format import number, relative_difference, rounded
from hapsim.units import LINEAR, Units

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType

    from hapsim.errors import HapsimError
    from hapsim.measuring.device_fit import Estimate

Level = Literal["info", "warning", "error"]

_PLACE = re.compile(r"\S.*?:\d+:\d+:")  # file:line:column; the file's name may have spaces
_INDENT = "    "  # of the second and further lines
_NO_SPACE = "\0"  # stands for a space at which no line breaks
_PERIOD_S = 1.0
_DIGITS = 1e-7  # of a value: finer ones are not printed, however small its uncertainty is
_PHRASE = 24  # characters: a longer cell is a phrase, which wraps, and not a number


def document(value: Any) -> str:
    """Returns the text of a JSON document: a result, or a dict of results."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def failure_document(failure: HapsimError | None) -> dict[str, Any]:
    """Returns the keys `error` and `exit_status` of a failed command; none if it did not fail."""
    return {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}


def stdout() -> Console:
    """Returns a rich console on standard output."""
    return _console()


def stderr() -> Console:
    """Returns a rich console on standard error."""
    return _console(stderr=True)


def _console(**options: Any) -> Console:
    from rich.console import Console

    return Console(highlight=False, **options)


_units: list[Units] = []


def set_output_units(units: Units, *of_channels: Units) -> None:
    """Sets the units of all later output: of a scene, and of each of its channels."""
    _units[:] = units, *of_channels


def use_channel_units(channel: int) -> None:
    """Sets the units of all later output to those of this channel."""
    if _units:
        _units[0] = output_units(channel)


def output_units(channel: int | None = None) -> Units:
    """Returns the units of the output, or of a channel's motion."""
    place = 0 if channel is None else channel + 1
    return _units[place] if place < len(_units) else LINEAR


@dataclass(frozen=True)
class Table:
    """A table that rich prints. Its cells wrap at words, and numbers stay whole: where the columns have no room side by
    side, each row is printed as lines, one for each value."""

    title: str
    headings: list[str]
    """A column stands left if its heading is empty or begins with "<", else right."""
    rows: list[list[str]]
    caption: str
    options: dict[str, Any]
    """Options of rich's table."""

    def __rich_console__(self, _console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        from rich.text import Text

        if self.title:
            yield Text.from_markup(self.title, style="table.title")
        names = [heading.removeprefix("<") for heading in self.headings]
        widths = self._widths(names, options.max_width)
        yield from self._side_by_side(names, widths) if widths else self._stacked(names)
        if self.caption:
            yield Text.from_markup(self.caption, style="table.caption")

    def _widths(self, names: list[str], available: int) -> list[int]:
        """Returns the width of each column; [] where they have no room. The widest are narrowed first, down to their
        longest word or number."""
        from rich.cells import cell_len as cell_width
        from rich.text import Text

        shown = names if self.options.get("show_header", True) else [""] * len(names)
        widths, least = [], []
        for heading, cells in zip(shown, zip(*self.rows, strict=True) if self.rows else [()] * len(names), strict=True):
            plain = [Text.from_markup(cell).plain for cell in (heading, *cells)]
            widths.append(max(1, *map(cell_width, plain)))
            least.append(max((cell_width(word) for cell in plain for word in _unbroken(cell)), default=0))
        available -= len(names) * (3 if self.options.get("box", True) else 2) + 1  # borders and padding
        if sum(least) > available:
            return []
        while sum(widths) > available:
            spare = [width if width > low else 0 for width, low in zip(widths, least, strict=True)]
            widths[spare.index(max(spare))] -= 1
        return widths

    def _side_by_side(self, names: list[str], widths: list[int]) -> Iterator[RenderableType]:
        from rich.table import Table as RichTable

        made = RichTable(**self.options)
        for heading, name, width in zip(self.headings, names, widths, strict=True):
            made.add_column(name, justify="left" if heading[:1] in ("", "<") else "right", width=width)
        for row in self.rows:
            made.add_row(*row)
        yield made

    def _stacked(self, names: list[str]) -> Iterator[RenderableType]:
        from rich.padding import Padding
        from rich.table import Table as RichTable

        for first, *others in self.rows:
            values = RichTable.grid(padding=(0, 2))
            values.add_column(overflow="fold")
            values.add_column(overflow="fold")
            shows_names = self.options.get("show_header", True)
            for name, value in zip(names[1:], others, strict=True):
                if value:
                    values.add_row(*([name, value] if shows_names else [value]))
            yield f"{names[0]} {first}".lstrip()
            yield Padding(values, (0, 0, 0, 2))


def _unbroken(cell: str) -> list[str]:
    """Returns the parts of a cell that stay in one line: a number with its unit or sign, else words."""
    return [cell] if len(cell) <= _PHRASE and any(one.isdigit() for one in cell) else cell.split()


Line = str | Table
"""A printed line or table."""


def show(out: Console, lines: Iterable[Line]) -> None:
    """Prints these lines."""
    for line in lines:
        out.print(line)


def table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", **options: Any
) -> Table:
    """Returns a table without the columns that have a heading and no values. A column stands left if its heading is
    empty or begins with "<", else right. `options`: rich's."""
    rows = list(rows)
    shown = [i for i, heading in enumerate(headings) if not (heading and rows) or any(row[i] for row in rows)]
    kept = [[row[i] for i in shown] for row in rows]
    return Table(title, [headings[i] for i in shown], kept, caption, options)


def compared(
    label: str, unit: str, expected: float, found: float, off: float, units: Units | None = None, exact: bool = False
) -> tuple[str, ...]:
    """Returns a row of a table: `label` with its unit, the expected value, the one that was found, its uncertainty
    `off`, and how far apart they are, to the digits of the uncertainty. Values are in SI units; NaN is a dash. `unit`:
    that of a line, such as N/m. `units`: of the output [default: `output_units()`]. `exact`: the expected value has no
    uncertainty."""
    units = units or output_units()
    ideal, value, scaled_off = (units.scaled(float(one), unit) for one in (expected, found, off))
    both = [rounded(one, max(scaled_off, _DIGITS * abs(one))) if math.isfinite(one) else "–" for one in (ideal, value)]
    if exact:
        both[0] = number(ideal)
    return f"{label}  {units.name(unit)}".rstrip(), *both, units.number(off, unit, 1), relative_difference(value, ideal)


def estimates_table(
    title: str,
    labels: Mapping[str, tuple[str, str]],
    declared: Mapping[str, float],
    estimates: Mapping[str, Estimate],
    judge: Callable[[Estimate, float, str], str],
) -> Table:
    """Returns the table of estimates beside declared values, in SI units. `labels`: words and unit of each. `judge`:
    returns the last cell from an estimate, its declared value, and how far these are apart."""
    rows = []
    for name, one in estimates.items():
        known = declared.get(name, math.nan)
        *cells, off_by = compared(*labels[name], known, one.value, one.uncertainty, exact=True)
        if known == 0.0:
            off_by = output_units().number(one.value, labels[name][1], "+.2g")
        rows.append((*cells, judge(one, known, off_by)))
    return table(title, ("", "declared", "found", "uncertainty", "off by"), rows)


def print_line(sentences: object, stream: TextIO | None = None, indent: str = _INDENT) -> None:
    """Prints sentences to `stream` [default: standard output], broken at words on a terminal.

    rich would also break a long path, which could then not be copied.
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

    def write(self, level: Level, event: str, message: str, about: str = "", **fields: Any) -> None:
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


def print_message(text: object, event: str = "failed", level: Level = "error", label: str = "", **fields: Any) -> None:
    """Prints an error, a warning or an event on standard error, after its `label`. `fields`: for the log."""
    if _log is not None:
        _log.write(level, event, str(text), about=str(text), **fields)
    else:
        print_line(f"{label}{text}", sys.stderr)


def exit_if_failed(failure: HapsimError | None) -> None:
    """Prints why a command failed, and exits with the status of that; does nothing for None."""
    if failure is not None:
        print_message(failure)
        raise typer.Exit(failure.exit_status)


def warn(warning: object, event: str) -> None:
    """Prints a warning on standard error."""
    print_message(warning, event, "warning", "Warning: ")
