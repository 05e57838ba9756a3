"""Admittance mode: the simulated mass at the device point, the hand that it assumes, the servo that follows its
position, and the force sensor of the mock; and what does not go with the mode."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import AfterValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError, core_schema

from hapsim.dampers import DAMPERS

from .issue import Issue, Path, with_article
from .modules.links import ViscoElastic
from .quantity import Expectation, quantity
from .schemas import with_message
from .section import ModuleContext, Section
from .values import PerChannel, SpanPerChannel, per_channel, spans_of

Mode = Literal["impedance", "admittance"]
_MODES = "impedance or admittance, one for all channels of the device"
MODE = Expectation(
    "What the device renders: a force, from the position that it measures (impedance); or a position, from the force "
    "that it measures (admittance)",
    _MODES,
    with_message(core_schema.literal_schema(list(get_args(Mode))), _MODES),
)
ForceFault = Literal["none", "dead", "inverted"]

SIMULATED_MASS = quantity(
    "Mass of the device point, which the sensed force moves",
    "kg",
    above=0,
    per_channel=True,
    left_out="none: required with mode: admittance",
)
SIMULATED_DAMPING = quantity("Damping of the device point to the ground", "N·s/m", least=0, per_channel=True)
SPEED_LIMIT = quantity("Largest speed of a commanded position", "m/s", above=0, left_out="1 m/s, or 20 rad/s")
ACCELERATION_LIMIT = quantity(
    "Largest acceleration of a commanded position", "m/s²", above=0, left_out="100 m/s², or 2000 rad/s²"
)


def required_with(mode: Mode) -> tuple[Any, ...]:
    """Returns the metadata of a field without which a device in this mode is none. ``mode`` stands before it."""

    def check(value: Any, info: ValidationInfo) -> Any:
        if value is None and info.data.get("mode") == mode:
            raise PydanticCustomError("missing", "Field required")
        return value

    return AfterValidator(check), Field(validate_default=True)


class AssumedHand(Section):
    """The hand for which an admittance is judged: a spring and a damper to where it is, on the handle. SI units."""

    stiffness: Annotated[
        SpanPerChannel, quantity("Stiffness of the hand", "N/m", least=0, per_channel=True, spans=True)
    ]
    damping: Annotated[
        SpanPerChannel, quantity("Viscosity of the hand", "N·s/m", least=0, per_channel=True, spans=True)
    ] = 0.0
    mass: Annotated[
        PerChannel, quantity("Mass of hand and handle beyond the force sensor", "kg", least=0, per_channel=True)
    ] = 0.0


class Servo(Section):
    """The device's own position loop, of second order: x'' + 2 ζ ω x' + ω² x = ω² times the command, with
    ω = 2 π ``bandwidth`` and ζ = ``damping``. SI units."""

    bandwidth: Annotated[PerChannel, quantity("Natural frequency of the servo", "Hz", above=0, per_channel=True)]
    damping: Annotated[PerChannel, quantity("Damping ratio of the servo", "1", above=0, per_channel=True)] = 1.0


class ForceSensor(Section):
    """The mock's sensor of the force between hand and handle, with its faults. SI units."""

    limit: Annotated[
        float | None, quantity("Force at which the sensor saturates", "N", above=0, left_out="ten times force_limit")
    ] = None
    quantum: Annotated[
        float | None, quantity("Step of the force", "N per count", above=0, left_out="as fine as its 32 bits are")
    ] = None
    offset: Annotated[PerChannel, quantity("Force that the sensor shows without a hand", "N", per_channel=True)] = 0.0
    drift: Annotated[float, quantity("Change of the offset", "N/s")] = 0.0
    noise: Annotated[float, quantity("Noise of the force", "N rms", least=0)] = 0.0
    fault: ForceFault = Field(
        default="none", description="A sensor that keeps its count (dead), or has the other sign (inverted)"
    )
    fault_time: Annotated[float, quantity("Time at which the fault begins", "s", least=0)] = 0.0


class ServoOfChannel(NamedTuple):
    """Servo of one channel: Hz, and a ratio."""

    bandwidth: float
    damping: float


class HandOfChannel(NamedTuple):
    """The assumed hand of one channel: least and most stiffness, N/m, and damping, N·s/m; mass, kg."""

    stiffness: tuple[float, float]
    damping: tuple[float, float]
    mass: float


def servos_of(servo: Servo | None, channels: int) -> tuple[ServoOfChannel | None, ...]:
    """Returns the servo of each of ``channels`` channels; None: it follows its commands exactly."""
    if servo is None:
        return (None,) * channels
    both = (per_channel(one, channels) for one in (servo.bandwidth, servo.damping))
    return tuple(ServoOfChannel(*one) for one in zip(*both, strict=True))


def hands_of(hand: AssumedHand | None, channels: int) -> tuple[HandOfChannel, ...]:
    """Returns the assumed hand of each of ``channels`` channels; without one none holds the device."""
    if hand is None:
        return (HandOfChannel((0.0, 0.0), (0.0, 0.0), 0.0),) * channels
    spans = (spans_of(per_channel(one, channels)) for one in (hand.stiffness, hand.damping))
    return tuple(HandOfChannel(*one) for one in zip(*spans, per_channel(hand.mass, channels), strict=True))


_OF_ADMITTANCE: dict[Path, tuple[str, ...]] = {
    ("device",): (
        "simulated_mass",
        "simulated_damping",
        "assumed_hand",
        "servo",
        "speed_limit",
        "acceleration_limit",
    ),
    ("mock",): ("servo",),
    ("mock", "hand"): ("mass",),
    ("mock", "force_sensor"): tuple(ForceSensor.model_fields),
}
"""Keys that need the mode, by part."""
_OF_IMPEDANCE = {
    "mass": "the mass at the hand is simulated_mass",
    "friction": "the servo overcomes it",
    "mass_at": "the servo hides the device's mass",
    "stiffness": "the servo overcomes it",
    "transmission": "the servo hides it",
    "motor_lag": "the servo hides it",
    "coulomb": "the servo overcomes it",
    "grips": "the hand is a spring and a damper beyond the force sensor",
    "cogging": "the servo overcomes it",
    "force_noise": "no force is commanded",
    "saturation": "no force is commanded",
    "when": "a device without torque follows no command",
}
_NOTHING = (None, 0.0, (), "none")
_ALONE = {
    "hold": ("zoh", "commands are positions"),
    "sampling": ("ideal", "the force is read at an instant"),
    "law": ("host", "the board follows a position, not a force law"),
    "correction": ("none", "it corrects a force, and the device point has no force of its own to correct"),
}


def _without_mode(parts: Mapping[Path, Mapping[str, Any]]) -> Iterator[Issue]:
    for path, keys in _OF_ADMITTANCE.items():
        for key in (key for key in keys if parts[path].get(key) not in _NOTHING):
            sentence = f"found {with_article(key)} without its mode; add device.mode: admittance, or omit {key}"
            yield Issue((*path, key), sentence, at_key=True)


def admittance_issues(
    around: ModuleContext, parts: Mapping[Path, Mapping[str, Any]], scene: Mapping[str, object]
) -> Iterator[Issue]:
    """Yields what does not fit the mode of the device. ``parts``: the sound fields of device and mock."""
    device, mock, written = parts[("device",)], parts[("mock",)], scene.get("device")
    if "mode" not in device and isinstance(written, Mapping) and "mode" in written:
        return  # it is no mode, which is another issue
    if device.get("mode", "impedance") != "admittance":
        yield from _without_mode(parts)
        return
    for name, part in (("device", device), ("mock", mock)):
        for key, why in _OF_IMPEDANCE.items():
            if part.get(key) not in _NOTHING:
                sentence = f"found {with_article(key)} with mode: admittance, expected none: {why}"
                yield Issue((name, key), sentence, at_key=True)
        for key, (right, why) in _ALONE.items():
            if (found := part.get(key)) not in (None, right):
                yield Issue((name, key), f"found {found} with mode: admittance, expected {right}: {why}")
    if scene.get("space", 1) != 1:
        yield Issue(("device", "mode"), "found admittance with space: 2, expected impedance: it has one coordinate")
    if device.get("clock") == "host":
        sentence = "found host with mode: admittance, expected device or lockstep: a timer of the device paces it"
        yield Issue(("device", "clock"), sentence)
    for name, link in around.of_type(ViscoElastic, "damper").items():
        if DAMPERS[link.damper].senses:
            sentence = f"found {link.damper} with mode: admittance, in which the device point's velocity is computed"
            yield Issue(("modules", name, "damper"), f"{sentence}; expected backward")
