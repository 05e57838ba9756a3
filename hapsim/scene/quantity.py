"""What a value of the scene file may be, said once: the check, the words of an error and the JSON schema.

Each class here stands in a field's ``Annotated[...]``. The words are ours rather than pydantic's, so that a
person who never heard of pydantic can act on them.
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

_MAPPINGS = "{from: the least, to: the most}, or {value: a number, uncertainty: its standard uncertainty}"

#: A number of the scene file, or one for each channel of the device.
PerChannel = float | tuple[float, ...]


class _Mapping(BaseModel):
    """What a mapping says of a number."""

    model_config = ConfigDict(frozen=True)

    def __str__(self) -> str:
        """As a scene's file spells it, in braces."""
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


#: A number of the scene file with what is known of it, or one for each channel of the device.
SpanPerChannel = float | Span | Known | tuple[float | Span | Known, ...]

#: A number or a word, or one for each channel.
WordPerChannel = float | str | tuple[float | str, ...]

#: A lower and an upper limit, or such a pair for each channel.
Limits = tuple[float, float]
LimitsPerChannel = Limits | tuple[Limits, ...]


def unexpected(expected: str, at: tuple[int | str, ...] = (), found: str = "") -> NoReturn:
    """Say that a value, or the entry ``at`` within it, is not what was ``expected``; ``found``: what it is, in place of
    what the file spells there.

    Raises:
        PydanticCustomError: always; inside a pydantic validation it becomes one of the collected faults.
    """
    raise PydanticCustomError(UNEXPECTED, "expected {expected}", {"expected": expected, "at": at, "found": found})


class Expectation:
    """What one field expects. An instance stands in ``Annotated[type, ...]``, where pydantic finds it."""

    def expected(self) -> str:
        """The words that follow "expected" in an error."""
        raise NotImplementedError

    def check(self, value: object) -> object:
        """The value in its final type, or an error through `unexpected`."""
        raise NotImplementedError

    def json_schema(self) -> dict[str, Any]:
        """The JSON schema of the value, description and unit included."""
        raise NotImplementedError

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(
        self, _schema: core_schema.CoreSchema, _handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return self.json_schema()


@dataclass(frozen=True)
class Quantity(Expectation):
    """A finite number in SI units, within bounds.

    Attributes:
        description: what the number is, for the schema.
        unit: its unit as people read it, such as ``N·s/m``.
        above, least, most: the bounds; ``above`` is exclusive.
        per_channel: a list with one number for each channel is welcome too, and becomes a tuple.
        left_out: what it means to leave the number out; where this is given, None is welcome in Python too.
        spans: a mapping is welcome in place of a number: ``{from: least, to: most}`` becomes a `Span`,
            ``{value: number, uncertainty: number}`` a `Known`.
        word: a word that is welcome in place of a number.
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
        span = f", or {_MAPPINGS}" if self.spans else ""
        word = f", or {self.word}" if self.word else ""
        several = ", or a list with one per channel" if self.per_channel else ""
        return self._one() + word + span + several

    def check(self, value: object) -> SpanPerChannel | WordPerChannel | None:
        """A float, or a tuple of one for each channel; a welcome None stays. An error through `unexpected`."""
        if value is None and self.left_out:
            return None
        if self.per_channel and is_list(value):
            return tuple(self._entry(entry, (index,)) for index, entry in enumerate(value))
        return self._entry(value, ())

    def json_schema(self) -> dict[str, Any]:
        """A number within the bounds, or a list of one for each channel, or ``null``."""
        bounds = {"exclusiveMinimum": self.above, "minimum": self.least, "maximum": self.most}
        number = {"type": "number"} | {key: bound for key, bound in bounds.items() if bound is not None}
        kinds: list[dict[str, Any]] = [number]
        if self.spans:
            for keys in (["from", "to"], ["value", "uncertainty"]):
                both = {"type": "object", "properties": dict.fromkeys(keys, number), "required": keys}
                kinds.append(both | {"additionalProperties": False})
        if self.word:
            kinds.append({"const": self.word})
        if self.per_channel:
            items = number if len(kinds) == 1 else {"anyOf": list(kinds)}
            kinds.append({"type": "array", "items": items, "minItems": 1, "maxItems": MOST_CHANNELS})
        if self.left_out:
            kinds.append({"type": "null"})
        return {"description": self._described()} | (number if len(kinds) == 1 else {"anyOf": kinds})

    def _described(self) -> str:
        left_out = f"; left out: {self.left_out}" if self.left_out else ""
        return f"{self.description}, in {self.unit}{left_out}"

    def _one(self, kind: str = "number") -> str:
        return f"a {kind}{_bounds(self.above, self.least, self.most)} ({self.unit})"

    def _entry(self, value: object, at: tuple[int | str, ...]) -> Any:
        if isinstance(value, Span | Known) or (self.word and value == self.word):
            return value
        if not self.spans or not isinstance(value, Mapping):
            return self._number(value, at)
        if set(value) == {"from", "to"}:
            least, most = (self._number(value[key], (*at, key)) for key in ("from", "to"))
            if least >= most:
                unexpected(f"from ({least:g}) below to ({most:g})", at)
            return Span(least=least, most=most)
        if set(value) == {"value", "uncertainty"}:
            number, uncertainty = (self._number(value[key], (*at, key)) for key in ("value", "uncertainty"))
            if uncertainty >= number:
                unexpected(f"uncertainty ({uncertainty:g}) below value ({number:g})", at)
            return Known(value=number, uncertainty=uncertainty)
        unexpected(_MAPPINGS, at)

    def _number(self, value: object, at: tuple[int | str, ...]) -> float:
        number = as_float(value)
        if number is None:
            unexpected(self._one() if at else self.expected(), at)
        if not math.isfinite(number):
            unexpected(self._one("finite number"), at)
        too_low = (self.above is not None and number <= self.above) or (self.least is not None and number < self.least)
        if too_low or (self.most is not None and number > self.most):
            unexpected(self._one() if at else self.expected(), at)
        return number


@dataclass(frozen=True)
class Interval(Expectation):
    """A lower and an upper limit in SI units, or such a pair for each channel; None is welcome in Python too.

    Attributes:
        description: what the limits are of, for the schema.
        unit: their unit as people read it.
        left_out: what it means to leave them out.
    """

    description: str
    unit: str
    left_out: str

    def expected(self) -> str:
        return f"[the least, the most] ({self.unit}), or a list of such pairs, one per channel"

    def check(self, value: object) -> LimitsPerChannel | None:
        """A pair of numbers, or a tuple of one for each channel; None stays. An error through `unexpected`."""
        if value is None:
            return None
        if not is_list(value) or not value:
            unexpected(self.expected())
        if any(is_list(entry) for entry in value):
            return tuple(self._pair(entry, (index,)) for index, entry in enumerate(value))
        return self._pair(value, ())

    def json_schema(self) -> dict[str, Any]:
        """A pair, or a list of one for each channel, or ``null``."""
        pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        pairs = {"type": "array", "items": pair, "minItems": 1, "maxItems": MOST_CHANNELS}
        described = f"{self.description}, in {self.unit}; left out: {self.left_out}"
        return {"description": described, "anyOf": [pair, pairs, {"type": "null"}]}

    def _pair(self, value: object, at: tuple[int, ...]) -> Limits:
        if not is_list(value) or len(value) != 2:
            unexpected(f"[the least, the most] ({self.unit})" if at else self.expected(), at)
        least, most = (self._number(entry, (*at, index)) for index, entry in enumerate(value))
        if not least < most:
            unexpected(f"the least ({least:g}) below the most ({most:g})", at)
        return least, most

    def _number(self, value: object, at: tuple[int, ...]) -> float:
        number = as_float(value)
        if number is None or not math.isfinite(number):
            unexpected(f"a finite number ({self.unit})", at)
        return number


@dataclass(frozen=True)
class Count(Expectation):
    """A whole number within bounds, written without a decimal point.

    Attributes:
        description: what is counted, for the schema.
        least, most: the bounds, both inclusive.
        unit: the unit as people read it, or nothing for a bare number.
        left_out: what it means to leave the number out; where this is given, None is welcome in Python too.
    """

    description: str
    least: int
    most: int
    unit: str = ""
    left_out: str = ""

    def expected(self) -> str:
        unit = f" ({self.unit})" if self.unit else ""
        return f"a whole number from {self.least} to {self.most}{unit}"

    def check(self, value: object) -> int | None:
        """A whole number within the bounds, or an error through `unexpected`."""
        if value is None and self.left_out:
            return None
        if isinstance(value, bool) or not isinstance(value, Integral):
            unexpected(self.expected())
        number = int(value)
        if not self.least <= number <= self.most:
            unexpected(self.expected())
        return number

    def json_schema(self) -> dict[str, Any]:
        """A whole number within the bounds."""
        description = f"{self.description}, in {self.unit}" if self.unit else self.description
        number = {"type": "integer", "minimum": self.least, "maximum": self.most}
        if not self.left_out:
            return number | {"description": description}
        return {"description": f"{description}; left out: {self.left_out}", "anyOf": [number, {"type": "null"}]}


@dataclass(frozen=True)
class Words(Expectation):
    """A list of words, each one of a few.

    Attributes:
        description: what they say, for the schema.
        words: which there are.
        count: how many the list has.
    """

    description: str
    words: tuple[str, ...]
    count: int

    def expected(self) -> str:
        return f"a list of {self.count} words, each {' or '.join(self.words)}"

    def check(self, value: object) -> tuple[str, ...]:
        """The words, or an error through `unexpected`, for the first that is none of them."""
        if not isinstance(value, list | tuple) or len(value) != self.count:
            unexpected(self.expected())
        for index, word in enumerate(value):
            if word not in self.words:
                unexpected(" or ".join(self.words), (index,))
        return tuple(value)

    def json_schema(self) -> dict[str, Any]:
        """A list of so many words."""
        return {
            "description": self.description,
            "type": "array",
            "items": {"enum": list(self.words)},
            "minItems": self.count,
            "maxItems": self.count,
        }


@dataclass(frozen=True)
class Name(Expectation):
    """The name of a module: letters, digits, ``_`` and ``-``, starting with a letter or ``_``."""

    PATTERN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
    WORDS = "letters, digits, _ and -, starting with a letter or _"

    def expected(self) -> str:
        return self.WORDS

    def check(self, value: object) -> str:
        if not isinstance(value, str) or not self.PATTERN.fullmatch(value):
            unexpected(self.expected())
        return value

    def json_schema(self) -> dict[str, Any]:
        """A text of this pattern."""
        return {
            "type": "string",
            "pattern": f"^{self.PATTERN.pattern}$",
            "description": f"A name: {self.WORDS}",
        }


def per_channel(value: PerChannel, channels: int) -> tuple[float, ...]:
    """One value for each of ``channels`` channels: a number is repeated, a tuple is taken as it is."""
    return value if isinstance(value, tuple) else (value,) * channels


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether the file has a list there."""
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def as_float(value: object) -> float | None:
    """The number that a value of the file is, or nothing."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf  # an integer beyond every float


def _bounds(above: float | None, least: float | None, most: float | None) -> str:
    if most is not None and least is not None:
        return f" from {least:g} to {most:g}"
    if above is not None:
        return f" > {above:g}"
    return f" >= {least:g}" if least is not None else ""
