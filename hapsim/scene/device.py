"""What stands on the other side of the wire: the device that the hand holds."""

import math
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field

from .choices import CORRECTION, HOLD, SAMPLING, CorrectionName, Hold, Sampling
from .part import Part
from .quantity import Count, Expectation, Known, PerChannel, Quantity, Span, SpanPerChannel, per_channel, unexpected

Clock = Literal["device", "host", "lockstep"]

MASS = Quantity("Moving part of the device and the hand that holds it", "kg", above=0, per_channel=True)
FRICTION = Quantity("Viscous friction of the device", "N·s/m", least=0, per_channel=True)
STIFFNESS = Quantity("Spring in the device itself, at rest at position 0", "N/m", least=0, per_channel=True)
DELAY = Quantity(
    "From sampling the position to the force's change, any real number", "sample periods", least=0, most=1000
)
SLEW_LIMIT = Quantity(
    "How fast the force may change from one sample to the next",
    "N/s",
    above=0,
    left_out="behind a port force_limit in 1 ms, or in a sample period where that is longer; before the mock none",
)
SOFT_START = Quantity(
    "How long what the scene asks for in the very first sample takes to rise; 0: no time",
    "s",
    least=0,
    most=10,
    left_out="0.05 behind a port, 0 before the mock",
)
ENERGY_LIMIT = Quantity(
    "Energy that the scene may give the hand before the loop stops",
    "J",
    above=0,
    left_out="behind a port, and in `hapsim run`, force_limit times 0.02 m; before the mock none",
)


class PortName(Expectation):
    """A serial port by the name that the system has for it; in Python None: the embedded mock."""

    def expected(self) -> str:
        return "the name of a serial port, such as /dev/ttyACM0"

    def check(self, value: object) -> str | None:
        if value is not None and (not isinstance(value, str) or not value):
            unexpected(self.expected())
        return value

    def json_schema(self) -> dict[str, Any]:
        description = "Serial port, such as /dev/ttyACM0; left out: the embedded mock"
        return {"description": description, "anyOf": [{"type": "string", "minLength": 1}, {"type": "null"}]}


class Device(Part):
    """The device that the hand holds, and the link to it. SI units."""

    port: Annotated[str | None, PortName()] = None
    baud: Annotated[int, Count("Speed of the serial link", 1, 100_000_000, "bit/s")] = 2_000_000
    clock: Clock = Field(
        default="device",
        description="Who paces the loop; lockstep: the mock, in virtual time, as fast as it goes",
    )
    mass: Annotated[SpanPerChannel, replace(MASS, spans=True)]
    friction: Annotated[PerChannel, FRICTION] = 0.0
    stiffness: Annotated[PerChannel, STIFFNESS] = 0.0
    delay: Annotated[float, DELAY] = 1.0
    hold: Hold = Field(default="zoh", description=HOLD)
    sampling: Sampling = Field(default="ideal", description=SAMPLING)
    force_limit: Annotated[float, Quantity("Force that is never exceeded", "N", above=0)] = 10.0
    slew_limit: Annotated[float | None, SLEW_LIMIT] = None
    soft_start: Annotated[float | None, SOFT_START] = None
    energy_limit: Annotated[float | None, ENERGY_LIMIT] = None
    correction: CorrectionName = Field(default="none", description=CORRECTION)

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

    def stiffnesses(self, channels: int) -> tuple[float, ...]:
        """Stiffness of the real spring of each of ``channels`` channels, in N/m."""
        return per_channel(self.stiffness, channels)

    def _masses(self, channels: int) -> tuple[float | Span | Known, ...]:
        return self.mass if isinstance(self.mass, tuple) else (self.mass,) * channels
