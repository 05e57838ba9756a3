"""Expected values of the scene file, each declared once for the check, the error message and the JSON schema.

Instances of `Expectation` stand in a field's ``Annotated[...]``. pydantic checks and describes the value. The error
messages are written here, so that they make sense without knowing pydantic.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import core_schema

from hapsim.units import MOTIONS, Units

from .schemas import (
    BRANCHES,
    DISC,
    KNOWN,
    LEAST,
    LIST,
    LISTS,
    MOST_CHANNELS,
    MOST_CORNERS,
    MOST_POINTS,
    NUMBER,
    POLYGON,
    SPAN,
    WORD,
    Schema,
    choice,
    known,
    list_of,
    mapping_of,
    matrix_of,
    number_schema,
    span,
    unexpected,
    whole_schema,
    with_message,
)
from .values import Area, Branches, Curve, Limits, force_at

_ROUNDING = 1e-12  # of the largest force of two branches
_MAPPINGS = "{from: the least, to: the most}, or {value: a number, uncertainty: its standard uncertainty}"


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected value of one field.

    Attributes:
        description: describes the value in the schema.
        expected: the words that follow "expected" in an error, with units as for linear motion, such as ‹N/m›.
        schema: pydantic's schema of the value.
        unit: its unit, as for linear motion: ``N·s/m``; of points ``points [m, N]``.
        left_out: the default in words; where this is given, None is accepted in Python too.
        in_file: whether a scene may name a CSV file in its place.
    """

    description: str
    expected: str
    schema: Any
    unit: str = ""
    left_out: str = ""
    in_file: bool = False

    @property
    def units(self) -> list[str]:
        """The unit; of points that of each number."""
        return self.unit.removeprefix("points [").removesuffix("]").split(", ")

    @property
    def marked_unit(self) -> str:
        """The unit as it stands in `expected`: ‹N/m›."""
        return f"points [‹{'›, ‹'.join(self.units)}›]" if self.units[1:] else f"‹{self.unit}›"

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> Schema:
        as_it_is = core_schema.plain_serializer_function_ser_schema(lambda value: value)
        schema = core_schema.nullable_schema(self.schema) if self.left_out else self.schema
        described: Schema = {**schema, "serialization": as_it_is}
        return described

    def __get_pydantic_json_schema__(self, schema: Schema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        unit = f", in {Units.of(MOTIONS).filled(self.marked_unit)}" if self.unit else ""
        default = f"; default: {self.left_out}" if self.left_out else ""
        values = handler(schema)
        return (_or_file(values) if self.in_file else values) | {"description": f"{self.description}{unit}{default}"}


def _or_file(values: dict[str, Any]) -> dict[str, Any]:
    """Returns the JSON schema of values that a file may have instead."""
    turn = {"type": ["number", "string"]}
    mapping = {"type": "object", "properties": {"file": {"type": "string"}, "turn": turn}, "required": ["file"]}
    return {"anyOf": [values, {"type": "string"}, mapping | {"additionalProperties": False}]}


def expectation_of(field: FieldInfo) -> Expectation | None:
    """Returns the expected value of a field of a part; None if any is."""
    return next((one for one in field.metadata if isinstance(one, Expectation)), None)


def quantity(
    description: str,
    unit: str,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    per_channel: bool = False,
    left_out: str = "",
    spans: bool = False,
    word: str = "",
    coordinates: bool = False,
    matrix: bool = False,
) -> Expectation:
    """A finite number in SI units, within bounds.

    Args:
        description, unit, left_out: as in `Expectation`.
        above, least, most: the bounds; ``above`` is exclusive.
        per_channel: a list with one number for each channel is accepted too, and becomes a tuple.
        spans: a mapping is accepted in place of a number: ``{from: least, to: most}`` becomes a `Span`,
            ``{value: number, uncertainty: number}`` a `Known`.
        word: a word that is accepted in place of a number.
        coordinates: a list [x, y] is accepted too, and becomes a tuple: in a scene with space: 2.
        matrix: a symmetric positive definite matrix of plain numbers is accepted too, and becomes a tuple of rows.
    """
    bounds = f" > {above:g}" if above is not None else ""
    if least is not None:
        bounds = f" >= {least:g}" if most is None else f" from {least:g} to {most:g}"
    number_words = f"a number{bounds} (‹{unit}›)"
    entry_words = ", or ".join(filter(None, (number_words, word, _MAPPINGS if spans else "")))
    words = f"{entry_words}, or a list with one per channel" if per_channel else entry_words
    words += ", or a symmetric matrix" if matrix else ""
    number = number_schema(number_words, unit, gt=above, ge=least, le=most)
    kinds = {NUMBER: number}
    if word:
        kinds[WORD] = with_message(core_schema.literal_schema([word]), words)
    if spans:
        kinds[SPAN] = mapping_of(number, "from", "to", span)
        kinds[KNOWN] = mapping_of(number, "value", "uncertainty", known)
    if coordinates:
        kinds[LIST] = list_of([number], 2, 2, f"two numbers [x, y] (‹{unit}›)")
    if per_channel:
        kinds = {**kinds, LIST: list_of([choice(kinds, entry_words)], 1, MOST_CHANNELS, words)}
    if matrix:
        kinds[LISTS] = matrix_of(number_schema(f"a number (‹{unit}›) in a row of a matrix", unit), words)
    return Expectation(description, words, choice(kinds, words), unit, left_out)


def interval(description: str, unit: str, left_out: str) -> Expectation:
    """A lower and an upper limit in SI units, or such a pair for each channel; in the plane an `Area` too."""
    pair_words = f"[the least, the most] (‹{unit}›)"
    areas = "with space: 2 also {disc: radius, center: [x, y]} or {polygon: places}"
    words = f"{pair_words}, or a list of such pairs, one per channel; {areas}"
    limits = list_of([number_schema(f"a number (‹{unit}›)", unit)], 2, 2, pair_words)

    def ascending(pair: Limits) -> Limits:
        """Returns them, if each is larger than the one before."""
        if not pair[0] < pair[1]:
            unexpected("the least before the most; swap them" if pair[0] > pair[1] else "two different limits")
        return pair

    pair = core_schema.no_info_after_validator_function(ascending, limits)
    kinds = {LIST: pair, LISTS: list_of([pair], 1, MOST_CHANNELS, words)}
    radius = core_schema.typed_dict_field(number_schema(f"a number > 0 (‹{unit}›)", unit, gt=0.0))
    center = core_schema.typed_dict_field(place("", unit).schema, required=False)
    corners = core_schema.typed_dict_field(places("", unit, 3).schema)
    for kind, fields in {DISC: {"disc": radius, "center": center}, POLYGON: {"polygon": corners}}.items():
        mapping = core_schema.typed_dict_schema(fields, extra_behavior="forbid")
        kinds[kind] = core_schema.no_info_after_validator_function(lambda found: Area(**found), mapping)
    return Expectation(description, words, choice(kinds, words), unit, left_out)


def curve(
    description: str,
    along: str,
    up: str,
    left_out: str,
    fewest: int = 2,
    above: float | None = None,
    branches: bool = False,
) -> Expectation:
    """A list of at least `fewest` points [x, y] by ascending x, in the units `along` and `up`; every y > `above`; or,
    with `branches`, a mapping of two: ``{press: points, release: points, turn: way}`` becomes `Branches`."""

    def ascending(points: Curve) -> Curve:
        """Returns them, if each is larger than the one before."""
        for index, ((before, _), (x, _)) in enumerate(pairwise(points), 1):
            if not x - before >= LEAST:
                expected = f"a number > ‹{before!r} {along}›{'' if x <= before else f', by {LEAST:g} or more'}"
                unexpected(f"{expected}: the points stand in ascending order", (index, 0))
        return points

    unit = f"points [{along}, {up}]"
    words = f"a list of {fewest} to {MOST_POINTS} points [‹{along}›, ‹{up}›]"
    y_words = "a number" if above is None else f"a number > {above:g}"
    axes = [number_schema(f"a number (‹{along}›)", along), number_schema(f"{y_words} (‹{up}›)", up, gt=above)]
    points = list_of([list_of(axes, 2, 2, f"a point [‹{along}›, ‹{up}›], two numbers")], fewest, MOST_POINTS, words)
    schema: Schema = core_schema.no_info_after_validator_function(ascending, points)
    if branches:
        words += f", or {{press: such a list, release: another, turn: a distance > 0 (‹{along}›)}}, or a file.csv"
        fields = {key: core_schema.typed_dict_field(schema) for key in ("press", "release")}
        turn = number_schema(f"a distance > 0 (‹{along}›)", along, gt=0.0)
        fields["turn"] = core_schema.typed_dict_field(turn, required=False)
        mapping = core_schema.typed_dict_schema(fields, extra_behavior="forbid")
        both = core_schema.no_info_after_validator_function(_branches, mapping)
        schema = choice({LIST: schema, LISTS: schema, BRANCHES: both}, words)
    return Expectation(description, words, schema, unit, left_out, in_file=branches)


def _branches(found: dict[str, Any]) -> Branches:
    """Two curves over the distances of both. One that is above the other by no more than rounding is taken as it."""
    press, release = found["press"], found["release"]
    size = _ROUNDING * max(abs(force) for _, force in (*press, *release))
    ways = sorted((x, key, i) for key in ("press", "release") for i, (x, _) in enumerate(found[key]))
    both: list[tuple[float, float, float]] = []
    for x, key, i in ways:
        pressing, releasing = force_at(press, x), force_at(release, x)
        if releasing > pressing + size:
            above, below = f"‹{releasing!r} N› while one releases", f"‹{pressing!r} N› while one presses"
            expected = f"no more than {below}" if key == "release" else f"at least {above}"
            unexpected(f"{expected}, at ‹{x!r} m›", (key, i, 1))
        if not both or x - both[-1][0] >= LEAST:
            both.append((x, pressing, min(pressing, releasing)))
    curves = {key: tuple((one[0], one[at]) for one in both) for at, key in enumerate(("press", "release"), 1)}
    return Branches(**found | curves)


def numbers(description: str, unit: str, left_out: str) -> Expectation:
    """A list of numbers, each larger than the one before; without a unit, of whole ones from 0."""
    one, what = f"a number (‹{unit}›)" if unit else "a whole number >= 0", f" (‹{unit}›)" if unit else ""
    words = f"a list of 1 to {MOST_POINTS} ascending {'' if unit else 'whole '}numbers{what}"

    def ascending(found: tuple[float, ...]) -> tuple[float, ...]:
        """Returns them, if each is larger than the one before."""
        for index, (before, after) in enumerate(pairwise(found), 1):
            if after - before < LEAST:
                unexpected(f"a number > ‹{before!r} {unit or '1'}›: they stand in ascending order", (index,))
        return found

    every = list_of([number_schema(one, unit) if unit else whole_schema(one, 0, MOST_POINTS)], 1, MOST_POINTS, words)
    schema = core_schema.no_info_after_validator_function(ascending, every)
    return Expectation(description, words, schema, unit, left_out)


def place(description: str, unit: str, left_out: str = "") -> Expectation:
    """A place in the plane, or a size of two sides: two numbers."""
    words = f"two numbers [x, y] (‹{unit}›)"
    return Expectation(
        description, words, list_of([number_schema(f"a number (‹{unit}›)", unit)], 2, 2, words), unit, left_out
    )


def places(description: str, unit: str, fewest: int, left_out: str = "") -> Expectation:
    """A list of at least `fewest` places in the plane, no two neighbours alike."""
    words = f"a list of {fewest} to {MOST_CORNERS} places [x, y] (‹{unit}›)"

    def apart(found: Curve) -> Curve:
        """Returns them, if no two neighbours are alike."""
        for index, (before, one) in enumerate(pairwise(found), 1):
            if math.dist(before, one) < LEAST:
                unexpected("another place than the one before", (index,))
        return found

    every = list_of([place("", unit).schema], fewest, MOST_CORNERS, words)
    return Expectation(description, words, core_schema.no_info_after_validator_function(apart, every), unit, left_out)


def count(description: str, least: int, most: int, unit: str = "", left_out: str = "") -> Expectation:
    """A whole number from `least` to `most`, written without a decimal point."""
    words = f"a whole number from {least} to {most}" + (f" ({unit})" if unit else "")
    return Expectation(description, words, whole_schema(words, least, most, unit), unit, left_out)


def counts(description: str, count: int, least: int, most: int, left_out: str) -> Expectation:
    """A list of `count` whole numbers from `least` to `most`."""
    words = f"a list of {count} whole numbers from {least} to {most}"
    entries = list_of([whole_schema(words, least, most)], count, count, words)
    return Expectation(description, words, entries, left_out=left_out)


def words_of(description: str, words: tuple[str, ...], count: int) -> Expectation:
    """A list of `count` of these words."""
    either = " or ".join(words)
    return names(description, f"a list of {count} words, each {either}", either, count, words)


def some_of(description: str, words: tuple[str, ...]) -> Expectation:
    """A list of some of these words, each once; it becomes a tuple in their order."""
    either = " or ".join(words)
    expected = f"a list of {either}, each once"
    entries = list_of([with_message(core_schema.literal_schema(list(words)), either)], 0, len(words), expected)

    def in_order(found: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(found)) < len(found):
            unexpected(expected, found="a list that names one twice")
        return tuple(sorted(found, key=words.index))

    return Expectation(description, expected, core_schema.no_info_after_validator_function(in_order, entries))


def word_per_channel(description: str, words: tuple[str, ...]) -> Expectation:
    """One of these words, or a list with one for each channel."""
    either = " or ".join(words)
    expected = f"{either}, or a list with one per channel"
    literal = core_schema.literal_schema(list(words))
    entries = list_of([with_message(literal, either)], 1, MOST_CHANNELS, expected)
    kinds = {WORD: with_message(literal, expected), LIST: entries}
    return Expectation(description, expected, choice(kinds, expected))


def names(description: str, expected: str, entry: str, count: int, words: tuple[str, ...] = ()) -> Expectation:
    """A list of `count` texts, or of these words; `entry`: what an error calls one."""
    one = core_schema.literal_schema(list(words)) if words else core_schema.str_schema(strict=True)
    entries = list_of([with_message(one, entry)], count, count, expected)
    return Expectation(description, expected, entries)


def text(description: str, expected: str, pattern: str, left_out: str = "") -> Expectation:
    """A text of a regular expression `pattern`."""
    schema = core_schema.str_schema(strict=True, pattern=f"^{pattern}$")
    return Expectation(description, expected, with_message(schema, expected), left_out=left_out)


def switch(description: str) -> Expectation:
    """true or false."""
    return Expectation(
        description, "true or false", with_message(core_schema.bool_schema(strict=True), "true or false")
    )


def version(number: int, format_name: str) -> Expectation:
    """The number of the format that this hapsim reads."""
    expected = f"{number}: this hapsim reads version {number} of the {format_name} format"
    return Expectation(f"Version of the {format_name} format", expected, whole_schema(expected, number, number))


NAME_PATTERN = "[A-Za-z_][A-Za-z0-9_-]*"
_NAME = "letters, digits, _ and -, starting with a letter or _"
NAME = text(f"A name: {_NAME}", _NAME, NAME_PATTERN)
"""The name of a module."""
