"""Prediction: what a scene's hand will feel, from the mathematics alone. Nothing is run, nothing is compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.number_format import number
from hapsim.prediction.characteristic import Piece, hand_at, piece_at, scene_at
from hapsim.prediction.correction import (
    Corrected,
    CorrectionKind,
    Rendering,
    felt_error,
    remedies_for,
    rendered,
)
from hapsim.prediction.felt import felt_by, felt_of_predictor, robustness_of, swing
from hapsim.prediction.force_bounds import slow_slew
from hapsim.prediction.linear import (
    LinearScene,
    hand_of,
    instead_of,
    is_lone,
    links_of,
    network_of,
    why_coupled,
)
from hapsim.prediction.own_limits import own_limits
from hapsim.prediction.plausibility import unlikely
from hapsim.prediction.quick import is_surely_stable
from hapsim.prediction.regions import growth, growth_of, regions_of
from hapsim.prediction.timing import PACED, wire_delay, wire_of, wire_time_of, with_wire_delay
from hapsim.prediction.types import Desired, Felt, LinkMargin, Prediction, Region
from hapsim.scene import Nonlinear, Scene
from hapsim.scene.load import SceneSource, as_scene
from hapsim.scene.modules import Link
from hapsim.scene.quantity import per_channel
from hapsim.theory import (
    Margins,
    Network,
    NotWorkedOutError,
    Solution,
    Stabilizing,
    margins_of,
    solve,
)
from hapsim.theory.arrays import sort_by_modulus
from hapsim.theory.network import ContinuousMode, continuous_modes, is_large

_MASSES = 9  # of a span, at which the error of a correction is looked at
_REACHED = 1e-6  # an error of a correction that is none
_SURELY = 1.0 + 1e-9  # what grows by more in a sample is not at the limit
_MOST = 1e60  # of b0 T/m and k0 T²/m: their fourth powers are numbers, too


def predict(scene: SceneSource, *, with_margins: bool = True, at: float | None = None) -> Prediction:
    """What the hand will feel in `scene`, whether the whole of it is stable, and whether the wire is fast enough.

    `scene`: a Scene, or the path of a scene file. `with_margins`: also each link's gain margin, which for a large scene
    takes longer than the rest. `at`: the position of the hands in m [default: where they rest, or are held nearest to
    position 0]. UsageError where that is beyond the travel.
    """
    scene = as_scene(scene)
    with scene.units.in_errors():
        _require_within_numbers(scene)
    rendering = rendered(scene)
    as_seen = rendering.seen
    linear = scene_at(as_seen, at)
    network, points = network_of(as_seen, linear)
    network, solution, instead = _solved(network)
    coupled = {name: why for name in scene.device_points if (why := why_coupled(as_seen, linear, name))}
    felt = tuple(felt_by(rendering, linear, name) for name in scene.device_points if name not in coupled)
    regions = {one.name: found for one in felt if len(found := regions_of(rendering, one.name, at or 0.0)) > 1}
    hands = {name: hand_at(rendering.desired, name, at or 0.0) for name in regions}
    here = {
        name: piece_at(one, name, at if at is not None and one.low <= at <= one.high else None)
        for name, one in hands.items()
    }
    shaken = max(map(growth, regions.values()), default=0.0)

    def is_held(name: str) -> bool:  # somewhere, if not at `at`
        return at is not None and any(one.kind == "held" and one.is_stable for one in regions.get(name, ()))

    whole = not coupled and not linear.masses
    poles, radius = solution.poles, solution.spectral_radius
    if whole and rendering.kind is not None:  # what is made for another mass is no part of the network
        poles = sort_by_modulus(np.array([pole for one in felt for pole in one.poles], complex))
        radius = max(one.spectral_radius for one in felt)
    margins = margins_of(network, solution.poles) if with_margins else Margins([])
    return Prediction(
        rate=scene.rate,
        felt=felt,
        regions=regions,
        here=here,
        coupled=coupled,
        # A loop of lone hands is judged by the formula, which resolves poles that rounding would place on the circle.
        stable=not shaken and all(one.stable or is_held(one.name) for one in felt) and (whole or solution.is_stable),
        spectral_radius=max(radius, shaken),
        poles=tuple(complex(pole) for pole in poles if abs(pole) > 1e-9),
        poles_in_all=solution.all,
        poles_method=solution.method,
        modes=tuple(solution.modes),
        points=points,
        margins=_least(_link_margins(linear, margins, felt), regions),
        margins_method=margins.method,
        wire_time=wire_time_of(scene),
        wire_of=wire_of(scene),
        wire_delay=wire_delay(scene),
        assumptions=tuple(map(scene.units, (*linear.assumptions, *([instead] if instead else []), *_near_pose(scene)))),
        rendering=None if rendering.kind is None else rendering,
        desired=_desired(rendering, felt, here),
        desired_modes=_desired_modes(rendering),
        by_its_scheme=not instead,
    )


def _near_pose(scene: Scene) -> list[str]:
    """Returns where the device's mass and friction hold, in a sentence; none where that is everywhere."""
    if scene.device.mass_at is None:
        return []
    pose = ", ".join(f"{one:g}" for one in per_channel(scene.device.mass_at, scene.channels))
    return [
        f"k and b hold near {pose} m (device.mass_at): elsewhere the device has another mass and friction, and a force "
        "on one channel moves another too"
    ]


def _require_within_numbers(scene: Scene) -> None:
    """UsageError where the device is beyond what floating point holds."""
    if not 1e-9 <= scene.rate <= 1e9:
        raise UsageError(f"rate: found {scene.rate:g} Hz, which is beyond what is worked out (1e-9 to 1e9 Hz)")
    device, channels = scene.device, scene.channels
    for (mass, _), friction, stiffness in zip(
        device.mass_spans(channels), device.frictions(channels), device.stiffnesses(channels), strict=True
    ):
        if friction > _MOST * mass * scene.rate or stiffness > _MOST * mass * scene.rate**2:
            raise UsageError(
                f"device: found {friction:g} N·s/m of friction and a spring of {stiffness:g} N/m on {mass:g} kg, which "
                "is beyond what is worked out: expected a larger mass, or less of them"
            )


def _desired_modes(rendering: Rendering) -> tuple[ContinuousMode, ...]:
    if rendering.kind is None:
        return ()
    network, _ = network_of(rendering.desired, scene_at(rendering.desired))
    return () if is_large(network) else tuple(continuous_modes(network))


def _desired(rendering: Rendering, felt: tuple[Felt, ...], here: Mapping[str, Piece]) -> tuple[Desired, ...]:
    """One for each of the lone hands that a correction acts on; `here`: where those with regions are."""
    of_point, kind = {one.name: one for one in felt}, rendering.kind
    found = []
    for port in rendering.ports:
        k, b = port.desired
        if kind is None or port.name not in of_point or math.isnan(k):
            continue
        if port.name in here:
            piece, device = here[port.name], port.declared
            k, b = device.stiffness + piece.stiffness, device.friction + piece.damping
        robustness = robustness_of(of_point[port.name])
        frequency, ratio = swing(port.declared.mass, k, b)
        least, most = rendering.desired.device.mass_spans(rendering.desired.channels)[port.channel]
        masses = np.geomspace(least, most, 1 if least == most else _MASSES).tolist()
        reached = port.reached
        errors = [_error_with(kind, port, mass) for mass in masses]
        if port.name in here:
            one = of_point[port.name]
            errors = [float(felt_error((np.array(one.k), np.array(one.b)), (k, b), one.configuration.mass))]
            reached = errors[0] < _REACHED
        desired = Desired(
            name=port.name,
            channel=port.channel,
            k=k,
            b=b,
            frequency_hz=frequency,
            damping_ratio=ratio,
            error=float(np.max(errors)),
            reached=reached,
            remedies=None
            if reached or port.name in here or least < most
            else remedies_for(kind, port.declared, port.desired),
            stable_masses=robustness.stable_masses,
            steady_stiffness=robustness.steady_stiffness,
        )
        found.append(desired)
    return tuple(found)


def _error_with(kind: CorrectionKind, port: Corrected, mass: float) -> float:
    """`felt_error` of a hand of this mass, once an estimate of it has settled; 0 for the device alone."""
    one = port.settled(mass)
    if one.stiffness == one.damping == 0.0:
        return 0.0
    loop = kind.closed(replace(port.declared, mass=mass), replace(port.declared, mass=one.made_for), one.observer)
    return float(felt_error(loop.equivalent(one.stiffness, one.damping), port.desired, mass))


def predict_on_wire(scene: Scene) -> Prediction | None:
    """What the hand will feel on a UART, with `WireTime.delay_samples` in place of one, where the scene's own wire is
    none or its pace is not known, as `predict` says it of others. None where a UART costs one sample or is saturated.
    """
    samples = 1 if wire_of(scene) in PACED else wire_time_of(scene).delay_samples
    return None if samples in (None, 1) else predict(with_wire_delay(scene, samples), with_margins=False)


def _solved(network: Network) -> tuple[Network, Solution, str]:
    """The network, its poles and modes; where they are not worked out, those of `instead_of` it, and a sentence."""
    try:
        return network, solve(network), ""
    except NotWorkedOutError as reason:
        instead, sentence = instead_of(network, reason)
        return instead, solve(instead), sentence


class Shaking(NamedTuple):
    """A motion that surely grows."""

    growth: float
    """By how much it is multiplied in a sample, above 1."""
    module: str
    """That moves most in it; "" where no motion was found that does."""

    @property
    def sentence(self) -> str:
        """Without a full stop."""
        by = "beyond all numbers" if self.growth > 1e300 else f"{self.growth:.3g}-fold"
        if self.growth < 2.0:
            by = f"by {100.0 * (self.growth - 1.0):.2g} %"
        whose = f"the motion of {self.module}" if self.module else "a motion"
        return (
            f"{whose} grows {by} a sample; reduce the stiffness there, change its damping, add mass or raise the rate"
        )


def surely_shaken_by(scene: Scene) -> Shaking | None:
    """What will surely shake the hand in `scene`; None where nothing does.

    It is not sure at the limit, or where it was not worked out for the scheme by which the scene runs. This is what a
    running loop has to know of a scene before it takes it, at a tenth of what `predict` costs.
    """
    return None if is_surely_stable(scene) else found_to_shake(scene)


def found_to_shake(scene: Scene) -> Shaking | None:
    """`surely_shaken_by`, worked out in full."""
    scene = rendered(scene).seen
    linear = scene_at(scene)
    for name in scene.device_points:
        grows, whose = growth_of(scene, linear, name)
        if grows > _SURELY:
            return Shaking(grows, whose)
    network, points = network_of(scene, linear)
    try:
        solution = solve(network)
    except NotWorkedOutError:
        return None
    if np.isnan(solution.spectral_radius):
        return Shaking(np.inf, "")
    if not solution.spectral_radius > _SURELY:
        return None
    if is_lone(scene, linear):  # judged by the formula, which resolves poles that rounding would place on the circle
        hands = (hand_of(scene, linear, name) for name in scene.device_points)
        if all(bool(configuration.is_stable(stiffness, damping)) for configuration, stiffness, damping in hands):
            return None
    fastest = max(solution.modes, key=lambda mode: abs(mode.pole), default=None)
    if fastest is None or abs(fastest.pole) < solution.spectral_radius * (1.0 - 1e-9):
        return Shaking(solution.spectral_radius, "")
    return Shaking(solution.spectral_radius, points[int(np.argmax(fastest.participation))].partition(".")[0])


def is_surely_unstable(prediction: Prediction) -> bool:
    """Whether `surely_shaken_by` finds something, by what was predicted."""
    return prediction.by_its_scheme and not prediction.stable and prediction.spectral_radius > _SURELY


def warnings_about(scene: Scene, prediction: Prediction) -> list[str]:
    """What a hand should know before `scene` runs, of which this was predicted: sentences, none where all is well."""
    warnings, limit = unlikely(scene), scene.mock_device.force_limit
    if not prediction.by_its_scheme:
        warnings.append(
            f"how stable the scene is was worked out for scheme: cordis, not for {scene.scheme}, by which it runs."
            if scene.substeps == 1
            else "how stable the scene is was worked out for a device that samples with every substep, not as it runs."
        )
    elif is_surely_unstable(prediction):
        warnings.append(
            "the scene is predicted unstable: `hapsim run` and `measure` refuse it. With --unstable the device "
            f"oscillates with up to {most_force(scene)}, until the energy guard ends the run "
            "(hapsim/STABILITY.md says what it finds)."
        )
        warnings += own_limits(scene)
    for name in prediction.regions:
        hand = hand_at(scene, name)
        x = max(hand.edges(), key=lambda x: abs(float(hand.force(x))), default=0.0)
        if abs(float(hand.force(x))) > limit:
            warnings.append(
                f"{name} at {number(x)} m: the scene asks for {number(abs(float(hand.force(x))))} N, of which the hand "
                f"feels {limit:g} N, the force limit."
            )
    slow = slow_slew(scene, prediction)
    warnings += [slow] if slow else []
    for one in (one for one in prediction.desired if one.remedies is not None):
        off = f", off by {one.error:.1%}" if math.isfinite(one.error) else ""
        warnings.append(
            f"correction {scene.device.correction} does not reach k = {one.k:.6g} N/m, b = {one.b:.6g} N·s/m at "
            f"{one.name}: what comes nearest is simulated{off}. `hapsim check` shows what would reach it."
        )
    budget = prediction.wire_time
    is_explained = any(one.startswith(("rate: ", "device.baud: ")) for one in warnings)
    if prediction.wire_delay:
        warnings.append(f"{prediction.wire_delay}. The prediction is for that delay.")
    elif prediction.wire_of == "unknown" and not budget.fits and not is_explained:
        late = (
            f"{budget.delay_samples} samples of delay in place of one (`hapsim check` shows what the hand feels then)"
        )
        delay = "the frames queue up" if budget.is_saturated else late
        warnings.append(
            f"an exchange takes {budget.exchange_s * 1e3:.4g} ms at {scene.device.baud} baud with the host's work, the "
            f"sample period is {budget.period * 1e3:.4g} ms: on a UART {delay}. "
            "A USB device's own port does not mind."
        )
    return [*map(scene.units, warnings)]


def most_force(scene: Scene) -> str:
    """What bounds the force of an unstable scene, in words: its limit, or what all links of a hand pull together."""

    def of_link(link: Link) -> float:
        by_speed = isinstance(link, Nonlinear) and link.force_over_velocity
        return math.inf if by_speed else link.law().strongest(scene.rate)

    hands = scene.device_points
    strongest = max(sum(of_link(link) for link in scene.links.values() if name in link.between) for name in hands)
    limit = scene.mock_device.force_limit
    return f"the force limit of {limit:g} N" if strongest >= limit else f"the {number(strongest)} N of its links"


def with_mass(prediction: Prediction, channel: int, mass: float) -> Prediction:
    """The same for a hand of this mass (kg) on one channel, once a correction that adapts has found it."""
    rendering = prediction.rendering
    port = None if rendering is None else next((one for one in rendering.ports if one.channel == channel), None)
    if rendering is None or port is None or port.schedule is None:
        return prediction
    settled = port._replace(element=port.settled(mass))
    device = replace(port.declared, mass=mass)
    predictor = rendering.predictor_of(settled)
    felt = tuple(
        felt_of_predictor(one, device, predictor, settled.rendered) if one.channel == channel else one
        for one in prediction.felt
    )
    desired = list(prediction.desired)
    for i, one in enumerate(desired):
        if one.channel == channel:
            frequency, ratio = swing(mass, one.k, one.b)
            desired[i] = one._replace(frequency_hz=frequency, damping_ratio=ratio)
    return replace(prediction, felt=felt, desired=tuple(desired))


def _link_margins(linear: LinearScene, margins: Margins, felt: tuple[Felt, ...]) -> tuple[LinkMargin, ...]:
    """Where a hand's only link is all that holds it, its margin by the closed formula; not where the scene is unstable,
    which another hand may be to blame for."""
    lone = {one.name: one.limits for one in felt if len(links_of(linear, one.name)) == 1}
    named: list[LinkMargin] = []
    stabilizing = margins.stabilizing or [Stabilizing(None, None)] * len(margins.links)
    for (name, link), margin, ranges in zip(linear.links.items(), margins.links, stabilizing, strict=False):
        hand = None if margins.stabilizing else next((end for end in link.between if end in lone), None)
        factor = margin.stiffness_factor if hand is None else lone[hand].stiffness_factor
        named.append(LinkMargin(name, factor, margin.damping_factor, ranges.stiffness, ranges.damping))
    return tuple(named)


def _least(margins: tuple[LinkMargin, ...], regions: Mapping[str, tuple[Region, ...]]) -> tuple[LinkMargin, ...]:
    """Of each link the least margin in any region in which its hand is held."""
    least = {one.name: one for one in margins}
    for region in (one for found in regions.values() for one in found if one.kind == "held" and one.is_stable):
        felt = region.felt
        stiffest, strongest = felt.stiffness * felt.stiffness_factor, felt.stable_damping[1]
        for name, link in region.linear.items():
            before = least.get(name)
            if before is None or before.stabilizing_stiffness is not None:
                continue
            # What all links may have together, without what the others have.
            stiffness = (stiffest - felt.stiffness) / link.stiffness + 1.0 if link.stiffness > 0.0 else math.inf
            damping = (strongest - felt.damping) / link.damping + 1.0 if link.damping > 0.0 else math.inf
            least[name] = replace(
                before,
                stiffness_factor=min(before.stiffness_factor, stiffness),
                damping_factor=min(before.damping_factor, damping),
            )
    return tuple(least.values())
