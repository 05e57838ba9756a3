"""`hapsim measure`."""

from __future__ import annotations

import cmath
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapsim.cli.as_json import document, failure_document
from hapsim.cli.check import felt_document, felt_on, prediction_document, show_assumptions, show_wire
from hapsim.cli.live import live_line
from hapsim.cli.measure_impedance import measure_impedance
from hapsim.cli.options import (
    DataFile,
    DeviceOptions,
    Json,
    PictureFile,
    RecordOptions,
    Unstable,
    require_drawable,
    say_written,
    seconds,
)
from hapsim.cli.output import complain, say, stderr, stdout
from hapsim.cli.run import require_stable, warn, with_mock
from hapsim.cli.run_report import report_document, show_report, show_run
from hapsim.errors import RunError, UsageError
from hapsim.measuring.measure import measure as measure_scene
from hapsim.measuring.measure_trace import Measurement
from hapsim.number_format import number, relative_difference, rounded
from hapsim.prediction import Desired, Felt, Prediction, felt_at_rate, predict, predict_on_wire, with_mass
from hapsim.prediction.other_mass import masses_with, oscillation_at
from hapsim.recording.trace import Report

if TYPE_CHECKING:
    from hapsim.measuring.trace_quality import SeenRate
    from hapsim.recording.trace import Trace
    from hapsim.scene import Scene


def measure(
    device: DeviceOptions,
    *,
    channel: Annotated[
        int | None,
        typer.Option(help="Channel to measure [default: the first; with --impedance all]"),
    ] = None,
    duration: Annotated[
        float | None,
        seconds("Duration in seconds [default: about 2; with --impedance 8 for each channel]"),
    ] = None,
    push: Annotated[
        float | None,
        typer.Option(metavar="N", help="Largest force of the test pushes, N [default: a quarter of force_limit]"),
    ] = None,
    impedance: Annotated[
        bool,
        typer.Option("--impedance", help="Measure the driving-point impedance over frequency instead of k and b."),
    ] = False,
    travel: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="With --impedance: largest travel of the hand in m, approximate [default: 0.001]",
        ),
    ] = None,
    z_width: Annotated[
        bool,
        typer.Option("--z-width", help="With --impedance: also measure with the stiffest passive wall."),
    ] = False,
    picture: PictureFile = None,
    data: DataFile = None,
    record: RecordOptions,
    unstable: Unstable = False,
    explain: Annotated[bool, typer.Option("--explain", help="Print the report of the run too.")] = False,
    json: Json = False,
) -> None:
    """Measure what the hand feels, and compare it with the prediction.

    hapsim pushes the hand to both sides, computes k and b from the motion, and prints k and b beside
    the prediction. With --impedance it excites each channel in turn with many frequencies at once.
    """
    if impedance:
        measure_impedance(device, channel, duration, push, travel, z_width, picture, data, record, unstable, json)
        return
    if travel is not None or z_width:
        raise UsageError("--travel and --z-width go with --impedance: it is missing")
    _measure_pair(device, channel, duration, push, picture, data, record, unstable, explain, json)


def _measure_pair(
    device: DeviceOptions,
    channel: int | None,
    duration: float | None,
    push: float | None,
    picture: Path | None,
    data: Path | None,
    record: RecordOptions,
    unstable: bool,
    explain: bool,
    json: bool,
) -> None:
    """Rings a hand, and prints the k and b that it identifies beside the prediction."""
    path, kind = device.scene, device.kind()
    loaded = with_mock(device.load(), kind)
    require_drawable(picture, data)
    record.require_writable()
    if channel is None:
        channel = next(iter(loaded.device_points.values())).channel
    prediction = predict(loaded, with_margins=False)
    on_wire = None if prediction.wire_of == "none" else predict_on_wire(loaded)
    felt = felt_on(prediction, channel)
    why = next((prediction.coupled.get(n, "") for n, p in loaded.device_points.items() if p.channel == channel), "")
    if felt is None and (picture or data):
        raise UsageError(
            f"a ring-down is drawn for a hand that is a spring and damper's alone; this one {why}: "
            "leave out --picture and --data"
        )
    require_stable(path, loaded, prediction, unstable)
    warnings = warn(loaded, prediction)
    try:
        with live_line(stderr()) as tell:
            measurement = measure_scene(
                loaded,
                channel=channel,
                duration=duration,
                push=push,
                transport=kind,
                on_progress=tell,
                stop_on_signals=True,
            )
    except RunError as error:
        if error.trace is None:
            raise
        _end_failed(path, prediction, channel, error, error.trace, record.record, json)
    prediction = with_mass(prediction, channel, measurement.mass)
    felt = felt_on(prediction, channel)
    if record.record is not None:
        measurement.trace.save(record.record)
    if picture is not None or data is not None:
        _chart_ring_down(felt, measurement, picture, data)
    if json:
        measured = measurement_document(prediction, measurement, channel, on_wire)
        print(document({"scene": path, "warnings": warnings} | measured))
    else:
        _show_measured(loaded, channel, felt, why, measurement, prediction)
        (show_report if explain else show_run)(stdout(), measurement.trace.report)
        if on_wire is not None:
            show_wire(stdout(), prediction, on_wire)
        say_written(picture, data, record.record)
    if measurement.failure is not None:
        complain(measurement.failure)
        raise typer.Exit(measurement.failure.exit_status)


def _end_failed(
    scene: str, prediction: Prediction, channel: int, error: RunError, trace: Trace, record: Path | None, json: bool
) -> NoReturn:
    """Prints what was recorded and predicted of a run that failed before anything could be identified, and why."""
    if record is not None:
        trace.save(record)
    if json:
        print(document({"scene": scene} | measured_document(prediction, trace.report, channel, error)))
    else:
        show_report(stdout(), trace.report)
        say_written(record=record)
    complain(error)
    raise typer.Exit(error.exit_status)


def _show_measured(scene: Scene, channel: int, felt: Any, why: str, measurement: Any, prediction: Prediction) -> None:
    hands = {point.channel: name for name, point in scene.device_points.items()}
    least, most = scene.device.mass_spans(scene.channels)[channel]
    of_mass = "declared"
    if least < most:
        of_mass = "estimated" if any(measurement.trace.report.estimated_mass_kg) else "assumed"
        whose = "the estimated mass" if of_mass == "estimated" else "the middle of the span"
        say(
            f"k and b are those of a hand of {measurement.mass:.6g} kg, {whose} of {least:g} to {most:g} kg; they grow "
            "with the mass."
        )
    desired = next((one for one in prediction.desired if one.channel == channel), None)
    where = f"{hands[channel]}, channel {channel}"
    show_measurement(stdout(), where, felt, why, measurement, desired, prediction=prediction, of_mass=of_mass)
    show_assumptions(stdout(), prediction)
    others = ", ".join(f"--channel {c} for {name}" for c, name in hands.items() if c != channel)
    if others:
        say(f"Other hands of this scene: {others}.")


def _chart_ring_down(felt: Any, measurement: Any, picture: Path | None, data: Path | None) -> None:
    from hapsim.chart.figure import save_rows
    from hapsim.chart.ring_down import draw_ring_down, ring_down

    drawn = ring_down(measurement.trace, felt)
    if data is not None:
        save_rows(drawn, data)
    if picture is not None:
        draw_ring_down(drawn, felt, (measurement.k, measurement.b), picture)


_UNSURE = 4.0  # uncertainties: what is further apart is not the same
_MANY = 10.0
_SAME = 1e-4  # a mass that is clearly off changes the frequency by 50 times as much
_CLEARLY = 0.01  # of the mass, of what is predicted, of b of half the critical damping: what is less off is not said
_FEW = 0.01
_LASTS = 0.5  # modulus of a pole: below that of any that `SecondMode` counts


class ProbableMass(NamedTuple):
    """The mass with which the prediction has the eigenfrequency and the damping ratio that were measured."""

    mass: float
    """kg."""
    uncertainty: float
    """kg, standard."""
    factor: float
    """Times the mass to which the measurement refers."""


def probable_mass(felt: Felt | None, measurement: Measurement) -> ProbableMass | None:
    """None where the mass is as it is said to be, or no other explains both values.

    The eigenfrequency gives the mass; whether it is the mass that is wrong, the damping ratio tells.
    """
    if felt is None or not _is_undisturbed(measurement) or not measurement.frequency_hz > 0.0:
        return None
    same_frequency = abs(measurement.frequency_hz - felt.frequency_hz) < _SAME * felt.frequency_hz
    if same_frequency and abs(measurement.damping_ratio - felt.damping_ratio) < _SAME:
        return None  # and scipy.optimize, which takes long to import, stays out
    for mass in masses_with(felt, measurement.frequency_hz):
        step = 1e-4 * mass
        above, below = oscillation_at(felt, mass + step), oscillation_at(felt, mass - step)
        slope, ratio_slope = ((a - b) / (2.0 * step) for a, b in zip(above, below, strict=True))
        unsure = measurement.frequency_uncertainty_hz / abs(slope) if slope else math.inf
        allowed = math.hypot(measurement.damping_ratio_uncertainty, ratio_slope * unsure)
        if not abs(oscillation_at(felt, mass)[1] - measurement.damping_ratio) <= _UNSURE * allowed:
            continue
        known = measurement.mass_uncertainty or 0.0
        off = abs(mass - measurement.mass)
        if off > max(_CLEARLY * measurement.mass, _UNSURE * math.hypot(unsure, known)):
            return ProbableMass(mass, unsure, mass / measurement.mass)
    return None


def gives(prediction: Prediction, measurement: Measurement) -> bool:
    """Whether something swings along that the scene does not have: the motion has a second mode, and more poles that
    last than are predicted."""
    if measurement.second_mode is None:
        return False
    lasting = abs(measurement.second_mode.pole) * (1.0 - 1e-9)
    return sum(abs(pole) >= lasting for pole in measurement.poles) > sum(
        abs(pole) >= _LASTS for pole in prediction.poles
    )


def is_another_device(felt: Felt, measurement: Measurement) -> bool:
    """Whether k or b is off by much more than its uncertainty."""
    pairs = [
        (measurement.k - felt.k, measurement.k_uncertainty, felt.k),
        (measurement.b - felt.b, measurement.b_uncertainty, math.sqrt(abs(felt.k) * measurement.mass)),
    ]
    return _is_undisturbed(measurement) and any(
        abs(off) > max(_MANY * uncertainty, _CLEARLY * abs(whole)) for off, uncertainty, whole in pairs
    )


def _is_undisturbed(measurement: Measurement) -> bool:
    """At the declared rate, and with most forces below the limit and in time."""
    report, seen = measurement.trace.report, measurement.seen_rate
    shaped = report.limited_ticks + report.slewed_ticks + report.faded_ticks
    disturbed = shaped + report.deadline_misses > _FEW * report.ticks
    return not disturbed and (seen is None or not seen.differs_from(measurement.trace.rate))


def oscillation_of(pole: complex, rate_hz: float) -> tuple[float, float]:
    """(eigenfrequency in Hz, damping ratio) of a pole in the z-plane."""
    s = cmath.log(pole) * rate_hz
    return abs(s) / (2.0 * math.pi), -s.real / abs(s)


def show_measurement(
    out: Console,
    where: str,
    felt: Felt | None,
    why: str,
    measurement: Measurement,
    desired: Desired | None = None,
    *,
    prediction: Prediction | None = None,
    of_mass: str = "declared",
) -> None:
    """Prediction beside measurement, as `hapsim measure` tells them; and beside what is desired, with a correction.

    `where`: the hand in question; `why`: there is no prediction for it, in words; `prediction`: of the whole
    scene; `of_mass`: where the mass comes from, in a word.
    """
    out.print(_side_by_side(f"What the hand feels at {escape(where)}", felt, measurement, of_mass, desired))
    _show_at_seen_rate(out, felt, measurement, of_mass)
    if felt is None:
        out.print(
            f"This hand {why}: no single spring and damper is predicted for it. Measured is the mode that rings "
            "longest; k and b would give the hand's mass alone that mode. `hapsim check --explain` lists the modes."
        )
    report = measurement.trace.report
    for ticks, where_they_were, holds in (
        (report.limited_ticks, "at the force limit", "stay below it; beyond, the hand feels less"),
        (report.slewed_ticks, "at the slew limit or in the soft start", "are slower; in these the hand feels less"),
        (report.faded_ticks, "outside device.travel, where the force fades", "stay within it"),
    ):
        if ticks:
            out.print(
                f"[yellow]{ticks} of {report.ticks} ticks were {where_they_were}[/yellow]: k and b hold for motions "
                f"that {holds}."
            )
    _show_what_the_device_is(out, felt, measurement, prediction, of_mass)
    if not measurement.dominant:
        out.print(f"The motion is not that of a spring and damper: {_plainly(measurement.reason)}.")
    out.print(
        f"Read from {measurement.samples} samples; the fit leaves {measurement.residual_m:.2g} m, in "
        f"{measurement.order} poles."
    )


def _show_what_the_device_is(
    out: Console, felt: Felt | None, measurement: Measurement, prediction: Prediction | None, of_mass: str
) -> None:
    """Where it is not as the scene declares it: what that may be."""
    second, mass = measurement.second_mode, probable_mass(felt, measurement)
    if second is not None and prediction is not None and gives(prediction, measurement):
        frequency, ratio = oscillation_of(second.pole, measurement.trace.rate)
        out.print(
            f"[yellow]A second mode swings along[/yellow] at {frequency:.3g} Hz, damping ratio {ratio:.2g}, with "
            f"{100.0 * second.share:.3g} % of the motion's energy: the hand, or a part of the device, moves against "
            "the rest like a mass on a spring. k and b are those of the longest ringing mode, not what the hand feels."
        )
    elif mass is not None:
        share = mass.factor
        out.print(
            f"[yellow]The mass is probably {share:.3g} times the {of_mass} one[/yellow], {mass.mass:.4g} kg: with it "
            "the prediction has the eigenfrequency and the damping ratio that were measured, and the hand feels "
            f"k = {share * measurement.k:.6g} N/m, b = {share * measurement.b:.6g} N·s/m. `hapsim identify --write` "
            "measures and stores it."
        )
    elif felt is not None and is_another_device(felt, measurement):
        out.print(
            "[yellow]Measured and predicted are much further apart than the uncertainty[/yellow]: the device is not as "
            "the scene declares it, or has dry friction. `hapsim identify` finds what it is."
        )


def _plainly(reason: str) -> str:
    """Why there is no pair of poles, for who does not think in poles; `Measurement.reason` keeps it precise."""
    from hapsim.measuring.pole_pair import NO_SECOND_REAL_POLE

    if reason == NO_SECOND_REAL_POLE:
        return "the hand creeps back without swinging, in a way that no single spring and damper does"
    return reason


def _show_at_seen_rate(out: Console, felt: Felt | None, measurement: Measurement, of_mass: str) -> None:
    """Both sides once more, where the device was seen to sample at another rate than it declares."""
    seen, declared = measurement.seen_rate, measurement.trace.rate
    if seen is None or not seen.differs_from(declared):
        return
    rate, uncertainty = _rounded(seen)
    out.print(
        f"[yellow]The device sampled at {rate} ± {uncertainty} Hz[/yellow], as its positions "
        f"arrived; it declares {declared:g} Hz, for which the table above holds. With the rate that was seen:"
    )
    at_seen = None if felt is None else felt_at_rate(felt, seen.rate_hz)
    title = f"What the hand feels at {rate} Hz (or this machine held the device up)"
    out.print(_side_by_side(title, at_seen, measurement.at_rate(seen.rate_hz), of_mass))


def _rounded(seen: SeenRate) -> tuple[str, str]:
    """The rate and its uncertainty, Hz, to the second digit of the uncertainty."""
    decimals = max(1 - math.floor(math.log10(seen.uncertainty_hz)), 0)
    return f"{seen.rate_hz:.{decimals}f}", f"{seen.uncertainty_hz:.{decimals}f}"


def _side_by_side(
    title: str, felt: Felt | None, measurement: Measurement, of_mass: str, desired: Desired | None = None
) -> Table:
    """Returns the table of prediction and measurement, to the digits that the uncertainty leaves."""
    table = Table(title=title, title_justify="left")
    for heading in ("", *(["desired"] if desired else []), "predicted", "measured", "±", "off by"):
        table.add_column(heading, justify="right" if heading else "left")
    for label, key, uncertainty in (
        ("k  N/m", "k", measurement.k_uncertainty),
        ("b  N·s/m", "b", measurement.b_uncertainty),
        ("eigenfrequency  Hz", "frequency_hz", measurement.frequency_uncertainty_hz),
        ("damping ratio", "damping_ratio", measurement.damping_ratio_uncertainty),
    ):
        predicted, measured = math.nan if felt is None else getattr(felt, key), getattr(measurement, key)
        table.add_row(
            label,
            *([number(getattr(desired, key))] if desired else []),
            _to_digits(predicted, uncertainty),
            _to_digits(measured, uncertainty),
            number(uncertainty, 1),
            relative_difference(measured, predicted),
        )
    known = measurement.mass_uncertainty
    unsure = of_mass if known is None else number(known, 1)
    mass = number(measurement.mass) if known is None else rounded(measurement.mass, known)
    table.add_row("mass  kg", *([""] if desired else []), "", mass, unsure, "")
    return table


def _to_digits(value: float, uncertainty: float) -> str:
    return rounded(value, max(uncertainty, 1e-7 * abs(value))) if math.isfinite(value) else number(value)


def measurement_document(
    prediction: Prediction, measurement: Measurement, channel: int, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """What `hapsim measure` prints: prediction and measurement side by side, and how the run went. `rate_hz` is the
    rate that scene and device declare; a device that was seen to sample at another has both sides for that, too."""
    seen = measurement.seen_rate
    at_seen_rate = None
    if seen is not None and seen.differs_from(prediction.rate):
        felt = felt_on(prediction, channel)
        at_seen_rate = {
            "predicted": None if felt is None else felt_document(felt_at_rate(felt, seen.rate_hz)),
            "measured": _measured(measurement.at_rate(seen.rate_hz)),
        }
    return measured_document(prediction, measurement.trace.report, channel, measurement.failure, on_wire) | {
        "measured": _measured(measurement) | _device_document(prediction, measurement, channel),
        "rate_seen_hz": None if seen is None else seen.rate_hz,
        "rate_seen_uncertainty_hz": None if seen is None else seen.uncertainty_hz,
        "at_rate_seen": at_seen_rate,
    }


def measured_document(
    prediction: Prediction,
    report: Report,
    channel: int,
    failure: RunError | None = None,
    on_wire: Prediction | None = None,
) -> dict[str, Any]:
    """The same without a measurement: of a run that failed before anything could be identified."""
    run = report_document(report)
    rates = {"rate_hz": prediction.rate, "kept_rate_hz": run.pop("rate_hz")}
    predicted = prediction_document(prediction, channel, on_wire)
    return predicted | {"measured": None} | run | rates | failure_document(failure)


def _measured(measurement: Measurement) -> dict[str, Any]:
    left_out = ("trace", "failure", "seen_rate", "mass_uncertainty", "second_mode")
    values = {name: value for name, value in vars(measurement).items() if name not in left_out}
    return values | {"mass_kg": measurement.mass, "mass_uncertainty_kg": measurement.mass_uncertainty}


def _device_document(prediction: Prediction, measurement: Measurement, channel: int) -> dict[str, Any]:
    """What the measurement beside the prediction tells of the device's mass, and of a hand that gives."""
    from hapsim.cli.measure import gives, oscillation_of, probable_mass

    second, is_extra = measurement.second_mode, gives(prediction, measurement)
    mass = None if is_extra else probable_mass(felt_on(prediction, channel), measurement)
    document = None
    if second is not None:
        frequency, ratio = oscillation_of(second.pole, measurement.trace.rate)
        document = {"frequency_hz": frequency, "damping_ratio": ratio, "share": second.share, "predicted": not is_extra}
    return {
        "dominant": measurement.dominant and not is_extra,
        "second_mode": document,
        "probable_mass_kg": None if mass is None else mass.mass,
        "probable_mass_uncertainty_kg": None if mass is None else mass.uncertainty,
    }
