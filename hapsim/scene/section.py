"""Base classes of a scene: immutable models and tables, modules, and a module's view of the modules around it."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler
from pydantic_core import core_schema

from hapsim.errors import UsageError

from .issue import Issue, did_you_mean

T = TypeVar("T")
K = TypeVar("K")


class Section(BaseModel):
    """A section of the scene file: frozen, strict about types, and closed to unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Returns a copy with other values, which are not checked; `Scene.changed` checks them. Raises UsageError for
        a key that this section does not have."""
        known = type(self).model_fields
        for key in update or ():
            if key not in known:
                expected = f"expected one of {', '.join(known)}{did_you_mean(key, list(known))}"
                raise UsageError(f"found the key '{key}' of {type(self).__name__}, {expected}")
        tables = {key: Table(value) for key, value in (update or {}).items() if isinstance(value, dict)}
        return super().model_copy(update={**(update or {}), **tables}, deep=deep)


class Table(Mapping[str, T]):
    """A mapping that keeps its order, cannot be changed, and can be hashed when its values can."""

    __slots__ = ("_entries", "_of_kind")

    def __init__(self, entries: Mapping[str, T]) -> None:
        self._entries = dict(entries)
        self._of_kind: dict[type, dict[str, Any]] = {}  # found once: a scene may have thousands of modules

    def __getitem__(self, name: str) -> T:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def of_kind(self, kind: type[K]) -> dict[str, K]:
        """Returns the entries of this class, in their order."""
        if kind not in self._of_kind:
            self._of_kind[kind] = {name: one for name, one in self._entries.items() if isinstance(one, kind)}
        return dict(self._of_kind[kind])

    def __hash__(self) -> int:
        return hash(frozenset(self._entries.items()))

    def __repr__(self) -> str:
        return repr(self._entries)


#: A check of a module with those around it: yields issues, whose paths begin within the module.
Check = Callable[[Any, str, "ModuleContext"], Iterator[Issue]]


def check_of(*fields: str) -> Callable[[Check], Check]:
    """Marks a method of a module as a `Check` that looks at these fields: where one is faulty it is skipped."""

    def mark(method: Check) -> Check:
        method.fields = fields  # type: ignore[attr-defined]
        return method

    return mark


class Module(Section):
    """A module of the simulated scene. Each subclass adds ``type: Literal["its name"] = "its name"``."""

    #: The module is a point that a link can hold by one end.
    is_point: ClassVar[bool] = True
    #: The spaces of the scenes that can have it: 1, a line, and 2, the plane.
    spaces: ClassVar[tuple[int, ...]] = (1,)
    #: The module can move; a link between two that cannot would do nothing.
    can_move: ClassVar[bool] = True
    #: The fields that may change while the scene runs.
    live: ClassVar[tuple[str, ...]] = ()
    #: Those of them that a file may omit, each with the property that has its value, or its default.
    with_default: ClassVar[Mapping[str, str]] = {}
    #: Further ones that may change then; they are no numbers that could ramp one by one: the scene crossfades.
    crossfaded: ClassVar[tuple[str, ...]] = ()
    #: The fields that say how it begins, and nothing of how it goes on.
    initial: ClassVar[tuple[str, ...]] = ()

    type: str

    def issues(self, name: str, around: "ModuleContext") -> Iterator[Issue]:
        """Yields the faults that this module, called ``name``, has together with the others."""
        for kind in reversed(type(self).__mro__):
            for check in tuple(vars(kind).values()):  # a model is built when it is first used
                if hasattr(check, "fields") and around.knows(name, *check.fields):
                    for issue in check(self, name, around):
                        yield replace(issue, path=("modules", name, *issue.path))

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        # In Python a class names its type by itself; in the file `type` has to be there.
        described = handler.resolve_ref_schema(handler(schema))
        described["required"] = ["type", *described.get("required", [])]
        described["properties"]["type"].pop("default", None)
        return described


@dataclass(frozen=True)
class ModuleContext:
    """The modules of a scene, of which some may be faulty.

    Attributes:
        modules: by name; a faulty one has its sound fields only, one of unknown type is missing.
        kinds: the class of every module by name; None where the type is unknown.
        faulty: the faulty fields of each faulty module.
        away: the device points that other devices bring, in the scene at a port.
    """

    modules: Mapping[str, Module]
    kinds: Mapping[str, type[Module] | None]
    faulty: Mapping[str, frozenset[str]] = field(default_factory=dict)
    away: frozenset[str] = frozenset()

    @classmethod
    def of(cls, modules: Mapping[str, Module], away: Iterable[str] = ()) -> "ModuleContext":
        """Returns the context of sound modules."""
        return cls(modules, {name: type(module) for name, module in modules.items()}, {}, frozenset(away))

    def knows(self, name: str, *fields: str) -> bool:
        """Returns whether these fields of a module are sound."""
        return name in self.modules and self.faulty.get(name, frozenset()).isdisjoint(fields)

    def of_type(self, kind: type[K], *fields: str) -> dict[str, K]:
        """Returns the modules of this class of which these fields are sound, by name."""
        known = {name: one for name, one in self.modules.items() if self.knows(name, *fields)}
        return {name: one for name, one in known.items() if isinstance(one, kind)}

    def holder(self, end: str) -> str:
        """Returns the module that the end of a link names: itself, or the structure of which it names a point."""
        name, dot, _ = end.partition(".")
        return name if dot else end
