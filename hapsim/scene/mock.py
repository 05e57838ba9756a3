"""The mock device of a scene: its differences from the device, and what it has beside it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Field, PlainSerializer

from .admittance import ForceSensor, Servo, ServoOfChannel
from .choices import HOLD, SAMPLING, Hold, Sampling
from .device import ACCELERATION_AGE, DELAY, FRICTION, MASS, STIFFNESS, Device
from .drive import MOTOR_LAG, TRANSMISSION, Drive, Transmission
from .quantity import NAME, count, curve, numbers, quantity
from .section import Section, Table
from .values import Curve, Matrix, PerChannel, per_channel

AS_DEVICE = "as `device` says"

MOST_FORCE = 1e6
"""Largest force of the mock, N, whatever the scene allows: a force that a hand feels is then many of 2**32 steps."""

FORCE_COUNTS = 2.0**31  # the limit in N lies at the end of the counts' range: the finest step that 32 bits give

_SENSED_PER_LIMIT = 10.0


class Initial(Section):
    """Initial positions and velocities of the mock's moving parts. SI units."""

    position: Annotated[PerChannel, quantity("Position at the start", "m", per_channel=True)] = 0.0
    velocity: Annotated[PerChannel, quantity("Velocity at the start", "m/s", per_channel=True)] = 0.0


class Hand(Section):
    """The hand that holds the mock's moving parts, from the start of the run on: it pushes, and it is a spring and a
    damper to where it is. In impedance its mass is in ``mock.mass``. SI units."""

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
    mass: Annotated[
        PerChannel,
        quantity("Mass of the hand beyond the force sensor, with mode: admittance", "kg", least=0, per_channel=True),
    ] = 0.0


class Cogging(Section):
    """Force with which the mock's motor holds to its poles: a sine over its position. SI units."""

    force: Annotated[float, quantity("Amplitude of the force", "N", least=0)]
    pitch: Annotated[float, quantity("Distance from one pole to the next", "m", above=0)]


class ForceNoise(Section):
    """Noise of the mock's force. SI units."""

    rms: Annotated[float, quantity("Rms of the noise", "N", least=0)]
    band: Annotated[float, quantity("Frequency up to which it reaches, to first order", "Hz", above=0)]


class Saturation(Section):
    """Soft saturation of the mock's motor. SI units."""

    force: Annotated[float, quantity("Commanded force at which `share` is missing", "N", above=0)]
    share: Annotated[float, quantity("Share of the force that is missing there", "1", least=0, most=0.9)]


InputTimes = Annotated[
    tuple[float, ...], numbers("Times at which an input changes; it begins off", "s", "it stays off")
]


class Mock(Section):
    """Differences of the mock from the described device, and imperfections of a real device. SI units."""

    mass: Annotated[PerChannel | Matrix | None, replace(MASS, left_out=AS_DEVICE)] = None
    friction: Annotated[PerChannel | None, replace(FRICTION, left_out=AS_DEVICE)] = None
    stiffness: Annotated[PerChannel | None, replace(STIFFNESS, left_out=AS_DEVICE)] = None
    transmission: Transmission | None = Field(default=None, description=f"{TRANSMISSION}; without it: {AS_DEVICE}")
    motor_lag: Annotated[PerChannel | None, replace(MOTOR_LAG, left_out=AS_DEVICE)] = None
    servo: Servo | None = Field(default=None, description=f"The device's position loop; without it: {AS_DEVICE}")
    force_sensor: ForceSensor = Field(default=ForceSensor(), description="The force sensor, with mode: admittance")
    delay: Annotated[float | None, replace(DELAY, left_out=AS_DEVICE)] = None
    hold: Hold | None = Field(default=None, description=f"{HOLD}; without it: {AS_DEVICE}")
    sampling: Sampling | None = Field(default=None, description=f"{SAMPLING}; without it: {AS_DEVICE}")
    initial: Initial = Field(default=Initial(), description="Initial state of the moving parts")
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
    cogging: Cogging | None = Field(default=None, description="Force by which the motor holds to its poles")
    force_noise: ForceNoise | None = Field(default=None, description="Noise of the force")
    saturation: Saturation | None = Field(default=None, description="Force that the motor lacks when much is commanded")
    noise: Annotated[float, quantity("Noise of the position sensor", "m rms", least=0)] = 0.0
    acceleration_noise: Annotated[float, quantity("Rms noise of the acceleration sensor", "m/s²", least=0)] = 0.0
    acceleration_bandwidth: Annotated[
        float | None,
        quantity("Bandwidth of the acceleration sensor", "Hz", above=0, left_out="none: it follows at once"),
    ] = None
    acceleration_age: Annotated[int | None, replace(ACCELERATION_AGE, left_out=AS_DEVICE)] = None
    seed: Annotated[int, count("Seed of the noise: the same seed, the same run", 0, 2**32 - 1)] = 0
    baud: Annotated[
        int | None, count("Speed of the mock's UART", 1, 100_000_000, "bit/s", left_out="bytes take no time")
    ] = None
    turnaround: Annotated[
        float,
        quantity("Time the mock needs before it sends a position and after it receives a force", "s", least=0, most=1),
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
            left_out="it stays the same",
            fewest=1,
            above=0.0,
        ),
    ] = None
    clock_ppm: Annotated[
        float,
        quantity(
            "Difference of its clock from the nominal, in millionths: above 0, it samples faster",
            "1",
            least=-1000,
            most=1000,
        ),
    ] = 0.0
    phase: Annotated[
        float, quantity("Share of a period by which its first sample comes later", "1", least=0, most=1)
    ] = 0.0
    inputs: Annotated[
        Mapping[Annotated[str, NAME], InputTimes],
        AfterValidator(Table),
        PlainSerializer(dict),
        Field(description="Times at which inputs of the scene change, in s, by name"),
    ] = Field(default_factory=dict, validate_default=True)


@dataclass(frozen=True)
class MockDevice:
    """The mock as it is to be simulated: nothing left open, one value per channel where channels may differ. SI units,
    as in `Device` and `Mock`. `mass_matrix`: its rows; None where no channel moves another. `force_limit`: what it
    never exceeds, N; `baud`: None where bytes take no time."""

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
    mass_matrix: Matrix | None = None
    acceleration_age: int = 0
    acceleration_noise: float = 0.0
    acceleration_bandwidth: float | None = None
    baud: int | None = None
    turnaround: float = 0.0
    misses: float = 0.0
    grips: Curve = ()
    force_quantum: float | None = None
    hand: Hand = field(default_factory=Hand)
    drive: tuple[Drive, ...] = ()
    cogging: Cogging | None = None
    force_noise: ForceNoise | None = None
    saturation: Saturation | None = None
    servo: tuple[ServoOfChannel | None, ...] = ()
    force_sensor: ForceSensor = field(default_factory=ForceSensor)
    clock_ppm: float = 0.0
    phase: float = 0.0

    @property
    def is_driven(self) -> bool:
        """True if a motor or a transmission changes the commanded force before it moves the hand."""
        return bool(self.cogging or self.force_noise or self.saturation) or any(not one.is_rigid for one in self.drive)

    @property
    def force_scale(self) -> float:
        """N per count of the force on the wire."""
        return max(self.force_limit / FORCE_COUNTS, self.force_quantum or 0.0, math.ulp(0.0))

    @property
    def sensed_force_limit(self) -> float:
        """Force at which its force sensor saturates, N."""
        return self.force_sensor.limit or _SENSED_PER_LIMIT * self.force_limit

    @property
    def sensed_force_scale(self) -> float:
        """N per count of the sensed force on the wire."""
        return max(self.sensed_force_limit / FORCE_COUNTS, self.force_sensor.quantum or 0.0)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.mass)


#: The fields with which a mock may differ from the device; `baud` is of its own UART.
_AS_DEVICE = [name for name in Mock.model_fields if name in Device.model_fields and name != "baud"]


def resolve(device: Device, mock: Mock | None, channels: int) -> MockDevice:
    """Returns the mock of ``channels`` channels that ``mock`` describes, with ``device`` where it is silent."""
    mock = mock or Mock()
    differs = {name: value for name in _AS_DEVICE if (value := getattr(mock, name)) is not None}
    own = device.model_copy(update=differs)
    resolved: dict[str, Any] = {
        "mass": own.masses(channels),
        "mass_matrix": own.mass_matrix(channels),
        "friction": per_channel(own.friction, channels),
        "stiffness": own.stiffnesses(channels),
        "drive": own.drives(channels),
        "servo": own.servos(channels),
        "initial_position": per_channel(mock.initial.position, channels),
        "initial_velocity": per_channel(mock.initial.velocity, channels),
        "force_limit": min(own.force_limit, MOST_FORCE),
        "grips": mock.grips or (),
        "quantum": tuple(mock.quantum or scale.position_count for scale in device.scales(channels)),
    }
    others = (one.name for one in fields(MockDevice) if one.name not in resolved)
    return MockDevice(**resolved, **{name: getattr(own if name in _AS_DEVICE else mock, name) for name in others})
