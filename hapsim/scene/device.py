"""Device of a scene, as the hand holds it."""

import math
from itertools import combinations
from typing import Annotated, Any, Literal, cast

from pydantic import Field

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
    NAME_PATTERN,
    count,
    interval,
    quantity,
    some_of,
    text,
    word_per_channel,
)
from .section import Section
from .values import (
    Area,
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
        each: tuple[Any, ...] = per_channel(mass, channels)  # of a matrix its rows
        return tuple(one[c] if isinstance(one, tuple) else one for c, one in enumerate(each))
