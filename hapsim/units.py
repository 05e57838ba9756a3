"""The units of a motion, and quantities written in them.

A rotary channel has the same mathematics as a linear one: rad in place of m, N·m in place of N, kg·m² in place of kg.
So code names a unit by that of a line ("N/m"), and a scene's `Units` write it as that of its channels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, get_args

from hapsim.errors import HapsimError
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
    "mm": "mrad",
    "nm": "nrad",
    "µm": "µrad",
    "kg": "kg·m²",
    "newton": "N·m",
    "metres": "radians",
    "m": "rad",
    "N": "N·m",
    "mN": "mN·m",
    "µN": "µN·m",
}
_DEGREES = {"m": "°", "mm": "°", "µm": "°", "nm": "°", "m/s": "°/s", "mm/s": "°/s", "m/s²": "°/s²"}
_SMALLER = {"mm": 1e3, "µm": 1e6, "nm": 1e9, "mm/s": 1e3, "mN": 1e3, "µN": 1e6}
_MARKED = re.compile("‹([^›]+)›")
# A bare m or N is a unit only behind a number, in brackets, behind "in" or the two spaces of a heading.
_BARE = r"(?:(?<=[0-9)–] )|(?<=[(\[])|(?<=\bin )|(?<=\], )|(?<=, )(?=N\])|(?<=  ))[mN](?=$|[\s,;:.)\]])"
_UNIT = re.compile(
    rf"(?<![\w·/])(?:(?:N·s/m|N/[ms]|mm/s|m/s²?|[mµ]m|kg|newton|metres)(?![\w·/²])|[mN](?= per count\b)|{_BARE})"
    "(?! or (?:[mµ]?rad|N·m|kg·m²))",  # has both already
    re.MULTILINE,
)

_LIKE_A_UNIT = re.compile(r"(?<![\w·/])(?:N·s/m|N/[ms]|mm/s|m/s²?|[mµ]m|kg|newton|metres|[mN])(?![\w·/²])")


class InUnits(str):
    """A text that has its units."""

    __slots__ = ()


class Units:
    """The units of one or several motions. Where some channels turn and others do not: "5 N or N·m"."""

    def __init__(self, motions: Iterable[Motion], names: Iterable[str] = (), in_degrees: bool = False) -> None:
        """`in_degrees`: angles are written in degrees, where every channel turns."""
        self._motions = frozenset(motions)
        self.in_degrees = in_degrees and self._motions == {"rotary"}
        self._names = frozenset(one for one in names if _LIKE_A_UNIT.search(one))
        # Behind a number even m is a unit. A longer name is looked for first.
        every = "|".join(map(re.escape, sorted(self._names, key=len, reverse=True)))
        self._kept = re.compile(rf"(?<![\w./·-])(?<![0-9] )(?:{every})(?![\w·/-])") if every else None

    def keeping(self, names: Iterable[str]) -> Units:
        """The same, which leaves these names too as they are."""
        return Units(self._motions, self._names.union(names))

    @classmethod
    def said_by(cls, motion: object, in_degrees: bool = False) -> Units:
        """Returns the units of the motions that a scene or a document names: a word, or a list with one per channel."""
        return cls([one for one in MOTIONS if one in str(motion)] or ["linear"], in_degrees=in_degrees)

    @property
    def si(self) -> Units:
        """The same with angles in rad, for files and programs."""
        return Units(self._motions)

    @property
    def is_rotary(self) -> bool:
        """Whether something turns."""
        return "rotary" in self._motions

    def name(self, unit: str) -> str:
        """Returns the unit that stands for `unit` of a line: N·m/rad for N/m. Words may follow it: "m per count"."""
        of_a_line, *words = unit.split(" ", 1)
        turning = (self.in_degrees and _DEGREES.get(of_a_line)) or _ROTARY.get(of_a_line, of_a_line)
        if not self.is_rotary or turning == of_a_line:
            return unit
        return " ".join([f"{of_a_line} or {turning}" if "linear" in self._motions else turning, *words])

    def scaled(self, value: Any, unit: str) -> Any:
        """Returns a number or an array in SI units as it is in `name(unit)`."""
        if self.in_degrees and unit.partition(" ")[0] in _DEGREES:
            return value * (180.0 / math.pi)
        return value * _SMALLER[unit] if unit in _SMALLER else value

    def __call__(self, value: Any, unit: str | None = None, form: str | int = 6) -> str:
        """Returns a quantity with its unit.

        Args:
            value: in SI units, such as m where `unit` is mm; or the text of numbers in `name(unit)`.
            unit: that of a line, such as N/m.
            form: the number's format, such as ".3g", or how many digits `number` has.
        """
        if unit is None:
            return self._old(value)
        name = self.name(unit)
        return f"{self.number(value, unit, form)}{'' if name.startswith('°') else ' '}{name}"

    def number(self, value: Any, unit: str, form: str | int = 6) -> str:
        """Returns the same without the unit."""
        if isinstance(value, str):
            return value
        shown = self.scaled(value, unit)
        return number(shown, form) if isinstance(form, int) else f"{shown:{form}}"

    def filled(self, text: str) -> str:
        """Returns a text of ours, in which units stand as ‹N/m›, with these units."""
        return _MARKED.sub(lambda found: self.name(found[1]), text)

    def _old(self, text: str) -> str:
        if isinstance(text, InUnits):
            return text
        if not self.is_rotary:
            return InUnits(text)
        names = self._kept.finditer(text) if self._kept else ()
        kept = [at for name in names for at in range(*name.span())]
        return InUnits(_UNIT.sub(lambda found: self._translated(found, found.start() in kept), text))

    def _translated(self, found: re.Match[str], is_name: bool) -> str:
        if is_name:
            return found.group()
        rotary = _ROTARY[found.group()]
        return f"{found.group()} or {rotary}" if "linear" in self._motions else rotary

    @contextmanager
    def in_errors(self) -> Iterator[None]:
        """Translates the sentences of the errors that leave the block."""
        try:
            yield
        except HapsimError as error:
            error.args = tuple(self(one) if isinstance(one, str) else one for one in error.args)
            raise


LINEAR = Units(["linear"])
