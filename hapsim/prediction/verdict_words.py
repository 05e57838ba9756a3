"""Words about the verdict on a scene: what moves freely or slides, the states in which a motion grows, and the gain
margins of one hand and of the whole scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from hapsim.holds import HOLDS
from hapsim.number_format import angle, duration, frequency, listed, number, rounded_down
from hapsim.prediction.felt_alone import Felt
from hapsim.prediction.first_help import INSTALLED, ways_to_stability
from hapsim.prediction.force_bounds import slew_error
from hapsim.prediction.linear import mean_lag
from hapsim.prediction.prediction import AT_LIMIT, SLIDES, SNAPS, SWINGS, Prediction
from hapsim.prediction.stability import LinkMargin
from hapsim.prediction.states import IN_PLAY
from hapsim.prediction.timing import on_wire
from hapsim.prediction.turning import turning_sentences
from hapsim.scene import Scene
from hapsim.scene.input_states import MOST_COMBINED, used_inputs
from hapsim.scene.modules.links import Spring
from hapsim.scene.values import per_channel
from hapsim.theory.network import SURELY, is_large
from hapsim.theory.network.felt import matrices
from hapsim.theory.network.margins import SEARCHED
from hapsim.theory.network.modes import AT_THE_LIMIT
from hapsim.units import Units

_MOVES = 1e-6  # of the largest amplitude: what moves less is held
_NAMED = 3  # of modules that move together
_ROUNDED, _SLIDES = 1e-13, 1e-5  # of the largest stiffness: what holds nothing, on a line and in the plane
_GROWING = 3  # states of contacts in which something grows
_FAINT = 1e-9  # of m/T²: hardly a spring


def verdict_words(prediction: Prediction, is_slewed: bool = False) -> tuple[str, str, str]:
    """Returns the verdict; what follows it, with its colon, where it is neither stable nor unstable; and the spectral
    radius, with the state of the inputs that decides. `is_slewed`: the slew limit is too slow for the scene."""
    state, prediction = prediction.decisive
    notes = {
        SNAPS: f": the scene drives {', '.join(prediction.in_snap)} on to the next region",
        SLIDES: f": {next(slide_sentences(prediction), 'out of range')}",
        "trembles": f": {', '.join(prediction.trembles)} swings by less than a count",
        "not judged": ": its contacts can be in too many states",
        SWINGS: ": a knock sets off what no state of its contacts tells",
        AT_LIMIT: " between stable and unstable: something drifts or swings for ever",
        "stable without its slew limit": ": see the warning",
    }
    verdict = prediction.verdict
    verdict += " without its slew limit" if is_slewed and verdict == "stable" else ""
    radius = _radius_words(prediction)
    return verdict, notes.get(verdict, ""), f"while {state}{radius and f', {radius}'}" if state else radius


def verdict_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields what the verdict rests on: tables with a turn, the states of the contacts, and those of the inputs."""
    yield from turning_sentences(prediction.scene)
    yield from state_sentences(prediction)
    yield from gate_sentences(prediction)


def gate_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields the verdict in each state of the inputs that the scene's gates need, beside that of all of them on."""
    for state, one in prediction.with_inputs_off.items():
        verdict, note, radius = verdict_words(one)
        yield f"While {state}: {verdict}{note}{f' ({radius})' if radius else ''}"
    if len(used := used_inputs(prediction.scene)) > MOST_COMBINED:
        most = len(used) - 2
        between = "two" + (" or three" if most == 3 else f" to {most}" if most > 3 else "")
        yield f"Not judged: states in which, of {len(used)} inputs, {between} are on"


def slide_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields the slides, the fastest first; nothing on a line."""
    for one in prediction.slides:
        slides = "slides off" if f"{one.module}.x" in prediction.scene.device_points else "moves off"
        yield f"{one.module} {slides} along {angle(one.angle_deg)}: grows e-fold in {duration(one.e_fold_s)}"


def _radius_words(prediction: Prediction) -> str:
    """Returns the spectral radius of a prediction in words; of a stable one at 1 what moves freely, and the spectral
    radius of the rest; "" if it is not finite."""
    radius = prediction.spectral_radius
    if not math.isfinite(radius):
        return ""
    at_rest = [pole for pole in prediction.poles if pole.imag == 0.0 and pole.real >= 1.0 - AT_THE_LIMIT]
    if prediction.verdict != "stable" or not at_rest:
        return f"spectral radius {radius:.9g}"
    moving = [abs(pole) for pole in prediction.poles if pole not in at_rest]
    return "; ".join([*_free(prediction), *(f"the rest {number(max(moving), 9)}" for _ in moving[:1])])


def _free(prediction: Prediction) -> Iterator[str]:
    """Yields phrases on the modules that move freely, those that move together in one."""
    if is_large(prediction.network):
        yield "a part of it moves freely"
        return
    network, along = prediction.network, dict[str, list[int]]()
    for i, point in enumerate(prediction.points):
        along.setdefault(point.partition(".")[0], []).append(i)
    *_, K = matrices(network)
    _, sizes, right = np.linalg.svd(K)
    free = right[
        sizes <= (_ROUNDED if network.rows is None and network.second is None else _SLIDES) * sizes.max(initial=0.0)
    ]
    moved = free.T @ free

    def move(name: str, of: list[str]) -> list[str]:
        """Returns those that move where this one does."""
        return [other for other in of if np.abs(moved[np.ix_(along[name], along[other])]).max() > _MOVES]

    left = [name for name in along if move(name, [name])]
    while left:
        first, *others = group = move(left[0], left)
        left = [name for name in left if name not in group]
        yield f"{_listed(group)} freely{' together' if others else _direction(prediction, first, moved, along[first])}"


def _listed(names: list[str]) -> str:
    first, *others = names
    if not others:
        return f"{first} moves"
    if len(others) >= _NAMED:
        others = [*others[: _NAMED - 1], f"{len(others) - _NAMED + 1} others"]
    return f"{', '.join([first, *others[:-1]])} and {others[-1]} move"


def _direction(prediction: Prediction, name: str, moved: Any, own: list[int]) -> str:
    """Returns the direction in the plane in which this module moves: along a link, or at an angle; "" if in each."""
    values, vectors = np.linalg.eigh(moved[np.ix_(own, own)])
    if len(own) == 1 or values[0] > _MOVES:
        return ""
    x, y = vectors[:, 1].tolist()
    acting = [one for one in prediction.links if one.acts and name in one.link.between]
    if len(acting) == 1:
        return f" along {acting[0].name}"
    return f" along {angle(math.degrees(math.atan2(y, x)) % 180.0)}"


def state_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields the number of states of the scene's other contacts, and the motions that grow."""
    states, lines = prediction.states, list[str]()
    for one in sorted(states.growing, key=lambda one: -one.growth):
        whose = f"the motion of {one.module}" if one.module else "a motion"
        fast = f"e-fold in {duration(1.0 / (prediction.rate * math.log(one.growth)))}"
        lines.append(f"Unstable while {one.state}: {whose} grows {fast} by itself")
    shown = [*dict.fromkeys(lines)][:_GROWING]
    yield from shown
    if others := sum(line not in shown for line in lines):
        yield f"and in {others} other ways (--json lists them)"
    for module in dict.fromkeys(one.module for one in states.growing):
        if links := _undamped(prediction.scene, module):
            have = "have" if len(links) > 1 else "has"
            yield f"Nothing damps {module}: {' and '.join(links)} {have} no damping (type: viscoelastic takes some)"
    if states.growing and (help_first := ways_to_stability(prediction)):
        yield help_first
    if states.unjudged:
        which = f"{states.unjudged} of {states.count}" if states.is_complete else "some of more than 1000"
        yield f"Not judged: {which} states of its contacts"
    elif states.count > 1 and prediction.stable:
        yield f"Stable {states.words}"


def _undamped(scene: Scene, module: str) -> list[str]:
    """Returns the links of this module if none of them damps it, and nothing else does."""
    links = {
        name: isinstance(one, Spring) or getattr(one, "damping", None) == 0.0
        for name, one in (scene.links | scene.plane_links).items()
        if module in {end.partition(".")[0] for end in one.between}
    }
    is_free = module not in scene.device_points and not getattr(scene.modules.get(module), "damping", 0.0)
    return [*links] if is_free and all(links.values()) else []


def margin_sentence(felt: Felt, units: Units) -> str:
    """Returns the gain margin of one hand, in a sentence."""
    if felt.stiffness == 0.0:
        unstable = felt.spectral_radius > SURELY
        enough = _enough_damping(felt, units, "; the scene is stable") if unstable else ""
        return f"There is no stiffness to have a margin{enough}."
    if felt.stiffness_factor == 0.0:
        return f"At this damping no stiffness is stable{_enough_damping(felt, units, '; this one is')}."
    if not math.isfinite(felt.stiffness_factor):
        return "No stiffness makes it unstable at this damping."
    if felt.stable:
        return f"Gain margin: the loop becomes unstable at {felt.stiffness_factor:.3g} times this stiffness."
    stiffness = f"where the stiffness is {rounded_down(felt.stiffness_factor)} of the simulated one, or less"
    return f"It becomes stable {stiffness}{_enough_damping(felt, units)}."


def _enough_damping(felt: Felt, units: Units, becomes: str = "; or") -> str:
    least, most = felt.stable_damping
    if felt.stiffness == 0.0:  # nothing holds a hand without a spring, whatever the damping: with hardly any
        hand = felt.configuration
        least, most = map(float, hand.stable_damping(_FAINT * hand.stiffness_unit))
    if not most > 0.0:
        return "; no damping makes this stiffness stable: take less of it, a shorter delay or device.correction"
    return f"{becomes} where the damping is between {units.between(max(least, 0.0), most, 'N·s/m', ' and ')}"


def tightest(prediction: Prediction, count: int) -> list[LinkMargin]:
    """Returns the links with the smallest margins, at most `count`, smallest first."""
    known = [margin for margin in prediction.margins if not math.isnan(margin.stiffness_factor)]
    return sorted(known, key=change_to_limit)[:count]


def change_to_limit(margin: LinkMargin) -> float:
    """Returns the logarithm of the smallest factor that takes the scene to its limit; infinity if none does."""
    ranges = (*(margin.stabilizing_stiffness or ()), *(margin.stabilizing_damping or ()))
    factors = [least if least >= 1.0 else most for least, most in ranges]
    if not ranges:
        factors = [factor for factor in (margin.stiffness_factor, margin.damping_factor) if factor > 0.0]
    return min((abs(math.log(factor)) for factor in factors), default=math.inf)


def margin_sentences(prediction: Prediction, explain: bool) -> Iterator[str]:
    """Yields the smallest gain margin, unless `explain` lists them all, and which poles of a large scene are known."""
    if not explain and (summary := margin_summary(prediction)):
        yield summary
    if method := prediction.poles_method:
        yield f"A large scene: {method}."


def margin_summary(prediction: Prediction) -> str:
    """Returns the smallest gain margin of the scene in a sentence; of an unstable one what would make it stable."""
    slides = prediction.verdict_here == SLIDES
    if prediction.verdict_here == SNAPS:
        return "In a snap there is no gain margin"
    if not prediction.stable_as_taken and not prediction.at_limit and not slides:
        return _what_would_help(prediction)
    if not prediction.margins and prediction.felt_masses:
        return ""
    if not prediction.margins:
        return "There is no link to have a gain margin"
    if not (links := tightest(prediction, 1)):
        return "Gain margins were not worked out"
    here, how = " here" if prediction.places else "", f" ({SEARCHED})" if SEARCHED in prediction.margins_method else ""
    how += ", what slides being held" if slides else ""
    as_assumed = not (prediction.stable or prediction.at_limit or slides or here)
    in_play = all(one.state.endswith(IN_PLAY) for one in prediction.states.growing)
    if as_assumed:
        how += ", in mesh" if in_play else ", its contacts as the assumptions below have them"
    (link,) = links
    if math.isinf(change_to_limit(link)):
        return f"Gain margin: no link makes it unstable{here}{how}"
    factors = {"stiffness": link.stiffness_factor, "damping": link.damping_factor}
    what, factor = min(factors.items(), key=lambda entry: abs(math.log(entry[1])) if entry[1] > 0.0 else math.inf)
    what = f"{'simulated ' * prediction.changes_values}{what}"
    how += f" ({INSTALLED})" if prediction.changes_values else ""
    return f"Smallest gain margin: unstable at {factor:.4g} times the {what} of {link.name}{how}"


def _what_would_help(prediction: Prediction) -> str:
    units_of, ways = prediction.scene.units_of, ""
    if not prediction.changes_values:
        ways = " ".join(
            f"{one.name}: " * (len(prediction.felt) > 1) + margin_sentence(one, units_of(one.channel))
            for one in prediction.felt
            if one.spectral_radius > 1.0
        )
    if not ways and not prediction.states.growing:
        every = [one for regions in prediction.judge.regions.values() for one in regions if one.growth]
        if every and not prediction.changes_values:
            worst = max(every, key=lambda one: one.growth).felt
            ways = f"Where it is unstable: {margin_sentence(worst, units_of(worst.channel))}"
        else:
            ways = ways_to_stability(prediction)
    if ways:
        return ways
    if any(one.stabilizing_stiffness or one.stabilizing_damping for one in prediction.margins):
        return "--explain lists by how much each link has to change"
    return "Which change would make it stable was not worked out"


def predicted_for(scene: Scene) -> str:
    """Returns the device and the hands of a prediction: one, or each channel's where they differ."""
    device, channels = scene.device, scene.channels
    each = zip(device.mass_spans(channels), device.frictions(channels), device.stiffnesses(channels), strict=True)
    hands = [_one_hand(*one, scene.units_of(channel)) for channel, one in enumerate(each)]
    if device.is_admittance:
        hands = [_simulated(scene, channel) for channel in range(channels)]
    used = {point.channel: hands[point.channel] for point in scene.device_points.values()}
    first, *others = dict.fromkeys(used.values())
    who = "; ".join(f"channel {c}: {hand}" for c, hand in sorted(used.items())) if others else first
    delay = on_wire(scene).device.delay
    samples = "sample" if delay == 1.0 else "samples"
    declared = f", {device.delay:g} declared" if delay != device.delay else ""
    late = f"delay {delay:g} {samples} ({duration(delay * scene.period)}{declared})" if delay else "no delay"
    averaged = ", averaged positions" if device.sampling == "average" else ""
    steps = f", {scene.substeps} substeps a sample" if scene.substeps > 1 else ""
    if lag := mean_lag(scene):
        steps += f" (springs act on the mean position, {lag:.4g} of a sample late)"
    idle = [one for one in range(channels) if not any(one in hand for hand in scene.channel_groups)]
    if idle:
        steps += f"; a device with {channels} channels, of which nothing uses {listed(idle)}"
    if (board := device.board(scene.rate)) is not None:
        local = scene.period / board.steps
        steps += (
            f", law on the board at {frequency(board.steps * scene.rate)} ({duration(board.delay * local)} of delay"
        )
        steps += f", velocities over {duration(board.window * local)})"
    if device.is_admittance:
        return f"for a simulated mass of {who}, {late}{steps}"
    return f"for a hand of {who}, {late}, {HOLDS[device.hold].label}{averaged}{steps}"


def _simulated(scene: Scene, channel: int) -> str:
    """Returns the simulated mass of a channel, its hand and its servo."""
    device, channels, units = scene.device, scene.channels, scene.units_of(channel)
    mass, damping = device.masses(channels)[channel], device.frictions(channels)[channel]
    hand, servo = device.assumed_hands(channels)[channel], device.servos(channels)[channel]
    k = units(" to ".join(dict.fromkeys(units.number(one, "N/m", "g") for one in hand.stiffness)), "N/m")
    b = units(" to ".join(dict.fromkeys(units.number(one, "N·s/m", "g") for one in hand.damping)), "N·s/m")
    beyond = f" and {units(hand.mass, 'kg', 'g')} beyond the force sensor" if hand.mass else ""
    follows = f"by a servo of {frequency(servo.bandwidth)}, damping {servo.damping:g}" if servo else "exactly"
    simulated = f"{units(mass, 'kg', 'g')}, damping {units(damping, 'N·s/m', 'g')}"
    return f"{simulated}, in a hand of {k}, {b}{beyond}, followed {follows}"


def _one_hand(span: tuple[float, float], friction: float, stiffness: float, units: Units) -> str:
    least, most = span
    mass = units(most, "kg", "g") if least == most else f"{units.number(least, 'kg', 'g')} to {units(most, 'kg', 'g')}"
    spring = f", a spring of {units(stiffness, 'N/m', 'g')}" if stiffness else ""
    return f"{mass}, friction {units(friction, 'N·s/m', 'g')}{spring}"


def next_command(prediction: Prediction, is_placed: bool) -> tuple[str, ...]:
    """Returns what to do next with the scene: find out what shakes or is refused ("check",), measure what the hand
    feels ("measure",) or what hands tied to others feel ("measure", "--hands"), or else ("run",). `is_placed`: the
    prediction is for other places than the scene's."""
    scene, in_admittance = prediction.scene, bool(prediction.felt_masses)
    if not math.isfinite(prediction.spectral_radius) or prediction.shaking is not None or slew_error(scene):
        return ("check",)
    hands = per_channel(scene.mock_device.hand.stiffness, scene.channels)  # which hold the handles for `measure`
    channel = next((point.channel for point in scene.device_points.values()), 0)
    part = prediction.part_on(channel)
    is_linked = part is not None and len(part.names) > 1 and scene.space == 1 and not is_placed
    if (is_placed or is_linked or not hands[channel]) if in_admittance else not prediction.is_held:
        return ("run",)
    return ("measure", "--hands") if is_linked else ("measure",)
