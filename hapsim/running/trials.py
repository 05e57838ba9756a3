"""Trials of an experiment: which conditions come in which order, from a table of them."""

from __future__ import annotations

import csv
import random
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from hapsim.errors import UsageError
from hapsim.running.changed_scene import changed, require_restartable
from hapsim.running.live_parameters import OUTPUTS, by_part, checked_words, shown
from hapsim.scene import Scene
from hapsim.scene.issue import one_of
from hapsim.scene.load import SceneSource, as_scene

Order = Literal["random", "blocked", "as listed"]
Code = int | Mapping[str, int] | None

_COLUMNS = ("code", "restart")
_LARGEST = 2**31 - 1


class Trial(NamedTuple):
    """A trial: the arguments of `Session.trial`, in their order."""

    number: int
    """Number of the trial, from 1 on."""
    set: dict[str, float | str]
    """Values by live path."""
    restart: tuple[str, ...] = ()
    code: int | None = None


class Trials(Sequence[Trial]):
    """The trials of an experiment, in the order in which they are presented.

        for trial in hapsim.Trials("conditions.csv", seed=7, repetitions=10):
            session.trial(*trial)

    The first line of the table names its columns, each further line is a condition. A column is a live path of the
    scene ("touch.stiffness"), in SI units, `code` (number on the output of that name), or `restart` (modules, separated
    by spaces). An empty cell changes nothing.
    """

    def __init__(
        self,
        table: str | Path,
        *,
        seed: int | None = None,
        repetitions: int = 1,
        order: Order = "random",
        scene: SceneSource | None = None,
    ) -> None:
        """`table`: a CSV file. `repetitions`: times that each condition comes. `order`: "random" shuffles all trials,
        "blocked" the conditions within each repetition; both need a `seed`, with which the order is the same on every
        machine. `scene`: where it is given, each condition is tried on it [default: when its trial begins]. UsageError
        with the line for a table that has no conditions, or one that does not fit the scene."""
        if order not in get_args(Order):
            raise UsageError(f"order: found {order!r}, expected {one_of(list(get_args(Order)))}")
        if order != "as listed" and not _is_whole(seed, 0):
            raise UsageError(f"seed: found {seed!r}, expected a whole number, 0 or more: it makes the order repeatable")
        if not _is_whole(repetitions, 1):
            raise UsageError(f"repetitions: found {repetitions!r}, expected a whole number, 1 or more")
        if not isinstance(table, str | Path):
            found = type(table).__name__
            raise UsageError(
                f"table: found a {found}, expected the path of a .csv file (pandas: frame.to_csv(path, index=False))"
            )
        conditions = _conditions(Path(table), None if scene is None else as_scene(scene))
        chance = random.Random(seed)
        blocks = [conditions] * repetitions if order == "blocked" else [conditions * repetitions]
        if (
            order != "as listed"
        ):  # by `random`, whose numbers Python promises to repeat, as those of `shuffle` it does not
            blocks = [sorted(block, key=lambda _: chance.random()) for block in blocks]
        listed = (one for block in blocks for one in block)
        self._trials = [one._replace(number=number) for number, one in enumerate(listed, 1)]

    def __len__(self) -> int:
        return len(self._trials)

    def __getitem__(self, at: Any) -> Any:
        return self._trials[at]

    def __iter__(self) -> Iterator[Trial]:
        return iter(self._trials)


def trial_changes(
    scene: Scene, number: int, set: Mapping[str, Any], restart: Sequence[str], code: Code
) -> dict[str, Any]:
    """Returns what a trial with these arguments of `Session.trial` changes, by part and key. Raises UsageError where
    the scene cannot begin it."""
    if not _is_whole(number, 1) or number > _LARGEST:
        raise UsageError(f"number: found {number!r}, expected a whole number from 1 to {_LARGEST}")
    if not isinstance(set, Mapping):
        raise UsageError(
            f"set: found {set!r}, expected live paths with their values, such as {{'touch.stiffness': 500.0}}"
        )
    if not isinstance(restart, list | tuple):
        raise UsageError(f"restart: found {shown(restart)}, expected a list of modules, such as ['bob']")
    require_restartable(scene, restart)
    changes = by_part(set, scene)
    if code is not None:
        changes[OUTPUTS] = changes.get(OUTPUTS, {}) | _outputs_of(scene, code)
    words = checked_words(scene, changes)
    changed(scene, {name: values for name, values in changes.items() if name not in words})
    return changes


def _outputs_of(scene: Scene, code: int | Mapping[str, int]) -> dict[str, int]:
    """Returns values of outputs by name. A number is for the output `code`, or for the only one that programs set."""
    if isinstance(code, Mapping):
        return dict(code)
    known = [name for name, one in scene.outputs.items() if one.is_set_by_programs]
    if "code" in known or len(known) == 1:
        return {"code" if "code" in known else known[0]: code}
    expected = f"one of {', '.join(known)} by name" if known else "one in the scene: outputs: {code: {bits: [8, 15]}}"
    raise UsageError(f"code: found {len(known)} outputs that programs set, none of them `code`, expected {expected}")


def _is_whole(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _conditions(path: Path, scene: Scene | None) -> list[Trial]:
    """Reads a table, and tries each condition on the scene."""
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    head = lines[0] if lines else ""
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=max(",;\t", key=head.count))]
    for name in (columns := rows[0] if rows else []):
        if (name not in _COLUMNS and "." not in name) or columns.count(name) > 1:
            expected = "each column once: a live path such as touch.stiffness, code or restart"
            raise UsageError(f"{path}, line 1: found the column '{name}', expected {expected}")
    found = []
    for line, row in enumerate(rows[1:], 2):
        if not any(row):
            continue
        if len(row) != len(columns):
            raise UsageError(f"{path}, line {line}: cells: found {len(row)}, expected {len(columns)} as in line 1")
        cells = {name: cell for name, cell in zip(columns, row, strict=True) if cell}
        try:
            found.append(_condition(cells))
            if scene is not None:
                trial_changes(scene, *found[-1])
        except UsageError as error:
            raise UsageError(f"{path}, line {line}: {error}") from None
    if not found:
        raise UsageError(
            f"{path}: found no conditions, expected a line with names of columns, and one for each condition"
        )
    return found


def _condition(cells: dict[str, str]) -> Trial:
    restart, code = tuple(cells.pop("restart", "").split()), cells.pop("code", None)
    if code is not None and not code.isdecimal():
        raise UsageError(f"code: found '{code}', expected a whole number, 0 or more")
    return Trial(1, {name: _value(cell) for name, cell in cells.items()}, restart, None if code is None else int(code))


def _value(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell
