"""The checks that need more than one part of a scene at once.

They take whatever parts are sound, so that a file with a fault in one place still hears about the others.
"""

from collections.abc import Iterator, Mapping

from .issue import Issue, Path
from .modules import DevicePoint, ModuleContext
from .part import Part
from .quantity import Span

#: The parts that may have lists with one value per channel.
PER_CHANNEL_PARTS: tuple[Path, ...] = (("device",), ("mock",), ("mock", "initial"), ("mock", "hand"))

_OTHER_LISTS = ("grips",)  # that do not have a value for each channel

#: Fields by the path of the part that they belong to.
Fields = Mapping[Path, Mapping[str, object]]

#: The largest number of 32 bits.
MOST_SINGLE = (2.0 - 2.0**-23) * 2.0**127


def cross_check_issues(around: ModuleContext, per_channel: Fields, precision: object) -> list[Issue]:
    """The faults between the parts.

    Args:
        around: the modules.
        per_channel: the sound fields of the parts that may have lists with one value per channel.
        precision: in which the modules are worked out.
    """
    issues = [issue for name, module in around.modules.items() for issue in module.issues(name, around)]
    kinds = around.kinds.values()
    if None not in kinds and DevicePoint not in kinds:
        issues.append(
            Issue(
                ("modules",),
                "found no module of type device, expected at least one: it is what the hand holds",
                at_key=True,
            )
        )
    if precision == "single":
        issues += _beyond_single(around)
    issues += _nothing_to_adapt_to(per_channel[("device",)])
    issues += _margin_of_nothing(per_channel[("device",)])
    channels = _channels(around)
    if channels is not None:
        issues += _lists_of_another_length(per_channel, channels)
    return issues


def _nothing_to_adapt_to(device: Mapping[str, object]) -> Iterator[Issue]:
    if device.get("correction") != "adaptive" or "mass" not in device:
        return
    masses = device["mass"] if isinstance(device["mass"], tuple) else (device["mass"],)
    if not any(isinstance(mass, Span) for mass in masses):
        yield Issue(
            ("device", "correction"),
            "found adaptive with a mass that is known, expected device.mass: {from: the least, to: the most}; "
            "or write correction: predictor",
        )


def _margin_of_nothing(device: Mapping[str, object]) -> Iterator[Issue]:
    if "travel_margin" in device and device["travel_margin"] is not None and device.get("travel") is None:
        yield Issue(
            ("device", "travel_margin"),
            "found a margin without a travel, expected device.travel: [the least, the most] beside it; or leave it out",
            at_key=True,
        )


def _channels(around: ModuleContext) -> int | None:
    """Number of channels, or None where a faulty module leaves it open."""
    kinds = around.kinds
    if any(kinds[name] in (None, DevicePoint) and not around.knows(name, "channel") for name in kinds):
        return None
    used = [module.channel for module in around.modules.values() if isinstance(module, DevicePoint)]
    return 1 + max(used) if used else None


def _lists_of_another_length(per_channel: Fields, channels: int) -> Iterator[Issue]:
    for path, fields in per_channel.items():
        for name, value in fields.items():
            if name in _OTHER_LISTS or (name == "travel" and not _is_of_lists(value)):
                continue
            if isinstance(value, list | tuple) and len(value) != channels:
                one = "pair" if name == "travel" else "number"
                found = f"found {len(value)} {one}{'' if len(value) == 1 else 's'}"
                expected = f"expected {channels}: one for each channel, up to the highest that a module holds"
                yield Issue((*path, name), f"{found}, {expected}; or write a single {one} for all")


def _is_of_lists(value: object) -> bool:
    """Whether these are the limits of several channels, rather than one pair for all."""
    return isinstance(value, list | tuple) and isinstance(value[0], list | tuple)


def _beyond_single(around: ModuleContext) -> Iterator[Issue]:
    for name, module in around.modules.items():
        for field in type(module).model_fields:
            if around.knows(name, field):
                for path, value in _numbers(getattr(module, field)):
                    if abs(value) > MOST_SINGLE:
                        yield Issue(
                            ("modules", name, field, *path),
                            f"found {value:g}, beyond the numbers of precision: single, which end at "
                            f"{MOST_SINGLE:.2g}; expected a smaller one, or precision: double",
                        )


def _numbers(value: object) -> Iterator[tuple[Path, float]]:
    """The numbers in a field's value, each with what leads to it."""
    if isinstance(value, int | float):
        yield (), value
    elif isinstance(value, Part):
        for field in type(value).model_fields:
            for path, number in _numbers(getattr(value, field)):
                yield (field, *path), number
    elif isinstance(value, tuple):
        for index, entry in enumerate(value):
            for path, number in _numbers(entry):
                yield (index, *path), number
