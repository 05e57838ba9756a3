"""What stands on the other side of the wire: the device that the hand holds."""

import math
from typing import Annotated, Literal, cast

from pydantic import Field

from hapsim.scales import Scale, scale_of
from hapsim.units import MOTIONS, Motion

from .choices import (
    CORRECTION,
    DECIMATION,
    HOLD,
    MOTION,
    SAMPLING,
    CorrectionName,
    Decimation,
    Hold,
    Sampling,
)
from .part import Part
from .quantity import (
    Known,
    Limits,
    LimitsPerChannel,
    PerChannel,
    Span,
    SpanPerChannel,
    WordPerChannel,
    count,
    interval,
    per_channel,
    quantity,
    text,
    word_per_channel,
)

Clock = Literal["device", "host", "lockstep"]

_MASS = "Moving part of the device and the hand that holds it"
MASS = quantity(_MASS, "kg", above=0, per_channel=True)
SPANNED_MASS = quantity(_MASS, "kg", above=0, per_channel=True, spans=True)
FRICTION = quantity("Viscous friction of the device", "N·s/m", least=0, per_channel=True)
STIFFNESS = quantity("Spring in the device itself, at rest at position 0", "N/m", least=0, per_channel=True)
MASS_AT = quantity(
    "Device's own position, on each channel, at which mass and friction are as stated: a linkage has others elsewhere",
    "m",
    per_channel=True,
    left_out="they are the same everywhere",
)
DELAY = quantity(
    "From sampling the position to the force's change, any real number", "sample periods", least=0, most=1000
)
SLEW_LIMIT = quantity(
    "How fast the force may change from one sample to the next",
    "N/s",
    above=0,
    left_out="behind a port force_limit in 1 ms, or in a sample period where that is longer; before the mock none",
)
SOFT_START = quantity(
    "How long what the scene asks for in the very first sample takes to rise; 0: no time",
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
TRAVEL = interval(
    "How far the device moves, by the scene's positions: outside the force fades to zero", "m", "no limit"
)
TRAVEL_MARGIN = quantity(
    "Width of the band outside travel in which the force fades; a run ends beyond it",
    "m",
    above=0,
    left_out="a tenth of the travel",
)
ORIGIN = quantity(
    "Which of the device's positions is the scene's position 0; here: the one at arming",
    "m",
    per_channel=True,
    left_out="where the device powered up or homed",
    word="here",
)
_MARGIN_SHARE = 0.1  # of the travel


PORT = text(
    "Serial port, such as /dev/ttyACM0", "the name of a serial port, such as /dev/ttyACM0", ".+", "the embedded mock"
)


class Device(Part):
    """The device that the hand holds, and the link to it. SI units."""

    port: Annotated[str | None, PORT] = None
    baud: Annotated[int, count("Speed of the serial link", 1, 100_000_000, "bit/s")] = 2_000_000
    clock: Clock = Field(
        default="device",
        description="Who paces the loop; lockstep: the mock, in virtual time, as fast as it goes",
    )
    motion: Annotated[Motion | tuple[Motion, ...], word_per_channel(MOTION, MOTIONS)] = "linear"
    mass: Annotated[SpanPerChannel, SPANNED_MASS]
    friction: Annotated[PerChannel, FRICTION] = 0.0
    mass_at: Annotated[PerChannel | None, MASS_AT] = None
    stiffness: Annotated[PerChannel, STIFFNESS] = 0.0
    delay: Annotated[float, DELAY] = 1.0
    hold: Hold = Field(default="zoh", description=HOLD)
    sampling: Sampling = Field(default="ideal", description=SAMPLING)
    force_limit: Annotated[float, quantity("Force that is never exceeded", "N", above=0)] = 10.0
    slew_limit: Annotated[float | None, SLEW_LIMIT] = None
    soft_start: Annotated[float | None, SOFT_START] = None
    energy_limit: Annotated[float | None, ENERGY_LIMIT] = None
    travel: Annotated[LimitsPerChannel | None, TRAVEL] = None
    travel_margin: Annotated[float | None, TRAVEL_MARGIN] = None
    origin: Annotated[WordPerChannel | None, ORIGIN] = None
    correction: CorrectionName = Field(default="none", description=CORRECTION)
    decimation: Decimation = Field(default="last", description=DECIMATION)

    def motions(self, channels: int) -> tuple[Motion, ...]:
        """Motion of each of ``channels`` channels."""
        return self.motion if isinstance(self.motion, tuple) else (self.motion,) * channels

    def scales(self, channels: int) -> tuple[Scale, ...]:
        """What holds of each of ``channels`` channels where nothing is declared."""
        each = zip(
            self.motions(channels), self.mass_spans(channels), self.travels(channels), strict=False
        )  # lists stay
        return tuple(scale_of(motion, mass, high - low) for motion, (mass, _), (low, high) in each)

    def masses(self, channels: int) -> tuple[float, ...]:
        """Mass of each of ``channels`` channels, in kg; of one that is not known, the middle of its span."""
        return tuple(math.sqrt(least * most) if least < most else most for least, most in self.mass_spans(channels))

    def mass_spans(self, channels: int) -> tuple[tuple[float, float], ...]:
        """The least and the most that the mass of each of ``channels`` channels may be, in kg."""
        numbers = (one.value if isinstance(one, Known) else one for one in self._masses(channels))
        return tuple((one.least, one.most) if isinstance(one, Span) else (one, one) for one in numbers)

    def mass_uncertainties(self, channels: int) -> tuple[float | None, ...]:
        """Standard uncertainty of the mass of each of ``channels`` channels, in kg; None where the file states none."""
        return tuple(one.uncertainty if isinstance(one, Known) else None for one in self._masses(channels))

    def frictions(self, channels: int) -> tuple[float, ...]:
        """Viscous friction of each of ``channels`` channels, in N·s/m."""
        return per_channel(self.friction, channels)

    def travels(self, channels: int) -> tuple[Limits, ...]:
        """The least and the most position of each of ``channels`` channels, in m, as the scene counts; infinite where
        the scene names no travel."""
        if self.travel is None:
            return ((-math.inf, math.inf),) * channels
        pairs = tuple(one for one in self.travel if isinstance(one, tuple))
        return pairs or (cast(Limits, self.travel),) * channels

    def travel_margins(self, channels: int) -> tuple[float, ...]:
        """Width of the band outside the travel of each of ``channels`` channels, in m."""
        own = self.travel_margin
        return tuple(_MARGIN_SHARE * (most - least) if own is None else own for least, most in self.travels(channels))

    def origins(self, channels: int) -> tuple[float | None, ...]:
        """Which position of the device is the scene's 0, on each of ``channels`` channels, in m; None: that at
        arming."""
        origin = self.origin if isinstance(self.origin, tuple) else (self.origin or 0.0,) * channels
        return tuple(None if isinstance(one, str) else one for one in origin)

    def stiffnesses(self, channels: int) -> tuple[float, ...]:
        """Stiffness of the real spring of each of ``channels`` channels, in N/m."""
        return per_channel(self.stiffness, channels)

    def _masses(self, channels: int) -> tuple[float | Span | Known, ...]:
        return self.mass if isinstance(self.mass, tuple) else (self.mass,) * channels
