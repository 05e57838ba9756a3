"""What every module of a scene is, and what it may ask of the modules around it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from pydantic import GetJsonSchemaHandler
from pydantic_core import core_schema

from ..issue import Issue
from ..part import Part


class Check(NamedTuple):
    """A check of a module with those around it.

    Attributes:
        fields: those of its own that it looks at; where one of them is faulty the check is left out.
        issues: what it finds, of the module's name and what is around.
    """

    fields: tuple[str, ...]
    issues: Callable[[str, "ModuleContext"], Iterator[Issue]]


class Module(Part):
    """A module of the simulated scene. Each subclass adds ``type: Literal["its name"] = "its name"``."""

    #: The module is a point that a link can hold by one end.
    is_point: ClassVar[bool] = True
    #: The module can move; a link between two that cannot would do nothing.
    can_move: ClassVar[bool] = True
    #: The fields that may change while the scene runs.
    live: ClassVar[tuple[str, ...]] = ()
    #: The fields that say how it begins, and nothing of how it goes on.
    initial: ClassVar[tuple[str, ...]] = ()

    type: str

    def checks(self) -> list[Check]:
        """What is to be looked at together with the others."""
        return []

    def issues(self, name: str, around: "ModuleContext") -> Iterator[Issue]:
        """Faults that this module, called ``name``, has together with the others, as far as they can be judged."""
        for check in self.checks():
            if around.knows(name, *check.fields):
                yield from check.issues(name, around)

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
        modules: by name; of a faulty one its sound fields, and the others are not there.
        kinds: the class of every module by name; None where not even the type is known, and then it is no module.
        faulty: of each faulty module the fields that are not sound.
    """

    modules: Mapping[str, Module]
    kinds: Mapping[str, type[Module] | None]
    faulty: Mapping[str, frozenset[str]] = field(default_factory=dict)

    def knows(self, name: str, *fields: str) -> bool:
        """Whether these fields of a module are sound."""
        return name in self.modules and self.faulty.get(name, frozenset()).isdisjoint(fields)

    def holder(self, end: str) -> str:
        """The module that the end of a link names: itself, or the structure of which it names a point."""
        name, dot, _ = end.partition(".")
        return name if dot else end
