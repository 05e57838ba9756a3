"""What a link is for small motions: a spring and a damper, the assumption under which, and what schemes ask of it."""

from __future__ import annotations

from typing import NamedTuple


class Linear(NamedTuple):
    """What stands for a link in the linear theory.

    Attributes:
        stiffness: N/m. damping: N·s/m.
        assumption: under which that is so, in words that follow the link's name; "" where it is so always.
        memoryless: its force is one of where its ends are and how fast they go, and of nothing before (but for what its
            damper remembers, if it has one of several).
        in_a_matrix: it is that spring and that damper and nothing else, so that a scheme can work it into a matrix.

    The last two are as its part of the kernel says (`PartType`), or else the theory is of another scene.
    """

    stiffness: float
    damping: float
    assumption: str = ""
    memoryless: bool = False
    in_a_matrix: bool = False


def viscoelastic(stiffness: float, damping: float) -> Linear:
    """A spring and a damper, N/m and N·s/m."""
    return Linear(stiffness, damping, memoryless=True, in_a_matrix=True)


def spring(stiffness: float) -> Linear:
    """A spring of so many N/m."""
    return viscoelastic(stiffness, 0.0)


def damper(damping: float) -> Linear:
    """A damper of so many N·s/m."""
    return viscoelastic(0.0, damping)


def buffer(stiffness: float, damping: float) -> Linear:
    """The contact while it is touched. N/m, N·s/m.

    It is two linear systems, the one in touch and the one apart, and the change between them. In touch it is a spring
    and a damper; apart it is nothing. That both are stable does not make the whole stable, nor does a limit cycle need
    either to be unstable; what bounds it is passivity in touch (Colgate and Schenkel), under which no change between
    the two can add energy beyond what one sample of approach does.
    """
    return Linear(stiffness, damping, "is taken as touched all the time; apart, nothing is felt of it", memoryless=True)


def plectrum(stiffness: float, damping: float) -> Linear:
    """The link while it grips. N/m, N·s/m.

    It is two linear systems, the one that grips and the one released, and the change between them. Gripping it is a
    spring and a damper; released it is nothing. The release loses what the spring held, K release²/2. It grips again
    where its ends have passed each other by no more than they move in a sample, v T, which adds K (v T)²/2 at the most:
    the only energy that the change itself brings in.
    """
    return Linear(stiffness, damping, "is taken as gripping all the time; released, nothing is felt of it")
