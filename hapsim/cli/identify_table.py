"""What `hapsim identify` tells: before it pushes, what it found, and what of it goes into the scene's file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from hapsim.cli.sentences import say
from hapsim.number_format import rounded
from hapsim.scene import Known

if TYPE_CHECKING:
    from hapsim.measuring.device_excitation import Bounds
    from hapsim.measuring.device_fit import Estimate
    from hapsim.measuring.identify_device import DeviceIdentification
    from hapsim.scene import Scene

_LABELS = {
    "mass": "mass  kg",
    "friction": "friction  N·s/m",
    "stiffness": "stiffness  N/m",
    "delay": "delay  samples",
    "coulomb": "dry friction  N",
    "constant_force": "constant force  N",
}
_IN_SCENE = ("mass", "friction", "stiffness", "delay")
_SEEN = 3.0  # uncertainties: a value that is there
_OFF = 4.0  # uncertainties: another value than the declared one


def before_pushing(bounds: Bounds, channel: int, port: str | None, seconds: float) -> str:
    """For the user, before anything is armed."""
    device = "the embedded mock" if port is None else f"the device at {port}"
    return (
        f"Pushing channel {channel} of {device} now: at most {bounds.force:g} N to either side, {seconds:g} s and what "
        f"it takes to find out how hard; ended where the device is more than {1e3 * bounds.travel:g} mm from where "
        "it stands. Let it move freely, held as it will be held: the hand is part of the mass. Ctrl-C releases it."
    )


def declared_of(scene: Scene, channel: int) -> dict[str, float]:
    """What the file says of the device."""
    device, channels = scene.device, scene.channels
    return {
        "mass": device.masses(channels)[channel],
        "friction": device.frictions(channels)[channel],
        "stiffness": device.stiffnesses(channels)[channel],
        "delay": device.delay,
    }


def values_to_write(found: DeviceIdentification, declared: Mapping[str, float], span: bool) -> dict[str, str | Known]:
    """What `--write` puts into the `device` section, with the digits that are known, the mass with its uncertainty: no
    spring where none was seen and none is declared, and nothing below 0, which no device is. `span`: the file gives a
    span for the mass, of which one hand's says nothing."""
    values: dict[str, str | Known] = {}
    for name in _IN_SCENE[1:] if span else _IN_SCENE:
        estimate: Estimate = getattr(found, name)
        seen = estimate.value > _SEEN * estimate.uncertainty
        if name == "mass":
            uncertainty = float(f"{estimate.uncertainty:.1e}")
            values[name] = Known(value=float(rounded(estimate.value, uncertainty)), uncertainty=uncertainty)
        elif name != "stiffness" or seen or declared[name] != 0.0:
            values[name] = rounded(max(estimate.value, 0.0), estimate.uncertainty)
    return values


def has_span(scene: Scene, channel: int) -> bool:
    """Whether the file says between what the mass lies, and not what it is."""
    least, most = scene.device.mass_spans(scene.channels)[channel]
    return least < most


def show_identification(out: Console, found: DeviceIdentification, declared: Mapping[str, float], name: str) -> None:
    """Declared beside found, and what there is to be said of it."""
    table = Table(title=f"The device at {name}, channel {found.channel}", title_justify="left")
    for heading in ("", "declared", "found", "uncertainty", "off by"):
        table.add_column(heading, justify="right" if heading else "left")
    for key, label in _LABELS.items():
        estimate: Estimate = getattr(found, key)
        said = declared.get(key)
        table.add_row(
            label,
            "–" if said is None else f"{said:g}",
            rounded(estimate.value, estimate.uncertainty),
            f"{estimate.uncertainty:.1g}",
            "" if said is None else _off(said, estimate),
        )
    out.print()
    out.print(table)
    for sentence in _sentences(found):
        say(sentence)


def _off(declared: float, found: Estimate) -> str:
    """By how much the declared value is off, where that is sure."""
    if abs(found.value - declared) < _OFF * found.uncertainty:
        return "agrees"
    return f"{found.value / declared - 1.0:+.1%}" if declared else f"{found.value - declared:+.2g}"


def _sentences(found: DeviceIdentification) -> list[str]:
    pairs = ", ".join(f"({drive.stiffness:.3g}, {drive.damping:.2g})" for drive in found.drives)
    cut = "It was stopped before all was recorded. " if found.stopped else ""
    told = [
        f"{cut}Read from {found.samples} samples at simulated (K, B) of {pairs}; it moved {1e3 * found.peak_m:.2g} mm "
        f"at most. The fit leaves {found.residual_m:.2g} m rms."
    ]
    if found.hand is not None:
        mass, stiffness, damping = (
            rounded(one.value, one.uncertainty) for one in (found.hand.mass, found.hand.stiffness, found.hand.damping)
        )
        told.append(
            f"A second mass moves with it, a hand's: {mass} kg on {stiffness} N/m and {damping} N·s/m. The values "
            "above are the handle's. hapsim predicts one mass: what it predicts of this hand is the handle's alone."
        )
    if found.coulomb.value > _SEEN * found.coulomb.uncertainty:
        told.append(
            f"It has dry friction, {rounded(found.coulomb.value, found.coulomb.uncertainty)} N, for which `device` has "
            "no key: the prediction leaves it out, and what the hand feels is damped more. `mock.coulomb` gives it to "
            "the mock."
        )
    if abs(found.constant_force.value) > _SEEN * found.constant_force.uncertainty:
        told.append(
            f"A constant force of {rounded(found.constant_force.value, found.constant_force.uncertainty)} N acts where "
            "it was found: gravity, an offset of the force, or a spring that rests elsewhere."
        )
    if found.seen_rate is not None and found.seen_rate.differs_from(found.rate_hz):
        told.append(
            f"The device sampled at {found.seen_rate.rate_hz:.6g} Hz where it declares {found.rate_hz:g} Hz: mass, "
            "friction and stiffness hold for the declared rate. Set its timer right first."
        )
    if found.misfit:
        told.append(
            f"Warning: {found.misfit[0].lower()}{found.misfit[1:]} The uncertainties allow for it as noise only."
        )
    return told


def identification_document(
    found: DeviceIdentification, declared: Mapping[str, float], written: Mapping[str, str | Known] | None
) -> dict[str, Any]:
    """What `hapsim identify --json` prints."""
    seen = found.seen_rate
    return {
        "channel": found.channel,
        "declared": dict(declared),
        "identified": {name: asdict(getattr(found, name)) for name in _LABELS},
        "force_n": found.bounds.force,
        "travel_m": found.bounds.travel,
        "peak_m": found.peak_m,
        "drives": [
            {"K": drive.stiffness, "B": drive.damping, "push_n": drive.force, "push_s": drive.half / found.rate_hz}
            for drive in found.drives
        ],
        "samples": found.samples,
        "residual_m": found.residual_m,
        "misfit": found.misfit or None,
        "stopped": found.stopped,
        "rate_hz": found.rate_hz,
        "rate_seen_hz": None if seen is None else seen.rate_hz,
        "rate_seen_uncertainty_hz": None if seen is None else seen.uncertainty_hz,
        "hand": None if found.hand is None else asdict(found.hand),
        "noise_m": found.noise_m,
        "written": None if written is None else {name: _number(value) for name, value in written.items()},
    }


def _number(written: str | Known) -> float | dict[str, float]:
    return float(written) if isinstance(written, str) else written.model_dump()
