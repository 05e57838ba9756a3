"""The mock device: only where it differs from what `Device` says, or adds to it."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

from pydantic import Field

from .choices import HOLD, SAMPLING, Hold, Sampling
from .device import DELAY, FRICTION, MASS, STIFFNESS, Device
from .part import Part
from .quantity import Curve, PerChannel, count, curve, per_channel, quantity

AS_DEVICE = "as `device` says"

MOST_FORCE = 1e6
"""N, that the mock gives at most, whatever the scene allows: its 32 bits divide what it can give, and a force that a
hand would feel has to be many of these steps."""


FORCE_COUNTS = 2.0**31  # the limit in N lies at the end of the counts' range: the finest step that 32 bits give


class Initial(Part):
    """Where the mock's moving parts are when the run starts. SI units."""

    position: Annotated[PerChannel, quantity("Position at the start", "m", per_channel=True)] = 0.0
    velocity: Annotated[PerChannel, quantity("Velocity at the start", "m/s", per_channel=True)] = 0.0


class Hand(Part):
    """The hand that holds the mock's moving parts, from the start of the run on: it pushes, and it is a spring and a
    damper to where it is. Its mass is in ``mock.mass``. SI units."""

    #: As of a module: a hand that another program moves.
    live: ClassVar[tuple[str, ...]] = ("force", "stiffness", "damping", "position")
    crossfaded: ClassVar[tuple[str, ...]] = ()
    type: ClassVar[str] = "hand"

    force: Annotated[PerChannel, quantity("Force with which the hand pushes", "N", per_channel=True)] = 0.0
    stiffness: Annotated[PerChannel, quantity("Stiffness of the hand", "N/m", least=0, per_channel=True)] = 0.0
    damping: Annotated[PerChannel, quantity("Viscosity of the hand", "N·s/m", least=0, per_channel=True)] = 0.0
    position: Annotated[
        PerChannel, quantity("Position at which the spring of the hand has no force", "m", per_channel=True)
    ] = 0.0


class Mock(Part):
    """Where the mock differs from the described device, and what a real device has of itself. SI units."""

    mass: Annotated[PerChannel | None, replace(MASS, left_out=AS_DEVICE)] = None
    friction: Annotated[PerChannel | None, replace(FRICTION, left_out=AS_DEVICE)] = None
    stiffness: Annotated[PerChannel | None, replace(STIFFNESS, left_out=AS_DEVICE)] = None
    delay: Annotated[float | None, replace(DELAY, left_out=AS_DEVICE)] = None
    hold: Hold | None = Field(default=None, description=f"{HOLD}; without it: {AS_DEVICE}")
    sampling: Sampling | None = Field(default=None, description=f"{SAMPLING}; without it: {AS_DEVICE}")
    initial: Initial = Field(default=Initial(), description="Where the moving parts are when the run starts")
    hand: Hand = Field(default=Hand(), description="The hand that holds the moving parts")
    coulomb: Annotated[float, quantity("Dry friction", "N", least=0)] = 0.0
    quantum: Annotated[
        float | None,
        quantity("Step of the position on the wire", "m per count", above=0, left_out="1e-9 m, or 1e-6 rad"),
    ] = None
    force_quantum: Annotated[
        float | None,
        quantity("Step of the force on the wire", "N per count", above=0, left_out="as fine as its 32 bits are"),
    ] = None
    noise: Annotated[float, quantity("Noise of the position sensor", "m rms", least=0)] = 0.0
    seed: Annotated[int, count("Seed of the noise: the same seed, the same run", 0, 2**32 - 1)] = 0
    baud: Annotated[
        int | None, count("Speed of the mock's UART", 1, 100_000_000, "bit/s", left_out="bytes take no time")
    ] = None
    turnaround: Annotated[
        float,
        quantity("What the mock takes before a position's first byte and after a force's last", "s", least=0, most=1),
    ] = 0.0
    misses: Annotated[
        float,
        quantity("Share of the forces that come too late, drawn at random, in virtual time", "1", least=0, most=1),
    ] = 0.0
    grips: Annotated[
        Curve | None,
        curve(
            "The mass of every moving part and its hand from these times on: a hand that grips, or releases",
            "s",
            "kg",
            left_out="it stays what it is",
            fewest=1,
            above=0.0,
        ),
    ] = None


@dataclass(frozen=True)
class MockDevice:
    """The mock as it is to be simulated: nothing left open, one value per channel where channels may differ. SI units,
    as in `Device` and `Mock`. `force_limit`: what it never exceeds, N; `baud`: None where bytes take no time."""

    mass: tuple[float, ...]
    friction: tuple[float, ...]
    stiffness: tuple[float, ...]
    delay: float
    hold: Hold
    sampling: Sampling
    initial_position: tuple[float, ...]
    initial_velocity: tuple[float, ...]
    force_limit: float
    coulomb: float
    quantum: tuple[float, ...]
    noise: float
    seed: int
    baud: int | None = None
    turnaround: float = 0.0
    misses: float = 0.0
    grips: Curve = ()
    force_quantum: float | None = None
    hand: Hand = field(default_factory=Hand)

    @property
    def force_scale(self) -> float:
        """N per count of the force on the wire."""
        return max(self.force_limit / FORCE_COUNTS, self.force_quantum or 0.0, math.ulp(0.0))

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.mass)


#: The fields that a `Mock` says alone.
_OF_MOCK = ("coulomb", "noise", "seed", "baud", "turnaround", "misses", "force_quantum", "hand")


def resolve(device: Device, mock: Mock | None, channels: int) -> MockDevice:
    """Returns the mock of ``channels`` channels that ``mock`` describes, with ``device`` where it is silent."""
    mock = mock or Mock()
    return MockDevice(
        mass=device.masses(channels) if mock.mass is None else per_channel(mock.mass, channels),
        friction=per_channel(device.friction if mock.friction is None else mock.friction, channels),
        stiffness=per_channel(device.stiffness if mock.stiffness is None else mock.stiffness, channels),
        delay=device.delay if mock.delay is None else mock.delay,
        hold=mock.hold or device.hold,
        sampling=mock.sampling or device.sampling,
        initial_position=per_channel(mock.initial.position, channels),
        initial_velocity=per_channel(mock.initial.velocity, channels),
        force_limit=min(device.force_limit, MOST_FORCE),
        grips=mock.grips or (),
        quantum=tuple(mock.quantum or scale.position_count for scale in device.scales(channels)),
        **{name: getattr(mock, name) for name in _OF_MOCK},
    )
