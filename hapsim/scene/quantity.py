"""What a value of the scene file may be, declared once: the check, the words of an error and the JSON schema.

An instance of each class here stands in a field's ``Annotated[...]``. The words are ours rather than pydantic's, so
that a person who never heard of pydantic can act on them.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, NoReturn, TypeGuard

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler, model_serializer
from pydantic_core import PydanticCustomError, core_schema

#: The pydantic error type under which every check of ours reports.
UNEXPECTED = "unexpected"

MOST_CHANNELS = 16
LEAST_POINTS, MOST_POINTS = 2, 1000  # of a curve

_MAPPINGS = "{from: the least, to: the most}, or {value: a number, uncertainty: its standard uncertainty}"

#: Keys and indices that lead from a value to an entry within it.
_At = tuple[int | str, ...]


class _Mapping(BaseModel):
    """What a mapping says of a number."""

    model_config = ConfigDict(frozen=True)

    def __str__(self) -> str:
        """Returns the mapping in braces, as a scene's file spells it."""
        return "{" + ", ".join(f"{key}: {value!r}" for key, value in self.model_dump().items()) + "}"


class Span(_Mapping):
    """A number that is not known: `from` the least that it may be `to` the most."""

    least: float
    most: float

    @model_serializer
    def _as_written(self) -> dict[str, float]:
        return {"from": self.least, "to": self.most}


class Known(_Mapping):
    """A number that was measured, with its standard uncertainty."""

    value: float
    uncertainty: float


#: A number of the scene file, or one for each channel of the device; with what is known of it; or a word.
PerChannel = float | tuple[float, ...]
SpanPerChannel = float | Span | Known | tuple[float | Span | Known, ...]
WordPerChannel = float | str | tuple[float | str, ...]

#: A lower and an upper limit, or such a pair for each channel.
Limits = tuple[float, float]
LimitsPerChannel = Limits | tuple[Limits, ...]

#: A curve: points by ascending x, straight between them.
Curve = tuple[tuple[float, float], ...]


def unexpected(expected: str, at: _At = (), found: str = "") -> NoReturn:
    """Reports that a value, or the entry ``at`` within it, is not what was ``expected``.

    Args:
        expected: the words that follow "expected".
        at: leads to the entry.
        found: what stands there; left out: what the file spells there.

    Raises:
        PydanticCustomError: always; inside a pydantic validation it becomes one of the collected faults.
    """
    raise PydanticCustomError(UNEXPECTED, "expected {expected}", {"expected": expected, "at": at, "found": found})


class Expectation:
    """What one field expects.

    Attributes:
        description: what the value is, for the schema.
        unit: its unit as people read it, such as ``N·s/m``.
        left_out: what it means to leave the value out; where this is given, None is accepted in Python too.
    """

    description: str
    unit: str = ""
    left_out: str = ""

    def expected(self) -> str:
        """Returns the words that follow "expected" in an error."""
        raise NotImplementedError

    def check(self, value: Any) -> Any:
        """Returns the value in its final type; an error through `unexpected`."""
        raise NotImplementedError

    def schemas(self) -> list[dict[str, Any]]:
        """Returns the JSON schemas of the value, of which any may hold."""
        raise NotImplementedError

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        def checked(value: object) -> object:
            return None if value is None and self.left_out else self.check(value)

        return core_schema.no_info_plain_validator_function(checked)

    def __get_pydantic_json_schema__(
        self, _schema: core_schema.CoreSchema, _handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        described = self.description + (f", in {self.unit}" if self.unit else "")
        schemas = self.schemas()
        if self.left_out:
            described += f"; left out: {self.left_out}"
            schemas.append({"type": "null"})
        return {"description": described} | (schemas[0] if len(schemas) == 1 else {"anyOf": schemas})


@dataclass(frozen=True)
class Quantity(Expectation):
    """A finite number in SI units, within bounds.

    Attributes:
        above, least, most: the bounds; ``above`` is exclusive.
        per_channel: a list with one number for each channel is accepted too, and becomes a tuple.
        spans: a mapping is accepted in place of a number: ``{from: least, to: most}`` becomes a `Span`,
            ``{value: number, uncertainty: number}`` a `Known`.
        word: a word that is accepted in place of a number.
    """

    description: str
    unit: str
    above: float | None = None
    least: float | None = None
    most: float | None = None
    per_channel: bool = False
    left_out: str = ""
    spans: bool = False
    word: str = ""

    def expected(self) -> str:
        several = "a list with one per channel" if self.per_channel else ""
        return ", or ".join(filter(None, (self._number(), self.word, _MAPPINGS if self.spans else "", several)))

    def check(self, value: Any) -> Any:
        """Returns a float, a `Span`, a `Known` or the word, or a tuple of one for each channel."""
        if self.per_channel and is_list(value):
            return tuple(self._entry(entry, (index,)) for index, entry in enumerate(value))
        return self._entry(value, ())

    def schemas(self) -> list[dict[str, Any]]:
        bounds = {"exclusiveMinimum": self.above, "minimum": self.least, "maximum": self.most}
        number = {"type": "number"} | {key: bound for key, bound in bounds.items() if bound is not None}
        kinds: list[dict[str, Any]] = [number]
        for keys in (["from", "to"], ["value", "uncertainty"]) if self.spans else ():
            both = {"type": "object", "properties": dict.fromkeys(keys, number), "required": keys}
            kinds.append(both | {"additionalProperties": False})
        if self.word:
            kinds.append({"const": self.word})
        if self.per_channel:
            items = number if len(kinds) == 1 else {"anyOf": list(kinds)}
            kinds.append(_list_schema(items, 1, MOST_CHANNELS))
        return kinds

    def _number(self, kind: str = "number") -> str:
        bounds = f" > {self.above:g}" if self.above is not None else ""
        if self.least is not None:
            bounds = f" >= {self.least:g}" if self.most is None else f" from {self.least:g} to {self.most:g}"
        return f"a {kind}{bounds} ({self.unit})"

    def _entry(self, value: object, at: _At) -> Any:
        if isinstance(value, Span | Known) or (self.word and value == self.word):
            return value
        if not self.spans or not isinstance(value, Mapping):
            return self._checked(value, at)
        numbers = {key: self._checked(value[key], (*at, key)) for key in value} if _is_spelt(value) else {}
        match numbers:
            case {"from": least, "to": most}:
                if least >= most:
                    unexpected(f"from ({least:g}) below to ({most:g})", at)
                return Span(least=least, most=most)
            case {"value": number, "uncertainty": uncertainty}:
                if uncertainty >= number:
                    unexpected(f"uncertainty ({uncertainty:g}) below value ({number:g})", at)
                return Known(value=number, uncertainty=uncertainty)
        unexpected(_MAPPINGS, at)

    def _checked(self, value: object, at: _At) -> float:
        words = self._number() if at else self.expected()
        number = finite_number(value, words, self._number("finite number"), at)
        too_low = (self.above is not None and number <= self.above) or (self.least is not None and number < self.least)
        if too_low or (self.most is not None and number > self.most):
            unexpected(words, at)
        return number


def _is_spelt(value: Mapping[Any, object]) -> bool:
    return set(value) in ({"from", "to"}, {"value", "uncertainty"})


@dataclass(frozen=True)
class Interval(Expectation):
    """A lower and an upper limit in SI units, or such a pair for each channel."""

    description: str
    unit: str
    left_out: str

    def expected(self) -> str:
        return f"[the least, the most] ({self.unit}), or a list of such pairs, one per channel"

    def check(self, value: Any) -> LimitsPerChannel:
        if not is_list(value) or not value:
            unexpected(self.expected())
        if any(is_list(entry) for entry in value):
            return tuple(self._pair(entry, (index,)) for index, entry in enumerate(value))
        return self._pair(value, ())

    def schemas(self) -> list[dict[str, Any]]:
        pair = _list_schema({"type": "number"}, 2, 2)
        return [pair, _list_schema(pair, 1, MOST_CHANNELS)]

    def _pair(self, value: object, at: tuple[int, ...]) -> Limits:
        if not is_list(value) or len(value) != 2:
            unexpected(f"[the least, the most] ({self.unit})" if at else self.expected(), at)
        words = f"a finite number ({self.unit})"
        least, most = (finite_number(entry, words, words, (*at, index)) for index, entry in enumerate(value))
        if not least < most:
            unexpected(f"the least ({least:g}) below the most ({most:g})", at)
        return least, most


@dataclass(frozen=True)
class CurvePoints(Expectation):
    """A list of points [x, y], by ascending x.

    Attributes:
        along, up: units of x and y as people read them.
        fewest: how many points there are at least.
        above: what every y is greater than.
    """

    description: str
    along: str
    up: str
    left_out: str
    fewest: int = LEAST_POINTS
    above: float | None = None

    @property
    def unit(self) -> str:  # type: ignore[override]
        return f"points [{self.along}, {self.up}]"

    def expected(self) -> str:
        return f"a list of {self.fewest} to {MOST_POINTS} {self.unit}"

    def check(self, value: Any) -> Curve:
        if not is_list(value) or not self.fewest <= len(value) <= MOST_POINTS:
            unexpected(self.expected())
        points: list[tuple[float, float]] = []
        for index, entry in enumerate(value):
            points.append(self._point(entry, index))
            if index and not points[index - 1][0] < points[index][0]:
                before = f"{points[index - 1][0]:.15g}"
                unexpected(f"a number > {before} ({self.along}): the points stand in ascending order", (index, 0))
        return tuple(points)

    def schemas(self) -> list[dict[str, Any]]:
        return [_list_schema(_list_schema({"type": "number"}, 2, 2), self.fewest, MOST_POINTS)]

    def _point(self, entry: object, index: int) -> tuple[float, float]:
        if not is_list(entry) or len(entry) != 2:
            unexpected(f"a point [{self.along}, {self.up}], two numbers", (index,))
        words = [f"a finite number ({unit})" for unit in (self.along, self.up)]
        x, y = (finite_number(entry[axis], words[axis], words[axis], (index, axis)) for axis in (0, 1))
        if self.above is not None and not y > self.above:
            unexpected(f"a number > {self.above:g} ({self.up})", (index, 1))
        return x, y


@dataclass(frozen=True)
class Count(Expectation):
    """A whole number from `least` to `most`, written without a decimal point."""

    description: str
    least: int
    most: int
    unit: str = ""
    left_out: str = ""

    def expected(self) -> str:
        return f"a whole number from {self.least} to {self.most}" + (f" ({self.unit})" if self.unit else "")

    def check(self, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, Integral) or not self.least <= int(value) <= self.most:
            unexpected(self.expected())
        return int(value)

    def schemas(self) -> list[dict[str, Any]]:
        return [{"type": "integer", "minimum": self.least, "maximum": self.most}]


@dataclass(frozen=True)
class Words(Expectation):
    """A list of `count` words.

    Attributes:
        words: which there are; empty: any text.
        entry, several: what an error calls one of them, and all of them.
    """

    description: str
    words: tuple[str, ...]
    count: int
    entry: str = ""
    several: str = ""

    def expected(self) -> str:
        return self.several or f"a list of {self.count} words, each {' or '.join(self.words)}"

    def check(self, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list | tuple) or len(value) != self.count:
            unexpected(self.expected())
        for index, word in enumerate(value):
            if not isinstance(word, str) or (self.words and word not in self.words):
                unexpected(self.entry or " or ".join(self.words), (index,))
        return tuple(value)

    def schemas(self) -> list[dict[str, Any]]:
        return [_list_schema({"enum": list(self.words)} if self.words else {"type": "string"}, self.count, self.count)]


@dataclass(frozen=True)
class Text(Expectation):
    """A text of a regular expression `pattern`, called `wanted` in an error."""

    description: str
    wanted: str
    pattern: str
    left_out: str = ""

    def expected(self) -> str:
        return self.wanted

    def check(self, value: Any) -> str:
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            unexpected(self.wanted)
        return value

    def schemas(self) -> list[dict[str, Any]]:
        return [{"type": "string", "pattern": f"^{self.pattern}$"}]


_NAME = "letters, digits, _ and -, starting with a letter or _"
NAME = Text(f"A name: {_NAME}", _NAME, "[A-Za-z_][A-Za-z0-9_-]*")
"""The name of a module."""


@dataclass(frozen=True)
class Version(Expectation):
    """The number of the format that this hapsim reads. `format`: what it calls the format."""

    number: int
    format: str

    @property
    def description(self) -> str:  # type: ignore[override]
        return f"Version of the {self.format} format"

    def expected(self) -> str:
        return f"{self.number}: this hapsim reads version {self.number} of the {self.format} format"

    def check(self, value: Any) -> int:
        if type(value) is not int or value != self.number:
            unexpected(self.expected())
        return value

    def schemas(self) -> list[dict[str, Any]]:
        return [{"const": self.number, "type": "integer"}]


def per_channel(value: PerChannel, channels: int) -> tuple[float, ...]:
    """Returns one value for each of ``channels`` channels: a number is repeated, a tuple is taken as it is."""
    return value if isinstance(value, tuple) else (value,) * channels


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Returns whether the file has a list there."""
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def finite_number(value: object, number: str, finite: str, at: _At) -> float:
    """Returns the number that a value of the file is; `number` or `finite` through `unexpected` where it is none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        unexpected(number, at)
    try:
        result = float(value)
    except OverflowError:  # an integer beyond every float
        result = math.inf
    if not math.isfinite(result):
        unexpected(finite, at)
    return result


def _list_schema(items: dict[str, Any], least: int, most: int) -> dict[str, Any]:
    return {"type": "array", "items": items, "minItems": least, "maxItems": most}
