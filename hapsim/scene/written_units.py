"""Quantities as people write them in a file: "200 g", "2 N/mm", "0.3 N·m/deg".

The library pint reads units. It is imported for the first unit that is not a plain angle, since it takes some 0.3 s. It
knows the units below and no others. An angle is a dimension of its own here: a torque of 2 N·m is no stiffness in
N·m/rad. Numbers stay decimal until they are in SI units: "200 g" is 0.2 to the last bit.
"""

from __future__ import annotations

import math
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from contextlib import suppress
from decimal import Decimal
from functools import cache, lru_cache
from typing import Any

from hapsim.units import MOTIONS, OF_MOTION, Motion, Units, Written

from .issue import Path, did_you_mean, quote

_DECIMAL = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NOT_FINITE = r"[-+]?\.?(?:nan|inf|NaN|Inf|NAN|INF)(?=\s)"

#: An angle in degrees, or degrees a second: read without pint.
ANGLE = re.compile(rf"({_DECIMAL}) ?(?:deg|degrees?|[°º˚])(/s)?\Z")
_PER = {"m": "", "m per count": "", "m rms": "", "m/s": "/s"}

_MOST_DIGITS = 17  # of a float

#: A number and a unit, known or not; not 0x1F, which is a number elsewhere.
QUANTITY = re.compile(rf"\s*(?!0[xob])({_DECIMAL}|{_NOT_FINITE})(\s*)(?![eE][-+]?[0-9])([^\W\d_]|[°º˚%])(.{{0,40}})\Z")
SCHEMA_PATTERN = rf"^{_DECIMAL} ?[A-Za-zµμ°]"

_UNITS = """
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
kilo- = 1e3 = k-
mega- = 1e6 = M-
meter = [length] = m = metre
gram = [mass] = g
second = [time] = s = sec
radian = [angle] = rad
bit = [data]
sample = [sampling]
count = []
minute = 60 * second = min
degree = 0.01745329251994329576923690768 * radian = deg
turn = 6.283185307179586476925286767 * radian = rev = revolution
rpm = turn / minute
hertz = 1 / second = Hz
newton = kilogram * meter / second ** 2 = N
joule = newton * meter = J
watt = joule / second = W
baud = bit / second = Bd
inch = 0.0254 * meter = in
foot = 12 * inch = ft = feet
pound = 453.59237 * gram = lb
ounce = 28.349523125 * gram = oz
kilogram_force = 9.80665 * newton = kgf
gram_force = 0.00980665 * newton = gf
pound_force = 4.4482216152605 * newton = lbf
ounce_force = 0.27801385095378125 * newton = ozf
"""
_LIKELY = (
    *("m", "mm", "cm", "µm", "nm", "in", "g", "kg", "mg", "lb", "oz", "s", "ms", "µs", "min", "N", "mN", "kN", "lbf"),
    *("ozf", "kgf", "Nm", "mNm", "Hz", "kHz", "rad", "mrad", "deg", "rev", "rpm", "J", "mJ", "sample", "bit"),
)

# Other characters for the same, and what people write without a sign: Nm, mNm, Ncm, Ns, Nms, kgm², gcm²; and m2.
_SAME = str.maketrans("μ·⋅∙×º˚\u00a0\u202f", "µ****°°  ")
_LETTER = "[A-Za-zµ]"
_JOINED = (
    rf"(?<!{_LETTER})([nµumkM]?N)([cm]?m)?(s)?(?!{_LETTER})",
    rf"(?<!{_LETTER})([mk]?g)([cm]?m)(?!{_LETTER})",
)
_OF_PINT = AssertionError, AttributeError, TypeError, ValueError, tokenize.TokenError
"""Errors that pint raises for texts that are no units."""
_POINT = rf"(?<=[A-Za-zµ²³])\.(?={_LETTER})"
_EXPONENT = rf"(?<={_LETTER})(?=[23](?!\d))"
_WELL_FORMED = rf"(?!.*//)(?:{_LETTER}|°|[*/() ]|⁻?[¹²³]|(?:\^|\*\*) ?-?[1-4](?!\d))+\Z"


def quantities_in(data: object) -> Iterator[tuple[Path, str]]:
    """Yields the quantities with a unit among a file's values, each with its path. What anchors bring to several places
    comes once."""
    return _quantities(data, (), set())


def _quantities(value: object, path: Path, seen: set[int]) -> Iterator[tuple[Path, str]]:
    if isinstance(value, str) and QUANTITY.match(value):
        yield path, value
    elif isinstance(value, list | dict) and id(value) not in seen:
        seen.add(id(value))
        for step, entry in enumerate(value) if isinstance(value, list) else value.items():
            yield from _quantities(entry, (*path, step), seen)


class UnitError(ValueError):
    """A quantity that does not fit its field.

    Attributes:
        found: the words that follow "found" in a message.
        hint: the end of the message; "" without one.
        is_finite: False if the number is none, or too large for a float.
    """

    def __init__(self, found: str, hint: str = "", is_finite: bool = True) -> None:
        super().__init__(f"{found}{hint}")
        self.found, self.hint, self.is_finite = found, hint, is_finite

    def expected(self, unit: str) -> str:
        """Returns the words that follow "expected", with marks that `Units.filled` fills. `unit`: of the field."""
        return f"‹one {unit}›{self.hint}" if self.is_finite else f"a finite number (‹{unit}›)"


class _UnknownUnitError(ValueError):
    """A unit that hapsim does not know; its argument is the symbol, or the whole unit if it is no product of units."""


def has_dimension(unit: str) -> bool:
    """Returns whether a field with this unit takes a unit in its file. A share (1) or a gain (1/(SI unit)) has none."""
    return unit != "" and not unit.startswith("1")


def in_si(text: str, unit: str, motions: Iterable[Motion] = MOTIONS) -> float:
    """Returns a quantity in SI units.

    Args:
        text: matches `QUANTITY`.
        unit: of its field, as for linear motion, such as N/m.
        motions: those of which it may be; rotary: N·m/rad.

    Raises:
        UnitError: its unit is unknown or of another dimension, or its number is not finite.
    """
    angle = ANGLE.match(text) if "rotary" in motions else None
    if angle and _PER.get(unit) == (angle[2] or ""):
        return math.radians(float(angle[1]))
    number, _, written = _parted(text)
    try:
        factor = next((one for motion in motions if (one := _factor(written, unit, motion)) is not None), None)
    except _UnknownUnitError as error:
        (symbol,) = error.args
        hint = did_you_mean(symbol, _LIKELY) if symbol.isalpha() else ""
        raise UnitError(f"{text}, with the unknown unit {quote(symbol)}", hint) from None
    if factor is None:
        raise UnitError(text)
    value = float(number)  # Decimal takes no exponent of many digits
    value = float(Decimal(number) * factor) if value and math.isfinite(value) else value
    if not math.isfinite(value):
        raise UnitError(text, is_finite=False)
    return value


def written_unit(text: str, unit: str, motion: Motion) -> Written | None:
    """Returns the unit of a quantity of this motion; None if it is the SI unit, or of a quantity that has no motion.
    `text` and `unit`: as in `in_si`."""
    si = Units.of([motion]).name(unit)
    if unit not in OF_MOTION:
        return None
    if motion == "rotary" and (angle := ANGLE.match(text)):
        return Written(si, f"°{angle[2] or ''}", 180.0 / math.pi)
    _, _, name = _parted(text)
    factor = _factor(name, unit, motion)
    return Written(si, name, float(1 / factor)) if factor and factor != 1 else None


def unit_factor(written: str, unit: str, motion: Motion) -> Decimal | None:
    """Returns how many SI units a written unit is; None if it is none of this quantity. `unit`: as in `in_si`."""
    with suppress(_UnknownUnitError):
        return _factor("deg" if ANGLE.match(f"1 {written}") else written, unit, motion)
    return None


def like(text: str, value: str, unit: str) -> str:
    """Returns a number in SI units with the unit of the quantity `text`, in as few digits as mean that number; as it is
    where none do. `unit`: of its field, as in `in_si`."""
    _, gap, written = _parted(text)
    factor = next((one for motion in MOTIONS if (one := _factor(written, unit, motion)) is not None), None)
    if factor is None:
        return value
    whole = (Decimal(value) / factor).normalize()
    fewer = (Decimal(f"{whole:.{digits}g}") for digits in range(1, _MOST_DIGITS + 1))
    for shown in (whole, *fewer) if len(whole.as_tuple().digits) <= sys.float_info.dig else fewer:
        found = f"{shown:f}{gap}{written}" if 1e-4 <= abs(shown) < 1e7 or not shown else f"{shown:e}{gap}{written}"
        if in_si(found, unit) == float(value):
            return found
    return value


def _parted(text: str) -> tuple[str, str, str]:
    """Returns number, gap and unit of a quantity."""
    match = QUANTITY.match(text)
    assert match is not None
    number = "inf" if match[1][-1].isalpha() else match[1]
    return number, match[2], (match[3] + match[4]).strip()


@lru_cache(maxsize=4096)
def _factor(written: str, unit: str, motion: Motion) -> Decimal | None:
    """Returns how many of its field's SI units a written unit is; None if it has another dimension. Raises
    _UnknownUnitError."""
    of_field, _, words = Units.of([motion]).name(unit).partition(" ")  # such as "per count", which may be omitted
    source, target = _unit(written.removesuffix(f" {words}") if words else written), _unit(of_field)
    if source.dimensionality != target.dimensionality:
        return None
    factor: Decimal = _registry().convert(Decimal(1), source, target)
    return factor


def _unit(written: str) -> Any:
    """Returns pint's unit of a text. Raises _UnknownUnitError if there is none."""
    registry, text = _registry(), re.sub(_POINT, "*", written.translate(_SAME))
    text = text.replace("sample period", "sample").replace(" per ", "/")
    for joined in _JOINED:
        text = re.sub(joined, lambda found: "*".join(filter(None, found.groups())), text)
    text = re.sub(_EXPONENT, "**", text)
    if not re.match(_WELL_FORMED, text):
        raise _UnknownUnitError(written)
    for symbol in re.findall(rf"{_LETTER}+", text):
        if not _is_symbol(symbol, registry):
            raise _UnknownUnitError(symbol)
    with suppress(*_OF_PINT):
        return registry.parse_units(text)
    raise _UnknownUnitError(written)


def _is_symbol(text: str, registry: Any) -> bool:
    with suppress(*_OF_PINT):  # for nan, which is a number to it, and for prefixes of a level, such as mdB
        return text in registry
    return False


@cache
def _registry() -> Any:
    """Returns pint's registry of the units above."""
    import pint

    registry: Any = pint.UnitRegistry(None, non_int_type=Decimal)
    registry.load_definitions(_UNITS.strip().splitlines())
    return registry
