"""The modules that a scene can hold. A new one is a class here and a line in `AnyModule`."""

from typing import Annotated, get_args

from pydantic import Field

from .linear_links import Damper, Spring, ViscoElastic
from .link import Link
from .membrane import Membrane
from .module import Module, ModuleContext
from .nonlinear_links import Buffer, Click, Detent, Friction, Nonlinear, Plectrum
from .points import Cell, DevicePoint, Ground, Held, Mass, MaterialPoint
from .string import Pluck, String
from .structure import Elements, Structure

AnyModule = (
    DevicePoint
    | Ground
    | Mass
    | Cell
    | String
    | Membrane
    | ViscoElastic
    | Spring
    | Damper
    | Buffer
    | Nonlinear
    | Friction
    | Plectrum
    | Detent
    | Click
)

#: A module as the file has it: its ``type`` says which.
TypedModule = Annotated[AnyModule, Field(discriminator="type")]

#: The class of each ``type``, in the order in which people meet them.
MODULE_TYPES: dict[str, type[Module]] = {module.model_fields["type"].default: module for module in get_args(AnyModule)}

__all__ = [
    "MODULE_TYPES",
    "AnyModule",
    "Buffer",
    "Cell",
    "Click",
    "Damper",
    "Detent",
    "DevicePoint",
    "Elements",
    "Friction",
    "Ground",
    "Held",
    "Link",
    "Mass",
    "MaterialPoint",
    "Membrane",
    "Module",
    "ModuleContext",
    "Nonlinear",
    "Plectrum",
    "Pluck",
    "Spring",
    "String",
    "Structure",
    "TypedModule",
    "ViscoElastic",
]
