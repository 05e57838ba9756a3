"""Types of the values of a scene that are no plain numbers or words."""

from typing import Any

from pydantic import BaseModel, ConfigDict, model_serializer


class WrittenAsMapping(BaseModel):
    """Number that the file gives as a mapping."""

    model_config = ConfigDict(frozen=True)

    def __str__(self) -> str:
        """Returns the mapping in braces, as a scene's file spells it."""
        return "{" + ", ".join(f"{key}: {value!r}" for key, value in self.model_dump().items()) + "}"


class Span(WrittenAsMapping):
    """An unknown number: `from` its least `to` its largest possible value."""

    least: float
    most: float

    @model_serializer
    def _as_written(self) -> dict[str, float]:
        return {"from": self.least, "to": self.most}


class Known(WrittenAsMapping):
    """A number that was measured, with its standard uncertainty."""

    value: float
    uncertainty: float


class Area(WrittenAsMapping):
    """A disc or a polygon in the plane, about the scene's position 0. SI units."""

    disc: float | None = None
    center: tuple[float, float] = (0.0, 0.0)
    polygon: tuple[tuple[float, float], ...] = ()

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Corners of the polygon, m; of a disc its centre."""
        return self.polygon or (self.center,)

    @property
    def radius(self) -> float:
        """Distance from the corners to the edge, m: of a disc."""
        return self.disc or 0.0

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Least and most x, and least and most y, m."""
        return tuple((min(each) - self.radius, max(each) + self.radius) for each in zip(*self.corners, strict=True))

    @model_serializer
    def _as_written(self) -> dict[str, Any]:
        return {"polygon": self.polygon} if self.polygon else {"disc": self.disc, "center": self.center}


#: A number of the scene file, or one for each channel of the device; a `Span` or `Known` in its place; or a word.
PerChannel = float | tuple[float, ...]
SpanPerChannel = float | Span | Known | tuple[float | Span | Known, ...]
WordPerChannel = float | str | tuple[float | str, ...]

#: A symmetric positive definite matrix, one row per channel: the mass of a device whose channels move each other.
Matrix = tuple[tuple[float, ...], ...]

#: A lower and an upper limit, or such a pair for each channel.
Limits = tuple[float, float]
LimitsPerChannel = Limits | tuple[Limits, ...]

#: A curve: points by ascending x, straight between them.
Curve = tuple[tuple[float, float], ...]


def per_channel(value: PerChannel, channels: int) -> tuple[float, ...]:
    """Returns one value for each of ``channels`` channels: a number is repeated, a tuple is taken as it is."""
    return value if isinstance(value, tuple) else (value,) * channels
