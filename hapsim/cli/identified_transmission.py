"""The answer of `hapsim identify --transmission`: table, sentences, JSON, and the values written into the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hapsim.cli import output
from hapsim.cli.output import output_units
from hapsim.documents import pick
from hapsim.number_format import percent, rounded
from hapsim.scene.rewrite import rewrite_device

if TYPE_CHECKING:
    from hapsim.cli.command_options import PictureOptions
    from hapsim.measuring.device_fit import Estimate
    from hapsim.measuring.identify_transmission import TransmissionIdentification
    from hapsim.scene import Scene

_LABELS = {
    "mass": ("mass, bare", "kg"),
    "motor_mass": ("motor's mass", "kg"),
    "handle_mass": ("handle's mass, bare", "kg"),
    "stiffness": ("stiffness between", "N/m"),
    "damping": ("damping between", "N·s/m"),
    "friction": ("friction", "N·s/m"),
    "own_stiffness": ("spring of its own", "N/m"),
    "motor_lag": ("motor lag", "s"),
    "delay": ("delay", "samples"),
    "resonance_hz": ("resonance", "Hz"),
    "antiresonance_hz": ("antiresonance", "Hz"),
}
_LEAST_SPRING = 400.0  # N/m for each kg, some 3 Hz: dry friction looks like a softer one
_UNSURE_LAG = 0.02  # sample periods
_CLOSE, _NEAR = 2.0, 0.1  # uncertainties, and of the declared value: closer ones agree
_SEEN = 4.0  # uncertainties: a value that differs from 0, or from the declared one


def show_transmission(
    path: str, scene: Scene, found: TransmissionIdentification, write: bool, json: bool, picture: PictureOptions
) -> None:
    """Prints what was found, draws it and writes it into the file of the scene, as far as that is asked for."""
    if picture.wanted:
        from hapsim.chart.transmission_chart import draw_response, response_columns

        picture.write(lambda: response_columns(found), lambda file: draw_response(found, file))
    declared = _declared(scene, found.channel)
    values = _values_to_write(found, declared)
    if not json:
        output.stdout().print("")
        if found.fit.fits:
            title = f"The free device at {scene.hand_on(found.channel)}, channel {found.channel}"
            output.stdout().print(output.estimates_table(title, _LABELS, declared, found.estimates, _off_by))
        for sentence in _sentences(scene, found):
            output.print_line(sentence)
    in_file = rewrite_device(path, values, found.channel, scene.device_name) if write and values else {}
    if json:
        heading = {"scene": path, "motion": scene.device.motions(scene.channels)}
        print(output.document(heading | _document(found, declared, in_file if write else None)))
        return
    if in_file:
        written = ", ".join(f"{name}: {value}" for name, value in in_file.items())
        output.print_line(f"Wrote into `device` of {path}: {written}. Its mass stays: that is the mass with a hand.")
    else:
        why = "--write writes motor lag and transmission into its `device`" if values else "see above"
        output.print_line(f"The file was not changed: {why}.")
    picture.print_written()


def _declared(scene: Scene, channel: int) -> dict[str, float]:
    device, channels = scene.device, scene.channels
    drive = device.drives(channels)[channel]
    return {
        "motor_mass": drive.motor_mass,
        "stiffness": drive.stiffness,
        "damping": drive.damping,
        "friction": device.frictions(channels)[channel],
        "own_stiffness": device.stiffnesses(channels)[channel],
        "motor_lag": drive.lag,
        "delay": device.delay,
        "mass": device.masses(channels)[channel],
    }


def _values_to_write(found: TransmissionIdentification, declared: Mapping[str, float]) -> dict[str, str]:
    """Returns what `--write` puts into the `device` section: the lag and a found delay, and a transmission if each of
    its values is known. Nothing if the record does not decide, or a hand may hold the device."""
    fit, values = found.fit, dict[str, str]()
    if not fit.masses or _signs_of_a_hand(found, declared):
        return values
    estimates = found.estimates
    names = ["motor_lag", *(["delay"] if fit.delay_found else [])]
    if fit.masses == 2 and found.sees_motor:
        names += [name for name in ("stiffness", "damping", "motor_mass") if name in estimates]
        values = {
            f"transmission.{name}": word for name, word in zip(("sensor", "friction_at"), fit.two.sides, strict=True)
        }
    for name in names:
        key = name if name in ("motor_lag", "delay") else f"transmission.{name}"
        value = estimates[name].value
        values[key] = rounded(value, estimates[name].uncertainty) if value > 0.0 else "0"
    return values


def _off_by(estimate: Estimate, known: float, off_by: str) -> str:
    apart = abs(estimate.value - known)
    if apart < _CLOSE * estimate.uncertainty and (not known or apart <= _NEAR * abs(known)):
        return "agrees"
    return f"{off_by}, unsure".removeprefix(", ") if apart < _SEEN * estimate.uncertainty else off_by


def _sentences(scene: Scene, found: TransmissionIdentification) -> list[str]:
    units, frequency = output_units(), found.measured.frequency
    return [
        f"Read from {found.excitations} excitations at {frequency.size} frequencies from {frequency[0]:.3g} to "
        f"{frequency[-1]:.4g} Hz, with forces of up to {units(found.push_n, 'N', '.3g')}; it moved "
        f"{units(found.peak_m, 'mm', '.2g')} at most.",
        *found.fit.verdict(),
        *_of_play(found),
        *_of_sensor(found),
        *(_of_values(scene, found) if found.fit.fits else []),
    ]


def _of_play(found: TransmissionIdentification) -> list[str]:
    """Returns a sentence about the play between motor and handle, if there is some."""
    if (play := found.fit.play) is None:
        return []
    units, seen = output_units(), found.fit.two.plant.belt
    return [
        f"The play is about {units(play.size, 'mm', '.1g')}. The stiffness that is seen with it, "
        f"{units(seen, 'N/m', '.3g')}, is some {percent(play.share, 2)} of the belt's own. Take up the play, and try "
        "again."
    ]


def _rounded(estimate: Estimate) -> str:
    return rounded(estimate.value, estimate.uncertainty)


def _of_sensor(found: TransmissionIdentification) -> list[str]:
    """Returns sentences about the side of the sensor, and what it does not see."""
    fit, units = found.fit, output_units()
    if fit.masses != 2:
        return []
    plant, sensor = fit.two.plant, fit.two.sides.sensor
    resonance = f"{plant.resonance_hz:.4g} Hz"
    sentences = []
    if sensor == "motor":
        sentences.append(
            f"The position is the motor's: it hardly moves at {plant.antiresonance_hz:.4g} Hz, where the handle swings "
            f"alone, and both swing against each other at {resonance}."
        )
    else:
        most = units(0.25 * plant.mass * (2.0 * math.pi * plant.resonance_hz) ** 2, "N/m", ".3g")
        declared = found.declared.motor_mass
        basis = (
            f"Stiffness, damping and motor lag hold for the declared motor's mass, {units(declared, 'kg')}, which is "
            "not found and not written."
            if declared
            else "Declare `device.transmission` with its `motor_mass` and `sensor: handle`, and identify again."
        )
        sentences.append(
            f"The position is the handle's: motor and handle swing against each other at {resonance}, and no frequency "
            "leaves the handle at rest. Such a sensor cannot tell the motor's mass from the stiffness: a motor of any "
            f"mass fits, with the stiffness that gives this resonance, at most {most}. {basis}"
        )
    if plant.resonance_hz > 0.5 * found.rate_hz:
        image = f"{found.rate_hz - plant.resonance_hz:.4g} Hz"
        sentences.append(
            f"The resonance is beyond half the rate, and the loop meets its image at {image}. Predictions have that "
            "exactly, but a scene with a higher rate would feel more like its springs."
        )
    return sentences


def _of_values(scene: Scene, found: TransmissionIdentification) -> list[str]:
    """Returns sentences about the delay, the bare mass, and forces that the device should not have."""
    fit, units, declared = found.fit, output_units(), _declared(scene, found.channel)
    plant, unsure = fit.best.plant, fit.best.uncertainty
    sentences = []
    if fit.delay_found:
        sentences.append(
            f"The declared delay of {declared['delay']:g} samples does not fit: the response shows "
            f"{rounded(plant.delay, unsure.delay)}."
        )
    sentences += _signs_of_a_hand(found, declared) or [
        f"In all the bare device has {units(plant.mass, 'kg', '.4g')}; `device.mass` ({units(declared['mass'], 'kg')}) "
        "stays that of device and hand."
    ]
    rubbed = fit.best.estimate("friction")
    if abs(rubbed.value - declared["friction"]) > max(_NEAR * declared["friction"], rubbed.uncertainty):
        sentences.append(
            "Dry friction adds to the friction that is found, so it may differ from the declared one; --write leaves "
            "`device.friction`, which `identify` without --transmission tells from dry friction."
        )
    if unsure.lag > _UNSURE_LAG / found.rate_hz:
        sentences.append(
            f"The lag is uncertain by {units(unsure.lag, 's', '.2g')}: the frequencies that show it hardly move the "
            "device."
        )
    return sentences


def _signs_of_a_hand(found: TransmissionIdentification, declared: Mapping[str, float]) -> list[str]:
    """Returns warnings if the device is heavier than declared with a hand, or held by a spring that is not declared."""
    units, best = output_units(), found.fit.best
    mass, off = best.plant.mass, math.hypot(best.uncertainty.handle, best.uncertainty.motor)
    warnings = []
    if mass > declared["mass"] + _SEEN * off:
        warnings.append(
            f"Warning: the device has {units(mass, 'kg', '.4g')}, more than `device.mass` "
            f"({units(declared['mass'], 'kg')}), which is with a hand: is a hand on it? If not, `device.mass` is "
            "too small."
        )
    spring = best.estimate("stiffness")
    if spring.value - declared["own_stiffness"] > max(_SEEN * spring.uncertainty, _LEAST_SPRING * mass):
        warnings.append(
            f"Warning: a spring of {units(spring.value, 'N/m', '.3g')} holds the handle, and `device.stiffness` is "
            f"{units(declared['own_stiffness'], 'N/m')}: is a hand on it? If not, correct that value."
        )
    return warnings


def _document(
    found: TransmissionIdentification, declared: Mapping[str, float], written: Mapping[str, str] | None
) -> dict[str, Any]:
    """Returns the document of `hapsim identify --transmission --json`, without the scene."""
    fit = found.fit
    return {
        **pick(found, "channel rate_hz excitations push_n peak_m noise_m"),
        **pick(found.bounds, "force_n=force travel_m=travel"),
        "masses": fit.masses or None,
        "verdict": fit.verdict(),
        "one_mass_error": math.sqrt(fit.one.misfit),
        "two_masses_error": math.sqrt(fit.two.misfit),
        "shows_up_to_hz": fit.shows_up_to_hz,
        "sensor": fit.two.sides.sensor if fit.masses == 2 else None,
        "friction_at": fit.two.sides.friction if fit.masses == 2 else None,
        "delay_found": fit.delay_found,
        "play": fit.play and pick(fit.play, "size_m=size stiffness_share=share"),
        "declared": dict(declared),
        "identified": found.estimates,
        "written": written,
    }
