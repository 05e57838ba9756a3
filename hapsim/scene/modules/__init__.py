"""The modules that a scene can hold: every class of `point_modules`, `structures`, `links`, `detents` and `surfaces`
that says its `type`. A new one is a class there."""

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from ..section import Module, ModuleContext
from . import detents, links, point_modules, structures, surfaces
from .links import Link
from .point_modules import Held, MaterialPoint
from .structures import Elements, Pluck, Structure

__all__ = [
    "MODULE_TYPES",
    "Elements",
    "Held",
    "Link",
    "MaterialPoint",
    "Module",
    "ModuleContext",
    "Pluck",
    "Structure",
    "TypedModule",
]
"""Public names, in addition to the classes in MODULE_TYPES."""

MODULE_TYPES: dict[str, type[Module]] = {
    kind.model_fields["type"].default: kind
    for file in (point_modules, structures, links, detents, surfaces)
    for kind in vars(file).values()
    if isinstance(kind, type) and issubclass(kind, Module) and not kind.model_fields["type"].is_required()
}
"""The class of each ``type``, in the order in which people meet them: that of these files and of their text."""

if TYPE_CHECKING:
    TypedModule = Module
else:
    TypedModule = Annotated[Union[tuple(MODULE_TYPES.values())], Field(discriminator="type")]  # noqa: UP007
    """A module as the file has it: its ``type`` says which."""
