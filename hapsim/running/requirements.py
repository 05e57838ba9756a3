"""Requirements before a scene runs: valid options, a matching device, predicted stability.

A scene that is predicted unstable oscillates at the force limit, so it runs only on request. An unknown or marginal
stability does not prevent a run (`hapsim.prediction.surely_shaken_by`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.cordis.offline import most_substeps, tick_seconds
from hapsim.cordis.program import compile_scene, require_gates, require_lines
from hapsim.errors import DescriptionError, UsageError
from hapsim.loop.system import require_linux
from hapsim.number_format import duration, rounded_down
from hapsim.prediction import Prediction, is_surely_unstable, surely_shaken_by, unlikely
from hapsim.prediction.felt_mass import admittance_sentences
from hapsim.prediction.first_help import ways_to_stability
from hapsim.prediction.force_bounds import travel_error
from hapsim.prediction.timing import wire_delay, wire_time_of
from hapsim.prediction.warnings import oscillation
from hapsim.recording.trace import require_writable_as_trace
from hapsim.running.admittance_requirements import declared_numbers, require_admittance
from hapsim.running.lsl import require_lsl
from hapsim.running.session_options import RunOptions
from hapsim.scene import DamperScheme, Scene
from hapsim.scene.choices import SENSORS, WITH_SENSOR
from hapsim.scene.cross_checks import narrow_detents
from hapsim.scene.issue import one_of
from hapsim.scene.modules import ModuleContext
from hapsim.sound.play import choose_device
from hapsim.sound.wav import require_writable_as_wav

_MOST_TICKS = 2.0**62
_MOST_LATENCY_S, _MOST_VOLUME_DB = 0.5, 40.0
_FIRMWARE = "Not armed; set the register in its firmware"
_SCALES = (
    ("position_scale", "m per count", schema.REG_POSITION_SCALE),
    ("force_scale", "N per count", schema.REG_FORCE_SCALE),
    ("force_limit", "N", schema.REG_FORCE_LIMIT),
)

PACING = {"device": schema.PACED_BY_DEVICE, "host": schema.PACED_BY_HOST, "lockstep": schema.LOCKSTEP}
"""Code of a scene's clock on the wire."""


def require_runnable(scene: Scene, options: RunOptions) -> None:
    """Raises UsageError if the scene cannot run with these options, before anything is opened."""
    if not 1e-3 <= scene.rate <= 1e9:
        raise UsageError(f"rate: found {scene.rate:g} Hz, which no clock keeps (1e-3 to 1e9 Hz)")
    require_gates(scene)
    if scene.device.law == "board":
        require_lines(scene)
    if options.duration is not None and not 0 < options.duration * scene.rate < _MOST_TICKS:
        raise UsageError(f"duration: found {options.duration}, expected a finite number of seconds above 0")
    if not options.unstable and (why := travel_error(scene)):
        raise UsageError(why)
    if options.realtime:
        require_linux("--realtime", "leave it out")
    if options.record is not None:
        require_writable_as_trace(Path(options.record))
    _require_sound(scene, options)
    if options.lsl is not None:
        require_lsl()
        if options.is_virtual(scene):
            raise UsageError(
                "LSL: found virtual time (clock: lockstep), expected real time: its samples have no times. Use clock: "
                'device or host, or the mock in memory (transport="paced")'
            )
    is_judged = options.unstable is False and scene.at is None  # several devices are judged together
    shaken = surely_shaken_by(scene) if is_judged else None
    if shaken is not None and math.isinf(shaken.growth):
        shaken = None  # out of range: a guard reports the number in the first sample
    if shaken is not None:
        late = f" at its wire's delay ({wire_delay(scene)})" if wire_delay(scene) else ""
        raise UsageError(f"not armed: the scene is predicted unstable{late}: {shaken.sentence(scene.units)}")


def _require_sound(scene: Scene, options: RunOptions) -> None:
    """Raises UsageError if the scene's sound cannot be played or written with these options."""
    if not options.sound and options.sound_file is None:
        return
    if not scene.sound:
        raise UsageError(
            "the scene has no sound: expected pick-ups, such as sound: {ear: {from: gut.7, of: velocity}} "
            "(configs/README.md)"
        )
    if options.sound and options.is_virtual(scene):
        raise UsageError("sound is not played in virtual time (clock: lockstep): --sound-file writes a file")
    if not 0.0 <= options.latency_s <= _MOST_LATENCY_S:
        raise UsageError(f"latency: found {duration(options.latency_s)}, expected 0 to {duration(_MOST_LATENCY_S)}")
    if not options.volume_db <= _MOST_VOLUME_DB:
        raise UsageError(f"volume: found {options.volume_db:g} dB, expected at most {_MOST_VOLUME_DB:g} dB")
    if options.sound_file is not None:
        require_writable_as_wav(Path(options.sound_file), len(scene.sound), scene.step_rate)
    if options.sound and not options.resumes:
        choose_device(options.sound_device)


def require_not_less_stable(before: Scene, scene: Scene) -> None:
    """Raises UsageError if `scene` is certainly unstable, and more so than `before`, the running scene."""
    shaken = surely_shaken_by(scene)
    if shaken is None:
        return
    now = surely_shaken_by(before)
    if now is None or shaken.growth > now.growth:
        raise UsageError(f"the scene is predicted unstable: {shaken.sentence(scene.units)}")


def refusal_to_arm(path: str, scene: Scene, prediction: Prediction) -> str:
    """Returns why `scene`, of the file `path`, is not armed with this prediction; "" if it may be armed."""
    if not is_surely_unstable(prediction):
        return ""
    shaking, (_, prediction) = prediction.shaking, prediction.decisive
    words = None if shaking is None else shaking.motion if prediction.felt_masses else shaking.sentence
    grows = "" if words is None else f": {words(scene.units)}"  # of a simulated mass it is known what would help
    why = " ".join([".", *unlikely(scene)]) if unlikely(scene) else f"{grows}.{_stable_alternatives(scene, prediction)}"
    late = f"; {prediction.wire_delay}" if prediction.wire_delay else ""
    return (
        f"{path}: not armed: the scene is predicted unstable (spectral radius {prediction.spectral_radius:.6g}, stable "
        f"below 1{late}){why} `hapsim check` reports more. With --unstable it runs, and the device "
        f"{oscillation(scene, prediction).removesuffix('.')}"
    )


def _stable_alternatives(scene: Scene, prediction: Prediction) -> str:
    """Returns a sentence with what would make the scene stable: of each hand alone its stiffness or damping."""
    ways = list[str]()
    for mass in prediction.felt_masses:
        ways += admittance_sentences(mass, scene.units_of(mass.channel))
    if ways:
        return f" {'. '.join(ways)}."
    for one in () if prediction.changes_values else prediction.felt:
        least, most = one.stable_damping
        if 0.0 < one.stiffness_factor < 1.0:
            ways.append(f"{one.name} is stable below {rounded_down(one.stiffness_factor)} times its stiffness")
        if not one.stable and least < most:
            damping = scene.units_of(one.channel).between(max(least, 0.0), most, "N·s/m", " and ")
            ways.append(f"{one.name} is stable with a damping between {damping}")
    if ways:
        return f" Gain margin: {'; or '.join(ways)}."
    return f" {sentence}." if (sentence := ways_to_stability(prediction)) else ""


def require_compatible(scene: Scene, name: str, description: Description) -> None:
    """Raises UsageError or DescriptionError if scene and device do not match. `name`: the port, as the user gave it."""
    if description.channels < scene.channels:
        raise UsageError(f"{name}: the device has {description.channels} channel(s), the scene uses {scene.channels}")
    _require_numbers(scene, name, description)
    _require_motion(scene, name, description)
    if abs(description.rate_hz / scene.rate - 1.0) > 1e-6:
        raise UsageError(
            f"{name}: the device samples at {description.rate_hz:g} Hz, the scene says {scene.rate:g} Hz: "
            f"write rate: {description.rate_hz:g} into the scene, or set the device"
        )
    if description.max_watchdog_samples < 1:
        raise DescriptionError(
            f"{name}: the device allows no watchdog (its register {schema.REG_MAX_WATCHDOG} reads 0), so a force would "
            f"outlive a dead host: expected 1 to {schema.MAX_WATCHDOG_SAMPLES} samples. {_FIRMWARE}"
        )
    if not description.paces(PACING[scene.device.clock]):
        raise UsageError(
            f"{name}: the device cannot be run with clock: {scene.device.clock}; try another clock in the scene"
        )
    for channel, origin in enumerate(scene.device.origins(scene.channels)):
        most = 2**31 * description.position_scale[channel]
        if abs(origin or 0.0) >= most:
            units = scene.units_of(channel)
            raise UsageError(
                f"{name}: device.origin: found {units(origin, 'm', 'g')} on channel {channel}; this device counts up "
                f"to {units(most, 'm', 'g')}"
            )
    around, count_of = ModuleContext.of(scene.modules), description.position_scale.__getitem__
    for issue in narrow_detents(around, count_of, "declared by the device"):
        raise UsageError(f"{name}: {'.'.join(map(str, issue.path[1:]))}: {scene.units.filled(issue.sentence)}")
    if scene.device.is_admittance:
        require_admittance(scene, name, description)
    for sensor in scene.sensed:
        _require_sensor(sensor, scene, name, description)
    if scene.device.law == "board":
        _require_board(scene, name, description)
    if scene.has_words and not description.has_words:
        named = " and ".join(key for key in ("inputs", "outputs") if getattr(scene, key))
        raise UsageError(
            f"{name}: the scene has {named}, but the device has no digital word (its register {schema.REG_SENSORS}, "
            f"bit 2); remove {named}, or use a firmware that has one"
        )


def _require_board(scene: Scene, name: str, description: Description) -> None:
    """Raises UsageError if the device does not follow lines as the scene says, or takes less than its links have."""
    board, lines = scene.device.board(scene.rate), description.lines
    if board is None or lines is None:
        raise UsageError(
            f"{name}: device.law: found board, but the device follows no lines (its register {schema.REG_SENSORS}, "
            f"bit 3); write law: host, or use a firmware that does"
        )
    declared = {"board_rate": lines.steps * scene.rate, "board_delay": lines.delay, "board_window": lines.window}
    stated = {"board_rate": board.steps * scene.rate, "board_delay": board.delay, "board_window": board.window}
    if differing := [key for key, value in declared.items() if value != stated[key]]:
        found, write = (", ".join(f"{key}: {of[key]:g}" for key in differing) for of in (stated, declared))
        raise UsageError(f"{name}: device: found {found}, but the device has {write}: write that into the scene")
    if scene.device.delay + 1.0 > lines.kept:
        raise UsageError(
            f"{name}: device.delay: found {scene.device.delay:g} samples, but the device remembers {lines.kept} reports"
        )
    for hand, point in scene.device_points.items():
        links = [link.law() for link in scene.links.values() if hand in link.between]
        units, (*_, most_k, most_b) = scene.units_of(point.channel), lines.scales(point.channel)
        stiffness = max((max(law.sector[1], -law.sector[0]) for law in links), default=0.0)
        damping = max((max(law.dampings) for law in links), default=0.0)
        for what, value, most, unit in (("stiff", stiffness, most_k, "N/m"), ("damped", damping, most_b, "N·s/m")):
            if value > most:
                raise UsageError(
                    f"{name}: a link at {hand} is {what} with {units(value, unit, 'g')}, but the device's board takes "
                    f"at most {units(most, unit, rounded_down)}: make it softer, or write law: host"
                )


def with_sensors(scene: Scene, names: Sequence[str], description: Description) -> Scene:
    """Returns the scene with those of these sensors that the device declares, if their longer frames cause no delay."""
    wanted = (*scene.device.sensors, *(name for name in names if name in description.sensed))
    sensors = tuple(name for name in SENSORS if name in wanted)
    more = scene.model_copy(update={"device": scene.device.model_copy(update={"sensors": sensors})})
    return more if wire_time_of(more).delay_samples == wire_time_of(scene).delay_samples else scene


def require_in_time(scene: Scene, is_virtual: bool = False) -> None:
    """Raises UsageError if the steps of a sample, measured on this machine, take longer than its period."""
    if scene.substeps == 1 or is_virtual:
        return
    seconds = tick_seconds(compile_scene(scene), scene.channels)
    if seconds * scene.substeps > scene.period:
        fits = most_substeps(seconds, scene.period)
        expected = f"expected at most {fits}" if fits else "expected a smaller scene or a lower rate"
        raise UsageError(
            f"substeps: found {scene.substeps}, whose steps take {duration(seconds * scene.substeps)} here; the sample "
            f"period is {duration(scene.period)}; {expected}"
        )


def require_known_zero(scene: Scene, name: str) -> None:
    """Raises DescriptionError if the scene's travel counts from a zero that a restarted device has lost."""
    named = scene.device.origin is not None and not all(one is None for one in scene.device.origins(scene.channels))
    if named and scene.device.travel is not None:
        raise DescriptionError(
            f"{name}: the device restarted: its position 0 is now where it powered up or homed, but the scene's "
            "device.origin and device.travel count from where it was before. Not armed again: put the device back and "
            "start anew. With origin: here, or without an origin for a device that homes, it is armed again"
        )


def _require_numbers(scene: Scene, name: str, description: Description) -> None:
    """Raises DescriptionError if the rate, a scale or a limit is not a number above 0."""
    declared = [("rate", description.rate_hz, "Hz", schema.REG_RATE)]
    for field, unit, register in _SCALES:
        for c, value in enumerate(getattr(description, field)):
            at = schema.REG_CHANNEL + c * schema.CHANNEL_WORDS + register
            declared.append((f"{field.replace('_', ' ')} of channel {c}", value, scene.units.si.name(unit), at))
    if scene.device.is_admittance:
        named = scene.units.si.name
        declared += [(what, value, named(unit), at) for what, value, unit, at in declared_numbers(description)]
    for what, value, unit, register in declared:
        if not (np.isfinite(value) and value > 0):
            raise DescriptionError(
                f"{name}: the device declares a {what} of {value:g} {unit} (register {register}), which is not a "
                f"number above 0. {_FIRMWARE}"
            )


def _require_motion(scene: Scene, name: str, description: Description) -> None:
    """Raises UsageError if the device declares another motion than the scene. A device may declare none."""
    declared, scene_motions = description.motions[: scene.channels], scene.device.motions(scene.channels)
    if not description.rotary or declared == scene_motions:
        return
    channel = next(c for c in range(scene.channels) if declared[c] != scene_motions[c])
    alike = declared[0] if len(set(declared)) == 1 else f"[{', '.join(declared)}]"
    raise UsageError(
        f"{name}: channel {channel} of the device is {declared[channel]} (its register {schema.REG_ROTARY}), the scene "
        f"has motion: {scene_motions[channel]} there. Write motion: {alike} under device, and every value in the units "
        "of that motion"
    )


def _require_sensor(sensor: str, scene: Scene, name: str, description: Description) -> None:
    """Raises UsageError where the device does not send this value, of `Scene.sensed`, with its positions."""
    links, scale = scene.sensed_links, description.scale(sensor)
    if not scale and sensor in scene.device.sensors:
        (register,) = (f"{one.scale_register}" for one in schema.SENSED if one.name == sensor)
        if sensor == "acceleration":
            register = f"{schema.REG_SENSORS}, bit 0, and {register}"
        raise UsageError(
            f"{name}: found a device that does not sense {sensor} (its registers {register}), expected one that does: "
            f"device.sensors names it; leave {sensor} out there, or use a firmware that reports it"
        )
    if not scale:
        others = [name for name in get_args(DamperScheme) if name not in WITH_SENSOR]
        raise UsageError(
            f"{name}: the device does not sense velocity, but {', '.join(links)} {'ask' if links[1:] else 'asks'} "
            f"for it with damper: {one_of(WITH_SENSOR)}; write damper: {one_of(others)} there, or use a firmware that "
            "reports velocity"
        )
    if sensor not in description.sensed or not all(np.isfinite(scale)):
        raise DescriptionError(f"{name}: the device declares a channel's {sensor} scale that is not a number above 0")
