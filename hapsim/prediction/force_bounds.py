"""Bounds of the force besides its limit: slew, soft start, energy and travel."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from firmware_protocol.description import Description
from hapsim.number_format import duration, rounded_up
from hapsim.prediction.linear import configuration_of, with_device
from hapsim.prediction.plausibility import unlikely
from hapsim.prediction.predict import Prediction
from hapsim.prediction.timing import FIRST_SAMPLES, host_silence, on_wire
from hapsim.scene import Scene
from hapsim.scene.values import Area

RISE_S = 1e-3  # from zero to the force limit, or a sample period if that is longer
SOFT_START_S = 0.05
SIGN_RATE_HZ = 500.0  # below, the guard of the sign has too few samples
COARSEST = 2e-6  # s², of count times mass over force limit: with more, a hand moves as fast as the guard's filter
_SIGN_HZ = 5.0  # below, the guard finds only every second motor with a wrong sign
ARMED_INSIDE = 0.1  # of the energy limit: the work that a hand which is armed inside a contact gets on its way out
ONE_PERIOD = 1.0 + 1e-12  # so that rounding keeps a whole number of counts
_IN_HAND = 0.1  # of a mode's kinetic energy: with less in the hand, its force does not drive the mode


class ForceBounds(NamedTuple):
    """Bounds of a run's force."""

    slew_limit: float
    """Slew limit, N/s; infinity: none."""
    soft_start_s: float
    """Soft start, s; 0: none."""
    energy_limit: float
    """Energy limit, J; infinity: none."""


def force_bounds(
    scene: Scene, *, in_hand: bool, judges_energy: bool = False, force_limit: float | None = None
) -> ForceBounds:
    """Returns the bounds of a scene on a device that a hand may hold (`in_hand`) or on the mock. `judges_energy`: the
    energy has a limit on the mock too. `force_limit`: of the device, N."""
    device = scene.device
    most = device.force_limit if force_limit is None else min(force_limit, device.force_limit)
    slew, soft, energy = device.slew_limit, device.soft_start, device.energy_limit
    if slew is None:
        slew = most / max(RISE_S, scene.period) if in_hand else math.inf
    if soft is None:
        soft = max(SOFT_START_S, FIRST_SAMPLES * scene.period) if in_hand else 0.0
    if energy is None:
        least = min(one.energy for one in device.scales(scene.channels))
        energy = least * most if in_hand or judges_energy else math.inf
    return ForceBounds(slew, soft, energy)


def run_bounds(scene: Scene) -> ForceBounds:
    """Returns the bounds of `hapsim run` on the scene's own device."""
    in_hand = scene.device.port is not None and scene.device.clock != "lockstep"
    return force_bounds(scene, in_hand=in_hand, judges_energy=True)


def guard_sentence(scene: Scene) -> str:
    """Returns the bounds of the force in `hapsim run`, and after the host dies, in a sentence."""
    bounds = run_bounds(scene)
    slew = f", slew {scene.units(bounds.slew_limit, 'N/s', 'g')}" if math.isfinite(bounds.slew_limit) else ""
    soft = f", soft start {duration(bounds.soft_start_s)}" if bounds.soft_start_s > 0.0 else ""
    silence = duration(host_silence(scene.rate).zero_force_after_s)
    if scene.device.is_admittance:
        return (
            f"Guards: {command_limits(scene)}, energy {scene.units(bounds.energy_limit, 'J', 'g')}; {silence} "
            "after the host dies the device brakes to rest, and half a second after its watchdog its torque ends"
        )
    return (
        f"Guards: force {scene.units(scene.device.force_limit, 'N', 'g')}{slew}{soft}, energy "
        f"{scene.units(bounds.energy_limit, 'J', 'g')}; zero force {silence} after the host dies"
    )


def command_limits(scene: Scene) -> str:
    """Returns the limits of the commands of each channel of a scene in admittance, in words."""
    device, channels = scene.device, scene.channels
    each = zip(device.speed_limits(channels), device.acceleration_limits(channels), strict=True)
    limits = [
        f"{scene.units_of(c)(v, 'm/s', 'g')} and {scene.units_of(c)(a, 'm/s²', 'g')}" for c, (v, a) in enumerate(each)
    ]
    return f"commands {', '.join(dict.fromkeys(limits))}"


def slew_step_error(scene: Scene, force_scale: Iterable[float]) -> str:
    """Returns the error of a slew limit below one count of the device's force in a sample; "" if there is none.
    `force_scale`: N per count of each channel; a scale above the force limit has no finer step."""
    slew, limit = scene.device.slew_limit, scene.device.force_limit
    if slew is None:
        return ""
    scales = [scale for scale in force_scale if slew * scene.period / scale * ONE_PERIOD < 1.0 and scale <= limit]
    if not scales:
        return ""
    least = scene.units(max(scales) * scene.rate / ONE_PERIOD, "N/s", rounded_up)
    return (
        f"device.slew_limit: found {scene.units(slew, 'N/s', 'g')}, less than a count of the device's force per "
        f"sample; expected at least {least}"
    )


def slew_error(scene: Scene) -> str:
    """Returns the same error for the mock's counts, if the scene's device is the mock."""
    return slew_step_error(scene, [scene.mock_device.force_scale]) if scene.device.port is None else ""


def slew_problems(scene: Scene, prediction: Prediction) -> list[str]:
    """Returns why `hapsim run` refuses the slew limit, and whether it is too slow for the predicted `scene`."""
    refused, slow = slew_error(scene), slew_warning(scene, prediction)
    return [*([f"{refused}: `hapsim run` refuses this scene."] if refused else ()), *([slow] if slow else ())]


def slew_warning(scene: Scene, prediction: Prediction) -> str:
    """Returns a warning if the slew limit of `run_bounds` is too slow for the predicted `scene`; "" if it is not. Too
    slow is less than 2 pi f times the force limit, the steepest part of an oscillation up to it, with f the highest
    frequency at which a hand oscillates."""
    limit, slew = scene.device.force_limit, run_bounds(scene).slew_limit
    fastest = fastest_swing_hz(scene, prediction)
    steepest = 2.0 * math.pi * fastest * limit
    if not steepest > slew:
        return ""
    found, needed = scene.units(slew, "N/s", "g"), scene.units(steepest, "N/s", lambda value: str(math.ceil(value)))
    return (
        f"device.slew_limit: found {found}, with which the force takes {duration(limit / slew)} from zero to the force "
        f"limit of {scene.units(limit, 'N', 'g')}. The fastest oscillation of a hand ({fastest:.4g} Hz) has a quarter "
        f"period of {duration(0.25 / fastest)}; up to the limit it needs {needed}. "
        "The prediction does not include the slew limit: the late force may shake the hand. Use a slew_limit well "
        "above that, a lower force_limit, or less stiffness."
    )


def unjudged_motors(scene: Scene, description: Description | None = None) -> tuple[str, ...]:
    """Returns for each channel why the sign guard cannot judge its motor, or not each of its faults, in words that
    follow "because"; "" if it can. `description`: of the device, if it is known; a count of `mock.quantum` counts if it
    is coarser."""
    if scene.rate < SIGN_RATE_HZ:
        return (f"it samples at less than {SIGN_RATE_HZ:g} Hz",) * scene.channels
    masses, counts = scene.device.mass_spans(scene.channels), scene.mock_device.quantum
    limits = (math.inf,) * scene.channels
    if description is not None:  # of which the scene may use fewer channels
        limits = description.force_limit[: scene.channels]
        counts = tuple(map(max, description.position_scale, counts))
    reasons = []
    for c, ((_, mass), count, limit) in enumerate(zip(masses, counts, limits, strict=True)):
        units, coarsest = scene.units_of(c), COARSEST * min(limit, scene.device.force_limit) / mass
        if count > coarsest * ONE_PERIOD:
            found, most = units(count, "mm", ".3g"), units(coarsest, "mm", ".2g")
            reasons.append(f"its positions have counts of {found}, more than {most} for this mass and force limit")
        elif len(scene.hand_of(c)) > 1:
            reasons.append("in the plane, motors that are turned by 30° to 45° seem right")
        else:
            reasons.append("")
    return tuple(reasons)


def sign_warning(scene: Scene, prediction: Prediction) -> str:
    """Returns a warning if the guard may miss a wrongly wired motor while `scene` runs; "" if it mostly finds it, or in
    admittance, where the handle does not follow such a motor at all."""
    if scene.device.is_admittance:
        return ""
    reasons, fastest = unjudged_motors(scene), fastest_swing_hz(scene, prediction)
    channel = next((c for c, reason in enumerate(reasons) if reason), 0)
    why = reasons[channel]
    if not why and 0.0 < fastest < _SIGN_HZ:
        why = f"it oscillates at {fastest:.2g} Hz, below {_SIGN_HZ:g} Hz, like a hand"
    if not why:
        return ""
    hand = scene.hand_of(channel)
    pair = f" --pair {hand[0]},{hand[1]}" if len(hand) > 1 else ""
    return (
        f"A run of this scene may not reveal a motor that is wired the wrong way: {why}. "
        f"`hapsim probe PORT --push N{pair}` finds it before a run."
    )


def fastest_swing_hz(scene: Scene, prediction: Prediction) -> float:
    """Highest eigenfrequency, Hz, of a hand on the simulated links, below the Nyquist frequency; 0 if there is none."""
    still = {one.name for one in prediction.felt if one.stiffness == one.damping == 0.0}
    held = [i for i, name in enumerate(prediction.points) if name in scene.device_points and name not in still]
    hands = [one.frequency_hz for one in prediction.felt if one.name not in still]
    modes = [
        mode.frequency_hz
        for mode in prediction.modes
        if mode.damping_ratio < 1.0 and float(mode.participation[held].sum()) > _IN_HAND
    ]
    return max((one for one in [*hands, *modes] if 0.0 < one < 0.5 * prediction.rate), default=0.0)


def travel_error(scene: Scene) -> str:
    """Returns the error, without a full stop, of a travel margin whose force fades too steeply for the loop, or ""."""
    device = scene.device
    if device.travel is None:
        return ""
    for channel, margin in enumerate(scene.travel_margins):
        most = device.force_limit
        stable, damping = fade_stiffness(scene, channel), device.scales(scene.channels)[channel].grip_damping
        if not most <= stable * margin:
            where = f" on channel {channel}" if scene.channels > 1 else ""
            likely = "".join(f"{hint.removesuffix('.')}. " for hint in unlikely(scene))  # the cause comes first
            units = scene.units_of(channel)
            least = f"at least {units(most / stable, 'm', rounded_up)}" if stable else "a shorter delay"
            return (
                f"{likely}device.travel_margin: the force of up to {units(most, 'N', 'g')} fades over "
                f"{units(margin, 'm', 'g')}{where}, a stiffness of {units(most / margin, 'N/m', '.4g')} "
                f"that shakes the hand: with only the hand's {units(damping, 'N·s/m', 'g')} and the device's friction "
                f"as dampers, this loop is stable up to {units(stable, 'N/m', '.4g')}; expected "
                f"{least}, or a lower device.force_limit"
            )
    return ""


def fade_stiffness(scene: Scene, channel: int) -> float:
    """Largest stiffness, N/m, with which the loop of a channel is stable, held by a hand, without a simulated damper,
    with the least mass that the scene declares; in admittance K T²/M < 4 - 2 b T/M."""
    if scene.device.is_admittance:  # the simulated mass answers at once
        mass, friction = (of(scene.channels)[channel] for of in (scene.device.masses, scene.device.frictions))
        damping = friction + scene.device.scales(scene.channels)[channel].grip_damping
        return max(0.0, (4.0 * mass * scene.rate - 2.0 * damping) * scene.rate)
    by_host = with_device(on_wire(scene), law="host")  # the force fades once in a sample, wherever its law is
    loop = replace(configuration_of(by_host, channel), spring_lag=0.0)
    least, _ = scene.device.mass_spans(scene.channels)[channel]
    damping = scene.device.scales(scene.channels)[channel].grip_damping
    held = replace(loop, mass=least, friction=loop.friction + damping)
    most = float(held.stable_stiffness(0.0)[1])
    return most if math.isfinite(most) else 0.0


def travel_document(scene: Scene) -> dict[str, Any]:
    """Limits, margin and origin of every channel, in m: None if there is none, "here" for the position at arming; and
    the area of a hand in the plane, whose limits are those of the box around it."""
    device, channels = scene.device, scene.channels
    return {
        "limits_m": None if device.travel is None else device.travels(channels),
        "margin_m": None if device.travel is None else scene.travel_margins,
        "origin_m": ["here" if origin is None else origin for origin in device.origins(channels)],
    } | ({"area_m": device.travel.model_dump()} if isinstance(device.travel, Area) else {})
