"""`hapsim measure`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from typer import Context

from hapsim.cli import measure_remarks as remarks
from hapsim.cli import methods, output
from hapsim.cli.before_arming import print_warnings, require_stable
from hapsim.cli.check import felt_on, prediction_document
from hapsim.cli.check_details import assumption_lines, wire_lines
from hapsim.cli.command_options import PictureOptions, hand_channel, lines_of_mock, place_at, print_next, print_written
from hapsim.cli.measure_options import MeasureOptions
from hapsim.cli.option_modes import require_mode
from hapsim.cli.output import output_units
from hapsim.cli.run_command import show_report, show_run
from hapsim.device.open_connection import on_device
from hapsim.documents import pick
from hapsim.errors import RunError, UsageError
from hapsim.measuring.branch import on_branch
from hapsim.measuring.diagnosis import diagnose
from hapsim.measuring.measure import measure_on_line as measure_scene
from hapsim.measuring.measure_trace import Measurement
from hapsim.measuring.trace_quality import spikes
from hapsim.number_format import number, rounded
from hapsim.prediction import Desired, Felt, OwnMotion, Prediction, predict, predict_on_wire, with_mass
from hapsim.prediction.board_words import carried

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.recording.trace import Report
    from hapsim.scene import Scene


def measure(asked: MeasureOptions, *, context: Context) -> None:
    """Measure the stiffness k and damping b that the hand feels, and compare them with the prediction.

    hapsim pushes the hand to both sides, and computes k and b from the motion. With --at, or if the scene has contacts,
    tables, detents or dry friction, it first moves the hand slowly to a position. It then pushes so little that the
    hand stays in the region around that position. With --impedance, it excites each channel in turn with many
    frequencies at once.
    """
    scene = asked.load()
    require_mode(context, scene)
    if scene.ports:
        from hapsim.cli.measure_devices import measure_devices

        measure_devices(asked, scene)
        return
    asked.require_writable()
    if scene.device.is_admittance:
        from hapsim.cli.measured_mass import measure_pair

        scene, channel = on_device(scene, asked.kind()), hand_channel(scene, asked.channel)
        asked.require_units(scene, [channel])
        measure_pair(asked, scene, channel)
        return
    if asked.impedance:
        from hapsim.cli.measure_matrices import measure_impedance

        measure_impedance(asked, scene)
        return
    scene, channel = on_device(scene, asked.kind()), hand_channel(scene, asked.channel)
    asked.require_units(scene, [channel])
    if asked.mass:
        scene = remarks.with_hand(scene, channel, asked.hand_stiffness)
    at: Any = place_at(scene, asked.at, scene.units_of(channel))
    if asked.hands or scene.space > 1:
        from hapsim.cli.measure_matrices import measure_hands

        measure_hands(asked, scene, channel, at)
        return
    _measure_pair(asked, scene, channel, at)


def _measure_pair(asked: MeasureOptions, scene: Scene, channel: int, at: float | None) -> None:
    """Pushes a hand, and prints the measured k and b beside the prediction."""
    seen = scene if asked.branch is None else on_branch(scene, channel, asked.branch)
    prediction = carried(predict(seen, with_margins=False, at=at), lines_of_mock(scene))
    on_wire = None if prediction.wire_of == "none" else predict_on_wire(seen)
    if asked.wanted:
        _require_drawable(prediction, channel)
    whole = prediction if seen is scene else predict(scene, with_margins=False)
    require_stable(asked.scene, scene, whole, asked.unstable)
    warnings = print_warnings(scene, prediction)
    try:
        with asked.running() as options:
            measurement = measure_scene(scene, channel=channel, at=at, branch=asked.branch, **options)
    except RunError as error:
        if error.trace is None:
            raise
        _end_failed(asked, prediction, channel, error)
    prediction = with_mass(prediction, channel, measurement.mass)
    asked.save([channel], measurement.trace)
    if asked.wanted:
        _draw(felt_on(prediction, channel), measurement, asked)
    weight = remarks.measured_weight(scene, prediction, measurement, channel, asked) if asked.mass else None
    if asked.json:
        measured = measurement_document(prediction, measurement, channel, on_wire)
        measured |= {} if weight is None else {"felt_mass": weight}
        measured |= {"methods": methods.paragraph(prediction, measurement, channel)} if asked.methods else {}
        print(output.document({"scene": asked.scene, "warnings": warnings} | measured))
    else:
        show_measurement(output.stdout(), scene, prediction, measurement, channel, asked.push)
        if weight is not None:
            output.stdout().print(remarks.weight_sentence(weight, channel))
        (show_report if asked.explain else show_run)(output.stdout(), measurement.trace.report)
        if on_wire is not None or prediction.wire_delay:
            output.show(output.stdout(), wire_lines(prediction, on_wire, explain=True))
        if asked.methods:
            table = methods.rows(prediction, measurement, channel)
            text = escape(methods.paragraph(prediction, measurement, channel))
            output.stdout().print(f"\n{text}\n", soft_wrap=True)  # so that it can be copied in one line
            output.stdout().print(output.table("", ("", ""), table, show_header=False), escape(methods.CITED), sep="\n")
        asked.print_files([channel])
        _print_next(asked, scene, prediction, measurement, channel)
    output.exit_if_failed(measurement.failure)


def _print_next(
    asked: MeasureOptions, scene: Scene, prediction: Prediction, measurement: Measurement, channel: int
) -> None:
    """Prints the command to try next; none after a failure."""
    if measurement.failure is not None:
        return
    if not measurement.left_region and diagnose(prediction, measurement, channel).differs:
        print_next("identify", asked.scene, *asked.words(), "--channel", str(channel))
    else:
        asked.print_next_run(scene, asked.unstable)


def _require_drawable(prediction: Prediction, channel: int) -> None:
    if felt_on(prediction, channel) is None:
        raise UsageError(
            "a ring-down is drawn for a hand that is a spring and damper's alone; this one "
            f"{prediction.coupled.get(prediction.scene.hand_on(channel), '')}: omit --picture and --data"
        )


def _end_failed(asked: MeasureOptions, prediction: Prediction, channel: int, error: RunError) -> None:
    """Prints the prediction of a run that failed before anything could be identified, and exits with its error."""
    asked.save([channel], error.trace)
    if asked.json:
        print(output.document({"scene": asked.scene} | _run_document(prediction, error.trace.report, channel, error)))
    else:
        show_report(output.stdout(), error.trace.report)
        print_written("Trace", asked.record)
    output.exit_if_failed(error)


def _draw(felt: Any, measurement: Measurement, picture: PictureOptions) -> None:
    from hapsim.chart.trace_chart import draw_ring_down, ring_down

    drawn = ring_down(measurement.trace, felt, led=measurement.at_m is not None)
    picture.write(lambda: drawn, lambda path: draw_ring_down(drawn, felt, (measurement.k, measurement.b), path))


def show_measurement(
    out: Console,
    scene: Scene,
    prediction: Prediction,
    measurement: Measurement,
    channel: int = 0,
    push: float | None = None,
) -> None:
    """Prints prediction beside measurement on a channel, and beside what is desired, with a correction. `push`: N, if
    the largest one was asked for."""
    hands = {point.channel: name for name, point in scene.device_points.items()}
    felt, report, units = felt_on(prediction, channel), measurement.trace.report, scene.units_of(channel)
    desired = next((one for one in prediction.desired if one.channel == channel), None)
    least, most = scene.device.mass_spans(scene.channels)[channel]
    of_mass = "declared"
    if least < most:
        of_mass = "estimated" if any(report.estimated_mass_kg) else "assumed"
        whose = "the estimated mass" if of_mass == "estimated" else "the middle of the span"
        out.print(
            f"k and b are those of a hand of {units(measurement.mass, 'kg', '.6g')}, {whose} of "
            f"{units.number(least, 'kg', 'g')} to {units(most, 'kg', 'g')}; they grow with the mass."
        )
    where = "" if measurement.at_m is None else f", at {units(measurement.at_m, 'm')}"
    title = f"What the hand feels at {escape(hands[channel])}, channel {channel}{where}{remarks.of_mock(scene)}"
    part = prediction.part_on(channel)
    own = part.own_motion if part else None
    out.print(_side_by_side(title, own, measurement, of_mass, desired))
    diagnosis = diagnose(prediction, measurement, channel)
    _print_seen_rate(out, felt, measurement, of_mass, held_up=diagnosis.machine_held_up)
    if felt is None:
        linked = " Hands are linked: --hands measures them together, and compares." * (
            len(part.names) > 1 if part else 0
        )
        out.print(f"{_of_coupled(prediction.coupled[hands[channel]], own)}{linked}")
    reasons = () if measurement.left_region else remarks.other_device(diagnosis, measurement, of_mass)
    for sentence in (
        *remarks.attempts(measurement),
        *remarks.smaller_push(push, measurement.push_n),
        *remarks.limits(measurement),
        *remarks.too_fast(measurement),
        *remarks.unstable(measurement),
        *spikes([measurement.trace], channel),
        *remarks.dry_friction(scene, measurement, channel),
        *remarks.play(scene, measurement, channel),
        *reasons,
    ):
        out.print(sentence)
    if not measurement.dominant:
        out.print(f"The motion is not that of a spring and damper: {_plainly(measurement)}.")
    out.print(
        f"Fitted to {measurement.samples} samples with {measurement.order} poles; the residual is "
        f"{units(measurement.residual_m, 'm', '.2g')}."
    )
    output.show(out, assumption_lines(prediction.assumptions))
    if others := ", ".join(f"--channel {c} for {name}" for c, name in hands.items() if c != channel):
        out.print(f"Other hands of this scene: {others}.")


def _print_seen_rate(out: Console, felt: Felt | None, measurement: Measurement, of_mass: str, *, held_up: bool) -> None:
    """Prints what holds where positions arrived at another rate than the declared one; `held_up`: by this machine."""
    seen, declared = measurement.seen_rate, measurement.trace.rate
    if held_up and seen is not None:
        out.print(
            f"The positions arrived at {seen.rate_hz:.6g} Hz. This machine held them up: k and b are those of the "
            f"declared {declared:g} Hz, which the device kept. `hapsim doctor` looks for the cause."
        )
    elif seen is not None and seen.differs_from(declared):
        rate, uncertainty = (rounded(one, seen.uncertainty_hz) for one in (seen.rate_hz, seen.uncertainty_hz))
        out.print(
            f"[yellow]The device sampled at {rate} ± {uncertainty} Hz[/yellow], as its positions arrived; it declares "
            f"{declared:g} Hz, for which the table above holds. With the rate that was seen:"
        )
        at_seen = None if felt is None else felt.at_rate(seen.rate_hz)
        title = f"What the hand feels at {rate} Hz (or this machine held the device up)"
        out.print(_side_by_side(title, at_seen, measurement.at_rate(seen.rate_hz), of_mass))


def _of_coupled(why: str, own: Felt | OwnMotion | None) -> str:
    """Returns the meaning of prediction and measurement for a hand that moves masses or another hand."""
    what = "no single spring and damper" if own is None else "its own oscillation"
    return (
        f"This hand {why}. Predicted: {what}. Measured: the mode with nearly all of the energy, or else the one that "
        "decays slowest. k and b give the hand's mass alone the same mode. `hapsim check --explain` lists the modes."
    )


def _plainly(measurement: Measurement) -> str:
    """Returns the reason why no spring and damper fits, without poles. `Measurement.reason` has the precise one."""
    from hapsim.measuring.fitted_pair import NO_SECOND_REAL_POLE, OVER_SOON, TOO_FEW_POLES

    reason, slowest = measurement.reason, max(map(abs, measurement.poles), default=0.0)
    if reason == TOO_FEW_POLES or slowest < OVER_SOON:
        return "it is over within a few samples, too fast to tell, or too small for these counts"
    if reason == NO_SECOND_REAL_POLE:
        return "the hand creeps back without swinging, in a way that no single spring and damper does"
    return reason


def _side_by_side(
    title: str, felt: Felt | OwnMotion | None, measurement: Measurement, of_mass: str, desired: Desired | None = None
) -> output.Table:
    """Returns the table of prediction and measurement, to the digits that the uncertainty leaves."""
    units, rows = output_units(), list[tuple[str, ...]]()
    for label, key, unit, uncertainty in (
        ("k", "k", "N/m", measurement.k_uncertainty),
        ("b", "b", "N·s/m", measurement.b_uncertainty),
        ("eigenfrequency", "frequency_hz", "Hz", measurement.frequency_uncertainty_hz),
        ("damping ratio", "damping_ratio", "", measurement.damping_ratio_uncertainty),
    ):
        predicted = math.nan if felt is None else getattr(felt, key)
        name, *cells = output.compared(label, unit, predicted, getattr(measurement, key), uncertainty)
        rows.append((name, units.number(getattr(desired, key), unit) if desired else "", *cells))
    mass, known = units.scaled(measurement.mass, "kg"), measurement.mass_uncertainty
    off_by = of_mass if known is None else units.number(known, "kg", 1)
    weighed = number(mass) if known is None else units.rounded(measurement.mass, known, "kg")
    rows.append((f"mass  {units.name('kg')}", "", "", weighed, off_by, ""))
    return output.table(title, ("", "desired", "predicted", "measured", "±", "off by"), rows)


def measurement_document(
    prediction: Prediction, measurement: Measurement, channel: int, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """Returns the document of `hapsim measure`: prediction, measurement and run report. `rate_hz` is the rate
    that scene and device declare; `at_rate_seen` has both sides for another rate that was seen."""
    seen, felt = measurement.seen_rate, felt_on(prediction, channel)
    diagnosis, at_seen_rate = diagnose(prediction, measurement, channel), None
    if seen is not None and seen.differs_from(prediction.rate):
        at_seen_rate = {
            "predicted": felt and felt.at_rate(seen.rate_hz),
            "measured": measurement.at_rate(seen.rate_hz),
        }
    measured = pick(measurement, measurement.DOCUMENT) | {
        "dominant": measurement.dominant and not diagnosis.gives,
        **pick(diagnosis, "second_mode probable_delay probable_mass_kg=probable_mass.mass"),
        **pick(diagnosis, "probable_mass_uncertainty_kg=probable_mass.uncertainty"),
    }
    return {
        **_run_document(prediction, measurement.trace.report, channel, measurement.failure, on_wire),
        "measured": measured,
        **pick(measurement, "at_m push_n left_region? attempts"),
        **pick(seen, "rate_seen_hz=rate_hz rate_seen_uncertainty_hz=uncertainty_hz"),
        "at_rate_seen": at_seen_rate,
    }


def _run_document(
    prediction: Prediction, report: Report, channel: int, failure: RunError | None, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """Returns the same without a measurement: of a run that failed before anything could be identified."""
    predicted = prediction_document(prediction, channel, on_wire) | {"measured": None}
    rates = {"rate_hz": prediction.rate, "kept_rate_hz": report.rate_hz}
    return predicted | pick(report, "*") | rates | output.failure_document(failure)
