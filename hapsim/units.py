"""The units of a motion, and quantities written in them.

A rotary channel has the same mathematics as a linear one: rad in place of m, N·m in place of N, kg·m² in place of kg.
So code names a unit by that of a line ("N/m"), and a scene's `Units` write it as that of its channels: in rad, or in
degrees where the scene's file has any angle in degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from hapsim.number_format import number

Motion = Literal["linear", "rotary"]
MOTIONS: tuple[Motion, ...] = get_args(Motion)

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
    "kg": "kg·m²",
    "N": "N·m",
    "mN": "mN·m",
    "µN": "µN·m",
    "newton": "N·m",
    "metres": "radians",
}
_DEGREES = {"m": "°", "mm": "°", "µm": "°", "nm": "°", "m/s": "°/s", "mm/s": "°/s", "m/s²": "°/s²"}
_SMALLER = {"mm": 1e3, "µm": 1e6, "nm": 1e9, "mm/s": 1e3, "mN": 1e3, "µN": 1e6}
_MARKED = re.compile("‹(one )?([^›]+)›")

# What has a unit, and how a file may write it.
_EXAMPLES = {
    "m": ("a length", "0.05 m or 50 mm"),
    "rad": ("an angle", "0.5 rad or 30 deg"),
    "m/s": ("a velocity", "0.1 m/s or 100 mm/s"),
    "rad/s": ("an angular velocity", "2 rad/s or 90 deg/s"),
    "N": ("a force", "2 N or 500 mN"),
    "N·m": ("a torque", "0.05 N·m or 50 mN·m"),
    "N/m": ("a stiffness", "2000 N/m or 2 N/mm"),
    "N·m/rad": ("a stiffness", "0.3 N·m/rad or 5 mN·m/deg"),
    "N·s/m": ("a damping", "5 N·s/m or 0.005 N·s/mm"),
    "N·m·s/rad": ("a damping", "0.002 N·m·s/rad or 2 mN·m·s/rad"),
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
}


@dataclass(frozen=True)
class Units:
    """The units of one or several motions. Where some channels turn and others do not, a unit is both: "5 N or N·m"."""

    motions: frozenset[Motion]
    """None: as of a line."""
    in_degrees: bool = False
    """True if angles are in degrees; all channels are rotary then. Stiffness and damping stay per rad."""

    @classmethod
    def of(cls, motions: Iterable[Motion], in_degrees: bool = False) -> Units:
        """Returns the units of channels of these motions. `in_degrees`: whether the scene writes angles in degrees."""
        each = frozenset(motions)
        return cls(each, in_degrees and each == {"rotary"})

    @classmethod
    def parse(cls, motion: object) -> Units:
        """Returns the units of the motions that a document names: a word, or a list with one per channel."""
        return cls.of(one for one in MOTIONS if one in str(motion))

    @property
    def si(self) -> Units:
        """The same with angles in rad: for files, for programs, and for what a scene's file may hold."""
        return Units(self.motions)

    @property
    def is_rotary(self) -> bool:
        """True if a channel is rotary."""
        return "rotary" in self.motions

    def __call__(self, value: Any, unit: str, form: str | int = 6) -> str:
        """Returns a quantity with its unit.

        Args:
            value: in SI units, such as m where `unit` is mm; or the text of numbers in `name(unit)`.
            unit: that of a line, such as N/m.
            form: the number's format, such as ".3g", or how many digits `number` has.
        """
        name = self.name(unit)
        return f"{self.number(value, unit, form)}{'' if name.startswith('°') else ' '}{name}"

    def number(self, value: Any, unit: str, form: str | int = 6) -> str:
        """Returns the same without the unit."""
        if isinstance(value, str):
            return value
        shown = self.scaled(value, unit)
        return number(shown, form) if isinstance(form, int) else f"{shown:{form}}"

    def name(self, unit: str) -> str:
        """Returns the name that replaces this linear unit: N·m/rad for N/m. Words may follow it: "m per count"."""
        of_a_line, *words = unit.split(" ", 1)
        turning = (self.in_degrees and _DEGREES.get(of_a_line)) or _ROTARY.get(of_a_line, of_a_line)
        if not self.is_rotary or turning == of_a_line:
            return unit
        return " ".join([f"{of_a_line} or {turning}" if "linear" in self.motions else turning, *words])

    def scaled(self, value: Any, unit: str) -> Any:
        """Returns a number or an array in SI units as it is in `name(unit)`."""
        if self.in_degrees and unit in _DEGREES:
            return value * (180.0 / math.pi)
        return value * _SMALLER[unit] if unit in _SMALLER else value

    def filled(self, text: str) -> str:
        """Returns a text of ours with these units where it has ‹N/m›, and examples where it has ‹one N/m›."""
        return _MARKED.sub(lambda found: self._example(found[2]) if found[1] else self.name(found[2]), text)

    def _example(self, unit: str) -> str:
        """Returns what has this unit, with examples: "a mass (kg), such as 0.2 kg or 200 g"."""
        motions = [motion for motion in MOTIONS if motion in (self.motions or LINEAR.motions)]
        names = dict.fromkeys(Units.of([motion]).name(unit) for motion in motions)
        each = ((name, *_EXAMPLES[name]) for name in names)
        return ", or ".join(f"{thing} ({name}), such as {examples}" for name, thing, examples in each)


LINEAR = Units.of(["linear"])
