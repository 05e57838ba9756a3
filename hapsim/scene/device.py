"""Device of a scene, as the hand holds it, and the mock device with its differences from and additions to it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import AfterValidator, Field, PlainSerializer

from hapsim.holds import HOLDS
from hapsim.scales import Scale, scale_of
from hapsim.units import MOTIONS, Motion

from .admittance import (
    ACCELERATION_LIMIT,
    MODE,
    SIMULATED_DAMPING,
    SIMULATED_MASS,
    SPEED_LIMIT,
    AssumedHand,
    ForceSensor,
    HandOfChannel,
    Mode,
    Servo,
    ServoOfChannel,
    hands_of,
    required_with,
    servos_of,
)
from .board import BOARD_DELAY, BOARD_RATE, BOARD_WINDOW, Board, board_of
from .choices import (
    CORRECTION,
    DECIMATION,
    HOLD,
    LAW,
    MOTION,
    SAMPLING,
    SENSORS,
    CorrectionName,
    Decimation,
    Hold,
    Law,
    Sampling,
)
from .drive import MOTOR_LAG, TRANSMISSION, Drive, Transmission, drives_of
from .quantity import (
    NAME,
    NAME_PATTERN,
    count,
    curve,
    interval,
    numbers,
    quantity,
    some_of,
    text,
    word_per_channel,
)
from .section import Section, Table
from .values import (
    Area,
    Curve,
    Known,
    Limits,
    LimitsPerChannel,
    Matrix,
    PerChannel,
    Span,
    SpanPerChannel,
    WordPerChannel,
    per_channel,
    spans_of,
)

Clock = Literal["device", "host", "lockstep"]

_MASS = "Mass of the device's moving part and of the hand that holds it"
MASS = quantity(_MASS, "kg", above=0, per_channel=True, matrix=True)
SPANNED_MASS = quantity(
    _MASS,
    "kg",
    above=0,
    per_channel=True,
    spans=True,
    matrix=True,
    left_out="none: required with mode: impedance",
)
FRICTION = quantity("Viscous friction of the device", "N·s/m", least=0, per_channel=True)
STIFFNESS = quantity("Spring in the device itself, at rest at position 0", "N/m", least=0, per_channel=True)
MASS_AT = quantity(
    "Position of the device, by its own coordinate, at which mass and friction hold: those of a linkage vary",
    "m",
    per_channel=True,
    left_out="they are the same everywhere",
)
DELAY = quantity(
    "Delay from sampling the position to the change of the force; any real number", "sample periods", least=0, most=1000
)
SLEW_LIMIT = quantity(
    "Largest rate of change of the force",
    "N/s",
    above=0,
    left_out="behind a port force_limit in 1 ms, or in a sample period where that is longer; before the mock none",
)
SOFT_START = quantity(
    "Duration of the force's ramp from zero after arming; 0: none",
    "s",
    least=0,
    most=10,
    left_out="0.05 behind a port, 0 before the mock",
)
ENERGY_LIMIT = quantity(
    "Energy that the scene may give the hand before the loop stops",
    "J",
    above=0,
    left_out="behind a port, and in `hapsim run`, force_limit times 0.02 m, or 0.1 rad; before the mock none",
)
TRAVEL = interval("Range of the device, by the scene's positions; outside it the force fades to zero", "m", "no limit")
TRAVEL_MARGIN = quantity(
    "Width of the band outside travel in which the force fades; a run ends beyond it",
    "m",
    above=0,
    left_out="a tenth of the travel, in the plane of its smaller width",
)
ORIGIN = quantity(
    "Position of the device that is the scene's position 0; here: its position at arming",
    "m",
    per_channel=True,
    left_out="where the device powered up or homed",
    word="here",
)
ACCELERATION_AGE = count(
    "Age of the sensed acceleration in forces: measured just after the newest force begins to act (0), or before (1)",
    0,
    1,
)
_MARGIN_SHARE = 0.1  # of the travel

WHEN = text("Input while which is on the motor is on", "the name of an input", NAME_PATTERN, "always")
PORT = text(
    "Serial port, such as /dev/ttyACM0, or address of a device, such as tcp://192.168.7.2:7472",
    "the name of a serial port, such as /dev/ttyACM0, or an address",
    ".+",
    "the embedded mock",
)


class Device(Section):
    """The device that the hand holds, and the link to it. SI units."""

    port: Annotated[str | None, PORT] = None
    baud: Annotated[int, count("Speed of the serial link", 1, 100_000_000, "bit/s")] = 2_000_000
    clock: Clock = Field(
        default="device", description="Clock of the loop; lockstep: the mock, in virtual time, as fast as possible"
    )
    motion: Annotated[Motion | tuple[Motion, ...], word_per_channel(MOTION, MOTIONS)] = "linear"
    mode: Annotated[Mode, MODE] = "impedance"
    mass: Annotated[
        SpanPerChannel | Matrix | None,
        SPANNED_MASS,
        *required_with("impedance"),
    ] = None
    simulated_mass: Annotated[PerChannel | None, SIMULATED_MASS, *required_with("admittance")] = None
    simulated_damping: Annotated[PerChannel, SIMULATED_DAMPING] = 0.0
    assumed_hand: Annotated[AssumedHand | None, *required_with("admittance")] = Field(
        default=None, description="The hand for which mode: admittance is judged; required with it"
    )
    servo: Servo | None = Field(
        default=None,
        description="The device's position loop in mode: admittance; without it the device follows exactly, in "
        "straight lines from sample to sample",
    )
    speed_limit: Annotated[float | None, SPEED_LIMIT] = None
    acceleration_limit: Annotated[float | None, ACCELERATION_LIMIT] = None
    friction: Annotated[PerChannel, FRICTION] = 0.0
    mass_at: Annotated[PerChannel | None, MASS_AT] = None
    stiffness: Annotated[PerChannel, STIFFNESS] = 0.0
    transmission: Transmission | None = Field(default=None, description=f"{TRANSMISSION}; without it they are one mass")
    motor_lag: Annotated[PerChannel, MOTOR_LAG] = 0.0
    delay: Annotated[float, DELAY] = 1.0
    hold: Hold = Field(default="zoh", description=HOLD)
    sampling: Sampling = Field(default="ideal", description=SAMPLING)
    law: Law = Field(default="host", description=LAW)
    board_rate: Annotated[float, BOARD_RATE] = 10_000.0
    board_delay: Annotated[int, BOARD_DELAY] = 1
    board_window: Annotated[int | None, BOARD_WINDOW] = None
    force_limit: Annotated[float, quantity("Largest force", "N", above=0)] = 10.0
    slew_limit: Annotated[float | None, SLEW_LIMIT] = None
    soft_start: Annotated[float | None, SOFT_START] = None
    energy_limit: Annotated[float | None, ENERGY_LIMIT] = None
    travel: Annotated[LimitsPerChannel | Area | None, TRAVEL] = None
    travel_margin: Annotated[float | None, TRAVEL_MARGIN] = None
    origin: Annotated[WordPerChannel | None, ORIGIN] = None
    sensors: Annotated[tuple[str, ...], some_of("Sensors of the device beside that of the position", SENSORS)] = ()
    acceleration_age: Annotated[int, ACCELERATION_AGE] = 0
    correction: CorrectionName = Field(default="none", description=CORRECTION)
    decimation: Decimation = Field(default="last", description=DECIMATION)
    when: Annotated[str | None, WHEN] = None

    def board(self, rate: float) -> Board | None:
        """Returns the board's loop beside samples at ``rate`` Hz; None if the host evaluates the law."""
        if self.law == "host":
            return None
        return board_of(rate, self.board_rate, self.board_delay, self.board_window)

    @property
    def is_admittance(self) -> bool:
        """True if the device measures a force and follows a position."""
        return self.mode == "admittance"

    def motions(self, channels: int) -> tuple[Motion, ...]:
        """Motion of each of ``channels`` channels."""
        return per_channel(self.motion, channels)

    def scales(self, channels: int) -> tuple[Scale, ...]:
        """Returns the default scale of each of ``channels`` channels."""
        each = zip(self.motions(channels), self.mass_spans(channels), self.travels(channels), strict=False)
        return tuple(scale_of(motion, mass, high - low) for motion, (mass, _), (low, high) in each)

    def masses(self, channels: int) -> tuple[float, ...]:
        """Mass of each of ``channels`` channels, in kg: the middle of a span, and the diagonal of a matrix; in
        admittance the simulated one."""
        return tuple(math.sqrt(least * most) if least < most else most for least, most in self.mass_spans(channels))

    def mass_matrix(self, channels: int) -> Matrix | None:
        """Returns the rows of the mass matrix of ``channels`` channels, in kg; None where no channel moves another."""
        rows: Any = self.mass
        if not isinstance(rows, tuple) or not all(isinstance(one, tuple) for one in rows):
            return None
        return rows if any(rows[i][j] for i, j in combinations(range(channels), 2)) else None

    def mass_spans(self, channels: int) -> tuple[tuple[float, float], ...]:
        """The least and the most that the mass of each of ``channels`` channels may be, in kg."""
        return spans_of(self._masses(channels))

    def mass_uncertainties(self, channels: int) -> tuple[float | None, ...]:
        """Standard uncertainty of the mass of each of ``channels`` channels, in kg; None where the file states none."""
        return tuple(one.uncertainty if isinstance(one, Known) else None for one in self._masses(channels))

    @property
    def lag(self) -> float:
        """Friction that any hand needs on a spring K, over K T: 1/2 + delay for a zero-order hold and whole samples. A
        part f of a sample adds at most f (1 - f)/2 to that, another hold 2.1 % (a test compares with the theory)."""
        held, part = HOLDS[self.hold].mean_delay, self.delay % 1.0
        return (self.delay + held + 0.5 * part * (1.0 - part)) * (1.0 if held <= 0.5 else 1.021)

    def frictions(self, channels: int) -> tuple[float, ...]:
        """Viscous friction of each of ``channels`` channels, in N·s/m; in admittance the simulated damping."""
        return per_channel(self.simulated_damping if self.is_admittance else self.friction, channels)

    def assumed_hands(self, channels: int) -> tuple[HandOfChannel, ...]:
        """Returns the hand that each of ``channels`` channels is judged for in admittance."""
        return hands_of(self.assumed_hand, channels)

    def servos(self, channels: int) -> tuple[ServoOfChannel | None, ...]:
        """Returns the servo of each of ``channels`` channels; None where the device follows exactly."""
        return servos_of(self.servo, channels)

    def speed_limits(self, channels: int) -> tuple[float, ...]:
        """Returns the largest speed of each of ``channels`` channels' commands, m/s."""
        return tuple(self.speed_limit or one.command_speed for one in self.scales(channels))

    def acceleration_limits(self, channels: int) -> tuple[float, ...]:
        """Returns the largest acceleration of each of ``channels`` channels' commands, m/s²."""
        return tuple(self.acceleration_limit or one.command_acceleration for one in self.scales(channels))

    def drives(self, channels: int) -> tuple[Drive, ...]:
        """Returns what lies between the commanded force and the hand on each of ``channels`` channels."""
        return drives_of(self.transmission, self.motor_lag, channels)

    def travels(self, channels: int) -> tuple[Limits, ...]:
        """Least and most position of each of ``channels`` channels, m, from the scene's 0; infinite without travel. Of
        an area they are those of the box around it, for channels of x and y in turn."""
        if self.travel is None:
            return ((-math.inf, math.inf),) * channels
        if isinstance(self.travel, Area):
            return tuple(self.travel.bounds[c % 2] for c in range(channels))
        pairs = tuple(one for one in self.travel if isinstance(one, tuple))
        return pairs or (cast(Limits, self.travel),) * channels

    def travel_margins(self, channels: int) -> tuple[float, ...]:
        """Width of the band outside the travel of each of ``channels`` channels, in m."""
        own = self.travel_margin
        return tuple(_MARGIN_SHARE * (most - least) if own is None else own for least, most in self.travels(channels))

    def origins(self, channels: int) -> tuple[float | None, ...]:
        """Returns each channel's origin: the device position in m that is the scene's 0; None: that at arming."""
        origin = self.origin if isinstance(self.origin, tuple) else (self.origin or 0.0,) * channels
        return tuple(None if isinstance(one, str) else one for one in origin)

    def stiffnesses(self, channels: int) -> tuple[float, ...]:
        """Stiffness of the real spring of each of ``channels`` channels, in N/m."""
        return per_channel(self.stiffness, channels)

    def _masses(self, channels: int) -> tuple[float | Span | Known, ...]:
        mass = self.simulated_mass if self.is_admittance else self.mass
        assert mass is not None  # each mode requires its own
        each: tuple[Any, ...] = per_channel(mass, channels)
        return tuple(
            one[i] if isinstance(one, tuple) else one for i, one in enumerate(each)
        )  # of a matrix its diagonal


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
