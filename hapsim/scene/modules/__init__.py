"""The modules that a scene can hold. A new one is a file here and a line in `AnyModule`."""

from typing import Annotated, get_args

from pydantic import Field

from .buffer import Buffer
from .device_point import DevicePoint
from .ground import Ground
from .link import Link
from .mass import Mass
from .membrane import Membrane
from .module import Module, Surroundings
from .string import Pluck, String
from .structure import Elements, Structure
from .viscoelastic import ViscoElastic

AnyModule = DevicePoint | Ground | Mass | String | Membrane | ViscoElastic | Buffer

#: A module as the file has it: its ``type`` says which.
TypedModule = Annotated[AnyModule, Field(discriminator="type")]

#: The class of each ``type``, in the order in which people meet them.
MODULE_TYPES: dict[str, type[Module]] = {module.model_fields["type"].default: module for module in get_args(AnyModule)}

__all__ = [
    "MODULE_TYPES",
    "AnyModule",
    "Buffer",
    "DevicePoint",
    "Elements",
    "Ground",
    "Link",
    "Mass",
    "Membrane",
    "Module",
    "Pluck",
    "String",
    "Structure",
    "Surroundings",
    "TypedModule",
    "ViscoElastic",
]
