"""`hapsim identify`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hapsim.cli import output
from hapsim.cli.command_options import (
    DeviceOptions,
    Json,
    PictureOptions,
    flag,
    hand_channel,
    option,
    print_next,
    push_option,
    require_file,
    require_units,
    seconds,
)
from hapsim.cli.identified_servo import show_servo
from hapsim.cli.identified_transmission import show_transmission
from hapsim.cli.live import live_line
from hapsim.cli.output import output_units
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.measuring.device_sensor import has_right_scale, sensor_warnings
from hapsim.measuring.identify_device import SECONDS, bounds_of, identify_device
from hapsim.measuring.identify_servo import SECONDS as SECONDS_OF_SERVO
from hapsim.measuring.identify_servo import identify_servo
from hapsim.measuring.identify_transmission import SECONDS as SECONDS_OF_TRANSMISSION
from hapsim.measuring.identify_transmission import identify_transmission
from hapsim.measuring.trace_quality import spikes
from hapsim.number_format import rounded
from hapsim.scene import Known
from hapsim.scene.rewrite import require_rewritable, rewrite_device

if TYPE_CHECKING:
    from hapsim.measuring.device_fit import Estimate
    from hapsim.measuring.device_motion import Bounds
    from hapsim.measuring.identify_device import DeviceIdentification
    from hapsim.scene import Scene

_LABELS = {
    "mass": ("mass", "kg"),
    "friction": ("friction", "N·s/m"),
    "stiffness": ("stiffness", "N/m"),
    "delay": ("delay", "samples"),
    "coulomb": ("dry friction", "N"),
    "constant_force": ("constant force", "N"),
}
_HOLD = "Hold it as it will be held, and let it move freely: the hand is part of the mass."
_LET_GO = "Let go of it: no hand may hold it or lean on it."
_SEEN = 3.0  # uncertainties: a value that differs from 0
_OFF = 4.0  # uncertainties: a value that differs from the declared one

Written = Mapping[str, str | Known]
"""Values written into the scene, by key."""


def identify(
    device: DeviceOptions,
    channel: int | None = option(None, "Channel to push [default: the first]"),
    push: float | None = push_option("--force"),
    travel: float | None = option(
        "M", "Largest travel, such as 10mm. Beyond it the run stops [default: 0.005 m or 0.2 rad]", unit="m"
    ),
    duration: float | None = seconds("Duration of the recording in seconds [default: 6, of a transmission 25]"),
    transmission: bool = flag(
        "--transmission", "Identify motor, transmission, handle and the motor's lag. No hand may hold the device."
    ),
    write: bool = flag("--write", "Write the values into the scene's `device` [default: only print them]"),
    *,
    picture: PictureOptions,
    json: Json = False,
) -> None:
    """Push the device, and identify its mass, spring, delay, viscous and dry friction.

    hapsim pushes the device to both sides, gently at first, against several simulated springs. It prints each value
    with its uncertainty, beside the value in the scene. Only the `device` section of the scene is used. The file
    changes only with --write. With --transmission it shakes the device, and identifies the masses on either side of a
    belt, capstan or gear, its stiffness and damping, and the time by which the motor's force lags.

    With `mode: admittance` it commands a chirp to the device, which no hand may hold, and identifies the servo's
    bandwidth and damping, the delay, and the mass beyond the force sensor.
    """
    if write:
        require_file(device.scene, "--write")
    scene, kind = device.load(), device.kind()
    port = scene.device.port if kind == "auto" else None
    servo = scene.device.is_admittance
    if servo and (option := "--transmission" if transmission else "a picture" if picture.wanted else ""):
        raise UsageError(f"{option}: found with device.mode: admittance, whose servo is identified; omit it")
    picture.require_writable()
    of_channel = () if channel is None else ("--channel", str(channel))
    channel = hand_channel(scene, channel)
    if write:
        _require_right_device(scene, channel, port, transmission or servo)
        require_rewritable(device.scene)
    require_units(output_units(), push, travel)
    scene, travel = _within_travel(scene, channel, travel)
    bounds = bounds_of(scene, channel, push, travel)
    needed = duration or (SECONDS_OF_TRANSMISSION if transmission else SECONDS_OF_SERVO if servo else SECONDS)
    output.print_message(_before_pushing(bounds, channel, port, needed, held=not (transmission or servo), servo=servo))
    options: dict[str, Any] = {"channel": channel, "force": push, "travel": travel, "duration": duration}
    options |= {"transport": kind, "stop_on_signals": True}
    identified: Any = identify_transmission if transmission else identify_servo if servo else identify_device
    with live_line(output.stderr()) as show_progress:
        found = identified(scene, on_progress=show_progress, **options)
    if transmission:
        show_transmission(device.scene, scene, found, write, json, picture)
    elif servo:
        show_servo(device.scene, scene, found, write, json)
    else:
        _draw(found, picture)
        _show(device.scene, scene, found, write, json)
        if not json:
            picture.print_written()
            if write and not found.stopped:
                print_next("measure", device.scene, *device.words(), *of_channel)


def _draw(found: DeviceIdentification, picture: PictureOptions) -> None:
    """Draws what the fit leaves, if a picture or its data are wanted."""
    if picture.wanted:
        from hapsim.chart.trace_chart import draw_device_residual, residual_columns

        picture.write(lambda: residual_columns(found), lambda path: draw_device_residual(found, path))


def _require_right_device(scene: Scene, channel: int, port: str | None, transmission: bool) -> None:
    """Raises UsageError if what is found is not what the scene's `device` describes."""
    if port != scene.device.port:
        raise UsageError(
            "--write: found --mock or --transport beside a port: what is found of the mock is not its device's; leave "
            "out one of them"
        )
    if not transmission and not scene.device.drives(scene.channels)[channel].is_rigid:
        raise UsageError(
            "--write: the file states a transmission or a motor lag, and this identifies one mass that moves at once; "
            "expected --transmission too"
        )


def _before_pushing(bounds: Bounds, channel: int, port: str | None, seconds: float, held: bool, servo: bool) -> str:
    device = "the built-in mock" if port is None else f"the device at {port}"
    force, travel = output_units()(bounds.force, "N", "g"), output_units()(bounds.travel, "mm", "g")
    if servo:
        return (
            f"Commanding chirps to channel {channel} of {device}, less than {travel} to both sides. This takes about "
            f"{seconds:g} s. {_LET_GO} Ctrl-C releases it."
        )
    return (
        f"Pushing channel {channel} of {device} to both sides with at most {force}. This takes about {seconds:g} s, "
        f"plus the time to find the push. It stops if the device moves more than {travel} from where it is now. "
        f"{_HOLD if held else _LET_GO} Ctrl-C releases it."
    )


def _within_travel(scene: Scene, channel: int, travel: float | None) -> tuple[Scene, float | None]:
    """Returns the scene, and how far the device may move from where it is found (m), so that it stays in the scene's
    travel.

    Each of the runs that push it would take another `origin: here`: these count from where they find it, and the
    limits are what is left to either side.
    """
    device = scene.device
    least, most = device.travels(scene.channels)[channel]
    here = device.origins(scene.channels)[channel] is None
    room = min(most, -least) if here else 0.5 * (most - least)
    if here and room <= 0.0:
        found = f"{output_units().number(least, 'm', 'g')} to {output_units()(most, 'm', 'g')}"
        raise UsageError(
            f"device.travel: found {found} from the position at arming (origin: here), expected room to push to both "
            "sides. Move the device to the middle of its travel, and omit travel and origin for this command"
        )
    if here:
        none = {"travel": None, "travel_margin": None, "origin": None}
        scene = scene.model_copy(update={"device": device.model_copy(update=none)})
    usual = device.scales(scene.channels)[channel].travel
    return scene, travel if room >= (usual if travel is None else travel) else room


def _show(path: str, scene: Scene, found: DeviceIdentification, write: bool, json: bool) -> None:
    """Prints the estimates, then writes them if asked to. They are printed even if they cannot be written."""
    device, channels, channel = scene.device, scene.channels, found.channel
    least, most = device.mass_spans(channels)[channel]
    declared = {
        "mass": device.masses(channels)[channel],
        "friction": device.frictions(channels)[channel],
        "stiffness": device.stiffnesses(channels)[channel],
        "delay": device.delay,
    }
    if not json:
        title = f"The device at {scene.hand_on(channel)}, channel {channel}"
        estimates = {key: getattr(found, key) for key in _LABELS}
        output.stdout().print("", output.estimates_table(title, _LABELS, declared, estimates, _off_by))
        for sentence in [*_sentences(found, declared["mass"]), *_sensor_sentences(found, device.acceleration_age)]:
            output.print_line(sentence)
    values: Written | None = None
    if write and not found.stopped:
        values = _values_to_write(found, declared, has_span=least < most)
        values = {**values, **_age_to_write(found, device.sensors)}
    in_file = {} if values is None else rewrite_device(path, values, channel, scene.device_name)
    if json:
        print(
            output.document(
                {"scene": path, "motion": device.motions(channels)} | _identification_document(found, declared, values)
            )
        )
    elif values is None:
        why = "--write writes these values into its `device`"
        if write:
            why = "it was stopped before the recording was complete"
        elif not device.drives(channels)[channel].is_rigid:
            why = "its transmission or motor lag is no part of this fit of one mass; --transmission fits it"
        output.print_line(f"The file was not changed: {why}.")
    else:
        written = ", ".join(f"{name}: {value}" for name, value in in_file.items())
        stays = " The mass stays: the file gives a span for it, and this is one hand's." if least < most else ""
        output.print_line(f"Wrote into `device` of {path}: {written}.{stays}")


def _values_to_write(found: DeviceIdentification, declared: Mapping[str, float], has_span: bool) -> Written:
    """Returns what `--write` puts into the `device` section, with the digits that are known.

    The mass has its uncertainty; a spring is written if one was seen or is declared; nothing is below 0, as of no
    device. `has_span`: the file gives a span for the mass, which one hand does not determine.
    """
    values: dict[str, str | Known] = {}
    for name, declared_value in declared.items():
        estimate: Estimate = getattr(found, name)
        if name == "mass":
            uncertainty = float(f"{estimate.uncertainty:.1e}")
            if not has_span:
                values[name] = Known(value=float(rounded(estimate.value, uncertainty)), uncertainty=uncertainty)
        elif name != "stiffness" or _is_seen(estimate) or declared_value != 0.0:
            values[name] = rounded(max(estimate.value, 0.0), estimate.uncertainty)
    return values


def _age_to_write(found: DeviceIdentification, declared: Sequence[str]) -> Written:
    """Returns the age of the acceleration, if it is known and the scene reads this sensor."""
    sensor = found.acceleration_sensor
    if sensor is None or sensor.age is None or not has_right_scale(sensor) or "acceleration" not in declared:
        return {}
    return {"acceleration_age": str(sensor.age)}


def _sensor_sentences(found: DeviceIdentification, declared_age: int) -> list[str]:
    """Returns a sentence about the acceleration sensor, and warnings."""
    sensor, units = found.acceleration_sensor, output_units()
    if sensor is None:
        return []
    scale = rounded(sensor.scale.value, sensor.scale.uncertainty)
    offset, noise = units(_rounded(sensor.offset, "m/s²"), "m/s²"), units(sensor.noise, "m/s²", ".2g")
    age = "an age that the forces do not show" if sensor.age is None else f"an age of {sensor.age}"
    warnings = sensor_warnings(sensor, found.channel, declared_age, units)
    return [
        f"Its acceleration sensor shows {scale} times the acceleration of the motion, with an offset of {offset}, a "
        f"noise of {noise} rms, and {age}.",
        *(f"Warning: {sentence}." for sentence in warnings),
    ]


def _is_seen(estimate: Estimate) -> bool:
    return estimate.value > _SEEN * estimate.uncertainty


def _rounded(estimate: Estimate, unit: str) -> str:
    return output_units().rounded(estimate.value, estimate.uncertainty, unit)


def _off_by(estimate: Estimate, known: float, off_by: str) -> str:
    return "agrees" if abs(estimate.value - known) < _OFF * estimate.uncertainty else off_by


def _rate_sentences(found: DeviceIdentification, declared_mass: float) -> list[str]:
    """Returns a sentence if the positions arrived at another rate than the declared one: by it, the mass would be
    another. `declared_mass`: kg."""
    seen = found.seen_rate
    if seen is None or not seen.differs_from(found.rate_hz):
        return []
    arrived = f"The positions arrived at {seen.rate_hz:.6g} Hz, and the device declares {found.rate_hz:g} Hz"
    change = abs((found.rate_hz / seen.rate_hz) ** 2 - 1.0) * declared_mass
    if abs(found.mass.value - declared_mass) < _OFF * found.mass.uncertainty < 0.5 * change:
        return [f"{arrived}. The mass shows that it keeps that rate: this machine held the positions up."]
    return [
        f"{arrived}: mass, friction and stiffness hold for the declared rate. Either its timer is wrong, which you "
        "correct first, or this machine held the positions up (`hapsim doctor`)."
    ]


def _sentences(found: DeviceIdentification, declared_mass: float) -> list[str]:
    """Returns what the table does not say. `declared_mass`: kg."""
    units = output_units()
    pairs = ", ".join(
        f"({units(drive.stiffness, 'N/m', 3)}, {units(drive.damping, 'N·s/m', 2)})" for drive in found.drives
    )
    stopped = "Stopped before the recording was complete. " if found.stopped else ""
    sentences = [
        f"{stopped}Read from {found.samples} samples at simulated (K, B) of {pairs}; it moved "
        f"{units(found.peak_m, 'mm', '.2g')} at most. The fit leaves {units(found.residual_m, 'm', '.2g')} rms."
    ]
    if found.hand is not None:
        hand = found.hand
        mass, stiffness, damping = (
            units(_rounded(estimate, unit), unit)
            for estimate, unit in ((hand.mass, "kg"), (hand.stiffness, "N/m"), (hand.damping, "N·s/m"))
        )
        sentences.append(
            f"A second mass moves with it: {mass} on {stiffness} and {damping}. The values above are those of the mass "
            "whose position is read. The second is a hand's, or lies behind a transmission: with the hand off, "
            "--transmission identifies that. Without it in the file hapsim predicts the first mass alone."
        )
    if _is_seen(found.coulomb):
        sentences.append(
            f"It has dry friction, {units(_rounded(found.coulomb, 'N'), 'N')}, for which `device` has no key: the "
            "prediction leaves it out, and what the hand feels is damped more. `mock.coulomb` gives it to the mock."
        )
    if abs(found.constant_force.value) > _SEEN * found.constant_force.uncertainty:
        sentences.append(
            f"A constant force of {units(_rounded(found.constant_force, 'N'), 'N')} acts where it was found: gravity, "
            "an offset of the force, or a spring that rests elsewhere."
        )
    sentences += spikes(found.traces, found.channel)
    sentences += _rate_sentences(found, declared_mass)
    if found.misfit:
        sentences.append(
            f"Warning: {found.misfit[0].lower()}{found.misfit[1:]} The uncertainties allow for it as noise only."
        )
    return sentences


def _identification_document(
    found: DeviceIdentification, declared: Mapping[str, float], written: Written | None
) -> dict[str, Any]:
    """Returns the document of `hapsim identify --json`, without the scene."""
    values: dict[str, Any] | None = None
    if written is not None:
        values = {name: float(one) if isinstance(one, str) else one for name, one in written.items()}
        values |= {name: one.model_dump() for name, one in written.items() if isinstance(one, Known)}
    return {
        **pick(found, "channel peak_m samples residual_m stopped rate_hz noise_m"),
        "declared": dict(declared),
        "identified": pick(found, " ".join(_LABELS)),
        **pick(found.bounds, "force_n=force travel_m=travel"),
        "drives": [
            pick(drive, "K=stiffness B=damping push_n=force") | {"push_s": drive.half / found.rate_hz}
            for drive in found.drives
        ],
        **pick(
            found,
            "misfit? rate_seen_hz=seen_rate.rate_hz rate_seen_uncertainty_hz=seen_rate.uncertainty_hz hand "
            "acceleration_sensor",
        ),
        "written": values,
    }
