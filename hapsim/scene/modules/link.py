"""What every link is: an element between two points."""

from collections.abc import Iterator
from typing import Annotated, ClassVar

from ..issue import Issue, did_you_mean, quote
from ..quantity import Words
from .module import Check, Module, ModuleContext
from .structure import Structure

ENDS = Words(
    "The two modules that it joins, by name",
    (),
    2,
    entry="the name of a module",
    several="the names of two modules, such as [hand, wall]",
)


class Link(Module):
    """An element between two points, which are named and may stand anywhere in the file."""

    is_point: ClassVar[bool] = False
    can_move: ClassVar[bool] = False
    between: Annotated[tuple[str, str], ENDS]

    def checks(self) -> list[Check]:
        return [Check(("between",), self._ends_fit)]

    def _ends_fit(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        path = ("modules", name, "between")
        wrong_ends = [
            Issue((*path, index), sentence)
            for index, end in enumerate(self.between)
            if (sentence := _wrong_end(name, end, around))
        ]
        yield from wrong_ends
        if wrong_ends:
            return
        first, second = self.between
        if first == second:
            yield Issue(path, f"found {quote(first)} at both ends, expected two different points")
        elif all(_stays(end, around) for end in self.between):
            yield Issue(
                path,
                f"found {quote(first)} and {quote(second)}, of which neither can move; expected one end that can",
            )


def _stays(end: str, around: ModuleContext) -> bool:
    """Whether no force moves what is at this end."""
    kind = around.kinds.get(end)
    return kind is not None and not kind.can_move


def _wrong_end(name: str, end: str, around: ModuleContext) -> str | None:
    if end == name:
        return f"found {quote(end)}, the link itself; expected a point to hold"
    holder = around.holder(end)
    if holder not in around.kinds:
        points = [other for other, kind in around.kinds.items() if kind is None or kind.is_point]
        hint = did_you_mean(end, points)
        return f"found {quote(end)}, expected the name of a module of this scene{hint}"
    kind = around.kinds[holder]
    if kind is not None and (holder != end or issubclass(kind, Structure)):
        return _wrong_place(end, holder, kind, around)
    if kind is not None and not kind.is_point:
        return f"found {quote(end)}, which is a link; expected a point: a link joins points, not links"
    return None


def _wrong_place(end: str, holder: str, kind: type[Module], around: ModuleContext) -> str | None:
    """What is wrong with an end that names a structure, or a place in a module."""
    if not issubclass(kind, Structure):
        what = kind.model_fields["type"].default
        return f"found {quote(end)}, but {quote(holder)} is a single {what}; leave out the dot and what follows"
    structure = around.modules[holder]
    assert isinstance(structure, Structure)
    numbers = structure.numbers({field for field in kind.counts if around.knows(holder, field)})
    if holder != end and numbers.are(end[len(holder) + 1 :]):
        return None
    expected = f"expected one of its masses, {structure.place_words(numbers)}, such as {holder}.{numbers.first}"
    return f"found {quote(end)}, but {quote(holder)} is a {structure.type}; {expected}"
