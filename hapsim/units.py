"""The units of a motion. What hapsim says is written in those of a line (m, N, kg); here it becomes that of a rotation.

A rotary channel has the same mathematics: rad in place of m, N·m in place of N, kg·m² in place of kg. So every
sentence, heading and label is written once, and the scene's `Units` translate it where it reaches a user.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal, get_args

from hapsim.errors import HapsimError

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
    "µm": "µrad",
    "kg": "kg·m²",
    "newton": "N·m",
    "metres": "radians",
    "m": "rad",
    "N": "N·m",
}
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
    """The units of one or several motions.

    Called with a text in the units of a line, it returns the text in its own; where some channels turn and others do
    not, each unit in both: "5 N or N·m".
    """

    def __init__(self, motions: Iterable[Motion], names: Iterable[str] = ()) -> None:
        """`names`: of modules and files, which stay as the user wrote them though they look like units."""
        self._motions = frozenset(motions)
        self._names = frozenset(one for one in names if _LIKE_A_UNIT.search(one))
        # Behind a number even m is a unit. A longer name is looked for first.
        every = "|".join(map(re.escape, sorted(self._names, key=len, reverse=True)))
        self._kept = re.compile(rf"(?<![\w./·-])(?<![0-9] )(?:{every})(?![\w·/-])") if every else None

    def keeping(self, names: Iterable[str]) -> Units:
        """The same, which leaves these names too as they are."""
        return Units(self._motions, self._names.union(names))

    @property
    def is_rotary(self) -> bool:
        """Whether something turns."""
        return "rotary" in self._motions

    def __call__(self, text: str) -> str:
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
