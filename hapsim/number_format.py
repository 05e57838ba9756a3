"""Numbers in sentences and tables: rounded to the side that keeps a statement true, or to their uncertainty."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal


def rounded_down(value: float, digits: int = 4) -> str:
    """To so many digits, never above it."""
    return _rounded(value, digits, ROUND_FLOOR)


def rounded_up(value: float, digits: int = 4) -> str:
    """To so many digits, never below it."""
    return _rounded(value, digits, ROUND_CEILING)


def between(least: float, most: float, to: str = " to ") -> str:
    """A range, its ends rounded inward: with four digits, or as many as it takes for the lower one to stay below."""
    for digits in range(4, 17):
        low, high = rounded_up(least, digits), rounded_down(most, digits)
        if float(low) <= float(high):
            return f"{low}{to}{high}"
    return f"{least!r}{to}{most!r}"


def duration(seconds: float) -> str:
    """In ms, or in s from a second on."""
    return f"{seconds:.4g} s" if seconds >= 1.0 else f"{seconds * 1e3:.4g} ms"


def rounded(value: float, uncertainty: float) -> str:
    """A value to the second digit of its uncertainty."""
    if not (math.isfinite(value) and math.isfinite(uncertainty) and uncertainty > 0.0):
        return f"{value:g}"
    decimals = min(max(1 - math.floor(math.log10(uncertainty)), 0), 15)
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0: no minus before a zero


def _rounded(value: float, digits: int, direction: str) -> str:
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    exact = Decimal(value)
    return f"{float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - digits + 1), direction)):.{digits}g}"


def number(value: float, digits: int = 6) -> str:
    """A value to so many digits; a dash for none."""
    return f"{value + 0.0:.{digits}g}" if math.isfinite(value) else "–"  # + 0.0: no minus before a zero


def percent(share: float, digits: int = 2) -> str:
    """A share or a relative difference in percent: 0.0312 is 3.1 %."""
    return f"{100.0 * share:.{digits}g} %"


def relative_difference(value: float, reference: float) -> str:
    """How far a value is from its reference, in percent: +75 %, -0.0031 %; "" without a reference."""
    if not reference or not math.isfinite(value / reference):
        return ""
    off = 100.0 * (value / reference - 1.0)
    if abs(off) < 1e-4:
        return "< 0.0001 %"
    return f"{off:+.{max(1 - math.floor(math.log10(abs(off))), 0)}f} %"


def plural(count: int, noun: str, nouns: str = "") -> str:
    """A count with its noun: 1 function, 2 functions."""
    return f"{count} {noun if count == 1 else nouns or noun + 's'}"


def short(value: float) -> str:
    """Returns a number for a picture: four digits, and every digit before the point below a million."""
    digits = 4 if abs(value) < 1e4 else 5 if abs(value) < 1e5 else 6 if abs(value) < 1e6 else 4
    words = f"{value:.{digits}g}"
    return words.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-").replace("-", "−")


_TIME_UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def short_duration(seconds: float | None, digits: int = 3) -> str:
    """A duration in s, ms, µs or ns: 82 µs; a dash for none."""
    if seconds is None:
        return "–"
    if seconds == 0.0:
        return "0"
    size, unit = time_unit(seconds, digits)
    return f"{seconds / size:.{digits}g} {unit}"


def time_unit(seconds: float, digits: int = 3) -> tuple[float, str]:
    """(size in s, name) of the largest unit in which a duration is at least 1, rounded to so many digits."""
    nearest = float(f"{seconds:.{digits}g}")
    return next(((size, unit) for size, unit in _TIME_UNITS if nearest >= size * (1.0 - 1e-12)), _TIME_UNITS[-1])


def in_ascii(text: str) -> str:
    """The same text for a terminal without µ and dashes."""
    return text.replace("µ", "u").replace("–", "-")


def frequency(hertz: float) -> str:
    """A rate in Hz, or in kHz from a thousand on: 4 kHz."""
    return f"{hertz / 1e3:.4g} kHz" if hertz >= 1e3 else f"{hertz:.4g} Hz"


def share_in_percent(value: float) -> str:
    """A share (0 to 1) in percent, with the digits that matter close to 0 % and to 100 %. It is 100 % only where
    nothing is missing, and 0 % only where there is nothing."""
    in_percent = 100.0 * value
    if in_percent < 1.0:
        return f"{in_percent:.2g} %"
    if in_percent < 99.0:
        return f"{in_percent:.1f} %"
    return "100 %" if value >= 1.0 else f"{min(in_percent, 99.999):.{2 if in_percent < 99.99 else 3}f} %"
