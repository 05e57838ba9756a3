"""Curves in CSV files: distances and forces, with their units in the head, as people and instruments write them.

A scene names such a file in place of points. `insert_curves` puts the points there before anything is validated, so
that nothing else knows of files.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from typing import Any, NamedTuple, NoReturn

from hapsim.errors import UsageError
from hapsim.units import MOTIONS, Motion, Written

from .issue import Issue, Path, as_argument, quote
from .schemas import LEAST, MOST, MOST_POINTS
from .written_units import unit_factor, written_unit
from .yaml_file import YamlFile

KEY = "force_over_distance"
_FILE = YamlFile(UsageError, "a curve in CSV", "", most_bytes=100_000_000)  # some minutes at 10 kHz, or 10^6 rows
_HEAD = "a head with the units of distances and forces, such as mm,N or deg;mN·m"
_HEAD_ROWS = 60  # an instrument may write that much about itself above the head
_NUMBER = re.compile(r"[-+]?([0-9]+([.,][0-9]*)?|[.,][0-9]+)([eE][-+]?[0-9]+)?\Z")


class Column(NamedTuple):
    """A column with a unit."""

    at: int
    """Index in a row."""
    unit: str
    """As the head has it."""
    of: str
    """m for distances, N for forces: as of a line."""
    motion: Motion
    factor: Decimal
    """SI units in one of it."""


@dataclass(frozen=True)
class CurveTable:
    """The columns of a file that have units.

    Attributes:
        name: of the file.
        head: its row with the units, from 1.
        rows: the row of each line of numbers.
        columns: those of distances and of forces, in their order in the file.
        values: the numbers of each, in SI units.
    """

    name: str
    head: int
    rows: list[int]
    columns: list[Column]
    values: list[list[float]]

    @property
    def motion(self) -> Motion:
        """The motion of its units."""
        return self.columns[0].motion

    def of(self, unit: str) -> list[list[float]]:
        """Returns the values of the columns of distances (m) or forces (N)."""
        return [each for column, each in zip(self.columns, self.values, strict=True) if column.of == unit]

    def unit(self, of: str) -> Column:
        """Returns the first column of distances (m) or forces (N)."""
        return next(column for column in self.columns if column.of == of)

    @property
    def written(self) -> tuple[Written, ...]:
        """The units of the file that are no SI units."""
        each = (written_unit(f"1 {self.unit(of).unit}", of, self.motion) for of in ("m", "N"))
        return tuple(one for one in each if one)

    def fail(self, at: int, sentence: str) -> NoReturn:
        """Raises UsageError about the row of the number with this index."""
        raise UsageError(f"{self.name}:{self.rows[at]}: {sentence}")


def read_table(path: str, units: str = "", most_rows: int | None = None) -> CurveTable:
    """Returns the numbers of a CSV file: separated by commas, semicolons or tabs, with decimal points or commas.

    Args:
        path: of the file.
        units: in place of those of the file's head, separated by commas; "-" for a column to leave out.
        most_rows: number of rows from which on it is no curve, but a recording.

    Raises:
        UsageError: it cannot be read; the message names the row.
    """
    lines = _text_of(path).splitlines()
    row, columns, separator = _given(path, lines, units) if units else _found(path, lines)
    counts = {of: sum(one.of == of for one in columns) for of in ("m", "N")}
    if counts not in ({"m": 1, "N": 1}, {"m": 1, "N": 2}, {"m": 2, "N": 2}) or len({c.motion for c in columns}) > 1:
        names = ", ".join(one.unit for one in columns)
        expected = "expected one of distances, and one of forces or two: press and release; all of a line, or of turns"
        raise UsageError(f"{path}:{row}: found the columns {names}, {expected}. {_other_units(path)}")
    if most_rows and (many := sum(map(bool, map(str.strip, lines[row:])))) > most_rows:
        raise UsageError(f"{path}: found {many} rows, expected a curve of at most {most_rows}; {_way(path)}")
    rows: list[int] = []
    values: list[list[float]] = [[] for _ in columns]
    for at, cells in enumerate(_cells(path, lines[row:], separator), row + 1):
        if any(cell.strip() for cell in cells):
            rows.append(at)
            for column, each in zip(columns, values, strict=True):
                each.append(_number(f"{path}:{at}", cells, column))
            if not units and separator == "," and len(cells) > max(one.at for one in columns) + 1:
                _require_no_decimal_commas(f"{path}:{at}", cells, lines[row - 1])
    if len(set(values[0])) < 2:
        found = "one distance" if rows else "no numbers"
        raise UsageError(f"{path}:{rows[-1] if rows else row}: found {found}, expected two distances or more")
    return CurveTable(path, row, rows, columns, values)


def _text_of(path: str) -> str:
    """Returns the text of a file in UTF-8, UTF-16 with its mark, or the encoding of older instruments."""
    content = _FILE.content_of(path)
    if len(content) > _FILE.most_bytes:
        raise UsageError(f"{path}: found a file of more than {_FILE.most_bytes / 1e6:.0f} MB, expected a smaller one")
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", "replace")
    with suppress(UnicodeDecodeError):
        return content.decode("utf-8-sig")
    return content.decode("cp1252", "replace")


def _cells(path: str, lines: Sequence[str], separator: str) -> Iterator[list[str]]:
    """Yields the cells of each line."""
    try:
        yield from csv.reader(lines, delimiter=separator)
    except csv.Error as error:
        raise UsageError(f"{path}: this is no CSV: {error}") from None


def _found(path: str, lines: Sequence[str]) -> tuple[int, list[Column], str]:
    """Returns the number of the head's row, its columns and the separator."""
    for row, line in enumerate(lines[:_HEAD_ROWS], 1):
        separator = next((one for one in ";\t" if one in line), ",")
        cells = next(_cells(path, [line], separator), [])
        columns = [one for at, cell in enumerate(cells) if (one := _column(at, cell)) is not None]
        if {"m", "N"} <= {one.of for one in columns}:
            beside = all(one.at and _NUMBER.match(cells[one.at - 1].strip()) for one in columns)
            if beside:  # each number has its unit in the cell behind it
                return row - 1, [one._replace(at=one.at - 1) for one in columns], separator
            return row, columns, separator
    row, first = next(((at, line) for at, line in enumerate(lines, 1) if line.strip()), (1, ""))
    found = quote(first.strip()[:40]) if first else "nothing"
    likely = " Is g meant to be gf?" if re.search(r"\bg(rams?)?\b", "\n".join(lines[:_HEAD_ROWS])) else ""
    raise UsageError(f"{path}:{row}: found {found}, expected {_HEAD}.{likely} {_other_units(path)}")


def _given(path: str, lines: Sequence[str], units: str) -> tuple[int, list[Column], str]:
    """Returns the same for units that the user gives: the rows above the first one of numbers are left out."""
    columns = [_column(at, unit) for at, unit in enumerate(units.split(",")) if unit.strip() not in ("", "-")]
    if None in columns:
        raise UsageError(f"--units: found {units!r}, expected a unit for each column, or -, such as -,mm,gf")
    for row, line in enumerate(lines):
        separator = next((one for one in ";\t" if one in line), ",")
        cells = next(_cells(path, [line], separator), [])
        if all(one and one.at < len(cells) and _NUMBER.match(cells[one.at].strip()) for one in columns):
            return row, [one for one in columns if one], separator
    raise UsageError(f"{path}: found no row with a number in each column of --units {units}")


def _column(at: int, cell: str) -> Column | None:
    """Returns the column of a cell such as "mm", "Force (gf)", "angle / deg" or "force_N"; None without such a unit."""
    text = cell.strip()
    in_brackets = re.findall(r"[(\[{<]([^)\]}>]+)[)\]}>]", text)
    for written in (text, *in_brackets, *re.split(r"\s/\s?|\bin\s|_|:|\s", text)[-1:]):
        for of, motion in ((of, motion) for of in ("m", "N") for motion in MOTIONS):
            if factor := unit_factor(written.strip(), of, motion):
                return Column(at, written.strip(), of, motion, factor)
    return None


def _other_units(path: str) -> str:
    return (
        f"`hapsim curve {as_argument(path)} --units UNITS` takes others, such as -,mm,gf: a unit or - for each column"
    )


def _way(path: str) -> str:
    return f"`hapsim curve {as_argument(path)} -o NEW.csv` makes one"


def _number(where: str, cells: Sequence[str], column: Column) -> float:
    """Returns a number in SI units. Raises UsageError."""
    text = cells[column.at].strip() if column.at < len(cells) else ""
    if not _NUMBER.match(text):
        found = quote(text) if text else f"nothing in column {column.at + 1}"
        raise UsageError(f"{where}: found {found}, expected a number in {column.unit}")
    number = Decimal(text.replace(",", "."))
    if not abs(number) <= MOST or (number and abs(number) < 1e-300):
        raise UsageError(f"{where}: found {text} {column.unit}, expected at most {MOST:g} in size")
    return float(number * column.factor)


def _require_no_decimal_commas(where: str, cells: Sequence[str], head: str) -> None:
    """Raises UsageError for a row with more cells than the head."""
    named = len(next(csv.reader([head])))
    if len([*cells]) > named and any(cell.strip() for cell in cells[named:]):
        expected = f"expected {named} as in the head; is the comma a decimal one? Then separate columns by semicolons"
        raise UsageError(f"{where}: found {len(cells)} columns, {expected}")


def read_curve(path: str) -> tuple[dict[str, list[list[float]]], CurveTable]:
    """Returns `points`, or `press` and `release`, [m, N] of a file of at most 1000 rows by ascending distance, and its
    table. Raises UsageError, with the row."""
    table = read_table(path, most_rows=MOST_POINTS)
    (distances, *others), forces, way = table.of("m"), table.of("N"), _way(path)
    if others:
        raise UsageError(f"{path}:{table.head}: found two columns of distances, expected one; {way}")
    for at, (before, x) in enumerate(pairwise(distances), 1):
        if not x - before >= LEAST:
            (_, unit, *_, factor) = table.unit("m")
            found = f"found {' after '.join(f'{one / float(factor):.12g} {unit}' for one in (x, before))}"
            table.fail(at, f"{found}, expected ascending distances: it is a recording, no curve; {way}")
    curves = [[list(point) for point in zip(distances, force, strict=True)] for force in forces]
    if len(curves) == 1:
        return {"points": curves[0]}, table
    for at, (press, release) in enumerate(zip(*forces, strict=True)):
        if press < release:
            sentence = "found less force in the first column (press) than in the second (release)"
            table.fail(at, f"{sentence}, expected as much or more, or the link would give energy; {way}")
    return {"press": curves[0], "release": curves[1]}, table


class Curves(NamedTuple):
    """The files that a scene names in place of points."""

    tables: dict[Path, CurveTable]
    """Tables of the files that can be read, by the path of the value."""
    files: list[str]
    issues: list[Issue]


def insert_curves(data: object, folder: str | None) -> Curves:
    """Puts the points of the files that a scene's `data` names in their places.

    Args:
        data: of the scene's file, as plain values; changed.
        folder: that the names are relative to; None if the scene came from elsewhere, and may name no file.
    """
    found = Curves({}, [], [])
    for module, path in [*_named(data)]:
        try:
            name, beside = _parted(module[KEY])
            if folder is None:
                expected = "expected points: a scene that is sent has no files beside it"
                raise UsageError(f"found the file {quote(name)}, {expected}")
            found.files.append(os.path.join(folder, name))
            curves, found.tables[path] = read_curve(found.files[-1])
            if "points" in curves and beside:
                raise UsageError(f"found turn beside {name}, expected two columns of forces there: press and release")
            module[KEY] = curves.get("points", curves | beside)
        except UsageError as error:
            module[KEY] = [[0.0, 0.0], [1.0, 0.0]]
            found.issues.append(Issue(path, str(error)))
    return found


def _parted(value: Any) -> tuple[str, dict[str, Any]]:
    """Returns the file that a value names, and the keys beside it. Raises UsageError."""
    if isinstance(value, str):
        return value, {}
    beside = {key: one for key, one in value.items() if key != "file"}
    name = value["file"]
    if isinstance(name, str) and not set(beside) - {"turn"}:
        return name, beside
    keys = ", ".join(map(quote, beside)) if isinstance(name, str) else "no name"
    raise UsageError(f"found {keys} at file, expected {{file: the name of a file, turn: a distance}}")


def _named(data: object) -> Iterator[tuple[dict[str, Any], Path]]:
    """Yields each module with the name of a file, or a mapping with one, and the path of that value."""
    modules = data.get("modules") if isinstance(data, dict) else None
    for name, module in modules.items() if isinstance(modules, dict) else ():
        value = module.get(KEY) if isinstance(module, dict) else None
        if isinstance(value, str) or (isinstance(value, dict) and "file" in value):
            yield module, ("modules", name, KEY)
