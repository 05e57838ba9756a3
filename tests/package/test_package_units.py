"""Units that code names: each is one that `Units` knows, or its number would stand unscaled beside another unit."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

import hapsim
from hapsim.units import LINEAR, Units, Written

ROOM = Path(hapsim.__file__).parent
IS_UNITS = re.compile(r"(\w*units|LINEAR|units_of\(.*\)|units_at\(.*\)|units\(\)|drawn_in\(\))(\.si)?", re.S)
#: The argument that is a unit, by method.
UNIT_AT = {"__call__": 1, "name": 0, "scaled": 1, "number": 1, "rounded": 2, "between": 2}


def units_in(tree: ast.AST) -> list[str | None]:
    """Units of the calls of `Units`; None where one is no literal."""
    found: list[str | None] = []
    for call in ast.walk(tree):
        if not isinstance(call, ast.Call):
            continue
        owner, method = ast.unparse(call.func), "__call__"
        if isinstance(call.func, ast.Attribute) and call.func.attr in UNIT_AT:
            owner, method = ast.unparse(call.func.value), call.func.attr
        at = UNIT_AT[method]
        if (
            IS_UNITS.fullmatch(owner.rpartition(".")[2] if "(" not in owner else owner.split(".", 1)[-1])
            and call.args[at:]
        ):
            unit = call.args[at]
            found.append(unit.value if isinstance(unit, ast.Constant) and isinstance(unit.value, str) else None)
    return found


def test_every_unit_that_code_names_is_known() -> None:
    texts = [path.read_text(encoding="utf-8") for path in sorted(ROOM.rglob("*.py"))]
    found = Counter(
        unit for text in texts if re.search("units|LINEAR|drawn_in", text) for unit in units_in(ast.parse(text))
    )
    assert found["N/m"] > 30
    assert sum(found.values()) > 350
    assert found[None] < 0.12 * sum(found.values())
    for unit in found.keys() - {None}:
        assert LINEAR.name(unit or "") == unit


@pytest.mark.parametrize("unit", ["N/mm", "cm", "g", "Nm", "deg"])
def test_a_unit_that_nothing_is_scaled_to_is_an_error(unit: str) -> None:
    for units in (LINEAR, Units.of(["rotary"]), Units.of(["linear"], [Written("N/m", "N/mm", 1e-3)])):
        for ask in (units, units.scaled, units.number):
            with pytest.raises(ValueError, match="is no unit of a quantity"):
                ask(0.002, unit)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("‹0.0025 N/m›", "0.0025 N·m/rad"),
        ("more than ‹0.261799387799 m›", "more than 15°"),
        ("‹-1e-06 m›", "-5.72957795131e-05°"),
        ("a number (‹m›)", "a number (rad)"),
        ("a gain (‹1/(SI unit)›), ‹2.5 1›", "a gain (1/(SI unit)), 2.5 1"),
        ("‹inf N›", "– N·m"),
        ("between ‹-0.5 and 0.25 m›", "between -28.6478897565 and 14.3239448783°"),
    ],
)
def test_a_text_of_ours_has_numbers_in_the_units_of_the_file_and_names_of_si_units(text: str, told: str) -> None:
    """A number without a unit is in SI units, whatever the file has elsewhere."""
    assert Units.of(["rotary"], [Written("rad", "°", 57.29577951308232)]).filled(text) == told
