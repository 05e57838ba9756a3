"""`hapsim check`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapsim.cli.as_json import document
from hapsim.cli.options import Json, SceneFile, load
from hapsim.cli.output import stderr, stdout
from hapsim.errors import UsageError
from hapsim.holds import HOLDS
from hapsim.number_format import between, duration, number, rounded_down, rounded_up
from hapsim.prediction import (
    Desired,
    Felt,
    HostSilence,
    Prediction,
    Robustness,
    WireTime,
    correction_for,
    host_silence,
    predict,
    predict_on_wire,
    robustness_of,
    warnings_about,
)
from hapsim.prediction.force_bounds import (
    force_bounds,
    hidden_sign,
    refused_slew,
    refused_travel,
    run_bounds,
    slow_slew,
    travel_document,
)
from hapsim.theory import Mode

if TYPE_CHECKING:
    from hapsim.cordis.explain import Explanation
    from hapsim.prediction.correction import Remedies
    from hapsim.prediction.predict import LinkMargin
    from hapsim.scene import Scene


def check(
    scene: SceneFile,
    json: Json = False,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain", help="Print every mode, margin and bound; compile the scene too, and time its parts."
        ),
    ] = False,
) -> None:
    """Predict without running: stability, what the hand feels, gain margins, the wire."""
    loaded = load(scene)
    if why := refused_travel(loaded):
        raise UsageError(f"{scene}: {why}")
    with stderr().status("working out modes and gain margins"):
        prediction = predict(loaded)
        on_wire = predict_on_wire(loaded)
    explanation = _explanation(loaded) if explain else None
    warnings = slew_warnings(loaded, prediction)
    warnings += [one for one in warnings_about(loaded, prediction) if one not in warnings]
    if json:
        compiled = {} if explanation is None else {"compiled": explanation.as_document()}
        bounds = {"force_bounds": run_bounds(loaded)._asdict(), "travel": travel_document(loaded)}
        predicted = prediction_document(prediction, on_wire=on_wire)
        print(document({"scene": scene, "warnings": warnings} | predicted | bounds | compiled))
        return
    out = stdout()
    _show_verdict(out, scene, loaded, prediction)
    if explain:
        show_details(out, loaded, prediction, on_wire)
    else:
        _show_summary(out, loaded, prediction, on_wire)
    if explanation is not None:
        show_explanation(out, explanation)
    for warning in warnings:
        out.print(f"[yellow]Warning:[/yellow] {escape(warning)}")


def _explanation(scene: Scene) -> Explanation:
    from hapsim.cordis.explain import explain

    with stderr().status("compiling") as status:
        return explain(scene, lambda part: status.update(f"compiling and timing {part}"))


_NO_FACTOR, _UNKNOWN = "–", "?"
_MARGINAL = 1e-9  # of the spectral radius: a free motion, which rounding places on either side of 1


def _show_verdict(out: Console, name: str, scene: Scene, prediction: Prediction) -> None:
    held_back = bool(slew_warnings(scene, prediction))
    title, verdict = f"[bold]{escape(name)}[/bold]", f"at {prediction.rate:g} Hz: {_stability(prediction, held_back)}"
    if len(name) < out.width:
        out.print(title, verdict)
    else:
        out.print(title, soft_wrap=True)  # a path stays whole: it is to be copied
        out.print(verdict)
    out.print(_predicted_for(scene))


def _show_summary(out: Console, scene: Scene, prediction: Prediction, on_wire: Prediction | None) -> None:
    """Prints the answer in about ten lines; `show_details` has the rest."""
    if prediction.felt:
        out.print(_felt_summary(prediction))
    for coupled, why in prediction.coupled.items():
        out.print(f"[bold]{coupled}[/bold] {why}: no single k and b describe what it feels (--explain lists the modes)")
    out.print(_margin_summary(prediction))
    if prediction.poles_method:
        out.print(f"A large scene: {prediction.poles_method}.")
    budget = prediction.wire_time
    fits = "fits" if budget.fits else "[red]does not fit[/red]: a higher baud rate, or a lower rate"
    period = f"{duration(budget.exchange_s)} of the {duration(budget.period)} period"
    out.print(f"Wire: an exchange takes {period}: {fits}. {_delay(budget)}")
    if on_wire is not None:
        out.print(_felt_on_wire(prediction, on_wire))
    bounds = run_bounds(scene)
    slew = f", slew {bounds.slew_limit:g} N/s" if math.isfinite(bounds.slew_limit) else ""
    soft = f", soft start {duration(bounds.soft_start_s)}" if bounds.soft_start_s > 0.0 else ""
    silence = duration(host_silence(prediction.rate).zero_force_after_s)
    out.print(
        f"Guards: force {scene.device.force_limit:g} N{slew}{soft}, energy {bounds.energy_limit:g} J; zero force "
        f"{silence} after the host dies"
    )
    show_travel(out, scene)
    for desired in prediction.desired:
        if not desired.reached and prediction.rendering is not None and prediction.rendering.kind is not None:
            out.print(_reached(desired, prediction.rendering.kind.name))
    show_assumptions(out, prediction)


def _felt_summary(prediction: Prediction) -> Table:
    """Returns k, b and static stiffness of each hand, beside what was asked for."""
    desired = {one.name: one for one in prediction.desired}
    table = Table(box=None)
    for heading in ("", "asked for", "felt", "static", ""):
        table.add_column(heading, justify="right" if heading else "left")
    for felt in prediction.felt:
        wanted = desired.get(felt.name)
        k = felt.stiffness + felt.configuration.stiffness if wanted is None else wanted.k
        b = felt.damping + felt.configuration.friction if wanted is None else wanted.b
        static = number(robustness_of(felt).steady_stiffness)
        table.add_row(f"{escape(felt.name)}: k", number(k), number(felt.k), static, "N/m")
        table.add_row(f"{escape(felt.name)}: b", number(b), number(felt.b), "", "N·s/m")
    return table


def _margin_summary(prediction: Prediction) -> str:
    """Returns the smallest gain margin in a sentence."""
    if not prediction.stable and not _at_limit(prediction):
        hands = [felt for felt in prediction.felt if not felt.stable]
        return " ".join(map(_margin, hands)) or "--explain lists by how much each link has to change"
    if not prediction.margins:
        return "There is no link to have a gain margin"
    tightest = _tightest(prediction)
    if not tightest or not math.isfinite(_change(tightest[0])):
        return "Gain margin: no link makes it unstable" if tightest else "Gain margins were not worked out"
    one = tightest[0]
    factors = {"stiffness": one.stiffness_factor, "damping": one.damping_factor}
    what, factor = min(factors.items(), key=lambda entry: abs(math.log(entry[1])) if entry[1] > 0.0 else math.inf)
    return f"Smallest gain margin: unstable at {factor:.4g} times the {what} of {escape(one.name)}"


def show_details(out: Console, scene: Scene, prediction: Prediction, on_wire: Prediction | None) -> None:
    """Prints all that is predicted: the hands, modes, margins, the wire, what bounds the force. `on_wire`: as
    `predict_on_wire` returned it."""
    show_assumptions(out, prediction)
    in_table = {margin.stiffness_factor for margin in _tightest(prediction)}
    desired = {one.name: one for one in prediction.desired}
    for felt in prediction.felt:
        _show_felt(out, felt, felt.stiffness_factor in in_table, desired.get(felt.name))
    show_correction(out, prediction)
    for coupled, why in prediction.coupled.items():
        out.print(
            f"\n[bold]{coupled}[/bold] {why}: it feels no single spring and damper. The modes below are those "
            "of the whole."
        )
    if prediction.modes:
        out.print()
        out.print(_modes(prediction))
    if prediction.poles_method:
        out.print(f"A large scene: {prediction.poles_method}.")
    if prediction.margins:
        out.print()
        out.print(_margins(prediction))
        if prediction.margins_method:
            out.print(f"{prediction.margins_method[0].upper()}{prediction.margins_method[1:]}.")
    show_wire(out, prediction, on_wire)
    show_silence(out, prediction.rate)
    show_force_bounds(out, scene, prediction)


def show_assumptions(out: Console, prediction: Prediction) -> None:
    """What was taken for what it is not, so that a theory could be had."""
    for assumption in prediction.assumptions:
        out.print(f"[yellow]Assumed:[/yellow] {escape(assumption)}.")


def _predicted_for(scene: Scene) -> str:
    """Of which device and hand a prediction is; each channel's where they differ."""
    device, channels = scene.device, scene.channels
    each = zip(device.mass_spans(channels), device.frictions(channels), device.stiffnesses(channels), strict=True)
    hands = [_one_hand(*one) for one in each]
    used = {point.channel: hands[point.channel] for point in scene.device_points.values()}
    who = "; ".join(f"channel {c}: {one}" for c, one in sorted(used.items()))
    who = who if len(set(used.values())) > 1 else next(iter(used.values()))
    samples = "sample" if device.delay == 1.0 else "samples"
    late = f"delay {device.delay:g} {samples} ({duration(device.delay * scene.period)})" if device.delay else "no delay"
    hold = HOLDS[device.hold].label
    averaged = ", averaged positions" if device.sampling == "average" else ""
    return f"for a hand of {who}, {late}, {hold}{averaged}"


def _one_hand(span: tuple[float, float], friction: float, stiffness: float) -> str:
    least, most = span
    mass = f"{most:g} kg" if least == most else f"{least:g} to {most:g} kg"
    spring = f", a spring of {stiffness:g} N/m" if stiffness else ""
    return f"{mass}, friction {friction:g} N·s/m{spring}"


def _stability(prediction: Prediction, held_back: bool) -> str:
    """`held_back`: whether the slew limit is too slow for it."""
    radius = f"(spectral radius {prediction.spectral_radius:.9g})"
    if _at_limit(prediction):
        return (
            f"[yellow]at the limit[/yellow] between stable and unstable: something drifts or swings for ever {radius}"
        )
    if prediction.stable and held_back:
        return f"[yellow]stable without its slew limit[/]: see the warning {radius}"
    return f"{'[green]stable' if prediction.stable else '[red]unstable'}[/] {radius}"


def _at_limit(prediction: Prediction) -> bool:
    return not prediction.stable and abs(prediction.spectral_radius - 1.0) < _MARGINAL


def _show_felt(out: Console, felt: Felt, margin_in_table: bool, desired: Desired | None) -> None:
    """`margin_in_table`: whether its gain margin, that of its only link, stands in the table of the links' margins."""
    table = Table(title=f"What the hand feels at {felt.name}", title_justify="left")
    for heading in ("", *(["desired"] if desired else []), "simulated", "felt"):
        table.add_column(heading, justify="right" if heading else "left")
    robustness = robustness_of(felt)
    real = felt.configuration.friction
    own = f" (+ {felt.configuration.stiffness:.6g} real)" if felt.configuration.stiffness else ""
    for label, wanted, simulated, is_felt in (
        ("stiffness  N/m", "k", f"K = {felt.stiffness:.6g}{own}", f"k = {number(felt.k)}"),
        ("damping  N·s/m", "b", f"B = {felt.damping:.6g} (+ {real:.6g} real)", f"b = {number(felt.b)}"),
        ("eigenfrequency  Hz", "frequency_hz", "", number(felt.frequency_hz)),
        ("damping ratio", "damping_ratio", "", number(felt.damping_ratio)),
        ("static stiffness  N/m", "k", "", number(robustness.steady_stiffness)),
        ("noise gain  N/m", "", "", number(robustness.noise_gain)),
        ("stable masses  kg", "", "", _masses(robustness)),
    ):
        is_desired = [number(getattr(desired, wanted)) if wanted else ""] if desired else []
        table.add_row(label, *is_desired, simulated, is_felt)
    out.print()
    out.print(table)
    if desired is None and (name := correction_for(felt)):
        k, b = felt.stiffness + felt.configuration.stiffness, felt.damping + real
        out.print(f"With `correction: {name}` under `device` the hand would feel k = {k:.6g}, b = {b:.6g}.")
    if felt.reason:
        out.print(f"No spring and damper is equivalent: {felt.reason}.")
    if margin := _margin(felt, margin_in_table):
        out.print(margin)
    out.print(_passivity(felt))


def _masses(robustness: Robustness) -> str:
    least, most = robustness.stable_masses
    if math.isnan(least):
        return "none"
    if math.isinf(most):
        return "all" if least == 0.0 else f"from {least:.3g}"
    return f"{least:.3g} to {most:.3g}"


def _margin(felt: Felt, in_table: bool = False) -> str:
    if felt.stiffness == 0.0:
        return "There is no stiffness to have a margin."
    if felt.stiffness_factor == 0.0:
        return f"At this damping no stiffness is stable{_enough_damping(felt)}."
    if not math.isfinite(felt.stiffness_factor):
        return "No stiffness makes it unstable at this damping."
    if felt.stable:
        told = f"Gain margin: the loop becomes unstable at {felt.stiffness_factor:.3g} times this stiffness."
        return "" if in_table else told
    stiffness = f"where the stiffness is {rounded_down(felt.stiffness_factor)} of the simulated one, or less"
    return f"It becomes stable {stiffness}{_enough_damping(felt)}."


def _enough_damping(felt: Felt) -> str:
    least, most = felt.stable_damping
    if not most > 0.0:
        return "; no damping makes this stiffness stable: take less of it, a shorter delay or device.correction"
    return f"; or where the damping is between {between(max(least, 0.0), most, ' and ')} N·s/m"


def _passivity(felt: Felt) -> str:
    if felt.predictor is not None:
        return "Passivity: no condition is known where a predictor answers; another hand's mass is judged above."
    if felt.passive is None:
        return "Passivity: no condition is known for this hold, sampling and damper."
    if felt.passive:
        return "Passive: no hand, however it moves, makes it unstable (Colgate and Schenkel)."
    return "Not passive: this hand is judged above; a heavier, lighter or stiffer one may make it unstable."


def _margins(prediction: Prediction) -> Table:
    """The links that are closest to the limit first, as many as fit the eye."""
    unstable = not prediction.stable and not _at_limit(prediction)
    tightest, cell = _tightest(prediction), _stabilizing if unstable else _factor
    rows = [
        (
            margin.name,
            cell(margin.stiffness_factor, margin.stabilizing_stiffness),
            cell(margin.damping_factor, margin.stabilizing_damping),
        )
        for margin in tightest
    ]
    title = "Gain margins: the scene becomes unstable where a link is multiplied by"
    larger = "have larger margins"
    if unstable:
        signs = ", ".join(
            f"{sign}: {what}"
            for sign, what in ((_NO_FACTOR, "no factor does it"), (_UNKNOWN, "not worked out"))
            if any(sign in row[1:] for row in rows)
        )
        title = f"For the scene to be stable, multiply one link by{f' ({signs})' if signs else ''}"
        larger = "need a larger change"
    table = Table(title=title, title_justify="left")
    for heading in ("link", "stiffness times", "damping times"):
        table.add_column(heading, justify="left" if heading == "link" else "right")
    for row in rows:
        table.add_row(*row)
    left_out = len(prediction.margins) - len(tightest)
    if left_out:
        table.caption = f"and {left_out} links that were not worked out, or {larger}; --json has all that are known"
    return table


def _tightest(prediction: Prediction) -> list[LinkMargin]:
    """Those of the links that are closest to the limit first; so many that the table stays short."""
    known = [margin for margin in prediction.margins if not math.isnan(margin.stiffness_factor)]
    known.sort(key=_change)
    return known[:12]


def _change(margin: LinkMargin) -> float:
    """How large a factor takes the scene to the limit, in its logarithm."""
    ranges = (*(margin.stabilizing_stiffness or ()), *(margin.stabilizing_damping or ()))
    factors = [least if least >= 1.0 else most for least, most in ranges]
    if not ranges:
        factors = [factor for factor in (margin.stiffness_factor, margin.damping_factor) if factor > 0.0]
    return min((abs(math.log(factor)) for factor in factors), default=math.inf)


def _factor(value: float, _: object = None) -> str:
    if math.isnan(value):
        return "–"
    return "any" if math.isinf(value) else f"{value:.4g}"


def _stabilizing(_: float, ranges: tuple[tuple[float, float], ...] | None) -> str:
    """Which factors make an unstable scene stable."""
    if ranges is None:
        return _UNKNOWN
    return " or ".join(_range(*one) for one in ranges) or _NO_FACTOR


def _range(least: float, most: float) -> str:
    if least == 0.0:
        return f"{rounded_down(most)} or less"
    return between(least, most) if math.isfinite(most) else f"{rounded_up(least)} or more"


def _modes(prediction: Prediction) -> Table:
    table = Table(title="Modes", title_justify="left")
    for heading in ("pole", "|pole|", "Hz", "damping ratio", "moves"):
        table.add_column(heading, justify="left" if heading == "moves" else "right")
    for mode in prediction.modes[:12]:
        moving = _moving(prediction.points, mode.participation)
        names = ", ".join(f"{name} {share:.0%}" for name, share in moving[:3] if share > 0.05)
        names = names or f"many, most {moving[0][0]}"
        pole = f"{mode.pole.real:.6f} ± {abs(mode.pole.imag):.6f}j" if mode.pole.imag else f"{mode.pole.real:.6f}"
        table.add_row(pole, _modulus(abs(mode.pole)), *_oscillation(mode), names)
    if len(prediction.modes) > 12:
        table.caption = f"and {len(prediction.modes) - 12} more; --json has them all"
    return table


def _moving(points: tuple[str, ...], participation: Iterable[float]) -> list[tuple[str, float]]:
    """Modules and their share of a mode, the largest first; a structure's points together."""
    shares: dict[str, float] = {}
    for point, share in zip(points, participation, strict=True):
        module = point.partition(".")[0]
        shares[module] = shares.get(module, 0.0) + share
    return sorted(shares.items(), key=lambda entry: -entry[1])


def _modulus(value: float) -> str:
    """Close to the circle, what is missing from 1 or beyond it."""
    if value == 1.0:
        return "1"
    return f"1{value - 1.0:+.1e}" if abs(value - 1.0) < 1e-5 else f"{value:.6f}"


def _oscillation(mode: Mode) -> tuple[str, str]:
    """Frequency and damping ratio; a real pole has none worth naming."""
    return (number(mode.frequency_hz), number(mode.damping_ratio)) if mode.pole.imag else ("–", "–")


_EXACT = 1e-6  # errors below are none to anybody
_SMALL = 1e-3
_ROWS = 12


def show_correction(out: Console, prediction: Prediction) -> None:
    """Nothing, without a correction."""
    rendering = prediction.rendering
    if rendering is None or rendering.kind is None:
        return
    for desired in prediction.desired:
        out.print(_reached(desired, rendering.kind.name))
    if prediction.coupled and prediction.desired_modes:
        out.print()
        out.print(_desired_modes(prediction))
    for note in rendering.notes:
        out.print(f"[yellow]Of the correction:[/yellow] {escape(note)}.")


def _reached(desired: Desired, name: str) -> str:
    if desired.error < _EXACT:
        return f"Correction {name}: {desired.name} swings as desired.{_steady(desired)}"
    if desired.remedies is None:
        off = f"{desired.error:.1%} off at most" if desired.error >= _SMALL else "less than 0.1 % off"
        off = off if math.isfinite(desired.error) else "not a spring and damper's at some of them"
        return (
            f"Correction {name}: over the masses of its span, what {desired.name} feels is {off}; the table is of the "
            f"middle of the span.{_steady(desired)}"
        )
    off = f", {desired.error:.1%} off" if math.isfinite(desired.error) else ""
    return (
        f"[yellow]Correction {name} does not reach what is desired at {desired.name}[/yellow]: simulated is what comes "
        f"nearest{off}. {_what_would(desired.remedies)}"
    )


def _steady(desired: Desired) -> str:
    if abs(desired.steady_stiffness - desired.k) <= _EXACT * abs(desired.k):
        return ""
    return f" A steady push meets {desired.steady_stiffness:.6g} N/m, not {desired.k:.6g}."


def _what_would(remedies: Remedies) -> str:
    ways = []
    if remedies.rate_hz is not None:
        ways.append(f"a rate of {remedies.rate_hz:.4g} Hz or more, with a delay of as many samples")
    if remedies.delay_samples is not None:
        ways.append(f"a delay of {remedies.delay_samples:.3g} samples or less")
    if remedies.friction is not None:
        ways.append(f"{remedies.friction:.4g} N·s/m or more of real friction in place of simulated damping")
    if remedies.predictor:
        ways.append("correction: predictor")
    if not ways:
        return "No higher rate (up to 64 times), shorter delay, real friction or predictor alone makes it reachable."
    return f"It is reached by {'; or '.join(ways)}."


def _desired_modes(prediction: Prediction) -> Table:
    """The modes of the continuous scene: where those of the loop are to be."""
    table = Table(title="Desired modes (the scene in continuous time)", title_justify="left")
    for heading in ("Hz", "damping ratio"):
        table.add_column(heading, justify="right")
    for mode in prediction.desired_modes[:_ROWS]:
        table.add_row(f"{mode.frequency_hz:.6g}", f"{mode.damping_ratio:.6g}")
    left_out = len(prediction.desired_modes) - _ROWS
    if left_out > 0:
        table.caption = f"and {left_out} more; --json has them all"
    return table


def show_explanation(out: Console, explanation: Explanation) -> None:
    """What `hapsim check --explain` adds."""
    table = Table(title="What the scene was compiled to", title_justify="left")
    for heading in ("part", "how many", "as"):
        table.add_column(heading, justify="right" if heading == "how many" else "left")
    for heading in ("bytes", "ns alone"):
        table.add_column(heading, justify="right")
    for part in explanation.parts:
        alone = "" if math.isnan(part.seconds) else f"{part.seconds * 1e9:.3g}"
        table.add_row(part.name, str(part.modules or ""), part.compiled_as, str(part.bytes), alone)
    out.print()
    out.print(table)
    share = explanation.seconds / explanation.period
    out.print(
        f"A tick takes {explanation.seconds * 1e9:.3g} ns, {share:.2g} of the sample period, here and now; "
        f"{explanation.points} points, {explanation.bytes} bytes, {explanation.precision} precision."
    )
    out.print(f"Of these the scene has none, and nothing was compiled: {', '.join(explanation.absent)}.")


def show_wire(out: Console, prediction: Prediction, on_wire: Prediction | None) -> None:
    """What an exchange takes, and what that makes of the delay and of what the hand feels.

    `on_wire`: predicted for the delay that results; None where the wire costs one sample, or is saturated.
    """
    budget = prediction.wire_time
    verdict = "fits" if budget.fits else "[red]does not fit[/red]: a higher baud rate, or a lower rate"
    out.print(f"\n{_time(prediction)}: {verdict}. {_delay(budget)}")
    if on_wire is not None:
        out.print(_felt_on_wire(prediction, on_wire))
    elif not budget.fits and not budget.is_saturated and _predicts(prediction):
        out.print(
            "[yellow]The predictor leads the state to where a force acts that is in time[/yellow]: what is felt with "
            "one that never is was not worked out. Use a faster wire."
        )
    if prediction.wire_of == "port":
        out.print(
            "This is counted for a UART. A device with USB of its own (CDC) ignores the baud rate and answers within a "
            "polling interval, 0.125 or 1 ms; the latency timer of a USB converter comes on top and is not counted."
        )
    elif prediction.wire_of == "none":
        out.print("That would be a UART at device.baud; the mock has a wire only where mock.baud gives it one.")


def show_silence(out: Console, rate: float) -> None:
    """What becomes of the force when the host dies."""
    silence: HostSilence = host_silence(rate)
    out.print(
        f"If the host dies, with clock: device and clock: host alike: the last force acts for at most "
        f"{duration(silence.zero_force_after_s)} ({silence.time_to_live_samples} samples' time to live, and one more); "
        f"after {duration(silence.latched_after_s)} (watchdog of {silence.watchdog_samples} samples, if the device "
        "allows it) the device latches: zero force until it is armed again."
    )


def show_force_bounds(out: Console, scene: Scene, prediction: Prediction) -> None:
    """What bounds the force in `hapsim run`, where the scene says its device is."""
    bounds = run_bounds(scene)
    slew = f"by at most {bounds.slew_limit:g} N/s" if math.isfinite(bounds.slew_limit) else "as fast as the scene asks"
    soft = "at once"
    if bounds.soft_start_s > 0.0:
        soft = f"along a ramp of {duration(bounds.soft_start_s)} (what is asked for later comes without a ramp)"
    out.print(
        f"Force: at most {scene.device.force_limit:g} N; it changes {slew}, and what the scene asks for in the very "
        f"first sample comes {soft}. A run ends where the scene gives the hand more than {bounds.energy_limit:g} J, or "
        "goes on swinging or shaking at the force limit (what counts as that: hapsim/STABILITY.md, the guard of the "
        "energy)."
    )
    show_travel(out, scene)
    if scene.device.port is None and scene.device.clock != "lockstep":
        out.print(_behind_a_port(scene))
    if hidden := hidden_sign(scene, prediction):
        out.print(hidden)


def show_travel(out: Console, scene: Scene) -> None:
    """Within which limits the force is the scene's, and where its position 0 is; nothing where it names neither."""
    device, channels = scene.device, scene.channels
    limits, margins = device.travels(channels), device.travel_margins(channels)
    for c, origin in enumerate(device.origins(channels)):
        where = f" of channel {c}" if channels > 1 else ""
        if device.travel is not None:
            (least, most), stiffness = limits[c], device.force_limit / margins[c]
            out.print(
                f"Travel{where}: {least:g} to {most:g} m. Outside, the force fades to zero within {margins[c]:g} m (a "
                f"stiffness of up to {stiffness:.4g} N/m); a device that goes farther ends the run."
            )
        if device.origin is not None:
            zero = "the device is when it is armed" if origin is None else f"the device says {origin:g} m"
            out.print(f"Origin{where}: position 0 is where {zero}.")


def slew_warnings(scene: Scene, prediction: Prediction) -> list[str]:
    """What the slew limit takes from what is predicted without it; none where it takes nothing."""
    refused = refused_slew(scene)
    refused = f"{refused}: `hapsim run` refuses this scene." if refused else ""
    return [one for one in (refused, slow_slew(scene, prediction)) if one]


def _behind_a_port(scene: Scene) -> str:
    """How much of this is another with `--port`, where a hand may hold the device."""
    bounds = force_bounds(scene, in_hand=True)
    soft = f"along a ramp of {duration(bounds.soft_start_s)}" if bounds.soft_start_s > 0.0 else "at once"
    return (
        f"That is before the mock. Behind a port (`--port`) the force changes by at most {bounds.slew_limit:g} N/s, "
        f"and what the scene asks for in the very first sample comes {soft}."
    )


def _time(prediction: Prediction) -> str:
    """Its parts, and the period that they have to fit in."""
    budget = prediction.wire_time
    parts = []
    if budget.baud is not None:
        count = f"{budget.bytes_to_host} + {budget.bytes_to_device} bytes at {budget.baud} baud"
        parts.append(f"{count} take {duration(budget.seconds)}")
    if budget.turnaround_s > 0.0:
        parts.append(f"the device's turnaround {duration(budget.turnaround_s)}")
    if budget.host_work_s > 0.0:
        parts.append(f"the host's work {duration(budget.host_work_s)}")
    share = budget.exchange_s / budget.period
    whole = f"{duration(budget.exchange_s)} of the {duration(budget.period)} period ({share:.0%})"
    return f"Wire, an exchange: {', '.join(parts)}; {whole}"


def _delay(budget: WireTime) -> str:
    if budget.is_saturated:
        longest = max(budget.bytes_to_host, budget.bytes_to_device)
        return (
            f"A frame of {longest} bytes alone takes longer than a period: frames queue up, and the delay has no end."
        )
    if budget.fits:
        samples = "One sample of delay"
        rate = f", up to {_below(budget.highest_rate_hz)} Hz" if math.isfinite(budget.highest_rate_hz) else ""
        return f"{samples}{rate}."
    speed = "" if budget.least_baud is None or budget.baud is None else f" or above {math.ceil(budget.least_baud)} baud"
    return (
        f"Every force misses its deadline: {budget.delay_samples} samples of delay. One sample below "
        f"{_below(budget.highest_rate_hz)} Hz{speed}."
    )


def _felt_on_wire(prediction: Prediction, on_wire: Prediction) -> str:
    """What the hands feel at the delay that results, beside what they feel at the declared one."""
    sentences = []
    for declared, late in zip(prediction.felt, on_wire.felt, strict=True):
        delay = f"{late.configuration.delay:g} samples in place of {declared.configuration.delay:g}"
        if late.dominant:
            felt = f"k = {late.k:.6g} N/m, b = {late.b:.6g} N·s/m"
            instead = f" (instead of {declared.k:.6g}, {declared.b:.6g})" if declared.dominant else ""
        else:
            felt, instead = f"no spring and damper is equivalent: {late.reason}", ""
        sentences.append(f"With a delay of {delay}, at {late.name}: {felt}{instead}.")
    verdict = "stable" if on_wire.stable else "[red]unstable[/red]"
    return " ".join([*sentences, f"The scene is then {verdict} (spectral radius {on_wire.spectral_radius:.9g})."])


def _predicts(prediction: Prediction) -> bool:
    rendering = prediction.rendering
    return rendering is not None and rendering.kind is not None and rendering.kind.predicts


def _below(rate: float) -> str:
    """Rounded down."""
    return f"{math.floor(rate)}" if rate >= 10.0 else f"{rate:.3g}"


def prediction_document(
    prediction: Prediction, channel: int | None = None, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """What `hapsim check` prints; `predicted` and `dominant` are of `channel` (None: the first). `on_wire`: as
    `predict_on_wire` gave it."""
    felt = felt_on(prediction, channel)
    return {
        "rate_hz": prediction.rate,
        "nominal_rate_hz": prediction.rate,
        "stable": prediction.stable,
        "spectral_radius": prediction.spectral_radius,
        "poles_method": prediction.poles_method or "every pole (memories, at zero, are not listed)",
        "poles_in_all": prediction.poles_in_all,
        "dominant": felt is not None and felt.dominant,
        "poles": prediction.poles,
        "predicted": None if felt is None else felt_document(felt),
        **_correction_document(prediction, channel),
        "device_points": {one.name: felt_document(one) for one in prediction.felt},
        "coupled_device_points": prediction.coupled,
        "assumptions": prediction.assumptions,
        "modes": [
            {
                "pole": mode.pole,
                "frequency_hz": mode.frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "participation": dict(zip(prediction.points, mode.participation, strict=True)),
            }
            for mode in prediction.modes
        ],
        "margins": {
            margin.name: {
                "stiffness_factor": margin.stiffness_factor or None,
                "damping_factor": margin.damping_factor or None,
                "stabilizing_stiffness_factors": margin.stabilizing_stiffness,
                "stabilizing_damping_factors": margin.stabilizing_damping,
            }
            for margin in prediction.margins
        },
        "margins_method": prediction.margins_method or ("every link" if prediction.margins else "none"),
        "wire_time": _wire_document(prediction, channel, on_wire),
        "host_silence": asdict(host_silence(prediction.rate)),
    }


def _correction_document(prediction: Prediction, channel: int | None) -> dict[str, Any]:
    """`desired` and `correction`; nothing without a correction."""
    rendering = prediction.rendering
    if rendering is None or rendering.kind is None:
        return {}
    first = next((one for one in prediction.desired if channel in (None, one.channel)), None)
    return {
        "desired": None if first is None else _desired(first),
        "correction": {
            "name": rendering.kind.name,
            "device_points": {
                port.name: {
                    "written": dict(zip(("K", "B"), port.written, strict=True)),
                    "simulated": dict(zip(("K", "B"), port.rendered, strict=True)),
                    "made_for_kg": port.made_for,
                    "reached": port.reached,
                }
                for port in rendering.ports
            },
            "desired": {one.name: _desired(one) for one in prediction.desired},
            "desired_modes": [
                {"root": mode.root, "frequency_hz": mode.frequency_hz, "damping_ratio": mode.damping_ratio}
                for mode in prediction.desired_modes
            ],
            "notes": rendering.notes,
        },
    }


def _desired(desired: Desired) -> dict[str, Any]:
    values = desired._asdict()
    return values | {"remedies": None if desired.remedies is None else desired.remedies._asdict()}


def _wire_document(prediction: Prediction, channel: int | None, on_wire: Prediction | None) -> dict[str, Any]:
    """`predicted` and what goes with it: at the delay that results, null where the wire costs one sample."""
    budget = prediction.wire_time
    felt = None if on_wire is None else felt_on(on_wire, channel)
    return asdict(budget) | {
        "of": prediction.wire_of,
        "exchange_s": budget.exchange_s,
        "fits": budget.fits,
        "delay_samples": budget.delay_samples,
        "highest_rate_hz": budget.highest_rate_hz,
        "predicted": None if felt is None else felt_document(felt) | {"delay": felt.configuration.delay},
        "stable": None if on_wire is None else on_wire.stable,
    }


def felt_on(prediction: Prediction, channel: int | None) -> Felt | None:
    """The prediction for one channel (None: the scene's first), where the hand there is a system of its own."""
    for felt in prediction.felt:
        if channel in (None, felt.channel):
            return felt
    return None


def felt_document(felt: Felt) -> dict[str, Any]:
    """Returns what one hand feels, as a JSON document: k (N/m), b (N·s/m), its configuration and robustness."""
    values = asdict(replace(felt, predictor=None))
    configuration = values.pop("configuration")
    values.pop("predictor")
    hand = {name: configuration[name] for name in ("mass", "friction", "delay", "hold", "sampling", "damper", "cutoff")}
    return values | hand | {"device_stiffness": configuration["stiffness"]} | robustness_of(felt)._asdict()
