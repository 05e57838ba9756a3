"""The checks that need more than one part of a scene at once.

They take whatever parts are sound, so that a fault in one place does not hide faults in others.
"""

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from hapsim.dampers import DAMPERS
from hapsim.holds import HOLDS
from hapsim.scales import SCALES
from hapsim.units import MOTIONS, Motion

from .addresses import EXPECTED, address_of, is_address
from .admittance import admittance_issues
from .at_port import Owners, at_port_issue, device_names, modules_at, paths_at, port_issues
from .board import board_issues
from .choices import AHEAD, BY_SENSORS, SENSORS
from .drive import drive_issues
from .gates import gate_issues
from .issue import Issue, Path, quote
from .modules.detents import Detent
from .modules.links import Link, ViscoElastic
from .modules.point_modules import DevicePoint, Ground, Proxy
from .plane_checks import space_issues
from .scaled_links import scale_issues
from .section import ModuleContext
from .sound_channels import sound_issues
from .values import Span, entries_of
from .words import word_issues
from .written_units import QUANTITY, in_si

#: The parts that may have lists with one value per channel.
PER_CHANNEL_PARTS: tuple[Path, ...] = (
    ("device",),
    ("device", "transmission"),
    ("device", "assumed_hand"),
    ("device", "servo"),
    ("mock",),
    ("mock", "transmission"),
    ("mock", "servo"),
    ("mock", "force_sensor"),
    ("mock", "initial"),
    ("mock", "hand"),
)

#: Fields by the path of the part that they belong to.
Fields = Mapping[Path, Mapping[str, object]]

#: Counts of the encoder in a detent: one for each quarter of its force.
_LEAST_COUNTS = 4

#: The lists that have no value for each channel.
_LISTS = ("grips", "sensors")


def cross_check_issues(around: ModuleContext, per_channel: Fields, scene: Mapping[str, object]) -> Iterator[Issue]:
    """Yields the faults between the parts.

    Args:
        around: the modules.
        per_channel: the sound fields of the parts that may have lists with one value per channel.
        scene: what else it says, made or as written.
    """
    for name, module in around.modules.items():
        yield from module.issues(name, around)
    if None not in (kinds := around.kinds.values()) and DevicePoint not in kinds:
        sentence = "found no module of type device, expected at least one for the hand to hold"
        yield Issue(("modules",), sentence, at_key=True)
    if isinstance(sound := scene.get("sound"), Mapping):
        yield from sound_issues(sound, around, scene.get("scheme"))
    yield from port_issues(around, scene)
    if not (names := device_names(scene)):
        yield from _issues_at_device(around, per_channel, scene)
    owners, yielded = Owners(around, scene.get("leader") or next(iter(names), None)), set[Issue]()
    for name in names:
        parts = {path: per_channel[there] for path, there in paths_at(name, PER_CHANNEL_PARTS).items()}
        own = dict(scene) | {"sound": {}, "device": scene["devices"][name]}  # type: ignore[index]
        for issue in _issues_at_device(modules_at(around, owners, name)[0], parts, own):
            if (found := at_port_issue(issue, name)) not in yielded:  # a link between two devices is seen twice
                yielded.add(found)
                yield found
    yield from _links_of_both_motions(around, _motions(per_channel, names))


def per_channel_paths(scene: Mapping[str, object]) -> list[Path]:
    """Returns where a scene, made or as written, has lists with one value per channel."""
    each: Sequence[str | None] = device_names(scene) or (None,)
    return [there for name in each for there in paths_at(name, PER_CHANNEL_PARTS).values()]


def _motions(per_channel: Fields, names: Sequence[str]) -> object:
    """Returns what `motions_of` takes."""
    if not names:
        return per_channel[("device",)].get("motion")
    return {name: per_channel[("devices", name)].get("motion", "linear") for name in names}


def _issues_at_device(around: ModuleContext, per_channel: Fields, scene: Mapping[str, object]) -> Iterator[Issue]:
    """Yields the faults of a device and its mock, and of what a scene has with them."""
    kinds = around.kinds.values()
    yield from _device_issues(per_channel[("device",)])
    yield from space_issues(around, scene, per_channel[("device",)])
    yield from _coupled_issues(per_channel[("device",)], per_channel[("mock",)], scene.get("space", 1))
    yield from drive_issues(around, per_channel, scene.get("space", 1))
    yield from board_issues(around, per_channel, scene)
    yield from admittance_issues(around, per_channel, scene)
    yield from gate_issues(around, per_channel, scene)
    yield from scale_issues(around, per_channel, scene)
    substeps = scene.get("substeps")
    if isinstance(substeps, int) and substeps > 1:
        yield from _dampers_across_steps(around)
        yield from _predicted_mean(per_channel[("device",)])
    if Proxy in kinds:
        yield from _proxy_issues(around, per_channel[("device",)], scene)
    yield from word_issues(scene, per_channel[("mock",)].get("inputs"), around)
    if per_channel[("device",)].get("port") is None:
        yield from narrow_detents(around, _counts_of_mock(per_channel), "mock.quantum")
    yield from lists_of_another_length(per_channel, _channels(around))


def _proxy_issues(around: ModuleContext, device: Mapping[str, object], scene: Mapping[str, object]) -> Iterator[Issue]:
    """Yields what a proxy's implicit step cannot do."""
    alone = {("scheme",): (scene, "cordis"), ("substeps",): (scene, 1), ("device", "correction"): (device, "none")}
    for path, (part, right) in alone.items():
        if (found := part.get(path[-1], right)) != right:
            yield Issue(
                path,
                f"found {found} in a scene with a proxy, expected {right}, the only one for which its step is derived",
            )
    falls: defaultdict[str, float] = defaultdict(float)
    for name, link in around.modules.items():
        if not isinstance(link, Link) or not around.knows(name, *type(link).model_fields):
            continue
        ends = [end for end in link.between if around.kinds.get(end) is Proxy]
        for end in ends[:1]:
            falls[end] -= min(link.law().sector[0], 0.0)
            words, fit = f"{quote(end)}, a proxy, at an end of a {link.type}{_unfit_at_proxy(link)}", _FIT_AT_PROXY
            if len(ends) > 1:
                words, fit = " and ".join(map(quote, ends)), "a proxy at one end only"
            if len(ends) > 1 or _unfit_at_proxy(link):
                yield Issue(("modules", name, "between"), f"found {words}; expected {fit}")
    for name, fall in falls.items():
        proxy, rate = around.modules.get(name), scene.get("rate")
        if not isinstance(proxy, Proxy) or not isinstance(rate, int | float) or around.faulty.get(name):
            continue
        if fall >= proxy.mass * rate**2 + proxy.stiffness + proxy.damping * rate:
            found = f"found ‹{proxy.mass!r} kg›: links that fall by ‹{fall!r} N/m›"
            sentence = f"{found} push it to several places at once; expected a larger mass"
            yield Issue(("modules", name, "mass"), sentence)


_FIT_AT_PROXY = (
    "a spring, damper, viscoelastic (damper: backward), buffer, click, a detent (shape: snap or notch) or a nonlinear "
    "without force_over_velocity"
)


def _unfit_at_proxy(link: Link) -> str:
    """Returns words on why this link cannot end on a proxy, to follow its type; "" if it can."""
    law, damper = link.law(), getattr(link, "damper", "backward")
    unfit = {f" with damper: {damper}": damper != "backward", " with force_over_velocity": bool(law.speeds)}
    unfit |= {", which has a memory": not law.memoryless, " of shape: sine": law.is_curved}
    return next((words for words, is_so in unfit.items() if is_so), "")


def _device_issues(device: Mapping[str, object]) -> Iterator[Issue]:
    mass = device.get("mass")
    if device.get("correction") == "adaptive" and not any(
        one is None or isinstance(one, Span | list | tuple) or (isinstance(one, dict) and "from" in one)
        for one in entries_of(mass)
    ):
        yield Issue(
            ("device", "correction"),
            "found adaptive with a known mass; write device.mass: {from: the least, to: the most}, "
            "or correction: predictor",
        )
    yield from _sensor_issues(device)
    if isinstance(port := device.get("port"), str) and is_address(port) and address_of(port) is None:
        yield Issue(("device", "port"), f"found {quote(port)}, expected {EXPECTED}, or a serial port")
    if device.get("travel_margin") is not None and device.get("travel") is None:
        yield Issue(
            ("device", "travel_margin"),
            "found a margin without a travel; add device.travel: [the least, the most], or omit the margin",
            at_key=True,
        )


def _is_coupled(mass: object) -> bool:
    """Returns whether a mass, made or as written, is a matrix with numbers beside its diagonal."""
    return any(one for i, row in enumerate(entries_of(mass)) if isinstance(row, list | tuple) for one in row[:i])


def _coupled_issues(device: Mapping[str, object], mock: Mapping[str, object], space: object) -> Iterator[Issue]:
    """Yields what a device whose mass is a matrix, or its mock, cannot have. Corrections are for one coordinate, in
    which a hand moves one mass: with a matrix it moves another in each direction."""
    for path, mass in ((("device", "mass"), device.get("mass")), (("mock", "mass"), mock.get("mass"))):
        if _is_coupled(mass) and space == 1:
            found = "found a matrix in a scene with one coordinate"
            yield Issue(path, f"{found}, expected a number, or a list with one per channel; or write space: 2")
    if _is_coupled(device.get("mass")) and any(entries_of(device.get("stiffness"))):
        sentence = "found a spring in a device whose mass is a matrix, expected 0: its motion is not predicted"
        yield Issue(("device", "stiffness"), sentence)
    if _is_coupled(mock.get("mass") or device.get("mass")):
        if mock.get("coulomb"):
            sentence = "found dry friction with a mass that is a matrix, expected 0: its motion has no closed form"
            yield Issue(("mock", "coulomb"), sentence)
        if mock.get("grips"):
            sentence = "found grips with a mass that is a matrix, expected none: they give every channel one mass"
            yield Issue(("mock", "grips"), sentence, at_key=True)


def _sensor_issues(device: Mapping[str, object]) -> Iterator[Issue]:
    sensors, is_sensed = device.get("sensors", ()), device.get("correction") in BY_SENSORS
    missing = [name for name in SENSORS if name not in sensors] if isinstance(sensors, tuple | list) else []
    if is_sensed and missing:
        sentence = f"found sensed without a sensor of the {' and the '.join(missing)}; write device.sensors: "
        sentence += f"[{', '.join(SENSORS)}] if the device has them, or correction: predictor, which needs none"
        yield Issue(("device", "correction"), sentence)
    if is_sensed and isinstance(hold := device.get("hold", "zoh"), str) and not HOLDS[hold].keeps_last_force:
        sentence = f"found sensed with hold: {hold}: no sensor shows its acceleration; expected correction: predictor"
        yield Issue(("device", "correction"), sentence)
    if device.get("acceleration_age") and "acceleration" in missing:
        sentence = "found an age without the sensor; add device.sensors: [acceleration], or omit the age"
        yield Issue(("device", "acceleration_age"), sentence, at_key=True)


def _predicted_mean(device: Mapping[str, object]) -> Iterator[Issue]:
    if device.get("decimation") == "mean" and (correction := device.get("correction")) in AHEAD:
        yield Issue(
            ("device", "decimation"),
            f"found mean with correction: {correction}, whose force answers one state, that of the last substep; "
            "expected last, or correction: poles",
        )


def _counts_of_mock(per_channel: Fields) -> Callable[[int], float]:
    """A function of a channel: m per count. 0 where the file has something else."""
    quantum, motions = per_channel[("mock",)].get("quantum"), per_channel[("device",)].get("motion", "linear")

    def count(channel: int) -> float:
        """Returns the m per count of a channel."""
        if isinstance(quantum, str) and QUANTITY.match(quantum):  # where the scene has other faults
            return in_si(quantum, "m per count")
        if isinstance(quantum, int | float):
            return float(quantum)
        each = motions[channel : channel + 1] if isinstance(motions, list | tuple) else [motions]
        return 0.0 if quantum is not None else sum(SCALES[one].position_count for one in each if one in SCALES)

    return count


def narrow_detents(around: ModuleContext, quantum: Callable[[int], float], source: str) -> Iterator[Issue]:
    """Yields detents at a device point that its encoder does not resolve. `quantum`: m per count, from `source`."""
    known = around.of_type(Detent, "between", "pitch", "places", "shape", "sharpness")
    for name, detent in known.items():
        for hand in (around.modules[end] for end in detent.between if around.knows(end, "channel")):
            if not isinstance(hand, DevicePoint) or len(hand.all_channels) != 1:
                continue
            if detent.width < _LEAST_COUNTS * (count := quantum(hand.channel)):
                way = min(detent.ways)
                width = "" if detent.width == way else f", a notch of ‹{detent.width!r} m›"
                found = f"found ‹{way!r} m›{width}: {detent.width / count:.3g} counts of the encoder"
                sentence = f"{found} ({source}: ‹{count!r} m›); expected {_LEAST_COUNTS} or more"
                yield Issue(("modules", name, "pitch" if detent.pitch else "places"), sentence)


def _dampers_across_steps(around: ModuleContext) -> Iterator[Issue]:
    for name, link in around.of_type(ViscoElastic, "damper").items():
        if DAMPERS[link.damper].looks_back > 1:
            sentence = (
                f"found {link.damper} in a scene with substeps, of which it would use the last two alone; "
                "expected another damper, such as backward, or substeps: 1"
            )
            yield Issue(("modules", name, "damper"), sentence)


def motions_of(around: ModuleContext, motions: object) -> dict[str, Motion]:
    """Motion of each hand, and of the points and links that hang on it, except grounds; none where all have one.
    `motions`: a list by channel; by name for several devices, each a list or a word."""
    neighbours: defaultdict[str, list[str]] = defaultdict(list)
    for name, link in around.of_type(Link, "between").items():
        # A link with a ratio has the motion of its first end.
        for end in map(around.holder, link.between[: 1 if getattr(link, "ratio", None) else 2]):
            if around.kinds.get(end) is not Ground:
                neighbours[name].append(end)
                neighbours[end].append(name)
    for name, proxy in around.of_type(Proxy, "hand").items():
        neighbours[name].append(proxy.hand)
        neighbours[proxy.hand].append(name)
    by_device = motions if isinstance(motions, Mapping) else {None: motions}
    hands = around.of_type(DevicePoint, "channel", "channels", "of")
    found = {name: motion for name, hand in hands.items() if (motion := _motion_of(hand, by_device))}
    ahead = deque(found)
    while ahead:
        one = ahead.popleft()
        reached = [other for other in neighbours[one] if other not in found]
        found |= dict.fromkeys(reached, found[one])
        ahead.extend(reached)
    return found


def _motion_of(hand: DevicePoint, by_device: Mapping[Any, object]) -> Motion | None:
    """Returns the motion of a hand; None where it is unknown, or that of all."""
    motion, own = by_device.get(hand.of), hand.all_channels
    if isinstance(motion, list | tuple):
        motion = motion[own[0]] if own and own[0] < len(motion) else None
    elif None in by_device:
        return None
    return motion if motion in MOTIONS else None


def _links_of_both_motions(around: ModuleContext, motions: object) -> Iterator[Issue]:
    found = motions_of(around, motions)
    for name, link in around.of_type(Link, "between", "ratio").items():
        ends = {end: found.get(around.holder(end)) for end in link.between}
        differ, ratio = {*MOTIONS} <= {*ends.values()}, getattr(link, "ratio", None)
        per_channel = "(device.motion has one for each channel)"
        if ratio and not differ and not (isinstance(motions, list | tuple) and None in ends.values()):
            sentence = f"found a ratio between {' and '.join(map(quote, ends))}, of one motion; expected a linear"
            yield Issue(("modules", name, "ratio"), f"{sentence} and a rotary end, or no ratio {per_channel}")
        elif differ and not ratio:
            of_them = " and ".join(f"{quote(end)}, which is {motion}" for end, motion in ends.items())
            sentence = f"linear and rotary mixed on one link: found {of_them}; expected two ends of one motion, or"
            yield Issue(("modules", name, "between"), f"{sentence} a ratio {per_channel}")


def _channels(around: ModuleContext) -> int | None:
    """Number of channels, or None where a faulty module leaves it open."""
    kinds = around.kinds
    if any(kinds[name] in (None, DevicePoint) and not around.knows(name, "channel", "channels") for name in kinds):
        return None
    own = {name: one for name, one in around.modules.items() if name not in around.away}
    points = [module.all_channels for module in own.values() if isinstance(module, DevicePoint)]
    return max((1 + channel for channels in points for channel in channels), default=None) if all(points) else None


def lists_of_another_length(per_channel: Fields, channels: int | None) -> Iterator[Issue]:
    """Yields the lists of these parts that do not have a value for each channel."""
    fields = [((*path, name), value) for path, part in per_channel.items() for name, value in part.items()]
    for path, value in fields:
        one = {"travel": "pair", "motion": "word", "sensor": "word", "friction_at": "word"}.get(str(path[-1]), "number")
        if (
            path[-1] == "mass"
            and isinstance(value, list | tuple)
            and any(isinstance(row, list | tuple) for row in value)
        ):
            one = "row"
        if not channels or not isinstance(value, list | tuple) or path[-1] in _LISTS:
            continue
        if len(value) != channels and (one != "pair" or isinstance(value[0], list | tuple)):
            found = f"found {len(value)} {one}{'' if len(value) == 1 else 's'}"
            expected = f"expected {channels}: one for each channel, up to the highest that a module holds"
            yield Issue(path, f"{found}, {expected}; or write a single {one.replace('row', 'number')} for all")
