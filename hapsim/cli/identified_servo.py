"""The answer of `hapsim identify` in admittance: table, sentences, JSON, and the values written into the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hapsim.cli import output
from hapsim.cli.output import output_units
from hapsim.documents import pick
from hapsim.number_format import listed, rounded
from hapsim.scene.rewrite import rewrite_device

if TYPE_CHECKING:
    from hapsim.measuring.device_fit import Estimate
    from hapsim.measuring.identify_servo import ServoIdentification
    from hapsim.scene import Scene

_LABELS = {
    "bandwidth": ("servo's bandwidth", "Hz"),
    "damping": ("servo's damping ratio", ""),
    "delay": ("delay", "samples"),
    "handle_mass": ("mass beyond the sensor", "kg"),
}
_SEEN = 4.0  # uncertainties: a value that differs from 0, or from the declared one
_POOR = 0.05  # of the commands: a fit that leaves more is none of a servo


def show_servo(path: str, scene: Scene, found: ServoIdentification, write: bool, json: bool) -> None:
    """Prints what was found, and writes it into the file of the scene if that is asked for."""
    declared = _declared(scene, found.channel)
    estimates = {name: one for name in _LABELS if (one := getattr(found, name)) is not None}
    values = {} if found.error > _POOR else _values_to_write(found)
    if not json:
        title = f"The servo at {scene.hand_on(found.channel)}, channel {found.channel}"
        output.stdout().print("", output.estimates_table(title, _LABELS, declared, estimates, _off_by))
        for sentence in _sentences(found):
            output.print_line(sentence)
    in_file = rewrite_device(path, values, found.channel, scene.device_name) if write and values else {}
    if json:
        document = {
            "scene": path,
            "motion": scene.device.motions(scene.channels),
            **pick(found, "channel rate_hz periods lines lowest_hz highest_hz peak_m error"),
            **pick(found.bounds, "force_n=force travel_m=travel"),
            "declared": declared,
            "identified": {name: getattr(found, name) for name in _LABELS},
            "written": in_file if write else None,
        }
        print(output.document(document))
    elif in_file:
        output.print_line(
            f"Wrote into `device` of {path}: {', '.join(f'{name}: {text}' for name, text in in_file.items())}."
        )
    else:
        why = f"--write writes {listed([*values])} into its `device`" if values and not write else "see above"
        output.print_line(f"The file was not changed: {why}.")


def _declared(scene: Scene, channel: int) -> dict[str, float]:
    device, channels = scene.device, scene.channels
    servo = device.servos(channels)[channel]
    hand = {"handle_mass": device.assumed_hands(channels)[channel].mass, "delay": device.delay}
    return hand if servo is None else {"bandwidth": servo.bandwidth, "damping": servo.damping} | hand


def _off_by(estimate: Estimate, known: float, off_by: str) -> str:
    return "agrees" if abs(estimate.value - known) < _SEEN * estimate.uncertainty else off_by


def _values_to_write(found: ServoIdentification) -> dict[str, str]:
    """Returns what `--write` puts into the `device` section: the delay, and the servo if there is one."""
    names = {"delay": found.delay, "servo.bandwidth": found.bandwidth, "servo.damping": found.damping}
    return {name: rounded(one.value, one.uncertainty) for name, one in names.items() if one is not None}


def _sentences(found: ServoIdentification) -> list[str]:
    units, mass = output_units(), found.handle_mass
    sentences = [
        f"Read from {found.periods} chirps of commands at {found.lines} frequencies from {found.lowest_hz:.3g} to "
        f"{found.highest_hz:.4g} Hz; it moved {units(found.peak_m, 'mm', '.2g')} at most. The fit leaves "
        f"{100.0 * found.error:.2g} % of the commands."
    ]
    if found.bandwidth is None:
        sentences.append("The device follows its commands exactly, in straight lines from sample to sample.")
    if found.error > _POOR:
        sentences.append(
            "Warning: that is no servo of second order: its loop is of another kind, a hand stops it, it runs into a "
            "limit, or it rubs. Tune it first."
        )
    if mass.value < -_SEEN * mass.uncertainty:
        sentences.append(
            "Warning: the force sensor shows a force that pushes the handle on. A hand on the handle, or a stop, may "
            "do that: take the hand away and identify again. If it stays, the sensor has the wrong sign: exchange its "
            "wires, or invert it in the firmware; a guard ends each run with it."
        )
    elif not mass.value > _SEEN * mass.uncertainty:
        sentences.append(
            "The force sensor shows nothing of the handle's mass beyond it, which is too light for its noise: its sign "
            "is not known."
        )
    return sentences
