"""What every link is: an element between two points."""

from collections.abc import Iterator
from typing import Annotated, ClassVar

from hapsim.laws import Law

from ..issue import Issue, did_you_mean, quote
from ..quantity import names
from .module import Module, ModuleContext, check_of
from .structure import Structure

ENDS = names(
    "The two modules that it joins, by name",
    "the names of two modules, such as [hand, wall]",
    entry="the name of a module",
    count=2,
)


class Link(Module):
    """An element between two points, which are named and may stand anywhere in the file."""

    is_point: ClassVar[bool] = False
    can_move: ClassVar[bool] = False
    #: Its law, whatever its values are, is its `table`.
    has_table: ClassVar[bool] = False
    between: Annotated[tuple[str, str], ENDS]

    def law(self) -> Law:
        """Returns what it does over the distance of its ends, as the theory takes it."""
        raise NotImplementedError

    def table(self) -> Law | None:
        """Returns the law by whose knots the kernel works out its force; None where it has a recurrence of its own."""
        return self.law() if self.has_table else None

    @check_of("between")
    def _ends_fit(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        wrong_ends = {index: wrong_end(name, end, around) for index, end in enumerate(self.between)}
        yield from (Issue(("between", index), sentence) for index, sentence in wrong_ends.items() if sentence)
        if any(wrong_ends.values()):
            return
        first, second = self.between
        kinds = [around.kinds.get(end) for end in self.between]
        if first == second:
            yield Issue(("between",), f"found {quote(first)} at both ends, expected two different points")
        elif all(kind is not None and not kind.can_move for kind in kinds):
            ends = f"{quote(first)} and {quote(second)}"
            yield Issue(("between",), f"found {ends}, of which neither can move; expected one end that can")


def wrong_end(name: str, end: str, around: ModuleContext) -> str | None:
    """What is wrong with the point that `name`, a link or a pick-up, holds by this end; in words."""
    if end == name:
        return f"found {quote(end)}, the link itself; expected a point to hold"
    holder = around.holder(end)
    if holder not in around.kinds:
        points = [other for other, kind in around.kinds.items() if kind is None or kind.is_point]
        hint = did_you_mean(end, points)
        return f"found {quote(end)}, expected the name of a module of this scene{hint}"
    kind = around.kinds[holder]
    if kind is None:
        return None
    if issubclass(kind, Structure):
        return _wrong_place(end, holder, around) if around.knows(holder, *kind.counts) else None
    if holder != end:
        what = kind.model_fields["type"].default
        return f"found {quote(end)}, but {quote(holder)} is a single {what}; leave out the dot and what follows"
    if not kind.is_point:
        return f"found {quote(end)}, which is a link; expected a point"
    return None


def _wrong_place(end: str, holder: str, around: ModuleContext) -> str | None:
    structure = around.modules[holder]
    assert isinstance(structure, Structure)
    if holder != end and structure.has_place(end[len(holder) + 1 :]):
        return None
    expected = f"expected one of its masses, {structure.place_words()}, such as {holder}{'.0' * len(structure.counts)}"
    return f"found {quote(end)}, but {quote(holder)} is a {structure.type}; {expected}"
