"""What every module of a scene is, and what it may ask of the modules around it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import GetJsonSchemaHandler
from pydantic_core import core_schema

from ..issue import Issue
from ..part import Part


class Module(Part):
    """A module of the simulated scene. Each subclass adds ``type: Literal["its name"] = "its name"``."""

    #: The module is a point that a link can hold by one end.
    is_point: ClassVar[bool] = True
    #: The module can move; a link between two that cannot would do nothing.
    can_move: ClassVar[bool] = True
    #: The fields that `issues` looks at, its own and others'.
    shared: ClassVar[tuple[str, ...]] = ()
    #: The fields that may change while the scene runs.
    live: ClassVar[tuple[str, ...]] = ()
    #: The fields that say how it begins, and nothing of how it goes on.
    initial: ClassVar[tuple[str, ...]] = ()

    type: str

    def issues(self, _name: str, _around: "ModuleContext") -> Iterator[Issue]:
        """Faults that this module, called ``name``, has together with the others."""
        yield from ()

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
        sound: the modules that stand by themselves, by name; or of which at least the shared fields do.
        kinds: the class of every module by name, faulty ones too; None where not even the type is known.
    """

    sound: Mapping[str, Module]
    kinds: Mapping[str, type[Module] | None]

    def holder(self, end: str) -> str:
        """The module that the end of a link names: itself, or the structure of which it names a point."""
        name, dot, _ = end.partition(".")
        return name if dot else end
