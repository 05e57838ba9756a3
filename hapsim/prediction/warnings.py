"""What a hand should know before a scene runs."""

from __future__ import annotations

import math

from hapsim.number_format import number
from hapsim.prediction.characteristic import hand_at
from hapsim.prediction.force_bounds import slow_slew
from hapsim.prediction.own_limits import own_limits
from hapsim.prediction.plausibility import unlikely
from hapsim.prediction.predict import Prediction, is_surely_unstable
from hapsim.scene import Nonlinear, Scene
from hapsim.scene.modules import Link


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
    for name in prediction.trembles:
        swing = prediction.judge.swings[name]
        warnings.append(
            f"{name} swings by itself where a piece of its links is too stiff for the loop: by "
            f"{swing.sentence if swing else ''}, less than a count. Smoother tables do not."
        )
    if prediction.states.unjudged:
        warnings.append(
            "whether the scene is stable in every state of its contacts was not worked out: they are too many, or take "
            "too long. In one of them it may shake the hand."
        )
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
