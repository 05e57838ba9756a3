"""The checks that need more than one part of a scene at once.

They take whatever parts are sound, so that a fault in one place does not hide faults in others.
"""

from collections.abc import Callable, Iterator, Mapping

from .issue import Issue, Path
from .modules import Detent, DevicePoint, ModuleContext
from .part import Part
from .quantity import Span

#: The parts that may have lists with one value per channel.
PER_CHANNEL_PARTS: tuple[Path, ...] = (("device",), ("mock",), ("mock", "initial"), ("mock", "hand"))

#: Fields by the path of the part that they belong to.
Fields = Mapping[Path, Mapping[str, object]]

#: The largest number of 32 bits.
MOST_SINGLE = (2.0 - 2.0**-23) * 2.0**127

#: Counts of the encoder in a detent: one for each quarter of its force.
_LEAST_COUNTS = 4


def cross_check_issues(around: ModuleContext, per_channel: Fields, precision: object) -> Iterator[Issue]:
    """Yields the faults between the parts.

    Args:
        around: the modules.
        per_channel: the sound fields of the parts that may have lists with one value per channel.
        precision: of the scene, as written.
    """
    for name, module in around.modules.items():
        yield from module.issues(name, around)
    kinds = around.kinds.values()
    if None not in kinds and DevicePoint not in kinds:
        sentence = "found no module of type device, expected at least one: it is what the hand holds"
        yield Issue(("modules",), sentence, at_key=True)
    if precision == "single":
        yield from _beyond_single(around)
    yield from _device_issues(per_channel[("device",)])
    quantum = per_channel[("mock",)].get("quantum", 1e-9)
    if per_channel[("device",)].get("port") is None and isinstance(quantum, int | float):
        yield from narrow_detents(around, lambda _: float(quantum), "mock.quantum")
    yield from _lists_of_another_length(per_channel, _channels(around))


def _device_issues(device: Mapping[str, object]) -> Iterator[Issue]:
    mass = device.get("mass")
    masses = mass if isinstance(mass, tuple | list) else [mass]
    if device.get("correction") == "adaptive" and not any(one is None or _is_span(one) for one in masses):
        yield Issue(
            ("device", "correction"),
            "found adaptive with a mass that is known, expected device.mass: {from: the least, to: the most}; "
            "or write correction: predictor",
        )
    if device.get("travel_margin") is not None and device.get("travel") is None:
        yield Issue(
            ("device", "travel_margin"),
            "found a margin without a travel, expected device.travel: [the least, the most] beside it; or omit it",
            at_key=True,
        )


def narrow_detents(around: ModuleContext, quantum: Callable[[int], float], source: str) -> Iterator[Issue]:
    """Yields the detents at a device point that its encoder does not resolve. `quantum`: of a channel, m; `source`: who
    says so."""
    for name, detent in around.modules.items():
        if not isinstance(detent, Detent) or not around.knows(name, "between", "pitch", "shape", "sharpness"):
            continue
        for hand in (around.modules[end] for end in detent.between if around.knows(end, "channel")):
            if isinstance(hand, DevicePoint) and detent.width < _LEAST_COUNTS * (count := quantum(hand.channel)):
                width = "" if detent.width == detent.pitch else f", a notch of {detent.width:g}"
                found = f"found {detent.pitch:g}{width}: {detent.width / count:.3g} counts of the encoder"
                sentence = f"{found} ({source}: {count:g}); expected {_LEAST_COUNTS} or more"
                yield Issue(("modules", name, "pitch"), sentence)


def _is_span(mass: object) -> bool:
    return isinstance(mass, Span) or (isinstance(mass, dict) and "from" in mass)


def _channels(around: ModuleContext) -> int | None:
    """Number of channels, or None where a faulty module leaves it open."""
    kinds = around.kinds
    if any(kinds[name] in (None, DevicePoint) and not around.knows(name, "channel") for name in kinds):
        return None
    points = [module for module in around.modules.values() if isinstance(module, DevicePoint)]
    return max((1 + point.channel for point in points), default=None)


def _lists_of_another_length(per_channel: Fields, channels: int | None) -> Iterator[Issue]:
    fields = [((*path, name), value) for path, part in per_channel.items() for name, value in part.items()]
    for path, value in fields:
        one = "pair" if path[-1] == "travel" else "number"
        if not channels or not isinstance(value, list | tuple) or path[-1] == "grips":
            continue
        if len(value) != channels and (one == "number" or isinstance(value[0], list | tuple)):
            found = f"found {len(value)} {one}{'' if len(value) == 1 else 's'}"
            expected = f"expected {channels}: one for each channel, up to the highest that a module holds"
            yield Issue(path, f"{found}, {expected}; or write a single {one} for all")


def _beyond_single(around: ModuleContext) -> Iterator[Issue]:
    expected = f"beyond the numbers of precision: single, which end at {MOST_SINGLE:.2g}; expected a smaller one"
    for name, module in around.modules.items():
        known = {field: getattr(module, field) for field in type(module).model_fields if around.knows(name, field)}
        for path, value in _numbers(known):
            if abs(value) > MOST_SINGLE:
                yield Issue(("modules", name, *path), f"found {value:g}, {expected}, or precision: double")


def _numbers(value: object) -> Iterator[tuple[Path, float]]:
    """The numbers in a value, each with its path."""
    if isinstance(value, int | float):
        yield (), value
    elif isinstance(value, tuple | Part | dict):
        for step, entry in enumerate(value) if isinstance(value, tuple) else dict(value).items():
            yield from (((step, *path), number) for path, number in _numbers(entry))
