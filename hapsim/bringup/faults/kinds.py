"""The kinds of faults. A new one is a class with its effect, and a line in `AnyFault`."""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import Field

from hapsim.bringup.faults.description import Nonsense, Version
from hapsim.bringup.faults.fault import Fault
from hapsim.bringup.faults.motion import Invert, Leap
from hapsim.bringup.faults.noise import Garbage, WrongBaud
from hapsim.bringup.faults.plug import HalfFrame, Replug, Silence, Unplug
from hapsim.bringup.faults.rate import Rate
from hapsim.bringup.faults.reboot import Reboot
from hapsim.bringup.faults.stream import Corrupt, Delay, Drop, Duplicate, Reorder

AnyFault = (
    Drop
    | Corrupt
    | Duplicate
    | Delay
    | Reorder
    | Garbage
    | WrongBaud
    | HalfFrame
    | Silence
    | Unplug
    | Replug
    | Reboot
    | Version
    | Nonsense
    | Rate
    | Leap
    | Invert
)

TypedFault = Annotated[AnyFault, Field(discriminator="kind")]
"""A fault as the file has it: its `kind` says which."""

KINDS: dict[str, type[Fault]] = {fault.model_fields["kind"].default: fault for fault in get_args(AnyFault)}
"""The class of each `kind`, in the order in which `hapsim faults --list` tells them."""
