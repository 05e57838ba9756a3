"""The units of a motion, and quantities written in them.

A rotary channel has the same mathematics as a linear one: rad in place of m, N·m in place of N, kg·m² in place of kg.
So code names a unit by that of a line ("N/m"), and a scene's `Units` write it as that of its channels (N·m/rad), or as
the scene's file does (N·m/deg).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

from hapsim.number_format import between, number, rounded

Motion = Literal["linear", "rotary"]
MOTIONS: tuple[Motion, ...] = get_args(Motion)
Form = str | int | Callable[[float], str]

_ROTARY = {
    "N·s/m": "N·m·s/rad",
    "N/m": "N·m/rad",
    "N/s": "N·m/s",
    "m/s²": "rad/s²",
    "m/s": "rad/s",
    "mm/s": "mrad/s",
    "m": "rad",
    "mm": "mrad",
    "µm": "µrad",
    "nm": "nrad",
    "m/rad": "rad/m",
    "kg": "kg·m²",
    "N": "N·m",
    "mN": "mN·m",
    "µN": "µN·m",
    "newton": "N·m",
    "metres": "radians",
}
#: The linear units in which reports are; a rotary motion replaces all but that of an energy.
OF_MOTION = frozenset([*_ROTARY, "J"])
_SMALLER = {
    "mm": ("m", 1e3),
    "µm": ("m", 1e6),
    "nm": ("m", 1e9),
    "mm/s": ("m/s", 1e3),
    "mN": ("N", 1e3),
    "µN": ("N", 1e6),
    "mJ": ("J", 1e3),
}
_OF_NO_MOTION = ("", "1", "°", "1/(SI", "J", "Hz", "s", "bit/s", "sample", "samples", "counts")
_KNOWN = frozenset([*_ROTARY, *_ROTARY.values(), *_SMALLER, *_OF_NO_MOTION])
_LARGE = 1e6  # from here on numbers have an exponent
_MARKED = re.compile("‹(?:(one) |((?:-?(?:[0-9][-+.e0-9]*|inf|nan) (?:and )?)+))?([^›]+)›")

# What has a unit, and how a file may write it.
_EXAMPLES = {
    "m": ("a length", "0.05 m or 50 mm"),
    "rad": ("an angle", "0.5 rad or 30 deg"),
    "m/s": ("a velocity", "0.1 m/s or 100 mm/s"),
    "rad/s": ("an angular velocity", "2 rad/s or 90 deg/s"),
    "m/s²": ("an acceleration", "0.05 m/s² or 50 mm/s²"),
    "rad/s²": ("an angular acceleration", "2 rad/s² or 90 deg/s²"),
    "N": ("a force", "2 N or 500 mN"),
    "N·m": ("a torque", "0.05 N·m or 50 mN·m"),
    "N/m": ("a stiffness", "2000 N/m or 2 N/mm"),
    "N·m/rad": ("a stiffness", "0.3 N·m/rad or 5 mN·m/deg"),
    "N·s/m": ("a damping", "5 N·s/m or 0.005 N·s/mm"),
    "N·m·s/rad": ("a damping", "0.002 N·m·s/rad or 2 mN·m·s/rad"),
    "m/rad": ("a length per angle", "0.03 m/rad or 2 mm/deg"),
    "rad/m": ("an angle per length", "30 rad/m or 2 deg/mm"),
    "kg": ("a mass", "0.2 kg or 200 g"),
    "kg·m²": ("a moment of inertia", "2e-5 kg·m² or 200 g·cm²"),
    "N/s": ("a rate of force", "1000 N/s or 1 N/ms"),
    "N·m/s": ("a rate of torque", "10 N·m/s or 10 mN·m/ms"),
    "Hz": ("a frequency", "1000 Hz or 1 kHz"),
    "s": ("a time", "0.005 s or 5 ms"),
    "J": ("an energy", "0.2 J or 200 mJ"),
    "bit/s": ("a bit rate", "2000000 bit/s or 2 Mbit/s"),
    "samples": ("a number of samples", "100 samples"),
    "counts": ("a number of counts", "100 counts"),
    "sample periods": ("a number of samples", "1 sample or 1.5 samples"),
    "m per count": ("a length", "1 µm per count"),
    "rad per count": ("an angle", "0.1 deg per count"),
    "N per count": ("a force", "1 mN per count"),
    "N·m per count": ("a torque", "1 mN·m per count"),
    "m rms": ("a length", "2 µm rms"),
    "rad rms": ("an angle", "0.1 deg rms"),
    "N rms": ("a force", "10 mN rms"),
    "N·m rms": ("a torque", "1 mN·m rms"),
}


class Written(NamedTuple):
    """A unit in which a scene's file writes a quantity."""

    si: str
    """The SI unit of the same quantity, such as N·m/rad."""
    name: str
    """As the file has it, such as N·m/deg."""
    per_si: float
    """Number of them in one SI unit."""


def complete(written: Iterable[Written]) -> tuple[Written, ...]:
    """Returns the units of a file, the first of each quantity; with that of a velocity and of an acceleration where the
    file has only one of a length, and of a stiffness and a damping, which stand together, both where it has one."""
    found: dict[str, Written] = {}
    for one in written:
        of_torque = one.name.replace("J", "N·m") if one.si.startswith("N·m") else one.name  # 0.5 mJ is 0.5 mN·m
        found.setdefault(one.si, one._replace(name=of_torque))
    for k, b in (("N/m", "N·s/m"), ("N·m/rad", "N·m·s/rad")):
        for has, lacks, old, new in ((k, b, "/", "·s/"), (b, k, "·s/", "/")):
            if has in found and found[has].name.count(old) == 1:
                found.setdefault(lacks, Written(lacks, found[has].name.replace(old, new), found[has].per_si))
    for length in [found[si] for si in ("m", "rad") if si in found]:
        for per in ("/s", "/s²"):
            found.setdefault(length.si + per, Written(length.si + per, length.name + per, length.per_si))
    return tuple(found.values())


@dataclass(frozen=True)
class Units:
    """The units of one or several motions. Where some channels turn and others do not, a unit is both: "5 N or N·m"."""

    motions: frozenset[Motion]
    """None: as of a line."""
    written: tuple[Written, ...] = ()
    """Units of the scene's file in place of SI units; none where channels differ."""

    @classmethod
    def of(cls, motions: Iterable[Motion], written: Iterable[Written] = ()) -> Units:
        """Returns the units of channels of these motions. `written`: the units of the scene's file."""
        each = frozenset(motions)
        return cls(each, tuple(written) if len(each) == 1 else ())

    @classmethod
    def parse(cls, motion: object) -> Units:
        """Returns the units of the motions that a document names: a word, or a list with one per channel."""
        return cls.of(one for one in MOTIONS if one in str(motion))

    @property
    def si(self) -> Units:
        """The same in SI units: for files, for programs, and for what a scene's file may hold."""
        return Units(self.motions)

    @property
    def is_rotary(self) -> bool:
        """True if a channel is rotary."""
        return "rotary" in self.motions

    def __call__(self, value: Any, unit: str, form: Form = 6) -> str:
        """Returns a quantity with its unit.

        Args:
            value: in SI units, such as m where `unit` is mm; or the text of numbers in `name(unit)`.
            unit: that of a line, such as N/m.
            form: the number's format, such as ".3g", how many digits it has, or a function that writes it.
        """
        name = self.name(unit)
        return f"{self.number(value, unit, form)}{'' if name.startswith('°') else ' '}{name}"

    def number(self, value: Any, unit: str, form: Form = 6) -> str:
        """Returns the same without the unit."""
        if isinstance(value, str):
            return value
        shown = self.scaled(value, unit)
        text = form(shown) if callable(form) else number(shown, form) if isinstance(form, int) else f"{shown:{form}}"
        if "e+0" not in text or abs(float(text)) >= _LARGE:
            return text
        return f"{float(text):{'+' if text[0] == '+' else ''}.0f}"  # 4000 mN, not 4e+03 mN

    def rounded(self, value: float, uncertainty: float, unit: str) -> str:
        """Returns a number without its unit, to the second digit of its uncertainty."""
        return rounded(self.scaled(value, unit), self.scaled(uncertainty, unit))

    def spring(self, letters: str, k: float, b: float, form: Form = 6) -> str:
        """Returns a stiffness and a damping with these letters: K = 1000 N/m, B = 5 N·s/m."""
        return f"{letters[0]} = {self(k, 'N/m', form)}, {letters[1]} = {self(b, 'N·s/m', form)}"

    def between(self, least: float, most: float, unit: str, to: str = " to ") -> str:
        """Returns a range with its unit, its ends rounded inward."""
        return self(between(self.scaled(least, unit), self.scaled(most, unit), to), unit)

    def name(self, unit: str) -> str:
        """Returns the name that replaces this linear unit: N·m/rad for N/m. Words may follow it: "m per count". Raises
        ValueError for a unit that is not of hapsim's, such as N/mm: nothing would be scaled to it."""
        of_a_line, *words = unit.split(" ", 1)
        if of_a_line not in _KNOWN:
            raise ValueError(f"{unit!r} is no unit of a quantity here, expected one such as N/m")
        if not words and (written := self._written(unit)):
            return written.name
        turning = _ROTARY.get(of_a_line, of_a_line)
        if not self.is_rotary or turning == of_a_line:
            return unit
        return " ".join([f"{of_a_line} or {turning}" if "linear" in self.motions else turning, *words])

    def scaled(self, value: Any, unit: str) -> Any:
        """Returns a number or an array in SI units as it is in `name(unit)`. Raises ValueError as that."""
        _ = self.name(unit)
        written = self._written(unit)
        factor = written.per_si if written else _SMALLER.get(unit, (unit, 1.0))[1]
        return value if factor == 1.0 else value * factor

    def _written(self, unit: str) -> Written | None:
        """Returns the file's unit in place of a linear one. µm stay: errors of sensors are in them."""
        si, factor = _SMALLER.get(unit, (unit, 1.0))
        if self.is_rotary:
            si = _ROTARY.get(si, si)
        elif factor > 1e3:
            return None
        return next((one for one in self.written if one.si == si), None)

    def filled(self, text: str) -> str:
        """Returns a text of ours with SI units where it has ‹N/m›, examples where it has ‹one N/m›, and a number in
        these units where it has one in SI units, ‹0.5 N/m›, or two, ‹0 and 0.5 N/m›."""

        def fill(found: re.Match[str]) -> str:
            """Returns the words for one mark."""
            if found[1]:
                return self._example(found[3])
            numbers = (
                [self.number(float(one), found[3], 12) for one in found[2].split() if one != "and"] if found[2] else []
            )
            return self(" and ".join(numbers), found[3]) if numbers else self.si.name(found[3])

        return _MARKED.sub(fill, text)

    def _example(self, unit: str) -> str:
        """Returns what has this unit, with examples: "a mass (kg), such as 0.2 kg or 200 g"."""
        motions = [motion for motion in MOTIONS if motion in (self.motions or LINEAR.motions)]
        names = dict.fromkeys(Units.of([motion]).name(unit) for motion in motions)
        each = ((name, *_EXAMPLES[name]) for name in names)
        return ", or ".join(f"{thing} ({name}), such as {examples}" for name, thing, examples in each)


LINEAR = Units.of(["linear"])
