"""The checks that need more than one part of a scene at once.

They take whatever parts are sound, so that a file with a fault in one place still hears about the others.
"""

from collections.abc import Iterator, Mapping

from .issue import Issue, Path
from .modules import DevicePoint, ModuleContext

#: The parts that may have lists with one value per channel.
PER_CHANNEL_PARTS: tuple[Path, ...] = (("device",), ("mock",), ("mock", "initial"))

#: Fields by the path of the part that they belong to.
Fields = Mapping[Path, Mapping[str, object]]


def cross_check_issues(around: ModuleContext, per_channel: Fields) -> list[Issue]:
    """The faults between the parts.

    Args:
        around: the modules.
        per_channel: the sound fields of the parts that may have lists with one value per channel.
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
    channels = _channels(around)
    if channels is not None:
        issues += _lists_of_another_length(per_channel, channels)
    return issues


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
            if isinstance(value, list | tuple) and len(value) != channels:
                found = f"found {len(value)} {'number' if len(value) == 1 else 'numbers'}"
                expected = f"expected {channels}: one for each channel, up to the highest that a module holds"
                yield Issue((*path, name), f"{found}, {expected}; or write a single number for all")
