"""The linearisation of a link."""

from __future__ import annotations

from typing import NamedTuple


class Linear(NamedTuple):
    """What stands for a link in the linear theory.

    Attributes:
        stiffness: N/m. damping: N·s/m.
        assumption: under which that is so, in words that follow the link's name; "" where it is so always.
    """

    stiffness: float
    damping: float
    assumption: str = ""
