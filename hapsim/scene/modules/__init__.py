"""The modules that a scene can hold. A new one is a file here and a line in `AnyModule`."""

from typing import Annotated, get_args

from pydantic import Field

from .buffer import Buffer
from .cell import Cell
from .damper import Damper
from .device_point import DevicePoint
from .friction import Friction
from .ground import Ground
from .link import Link
from .mass import Mass
from .material_point import Held, MaterialPoint
from .membrane import Membrane
from .module import Module, ModuleContext
from .nonlinear import Nonlinear
from .plectrum import Plectrum
from .spring import Spring
from .string import Pluck, String
from .structure import Elements, Structure
from .viscoelastic import ViscoElastic

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
    "Damper",
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
