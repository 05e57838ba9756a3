"""The objects that are compared. A new one is a file and a line here."""

from __future__ import annotations

from collections.abc import Iterable

from hapsim.errors import UsageError
from hapsim.speed_accuracy.compared import Object
from hapsim.speed_accuracy.contact import Contact
from hapsim.speed_accuracy.one_spring import OneSpring
from hapsim.speed_accuracy.ringing_string import RingingString
from hapsim.speed_accuracy.strings import StringOfMasses

SHARP = 0.2  # by which bending raises mode 5

OBJECTS: tuple[Object, ...] = (
    OneSpring(),
    Contact(),
    RingingString("string-10", "a string of 10 masses", StringOfMasses.tuned(10)),
    RingingString("string-100", "a string of 100 masses", StringOfMasses.tuned(100)),
    RingingString("string-1000", "a string of 1000 masses", StringOfMasses.tuned(1000)),
    RingingString("stiff-string-100", "a stiff string of 100 masses", StringOfMasses.tuned(100, sharp=SHARP)),
)


def objects_named(names: Iterable[str]) -> list[Object]:
    """Those of these names, in their own order; all of them where there is no name. UsageError for another name."""
    known = {one.name: one for one in OBJECTS}
    wanted = set(names)
    for name in sorted(wanted - known.keys()):
        raise UsageError(f"--object: found '{name}', expected one of {', '.join(known)}")
    return [one for one in OBJECTS if not wanted or one.name in wanted]
