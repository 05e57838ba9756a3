"""Schemas of numbers, lists and choices for pydantic, with their limits, units and errors: `quantity.py` is made of
them."""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from numbers import Integral, Real
from typing import Any, NoReturn, TypeGuard

from pydantic_core import PydanticCustomError, core_schema

from hapsim.units import LINEAR

from .values import Known, Matrix, Span, WrittenAsMapping
from .written_units import ANGLE, QUANTITY, SCHEMA_PATTERN, UnitError, has_dimension, in_si

Schema = core_schema.CoreSchema

#: The pydantic error type under which every check of ours reports.
UNEXPECTED = "unexpected"

#: The context of a validation of what a file says: numbers may have units there. Angles in degrees may have them in
#: Python too.
FROM_FILE = {"units": True}

#: Limits of numbers, in SI units: beyond them a number is a mistake, and what is worked out from it may be infinite.
#: `LEAST_SIZE` is that of sizes, such as a mass, `LEAST` that of the distance of neighbours. Positions have no least.
LEAST_SIZE, LEAST, MOST = 1e-18, 1e-12, 1e12

MOST_CHANNELS = 16
MOST_POINTS = 1000  # of a curve
MOST_CORNERS = 64  # of a polygon or a path

#: Marks of the kind of a value that may be of several: pydantic puts them into the location of an error.
KINDS = NUMBER, WORD, SPAN, KNOWN, LIST, LISTS, DISC, POLYGON, BRANCHES = (
    *("<number>", "<word>", "<span>", "<known>", "<list>", "<lists>", "<disc>", "<polygon>", "<branches>"),
)


def unexpected(expected: str, at: tuple[int | str, ...] = (), found: str = "") -> NoReturn:
    """Reports that a value, or the entry ``at`` within it, is not what was ``expected``.

    Args:
        expected: the words that follow "expected"; a unit stands in them as that of a line, such as ‹N/m›.
        at: leads to the entry.
        found: the words that follow "found"; by default the value as the file spells it.

    Raises:
        PydanticCustomError: always; inside a pydantic validation it becomes one of the collected faults.
    """
    context = {"expected": LINEAR.filled(expected), "of_motion": expected, "at": at, "found": found}
    raise PydanticCustomError(UNEXPECTED, "expected {expected}", context)


def _error(expected: str) -> Any:
    """Arguments that give errors of a schema our words."""
    context = {"expected": LINEAR.filled(expected), "of_motion": expected, "at": (), "found": ""}
    message = "expected {expected}"
    return {"custom_error_type": UNEXPECTED, "custom_error_message": message, "custom_error_context": context}


def with_message(schema: Schema, expected: str) -> Schema:
    return core_schema.custom_error_schema(schema, **_error(expected))


def choice(kinds: dict[Any, Any], expected: str) -> Schema:
    if len(kinds) == 1:
        (only,) = kinds.values()
        return only
    union = core_schema.tagged_union_schema(kinds, _kind_of, **_error(expected))
    return core_schema.no_info_before_validator_function(
        lambda value: value.model_dump() if isinstance(value, WrittenAsMapping) else value, union
    )


def _kind_of(value: object) -> str | None:
    if isinstance(value, Mapping):
        return next((kind for kind, keys in _KEYS.items() if frozenset(value) in keys), None)
    if _is_list(value):
        return LISTS if any(map(_is_list, value)) else LIST
    if isinstance(value, str):
        return NUMBER if QUANTITY.match(value) else WORD
    return NUMBER if isinstance(value, Real) and not isinstance(value, bool) else None


_KEYS = {
    SPAN: [{"from", "to"}],
    KNOWN: [{"value", "uncertainty"}],
    DISC: [{"disc"}, {"disc", "center"}],
    POLYGON: [{"polygon"}],
    BRANCHES: [{"press", "release"}, {"press", "release", "turn"}],
}
"""The keys of each kind of mapping."""


def number_schema(expected: str, unit: str, **bounds: Any) -> Schema:
    is_size = 0.0 in (bounds.get("gt"), bounds.get("ge"))

    def within(value: float) -> float:
        """Returns the value, unless it is too large, or too small for a size."""
        if abs(value) > MOST or (is_size and 0.0 < value < LEAST_SIZE):
            limit = f"at most {MOST:g} in size" if abs(value) > MOST else f"at least {LEAST_SIZE:g}"
            unexpected(f"{expected}, {limit}")
        return value

    number = with_message(core_schema.float_schema(strict=True, allow_inf_nan=False, **bounds), expected)
    return _with_unit(core_schema.no_info_after_validator_function(within, number), unit, _as_float, "number")


def whole_schema(expected: str, least: int, most: int, unit: str = "") -> Schema:
    number = with_message(core_schema.int_schema(strict=True, ge=least, le=most), expected)
    return _with_unit(number, unit, _as_int, "integer")


def _with_unit(schema: Schema, unit: str, convert: Callable[[object], object], kind: str) -> Schema:
    """The schema of a number, which in a file may have a unit of the dimension of `unit`. `kind`: JSON schema's."""

    def plain(value: object, info: core_schema.ValidationInfo) -> object:
        """Returns the number of a quantity in SI units; anything else converted."""
        if not isinstance(value, str) or not (info.context is FROM_FILE or ANGLE.match(value)):
            return convert(value)
        value = _in_si(value, unit)
        return int(value) if kind == "integer" and isinstance(value, float) and value.is_integer() else value

    if not has_dimension(unit):
        return core_schema.no_info_before_validator_function(convert, schema)
    written = {"pydantic_js_updates": {"type": [kind, "string"], "pattern": SCHEMA_PATTERN}}
    return core_schema.with_info_before_validator_function(plain, schema, metadata=written)


def _in_si(value: str, unit: str) -> str | float:
    """A quantity with a unit in SI units; other texts as they are."""
    if not QUANTITY.match(value):
        return value
    try:
        return in_si(value, unit)
    except UnitError as error:
        unexpected(error.expected(unit), found=error.found)


def _as_float(value: object) -> object:
    """Numbers of other types, such as numpy's, as Python's; all else as it is."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    try:
        return float(value)
    except OverflowError:  # an integer beyond every float
        return math.inf


def _as_int(value: object) -> object:
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool) else value


def mapping_of(number: Schema, first: str, second: str, make: Callable[[float, float], WrittenAsMapping]) -> Schema:
    fields = {key: core_schema.typed_dict_field(number) for key in (first, second)}
    mapping = core_schema.typed_dict_schema(fields, extra_behavior="forbid")
    return core_schema.no_info_after_validator_function(lambda pair: make(pair[first], pair[second]), mapping)


def span(least: float, most: float) -> Span:
    if least >= most:
        unexpected(f"from ({least:g}) below to ({most:g})")
    return Span(least=least, most=most)


def known(value: float, uncertainty: float) -> Known:
    if uncertainty >= value:
        unexpected(f"uncertainty ({uncertainty:g}) below value ({value:g})")
    return Known(value=value, uncertainty=uncertainty)


def matrix_of(number: Schema, expected: str) -> Schema:
    row = list_of([number], 1, MOST_CHANNELS, "a row of a matrix: a list of numbers, one per channel")

    def physical(rows: Matrix) -> Matrix:
        """Returns the matrix, if it is square, symmetric and positive definite."""
        for i, row in enumerate(rows):
            if len(row) != len(rows):
                unexpected(f"{len(rows)} numbers, as many as the matrix has rows", (i,), f"{len(row)}")
        for i, j in combinations(range(len(rows)), 2):
            if rows[i][j] != rows[j][i]:
                expected = (
                    f"{rows[i][j]:g}, the same as in row {i + 1}, column {j + 1}: a matrix of masses is symmetric"
                )
                unexpected(expected, (j, i), f"{rows[j][i]:g}")
        import numpy as np  # for such a scene alone: it takes a tenth of a second

        own = np.diag(rows)
        least = np.linalg.eigvalsh(rows / own**0.5 / own[:, None] ** 0.5)[0] if own.min() > 0.0 else 0.0
        if not least > len(rows) * sys.float_info.epsilon:
            found = "a matrix that gives some motion a kinetic energy of 0 or less"
            unexpected("a positive definite matrix", found=found)
        return rows

    rows = list_of([row], 1, MOST_CHANNELS, expected)
    return core_schema.no_info_after_validator_function(physical, rows)


def list_of(entries: list[Any], least: int, most: int, expected: str) -> Schema:
    """A tuple of `least` to `most` entries, alike or each by its own schema."""

    def as_tuple(value: object) -> tuple[Any, ...]:
        if not _is_list(value) or not least <= len(value) <= most:
            unexpected(expected)
        return tuple(value)

    variadic = 0 if len(entries) == 1 else None
    lengths = {"pydantic_js_updates": {"minItems": least, "maxItems": most}}
    every = core_schema.tuple_schema(entries, variadic_item_index=variadic, metadata=lengths)
    return core_schema.no_info_before_validator_function(as_tuple, every)


def _is_list(value: object) -> TypeGuard[Sequence[Any]]:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)
