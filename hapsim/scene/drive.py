"""Transmission between a device's motor and its handle, and a motor whose force lags."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_args

from hapsim.dampers import DAMPERS
from hapsim.holds import HOLDS

from .choices import BY_SENSORS, PREDICTS
from .issue import Issue, Path
from .modules.links import ViscoElastic
from .quantity import quantity, word_per_channel
from .section import ModuleContext, Section
from .values import Known, PerChannel, Span, entries_of, per_channel
from .written_units import QUANTITY, in_si

Side = Literal["motor", "handle"]
"""Sides of a transmission."""

MOTOR_LAG = quantity(
    "Time constant with which the motor's force follows the commanded one, to first order",
    "s",
    least=0,
    most=1,
    per_channel=True,
)
TRANSMISSION = "What lies between the motor and the handle"
SIDES: tuple[Side, ...] = get_args(Side)


class Transmission(Section):
    """The belt, capstan or gear between the motor and the handle, which the hand holds: a spring with a damper. SI
    units."""

    stiffness: Annotated[PerChannel, quantity("Stiffness between motor and handle", "N/m", above=0, per_channel=True)]
    damping: Annotated[PerChannel, quantity("Damping between motor and handle", "N·s/m", least=0, per_channel=True)] = (
        0.0
    )
    motor_mass: Annotated[
        PerChannel,
        quantity(
            "Mass on the motor's side, a part of `mass`; 0: the channel has no transmission",
            "kg",
            least=0,
            per_channel=True,
        ),
    ]
    sensor: Annotated[Side | tuple[Side, ...], word_per_channel("Side whose position is read", SIDES)] = "motor"
    friction_at: Annotated[Side | tuple[Side, ...], word_per_channel("Side that has the friction", SIDES)] = "motor"
    backlash: Annotated[
        PerChannel,
        quantity("Play between motor and handle, in which neither moves the other", "m", least=0, per_channel=True),
    ] = 0.0


class Drive(NamedTuple):
    """Motor and transmission of one channel, from the commanded force to the hand. SI units, as in `Transmission`.

    The handle has the mass without ``motor_mass``, the hand and the device's own spring. The motor's force f follows
    the commanded u by ``lag`` f' + f = u.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    motor_mass: float = 0.0
    sensor: Side = "motor"
    friction_at: Side = "motor"
    backlash: float = 0.0
    lag: float = 0.0

    @property
    def is_elastic(self) -> bool:
        """True if motor and handle are two masses."""
        return self.motor_mass > 0.0

    @property
    def is_rigid(self) -> bool:
        """True if the commanded force acts at once on one mass."""
        return not self.is_elastic and self.lag == 0.0


def drives_of(transmission: Transmission | None, lag: PerChannel, channels: int) -> tuple[Drive, ...]:
    """Returns the drive of each of ``channels`` channels with this motor lag, in s."""
    lags = per_channel(lag, channels)
    if transmission is None:
        return tuple(Drive(lag=one) for one in lags)
    own = [one if isinstance(one, tuple) else (one,) * channels for _, one in transmission]
    each = (Drive(*parts) for parts in zip(*own, lags, strict=True))
    return tuple(one if one.is_elastic else Drive(lag=one.lag) for one in each)


def drive_issues(around: ModuleContext, parts: Mapping[Path, Mapping[str, Any]], space: object) -> Iterator[Issue]:
    """Yields what a device with a transmission or a motor lag, or its mock, cannot have. ``parts``: their sound
    fields."""
    known, whole, own = set[tuple[str, object]](), dict[str, Any](), dict[str, Any]()
    for name in ("device", "mock"):  # the mock is as the device where it says nothing
        stated = {key: value for key, value in parts[(name,)].items() if value is not None}
        whole, own = whole | stated, dict(parts[(name, "transmission")]) or own
        for key, unit, limits, words in _limits(whole):
            found = _numbers(own.get(key), unit)
            each = zip(found * max(1, len(limits)), limits * max(1, len(found)), strict=False)
            if high := next((pair for pair in each if pair[0] >= pair[1]), None):
                where = "" if "transmission" in stated else f" (device.transmission.{key})"
                sentence = f"found ‹{high[0]!r} {unit}›{where}, expected less than ‹{high[1]!r} {unit}›: {words}"
                if (key, high) not in known:
                    known.add((key, high))
                    yield Issue((name,) if where else (name, "transmission", key), sentence)
        acts = {
            "transmission": _numbers(own.get("motor_mass"), "kg"),
            "motor_lag": _numbers(whole.get("motor_lag"), "s"),
        }
        for key in (key for key, numbers in acts.items() if any(numbers)):
            for reason in _unfit(around, whole, space, key):
                if (key, reason) not in known:
                    known.add((key, reason))
                    yield Issue(
                        (name, key) if key in stated else (name,), f"found a {_WORDS[key]} {reason}", at_key=True
                    )


_WORDS = {"transmission": "transmission", "motor_lag": "motor lag"}


def _limits(device: Mapping[str, Any]) -> Iterator[tuple[str, str, list[float], str]]:
    """Yields the numbers of a transmission that have a limit, with its unit, that of each channel, and the reason."""
    grips = [mass for one in device.get("grips") or () for mass in _numbers(one[1:], "kg")]
    masses = [min([mass, *grips]) for mass in _numbers(device.get("mass"), "kg")]
    yield "motor_mass", "kg", masses, "the mass of motor, handle and hand together"
    travel = device.get("travel")
    pairs = travel if isinstance(travel, tuple | list) else ()
    each = (_numbers(one, "m") for one in ([pairs] if _numbers(pairs[:1], "m") else pairs))
    yield "backlash", "m", [high - low for low, high in each], "the travel, or the motor never moves the handle"


def _unfit(around: ModuleContext, device: Mapping[str, Any], space: object, key: str) -> Iterator[str]:
    """Yields what stands in the way of a transmission or a motor lag (``key``), to follow "found a motor lag"."""
    if space != 1:
        yield "in a scene with space: 2, expected none: its motion is derived for one coordinate"
    if key == "motor_lag" and HOLDS.get(hold := str(device.get("hold", "zoh")), HOLDS["zoh"]).has_impulses:
        yield f"with hold: {hold}, expected a hold without impulses, which a lag would spread"
    if device.get("sampling") == "average":
        yield "with sampling: average, expected sampling: ideal: the mean position is not derived for it"
    correction, lags = device.get("correction"), {*_numbers(device.get("motor_lag"), "s")}
    if correction in PREDICTS and key == "transmission":
        yield f"with correction: {correction}, which knows one mass; expected none or poles"
    elif correction in PREDICTS and len(lags) > 1:
        yield f"with correction: {correction}, which takes it as a longer delay: expected the same for all channels"
    elif correction in BY_SENSORS:
        yield f"with correction: {correction}: what sensors show behind it is not derived; expected none or poles"
    senses = [name for name, one in around.of_type(ViscoElastic, "damper").items() if DAMPERS[one.damper].senses]
    if device.get("sensors") or senses:
        sensed = f"with a damper that senses the velocity ({senses[0]})" if senses else "with sensors"
        yield f"{sensed}, expected positions alone: what else is sensed is not derived for it"


def _numbers(value: object, unit: str) -> list[float]:
    """Returns a number, or those of a list, in SI units, and the least one of a span. Values are numbers already, or
    text from the file; others are left out."""
    found = list[float]()
    for one in entries_of(value):
        if isinstance(one, Span | Known | dict):
            least, *_ = one.values() if isinstance(one, dict) else one.model_dump().values()
            found += _numbers(least, unit)
        elif isinstance(one, str) and QUANTITY.match(one):
            found.append(in_si(one, unit))
        elif isinstance(one, float | int):
            found.append(float(one))
    return found
