"""Plausibility of a scene's values: a wrong unit, or a factor of a thousand.

Most keys of a scene take any number, in SI units: a mass of 200 is 200 kg. Only the devices that people build show that
grams were meant. A wrong value within these ranges is not found.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from hapsim.number_format import duration, frequency, number, plural, short, short_duration
from hapsim.prediction.characteristic import characteristic_of
from hapsim.prediction.linear import configuration_of
from hapsim.prediction.plane_geometry import Plane
from hapsim.scene import Mock, Scene
from hapsim.scene.modules.links import ViscoElastic
from hapsim.scene.modules.surfaces import Shape
from hapsim.scene.quantity import Expectation, expectation_of
from hapsim.scene.section import Section
from hapsim.scene.values import Area, Known, Span
from hapsim.theory.hand.configuration import stiffest_stable
from hapsim.units import Units


class Range(NamedTuple):
    """Range of a value in real devices and scenes; 0 is always within."""

    least: float
    most: float
    why: str
    slips: tuple[tuple[str, float], ...]
    """Units often written by mistake, each with the factor that corrects it; 0: take the reciprocal."""


_MORE, _LESS = ("a thousand times as much", 1e3), ("a thousandth of it", 1e-3)
_LENGTHS, _MASSES, _FORCES = (("mm", 1e-3), ("µm", 1e-6), _MORE), (("g", 1e-3), _MORE), (("mN", 1e-3), _MORE)
_STIFFNESSES, _DAMPINGS = (("N/mm", 1e3), _LESS), (("N·s/mm", 1e3), ("g/s", 1e-3))

RANGES = {
    "kg": Range(1e-3, 10.0, "a moving part and the hand that holds it weigh grams to 3 kg", _MASSES),
    "modules kg": Range(1e-7, 10.0, "simulated masses weigh a milligram to some kg", _MASSES),
    "rate": Range(50.0, 1e5, "devices sample at 200 Hz to 20 kHz", (("kHz", 1e3), ("the period in s", 0.0), _LESS)),
    "force_limit": Range(0.05, 250.0, "devices render 0.2 to 50 N", _FORCES),
    "N": Range(1e-3, 250.0, "a hand feels 10 mN and more, and devices render up to 50 N", _FORCES),
    "N·s/m": Range(0.0, 500.0, "a firm grip has 20 N·s/m", _DAMPINGS),
    "N/m": Range(1.0, 1e5, "springs of devices and hands have 10 to 1000 N/m", _STIFFNESSES),
    "modules N/m": Range(0.0, math.inf, "", _STIFFNESSES),  # `_spring_values` judges these two by rate and mass
    "modules N·s/m": Range(0.0, math.inf, "", _DAMPINGS),
    "m": Range(5e-6, 1.0, "devices move 2 mm to 0.5 m, in steps of 10 µm and more", _LENGTHS),
    "travel": Range(2e-4, 1.0, "devices move 2 mm to 0.5 m", _LENGTHS),
    "m/s": Range(0.0, 20.0, "hands move at up to 5 m/s", (("mm/s", 1e-3),)),
    "m per count": Range(1e-13, 5e-4, "encoders have counts of 1 nm to 0.1 mm", _LENGTHS),
    "m rms": Range(0.0, 5e-4, "position sensors have less than 0.1 mm of noise", _LENGTHS),
    "turnaround": Range(0.0, 0.02, "devices answer within milliseconds", (("ms", 1e-3), ("µs", 1e-6))),
    "cutoff": Range(1.0, math.inf, "below 1 Hz a filtered velocity comes too late for any hand", (("kHz", 1e3),)),
    "transmission N/m": Range(10.0, 1e8, "belts and capstans have 5 kN/m to 1 MN/m", _STIFFNESSES),
    "backlash": Range(0.0, 0.01, "gears have less than 1 mm of play", _LENGTHS),
    "motor_lag": Range(0.0, 0.02, "the force of a motor follows within milliseconds", (("ms", 1e-3), ("µs", 1e-6))),
    "bit/s": Range(1200, 2e7, "UARTs have 9600 to 12 million bit/s", (("kbit/s", 1e3), _LESS)),
}
"""Ranges by key, by "modules" and unit, or by unit. They are wider than the paper's 1 g, a motor fader's 30 g and 0.2
N, the values of Hapkit, FireFader, Haply and Falcon, and a handle of 3 kg with 50 N."""

_ANGLES, _TORQUES = (("deg", math.pi / 180.0), ("mrad", 1e-3), _MORE), (("mN·m", 1e-3), _MORE)
_INERTIAS = (("g·cm²", 1e-7), ("kg·cm²", 1e-4), _MORE)

ROTARY = {
    "kg": Range(1e-8, 0.5, "a knob has 1e-6 kg·m², a steering wheel 0.1", _INERTIAS),
    "modules kg": Range(1e-10, 0.5, "a knob has 1e-6 kg·m², a steering wheel 0.1", _INERTIAS),
    "force_limit": Range(5e-4, 50.0, "knobs render 5 mN·m and more, steering wheels up to 20 N·m", _TORQUES),
    "N": Range(1e-5, 50.0, "knobs render 5 mN·m and more, steering wheels up to 20 N·m", _TORQUES),
    "N·s/m": Range(0.0, 5.0, "a hand on a wheel has 0.5 N·m·s/rad", (_MORE, _LESS)),
    "N/m": Range(1e-5, 100.0, "springs of knobs and wheels have 0.001 to 10 N·m/rad", (_MORE, _LESS)),
    "transmission N/m": Range(0.01, 1e6, "belts and gears of knobs have 1 N·m/rad and more", (_MORE, _LESS)),
    "m": Range(1e-5, 20.0, "angles are in rad, or written as 90 deg", _ANGLES),
    "travel": Range(1e-3, 200.0, "angles are in rad, or written as 90 deg", _ANGLES),
    "pitch": Range(1e-4, 7.0, "a turn has 6.28 rad", _ANGLES),
    "m/s": Range(0.0, 500.0, "hands turn at up to 60 rad/s", (("deg/s", math.pi / 180.0), _MORE)),
    "m per count": Range(1e-13, 0.1, "encoders have counts of 1e-7 to 0.01 rad", _ANGLES),
    "m rms": Range(0.0, 0.02, "angle sensors have less than 0.01 rad of noise", _ANGLES),
}
"""Ranges where every channel turns. If only some turn, a value has to be outside both ranges."""

# The values below are ratios between keys.
_DELAYED, _LATE_SAMPLES, _LATE_S = 0.01, 10.0, 0.02  # sample periods; the slowest USB converter takes 16 ms
_TURNED = 20.0  # rad: where a file has degrees, more are degrees without a unit
_STOPS_S, _COASTS_S = 1e-3, 100.0  # time in which friction stops a free device
_FRICTION, _FRICTION_PER_KG = 50.0, 100.0  # N·s/m; a heavy hand has a heavy device's
_CREEPS = 5.0  # times critical damping: with more friction the hand creeps
_FELT_STIFFNESS, _FELT_DAMPING, _UNDAMPED = 5.0, 2e-3, 4e-4  # of a link at a hand: N/m; N·s/m, times sqrt(K m)
_STRONG, _JUMPS, _PRESSES = 10.0, 3.0, 30.0  # times the force limit: a link's own force; that at arming, far and near
_BEYOND = 3.0  # times the stiffest link at a hand that any damping makes stable
_HEAVY_KG = 2.0  # a whole string or membrane
_GIVES = 0.1  # of the travel: a transmission that stretches by more does not hold a handle
_FAR_M = 0.05  # a larger stretch at arming indicates a wrong position rather than a wrong stiffness


class _Value(NamedTuple):
    path: str
    value: float
    unit: str
    range: Range

    @property
    def module(self) -> str:
        """Name of its module; "" for a value of the device, the mock or the scene."""
        first, name, *_ = [*self.path.split("."), ""]
        return name if first == "modules" else ""

    @property
    def is_off(self) -> bool:
        return self.value != 0.0 and not self.range.least <= abs(self.value) <= self.range.most

    def sentence(self, units: Units) -> str:
        least, most, why, slips = self.range
        low = abs(self.value) < least
        si, takes_units = units.si, bool(units.written) and self.unit != "samples"
        bound = si(least if low else most, self.unit, short)
        found = f"{self.path}: found {si(self.value, self.unit)}, {'less' if low else 'more'} than {bound}: {why}."
        for meant, factor in slips:
            right = self.value * factor if factor else 1.0 / self.value
            if least <= abs(right) <= most and (factor == 0.0 or (factor > 1.0) is low):
                write = f"{number(self.value)} {meant}" if takes_units and " " not in meant else number(right)
                return f"{found} If you meant {meant}, write {write}."
        return found


def unlikely(scene: Scene) -> list[str]:
    """Returns a sentence for each key of `scene` that is probably a mistake: the value, why it is unlikely, and the
    probable intention. The same key of several modules shares one sentence."""
    if scene.is_auxiliary:
        return []
    if scene.ports:
        return [*dict.fromkeys(one for name in scene.ports for one in unlikely(scene.at_port(name)))]
    scene = scene.held
    weights = set(_weights(scene, _ranges(scene)["m"].most))
    off = [one for one in _values(scene, "", _ranges(scene)) if one.is_off and one.path not in weights]
    for of_part in (_device_values, _link_values):
        if not any(one.unit in ("Hz", "kg", "samples") for one in off):  # the other checks depend on these values
            off += [one for one in of_part(scene) if one.is_off and one.path not in weights]
    alike: dict[tuple[str, str], dict[str, _Value]] = {}
    for one in off:
        place, _, key = one.path.rpartition(".")
        alike.setdefault((place.partition(".")[0], key), {}).setdefault(one.path, one)
    sentences = []
    for first, *others in (list(same.values()) for same in alike.values()):
        also = f" The same holds for {plural(len(others), 'other module')}." if others else ""
        sentences.append(first.sentence(scene.units_at(first.module)) + also)
    if name := scene.device_name:
        sentences = [re.sub(r"^(device|mock)\.", rf"\1s.{name}.", one) for one in sentences]
    is_explained = any(one.unit in ("kg", "m", "N/m", "N") for one in off)
    return [*sentences, *(() if is_explained else _jumps_of_plane_links(scene) if scene.plane_links else _jumps(scene))]


def _weights(scene: Scene, far_m: float) -> Iterator[str]:
    """Yields the keys of grounds that are the far end of a constant force, and of the links to them: these links are so
    soft that the device can render their pull in spite of the distance."""
    for ground, module in scene.grounds.items():
        laws = {name: one.law() for name, one in scene.links.items() if ground in one.between}
        pulls = [0.0 if law.edges else law.below * abs(module.position) for law in laws.values()]
        if pulls and abs(module.position) > far_m and all(0.0 < one <= scene.device.force_limit for one in pulls):
            yield f"modules.{ground}.position"
            yield from (f"modules.{name}.stiffness" for name in laws)


def _ranges(scene: Scene) -> dict[str, Range]:
    """Returns the ranges for this scene's motion; if only some channels turn, from the least to the most of both."""
    turns = set(scene.device.motions(scene.channels))
    if len(turns) == 1:
        turned = ROTARY | ({"travel": ROTARY["travel"]._replace(most=_TURNED)} if scene.units.name("m") == "°" else {})
        return RANGES | (turned if scene.units.is_rotary else {})
    both = {key: (RANGES.get(key, one), one) for key, one in ROTARY.items()}
    wide = {
        key: two[0]._replace(least=min(one.least for one in two), most=max(one.most for one in two))
        for key, two in both.items()
    }
    return RANGES | wide


def _slips(scene: Scene, unit: str) -> tuple[tuple[str, float], ...]:
    """Returns the units that are written by mistake for this one, which is that of a line."""
    return _ranges(scene)[unit].slips


def _values(part: Section, path: str, ranges: dict[str, Range]) -> Iterator[_Value]:
    """Yields the numbers of a part of a scene that have a range; for a curve the largest along each axis."""
    for key, expected in _keys(type(part)):
        value, at = getattr(part, key), f"{path}{key}"
        if isinstance(value, Section):
            yield from _values(value, f"{at}.", ranges)
        elif key == "modules":
            for name, module in value.items():
                yield from _values(module, f"{at}.{name}.", ranges)
        elif expected is not None and value is not None:
            units = expected.units
            columns = list(zip(*value, strict=True)) if units[1:] else [value]
            for unit, column in zip(units, columns, strict=True):
                place = next((f"{one} " for one in ("modules", "transmission") if f"{one}." in path), "")
                limits = ranges.get(key) or ranges.get(place + unit) or ranges.get(unit)
                numbers = sorted(_numbers(column), key=abs)
                if limits is not None:
                    yield from (_Value(at, one, unit, limits) for one in (numbers[-1:] if units[1:] else numbers))


@cache
def _keys(kind: type[Section]) -> list[tuple[str, Expectation | None]]:
    """Keys of a kind of part, each with its expected values."""
    fields = kind.model_fields.items()
    return [(key, expectation_of(field)) for key, field in fields]


def _numbers(value: Any) -> list[float]:
    value = tuple(value.model_dump().values()) if isinstance(value, Area) else value
    if isinstance(value, tuple):
        return [one for entry in value for one in _numbers(entry)]
    if isinstance(value, Span):
        return [value.least, value.most]
    value = value.value if isinstance(value, Known) else value
    return [value] if isinstance(value, int | float) else []


def _device_values(scene: Scene) -> Iterator[_Value]:
    """Yields keys of device and mock that depend on each other."""
    device, mock, limit = scene.device, scene.mock or Mock(), scene.device.force_limit
    si = scene.units.si  # as the number that is found
    named = f"the force limit of {si(limit, 'N')}"
    most = max(_LATE_SAMPLES, _LATE_S * scene.rate)
    slips = (("seconds", scene.rate), ("µs", 1e-6 * scene.rate))
    late = Range(_DELAYED, most, f"its unit is the sample period, here {duration(scene.period)}", slips)
    for part, delay in (("device", device.delay), ("mock", mock.delay or 0.0)):
        yield _Value(f"{part}.delay", delay, "samples", late)
    scales = device.scales(scene.channels)
    least = min((one.brief for one in scales), default=0.0)
    brief = Range(least * limit, math.inf, f"{named} does that work within {si(least, 'mm', 'g')}", (_MORE,))
    yield _Value("device.energy_limit", device.energy_limit or 0.0, "J", brief)
    start = Range(scene.period, math.inf, "a ramp takes at least a sample period", (_MORE,))
    yield _Value("device.soft_start", device.soft_start or 0.0, "s", start)
    for one, scale in zip(device.stiffnesses(scene.channels), scales, strict=True):
        why = f"{named} stretches it by less than {si(scale.rigid, 'mm', 'g')}"
        yield _Value("device.stiffness", one, "N/m", Range(0.0, limit / scale.rigid, why, (_LESS,)))
    drives, travels = device.drives(scene.channels), device.travels(scene.channels)
    for drive, scale, (low, high) in zip(drives, scales, travels, strict=True):
        way = min(_GIVES * (high - low), scale.energy)
        why = f"{named} stretches it by more than {si(way, 'mm', 'g')}, so the motor does not hold the handle"
        yield _Value(
            "device.transmission.stiffness", drive.stiffness, "N/m", Range(limit / way, math.inf, why, (_MORE,))
        )
    weak = f"{named} does not overcome it"
    yield _Value("mock.coulomb", mock.coulomb, "N", Range(0.0, limit, weak, _slips(scene, "N")))
    for name, point in scene.device_points.items():
        units = scene.units_of(point.channel).si
        of_channel = (device.masses, device.frictions, device.stiffnesses)
        mass, friction, own = (values(scene.channels)[point.channel] for values in of_channel)
        held = (
            getattr(link.at_end(name) if isinstance(link, ViscoElastic) else link, "stiffness", 0.0)
            for link in scene.links.values()
            if name in link.between
        )
        critical = 2.0 * math.sqrt(max(own, *held, 0.0) * mass)
        why = f"a free hand of {units(mass, 'kg')} then stops in {short_duration(mass / (friction or math.inf))}"
        if friction > _CREEPS * critical > 0.0:
            why = f"critical damping is {units(critical, 'N·s/m', 3)}, so the hand creeps"
        most = min(mass / _STOPS_S, max(_FRICTION, _FRICTION_PER_KG * mass), _CREEPS * critical or math.inf)
        key = "device.simulated_damping" if device.is_admittance else "device.friction"
        yield _Value(key, friction, "N·s/m", Range(mass / _COASTS_S, most, why, _slips(scene, "N·s/m")))


def _link_values(scene: Scene) -> Iterator[_Value]:
    """Yields values of links that depend on the masses at their ends, and of structures and cells on their own."""
    spans, limit = scene.device.mass_spans(scene.channels), scene.device.force_limit
    every = scene.material_points | scene.structures
    every = {_module(name): one for name, one in every.items()}
    masses = {name: module.mass for name, module in every.items() if name not in scene.proxies}  # those have no limit
    for name, mass in masses.items():
        yield from _spring_values(scene, name, mass, "")
    moved = frozenset(every)
    masses |= {_module(name): spans[point.channel][0] for name, point in scene.device_points.items()}
    hands, ranges = {_module(name): name for name in scene.device_points}, _ranges(scene)
    if scene.device.is_admittance:  # each is a mass of the scene
        hands, moved = {}, frozenset(masses)
    strong = ranges["N"]._replace(most=_STRONG * limit, why=f"the force limit is {scene.units.si(limit, 'N')}")
    for name, link in (scene.links | scene.plane_links).items():
        ends = [_module(end) for end in link.between]
        hand = next((hands[end] for end in ends if end in hands), "")
        levers = (1.0, math.prod(link.second_scale))  # a scale shows its first end the mass at the second over this
        explicit = [masses[end] / lever for end, lever in zip(ends, levers, strict=True) if end in masses]
        if explicit and scene.proxies.keys().isdisjoint(ends):  # a proxy gives way to the stiffest coupling
            yield from _spring_values(scene, name, min(explicit), hand, not moved.isdisjoint(ends))
        if hand:
            yield from (
                one._replace(range=strong) for one in _values(link, f"modules.{name}.", ranges) if one.unit == "N"
            )
    for name, structure in scene.structures.items():
        many = len(structure.point_names())
        heavy = Range(
            0.0,
            _HEAVY_KG / many,
            f"{many} of them weigh {scene.units_at(name).si(many * structure.mass, 'kg')}",
            _slips(scene, "kg"),
        )
        yield _Value(f"modules.{name}.mass", structure.mass, "kg", heavy)


def _module(point: str) -> str:
    """Returns the name of a point's module."""
    return point.partition(".")[0]


def _spring_values(scene: Scene, name: str, mass: float, hand: str, moves: bool = True) -> Iterator[_Value]:
    """Yields a module's stiffness and damping with the ranges for this mass, in kg. `hand`: the device point that it
    holds, or ""; `moves`: whether it holds a point that the scene moves."""
    module, rate, units = scene.modules[name], scene.step_rate if moves else scene.rate, scene.units_at(name).si
    stiffness, damping = getattr(module, "stiffness", 0.0), getattr(module, "damping", 0.0)
    most = [mass * rate**2 * (8.0 if scene.scheme == "rk4" else 4.0), 2.0 * mass * rate]  # beyond any scheme
    hardest, least, why = most[0], [0.0, 0.0], f"at {frequency(rate)} it is unstable on {units(mass, 'kg')} with any"
    if hand:
        kind = getattr(module, "damper", "backward"), getattr(module, "cutoff", None)
        loop = configuration_of(scene, scene.device_points[hand].channel, *kind)
        surely = loop.stiffness_unit / (2.7 + 1.4 * loop.delay) ** 2  # stable with some damping, for any hold
        if stiffness > _BEYOND * surely and scene.device.correction == "none":
            hardest = stiffest_stable(loop).stiffness or hardest
            most[0] = min(most[0], _BEYOND * hardest)
        most[1] = math.inf if kind[1] else most[1]
        felt = 0.0 if scene.units_at(name).is_rotary else 1.0  # the size of a knob is unknown
        least = [felt * _FELT_STIFFNESS, max(felt * _FELT_DAMPING, _UNDAMPED * math.sqrt(stiffness * mass))]
    elif scene.scheme in ("exact", "midpoint"):
        most = [math.inf, math.inf]
    takes = frequency(rate * math.sqrt(max(stiffness / hardest, 1.0)))
    hard, soft = f"{why} damping, and needs about {takes}", f"1 cm of it is {units(0.01 * stiffness, 'N', 2)}"
    strong, weak = f"{why} stiffness", f"at {units(0.1, 'm/s')} it is {units(0.1 * damping, 'N', 2)}"
    k = Range(least[0], most[0], soft if stiffness < least[0] else hard, _slips(scene, "N/m"))
    b = Range(least[1], most[1], weak if damping < least[1] else strong, _slips(scene, "N·s/m"))
    yield _Value(f"modules.{name}.stiffness", stiffness, "N/m", k)
    yield _Value(f"modules.{name}.damping", damping, "N·s/m", b)


def _jumps(scene: Scene) -> Iterator[str]:
    """Yields a sentence for each hand that the scene pushes by far more than the force limit at the start."""
    device, limit = scene.device, scene.device.force_limit
    for hand, point in scene.device_points.items():
        alone, origin = characteristic_of(scene, hand), device.origins(scene.channels)[point.channel]
        if alone is None:
            continue
        least, most = device.travels(scene.channels)[point.channel]
        start, x = "device.travel", min(max(0.0, least), most)  # an unknown position counts as 0
        if device.port is None and origin is not None:
            start, x = "mock.initial.position", scene.mock_device.initial_position[point.channel] - origin
        forces = {name: one.sign * float(one.law.tension(one.distance(x))) for name, one in alone.links.items()}
        total, units = abs(sum(forces.values())), scene.units_of(point.channel)
        if total > _JUMPS * limit:
            name = max(forces, key=lambda one: abs(forces[one]))
            ground = next(end for end in scene.links[name].between if end != hand)
            distance = getattr(scene.links[name], "distance", 0.0)
            places = {
                start: x,
                f"modules.{ground}.position": alone.links[name].fixed_m,
                f"modules.{name}.distance": distance,
            }
            path, place = max(places.items(), key=lambda one: abs(one[1]))
            hint = f"{path} is {units(place, 'm')}. If you meant mm, write {number(1e-3 * place)}."
            is_far = abs(place) >= _FAR_M and not units.is_rotary
            if not is_far and not total > _PRESSES * limit:
                continue
            if not is_far or units.name("m") != "m":  # a place in mm was meant so
                hint = f"check the stiffness of {name} and the positions of its ends."
            pushes = f"at arming the scene pushes {hand} with {units(total, 'N', short)}"
            yield f"{pushes}; the force limit is {units(limit, 'N')}: {hint}"


def _jumps_of_plane_links(scene: Scene) -> Iterator[str]:
    """Yields a sentence for each link between points that meet at the start, and one for each hand as `_jumps` does."""
    plane, limit, units = Plane(scene), scene.device.force_limit, scene.units
    for one in plane.at({}):
        if one.distance == 0.0 and one.tension and math.isinf(one.curvature):
            ends = " and ".join(one.link.between)
            yield f"modules.{one.name}: {ends} meet at the start, where its force has no direction: it acts along x."
    for hand in plane.hands:
        x, y = np.array(plane.start[hand])
        total = math.hypot(*plane.forces(x, y, hand))
        if total > _PRESSES * limit:
            pushes = f"at arming the scene pushes {hand} with {units(total, 'N', short)}"
            yield f"{pushes}; the force limit is {units(limit, 'N')}: check its links and the positions of their ends."


def begun_inside(scene: Scene, work: float = math.inf) -> Iterator[str]:
    """Yields a sentence for each shape in which a hand starts before the mock: without a soft start the force jumps.
    `work`: J, most of it over the depth where the surface asks for more than the force limit."""
    if not scene.plane_links or scene.device.port is not None or scene.device.soft_start:
        return
    plane, units = Plane(scene), scene.units
    for one in plane.at({}):
        hand = next((end for end in one.link.between if end in plane.hands), "")
        if hand and isinstance(one.link, Shape) and one.distance < 0.0:
            limit = scene.device.force_limit
            force = -one.tension if -one.tension <= limit else min(limit, work / -one.distance)
            yield (
                f"{hand} starts {units(-one.distance, 'mm', '.3g')} inside {one.name}: at arming the force jumps to "
                f"{units(force, 'N', '.3g')}. Let it start outside (mock.initial.position), or set device.soft_start."
            )
