"""Durations and rates as people say them: 82 µs, 4 kHz."""

from __future__ import annotations

_STEPS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def duration(seconds: float | None, digits: int = 3) -> str:
    """A duration with the unit that suits it; a dash where there is none."""
    if seconds is None:
        return "–"
    if seconds == 0.0:
        return "0"
    size, unit = unit_for(seconds, digits)
    return f"{seconds / size:.{digits}g} {unit}"


def unit_for(seconds: float, digits: int = 3) -> tuple[float, str]:
    """(size in s, name) of the largest unit in which a duration is at least 1, rounded to so many digits."""
    rounded = float(f"{seconds:.{digits}g}")
    return next(((size, unit) for size, unit in _STEPS if rounded >= size * (1.0 - 1e-12)), _STEPS[-1])


def in_ascii(text: str) -> str:
    """The same for a terminal that has nothing else."""
    return text.replace("µ", "u").replace("–", "-")


def rate(hertz: float) -> str:
    """A rate: in kHz from a thousand on."""
    return f"{hertz / 1e3:.4g} kHz" if hertz >= 1e3 else f"{hertz:.4g} Hz"


def share(value: float) -> str:
    """A share (0 to 1) in percent, with the digits that matter: those of the little that there is, or that is missing.
    100 only where nothing is missing, 0 only where there is nothing."""
    percent = 100.0 * value
    if percent < 1.0:
        return f"{percent:.2g} %"
    if percent < 99.0:
        return f"{percent:.1f} %"
    return "100 %" if value >= 1.0 else f"{min(percent, 99.999):.{2 if percent < 99.99 else 3}f} %"
