"""What has to hold before a scene runs: the options, the device that answers, the predicted stability.

A scene that is predicted unstable shakes the hand with all the force there is, so it runs only on request. A stability
that was not worked out, or is marginal, is no reason to refuse (`hapsim.prediction.surely_shaken_by`).
"""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.errors import DescriptionError, UsageError
from hapsim.loop.system import require_linux
from hapsim.number_format import between, rounded_down
from hapsim.prediction import Prediction, is_surely_unstable, surely_shaken_by
from hapsim.prediction.force_bounds import refused_travel
from hapsim.recording.trace import require_writable_as_trace
from hapsim.running.options import RunOptions
from hapsim.scene import DamperScheme, Scene
from hapsim.scene.choices import WITH_SENSOR
from hapsim.scene.issue import one_of

_MOST_TICKS = 2.0**62

PACING = {
    "device": schema.PACED_BY_DEVICE,
    "host": schema.PACED_BY_HOST,
    "lockstep": schema.LOCKSTEP,
}
"""The code of a scene's clock on the wire."""


def require_runnable(scene: Scene, options: RunOptions) -> None:
    """Raises UsageError where the scene cannot run with these options, before anything is opened."""
    if not 1e-3 <= scene.rate <= 1e9:
        raise UsageError(f"rate: found {scene.rate:g} Hz, which no clock keeps (1e-3 to 1e9 Hz)")
    if options.duration is not None and not 0 < options.duration * scene.rate < _MOST_TICKS:
        raise UsageError(f"duration: found {options.duration}, expected a finite number of seconds above 0")
    if not options.unstable and (why := refused_travel(scene)):
        raise UsageError(why)
    if options.realtime:
        require_linux("--realtime", "leave it out")
    if options.record is not None:
        require_writable_as_trace(Path(options.record))
    shaken = surely_shaken_by(scene) if options.unstable is False else None
    if shaken is not None:
        raise UsageError(f"not armed: the scene is predicted unstable: {shaken.sentence}")


def require_not_less_stable(before: Scene, scene: Scene) -> None:
    """Raises UsageError where `scene` is certainly unstable, and more so than `before`, which runs: an unstable scene
    may be made less so."""
    shaken = surely_shaken_by(scene)
    if shaken is None:
        return
    now = surely_shaken_by(before)
    if now is None or shaken.growth > now.growth:
        raise UsageError(f"the scene is predicted unstable: {shaken.sentence}")


def why_not_armed(path: str, scene: Scene, prediction: Prediction) -> str:
    """Returns why `scene`, of the file `path`, is not armed given its prediction, and what to do; "" where it may be
    armed."""
    if not is_surely_unstable(prediction):
        return ""
    shaken = surely_shaken_by(scene)
    grows = "" if shaken is None else f": {shaken.sentence}"
    return (
        f"{path}: not armed: the scene is predicted unstable (spectral radius {prediction.spectral_radius:.6g}, stable "
        f"below 1){grows}.{_stable_alternatives(prediction)} `hapsim check` tells more; with --unstable it runs all "
        f"the same, and the hand is shaken with up to the force limit of {scene.device.force_limit:g} N until the "
        "energy guard ends the run (hapsim/STABILITY.md tells what it finds)"
    )


def _stable_alternatives(prediction: Prediction) -> str:
    """Returns a sentence: with how much of its stiffness, or with which damping, each hand that is a system of its own
    would be stable."""
    ways = []
    for one in prediction.felt:
        least, most = one.stable_damping
        if 0.0 < one.stiffness_factor < 1.0:
            ways.append(f"{one.name} with less than {rounded_down(one.stiffness_factor)} of its stiffness")
        if not one.stable and least < most:
            ways.append(f"{one.name} with a damping between {between(max(least, 0.0), most, ' and ')} N·s/m")
    return f" Stable by itself: {'; or '.join(ways)}." if ways else ""


def require_compatible(scene: Scene, name: str, description: Description) -> None:
    """UsageError or DescriptionError where scene and device do not go together. `name`: what a user calls the port."""
    if description.channels < scene.channels:
        raise UsageError(f"{name}: the device has {description.channels} channel(s), the scene uses {scene.channels}")
    _require_numbers(name, description)
    if abs(description.rate_hz / scene.rate - 1.0) > 1e-6:
        raise UsageError(
            f"{name}: the device samples at {description.rate_hz:g} Hz, the scene says {scene.rate:g} Hz: "
            f"write rate: {description.rate_hz:g} into the scene, or set the device"
        )
    if description.max_watchdog_samples < 1:
        raise DescriptionError(
            f"{name}: the device allows no watchdog (its register {schema.REG_MAX_WATCHDOG} reads 0), so that nothing "
            f"would end a force of a host that died: found 0, expected 1 to {schema.MAX_WATCHDOG_SAMPLES} samples. Not "
            "armed; set the register in its firmware"
        )
    if not description.paces(PACING[scene.device.clock]):
        raise UsageError(
            f"{name}: the device cannot be run with clock: {scene.device.clock}; try another clock in the scene"
        )
    for channel, origin in enumerate(scene.device.origins(scene.channels)):
        if abs(origin or 0.0) >= 2**31 * description.position_scale[channel]:
            raise UsageError(
                f"{name}: device.origin: found {origin:g} m on channel {channel}, where no position of this device is: "
                f"its counts end at {2**31 * description.position_scale[channel]:g} m"
            )
    if scene.sensed_links:
        _require_velocity(scene, name, description)


def require_known_zero(scene: Scene, name: str) -> None:
    """DescriptionError where the scene's travel counts from a zero that a device which restarted no longer has."""
    named = scene.device.origin is not None and not all(one is None for one in scene.device.origins(scene.channels))
    if named and scene.device.travel is not None:
        raise DescriptionError(
            f"{name}: the device restarted: its position 0 is now where it powered up or homed, and device.origin and "
            "device.travel of the scene count from where it was before. Not armed again: put the device where they "
            "hold, and start anew; with origin: here they count from where it is armed, and without an origin from the "
            "device's own zero (a device that homes), and it is armed again"
        )


def _require_numbers(name: str, description: Description) -> None:
    """DescriptionError where the rate, a scale or a limit is not a number above 0."""
    _require_above_zero(name, "a rate", description.rate_hz, "Hz", schema.REG_RATE)
    declared = (
        ("position scale", description.position_scale, "m per count", schema.REG_POSITION_SCALE),
        ("force scale", description.force_scale, "N per count", schema.REG_FORCE_SCALE),
        ("force limit", description.force_limit, "N", schema.REG_FORCE_LIMIT),
    )
    for channel in range(description.channels):
        at = schema.REG_CHANNEL + channel * schema.CHANNEL_WORDS
        for what, values, unit, register in declared:
            _require_above_zero(name, f"a {what} of channel {channel}", values[channel], unit, at + register)


def _require_above_zero(name: str, what: str, value: float, unit: str, register: int) -> None:
    if not (np.isfinite(value) and value > 0):
        raise DescriptionError(
            f"{name}: the device declares {what} of {value:g} {unit} (register {register}), which is not a number above"
            " 0. Not armed; set the register in its firmware"
        )


def _require_velocity(scene: Scene, name: str, description: Description) -> None:
    links, others = scene.sensed_links, [name for name in get_args(DamperScheme) if name not in WITH_SENSOR]
    if not description.velocity_scale:
        raise UsageError(
            f"{name}: the device does not sense velocity, but {', '.join(links)} {'ask' if links[1:] else 'asks'} "
            f"for it with damper: {one_of(WITH_SENSOR)}; write damper: {one_of(others)} there, or use a firmware that "
            "reports velocity"
        )
    if not description.senses_velocity or not all(np.isfinite(description.velocity_scale)):
        raise DescriptionError(f"{name}: the device declares a velocity scale that is not a number above 0")
