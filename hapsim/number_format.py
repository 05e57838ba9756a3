"""Numbers in sentences and tables: rounded to the side that keeps a statement true, or to their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterable
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal

_TIME_UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def number(value: float, digits: int = 6) -> str:
    """Returns a value with up to `digits` digits; a dash for infinity and NaN."""
    return f"{value + 0.0:.{digits}g}" if math.isfinite(value) else "–"  # + 0.0: no minus before a zero


def rounded_down(value: float, digits: int = 4) -> str:
    """Returns a value with `digits` digits, never above it."""
    return _rounded(value, digits, ROUND_FLOOR)


def rounded_up(value: float, digits: int = 4) -> str:
    """Returns a value with `digits` digits, never below it."""
    return _rounded(value, digits, ROUND_CEILING)


def _rounded(value: float, digits: int, direction: str) -> str:
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    exact = Decimal(value)
    return f"{float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - digits + 1), direction)):.{digits}g}"


def between(least: float, most: float, to: str = " to ") -> str:
    """Returns a range, its ends rounded inward: with four digits, or with more if a narrow range needs them."""
    for digits in range(4, 17):
        low, high = rounded_up(least, digits), rounded_down(most, digits)
        if float(low) <= float(high):
            return f"{low}{to}{high}"
    return f"{least!r}{to}{most!r}"


def rounded(value: float, uncertainty: float) -> str:
    """Returns a value to the second digit of its uncertainty."""
    if not (math.isfinite(value) and math.isfinite(uncertainty) and uncertainty > 0.0):
        return f"{value:g}"
    decimals = min(max(1 - math.floor(math.log10(uncertainty)), 0), 15)
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def percent(share: float, digits: int = 2) -> str:
    """Returns a share or a relative difference in percent: 0.0312 is 3.1 %."""
    return f"{100.0 * share:.{digits}g} %"


def share_in_percent(value: float) -> str:
    """Returns a share (0 to 1) in percent, with the digits that matter close to 0 % and to 100 %: 0 % and 100 % only if
    they are exact."""
    if value >= 1.0 or value < 0.01:
        return "100 %" if value >= 1.0 else f"{100.0 * value:.2g} %"
    digits = 1 if value < 0.99 else 2 if value < 0.9999 else 3
    return f"{min(100.0 * value, 99.999):.{digits}f} %"


def relative_difference(value: float, reference: float) -> str:
    """Returns how far a value is from its reference, in percent: +75 %, -0.0031 %; "" without a reference."""
    if not reference or not math.isfinite(value / reference):
        return ""
    off = 100.0 * (value / reference - 1.0)
    if abs(off) < 1e-4:
        return "< 0.0001 %"
    return f"{off:+.{max(1 - math.floor(math.log10(abs(off))), 0)}f} %"


def angle(degrees: float) -> str:
    """Returns an angle in degrees."""
    return f"{number(round(degrees, 6), 4)}°"


def plural(count: int, noun: str, nouns: str = "") -> str:
    """Returns a count with its noun: 1 function, 2 functions."""
    return f"{count} {noun if count == 1 else nouns or noun + 's'}"


def duration(seconds: float) -> str:
    """Returns a duration in ms, or in s from a second on."""
    return f"{seconds:.4g} s" if seconds >= 1.0 else f"{seconds * 1e3:.4g} ms"


def short_duration(seconds: float | None) -> str:
    """Returns a duration in s, ms, µs or ns: 82 µs; a dash for None."""
    if not seconds:
        return "–" if seconds is None else "0"
    size, unit = time_unit(seconds)
    return f"{seconds / size:.3g} {unit}"


def time_unit(seconds: float) -> tuple[float, str]:
    """Returns (size in s, name) of the largest unit in which a duration, rounded to three digits, is at least 1."""
    nearest = float(f"{seconds:.3g}")
    return next(((size, unit) for size, unit in _TIME_UNITS if nearest >= size * (1.0 - 1e-12)), _TIME_UNITS[-1])


def frequency(hertz: float) -> str:
    """Returns a rate in Hz, or in kHz from a thousand on: 4 kHz."""
    return f"{hertz / 1e3:.4g} kHz" if hertz >= 1e3 else f"{hertz:.4g} Hz"


def short(value: float) -> str:
    """Returns a number for a picture: four digits, and every digit before the point below a million."""
    digits = 4 if abs(value) < 1e4 else 5 if abs(value) < 1e5 else 6 if abs(value) < 1e6 else 4
    words = f"{value:.{digits}g}"
    return words.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-").replace("-", "−")


def in_ascii(text: str) -> str:
    """Returns the same text for a terminal without µ and dashes."""
    return text.replace("µ", "u").replace("–", "-")


def listed(items: Iterable[int | str]) -> str:
    """Returns numbers or names as "0", "0 and 1", "0, 1 and 2"."""
    *others, last = map(str, items)
    return f"{', '.join(others)} and {last}" if others else last
