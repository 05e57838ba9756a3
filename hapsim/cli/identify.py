"""`hapsim identify`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from hapsim.cli.as_json import document
from hapsim.cli.live import live_line
from hapsim.cli.options import DataFile, DeviceOptions, Json, PictureFile, require_drawable, say_written, seconds
from hapsim.cli.output import complain, say, stderr, stdout
from hapsim.device.known_devices import is_new
from hapsim.errors import UsageError
from hapsim.measuring.identify_device import SECONDS, TRAVEL_M, bounds_of, identify_device
from hapsim.number_format import relative_difference, rounded
from hapsim.scene import Known
from hapsim.scene.rewrite import require_rewritable, rewrite_device

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
_SEEN = 3.0  # uncertainties: a value that differs from 0
_OFF = 4.0  # uncertainties: a value that differs from the declared one


def identify(
    device: DeviceOptions,
    channel: Annotated[int | None, typer.Option(help="Channel to push [default: the first]")] = None,
    push: Annotated[
        float | None,
        typer.Option(
            "--push",
            "--force",
            metavar="N",
            help="Largest force of the test pushes, N [default: a quarter of force_limit]",
        ),
    ] = None,
    travel: Annotated[
        float | None, typer.Option(metavar="M", help="Stop if the device moves farther, m [default: 0.005]")
    ] = None,
    duration: Annotated[
        float | None,
        seconds("Seconds recorded for the fit [default: 6]"),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write the values into the scene's `device` [default: only print them]")
    ] = False,
    picture: PictureFile = None,
    data: DataFile = None,
    json: Json = False,
) -> None:
    """Push the device and identify its mass, friction, spring, delay and dry friction.

    Each value is printed with its uncertainty beside what the scene declares. The pushes go to both sides, gently at
    first, on several simulated springs. Of the scene it uses the device only. The file changes only with --write.
    """
    loaded, kind = device.load(), device.kind()
    require_drawable(picture, data)
    _require_writable_scene(device.scene, write, bool(loaded.device.port) and kind != "auto")
    if channel is None:
        channel = next(iter(loaded.device_points.values())).channel
    loaded, travel = _within_travel(loaded, channel, travel)
    on_mock = kind != "auto" or loaded.device.port is None
    port = None if on_mock else loaded.device.port
    complain(before_pushing(bounds_of(loaded, push, travel), channel, port, duration or SECONDS))
    with live_line(stderr()) as tell:
        found = identify_device(
            loaded,
            channel=channel,
            force=push,
            travel=travel,
            duration=duration,
            transport=kind,
            on_progress=tell,
            stop_on_signals=True,
        )
    if port:
        is_new(port)  # from now on not
    _chart_residual(found, picture, data)
    _tell(device.scene, loaded, found, write, json)
    if not json:
        say_written(picture, data)


def _within_travel(scene: Scene, channel: int, travel: float | None) -> tuple[Scene, float | None]:
    """The scene, and how far the device may move from where it is found (m), so that it stays in the scene's travel.

    Each of the runs that push it would take another `origin: here`: these count from where they find it, and the
    limits are what is left to either side.
    """

    device = scene.device
    if not 0 <= channel < scene.channels:
        return scene, travel
    least, most = device.travels(scene.channels)[channel]
    here = device.origins(scene.channels)[channel] is None
    room = min(most, -least) if here else 0.5 * (most - least)
    if here and room <= 0.0:
        raise UsageError(
            f"device.travel: found {least:g} to {most:g} m from where it is armed (origin: here), expected room "
            "to both sides to push it; put it in the middle of its travel, and leave out travel and origin for this"
        )
    if here:
        none = {"travel": None, "travel_margin": None, "origin": None}
        scene = scene.model_copy(update={"device": device.model_copy(update=none)})
    return scene, travel if room >= (TRAVEL_M if travel is None else travel) else room


def _tell(scene: str, loaded: Scene, found: DeviceIdentification, write: bool, json: bool) -> None:
    """Shows what was found, then writes it where that was asked for: if it cannot, it was shown at least."""

    declared, span = declared_of(loaded, found.channel), has_span(loaded, found.channel)
    if not json:
        hand = next(name for name, point in loaded.device_points.items() if point.channel == found.channel)
        show_identification(stdout(), found, declared, hand)
    values = values_to_write(found, declared, span) if write and not found.stopped else None
    if values is not None:
        rewrite_device(scene, values, found.channel)
    if json:
        print(document({"scene": scene} | identification_document(found, declared, values)))
    else:
        _say_what_was_written(scene, values, write, span)


def _say_what_was_written(scene: str, values: Mapping[str, str | Known] | None, asked: bool, span: bool) -> None:
    if values is None:
        why = "it was stopped before all was recorded" if asked else "--write writes what was found into its `device`"
        say(f"The file was not changed; {why}.")
        return
    told = ", ".join(f"{name}: {value}" for name, value in values.items())
    stays = " The mass stays: the file gives a span for it, and this is one hand's." if span else ""
    say(f"Wrote into `device` of {scene}: {told}.{stays}")


def _require_writable_scene(scene: str, write: bool, of_mock: bool) -> None:
    if not write:
        return
    if of_mock:
        raise UsageError(
            "--write: found --mock or --transport beside a port: what is found of the mock is not its device's; leave "
            "out one of them"
        )

    require_rewritable(scene)


def _chart_residual(found: DeviceIdentification, picture: Path | None, data: Path | None) -> None:
    if picture is None and data is None:
        return
    from hapsim.chart.device_residual import draw_device_residual, residual_columns
    from hapsim.chart.figure import save_rows

    if data is not None:
        save_rows(residual_columns(found), data)
    if picture is not None:
        draw_device_residual(found, picture)


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
    return relative_difference(found.value, declared) if declared else f"{found.value - declared:+.2g}"


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
