"""Lines of `hapsim check` about hands, modes, gain margins, the wire and the bounds of the force."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from rich.markup import escape

from hapsim.cli.output import Line, Table, output_units, table
from hapsim.number_format import between, duration, listed, number, rounded_down, rounded_up
from hapsim.prediction import correction_for, host_silence, robustness_of
from hapsim.prediction.correction import CORRECTIONS
from hapsim.prediction.felt_alone import felt_if_sensed
from hapsim.prediction.first_help import INSTALLED, ways_to_stability
from hapsim.prediction.force_bounds import command_limits, force_bounds, run_bounds, sign_warning
from hapsim.prediction.prediction import SLIDES
from hapsim.prediction.timing import wire_parts, wire_remedies
from hapsim.prediction.verdict_words import margin_sentence, tightest
from hapsim.scene.outlines import travel_in_words

if TYPE_CHECKING:
    from hapsim.cordis.offline import Explanation
    from hapsim.prediction import Desired, Felt, Prediction, WireTime
    from hapsim.scene import Scene

_ROWS = 12  # of a table
_NAMES = 6  # of a sentence
_HUGE = 100.0  # a pole beyond has no digit behind the point that matters
_NO_FACTOR, _UNKNOWN = "–", "?"


def assumption_lines(assumptions: Iterable[str]) -> Iterator[Line]:
    """Yields the assumptions of the prediction. Sentences that differ only in their first word become one."""
    alike: dict[str, list[str]] = {}
    for sentence in assumptions:
        name, _, rest = sentence.partition(" ")
        alike.setdefault(rest, []).append(name)
    for rest, (first, *others) in alike.items():
        more = f" and {len(others) - _NAMES} more" if len(others) > _NAMES else ""
        same = f" The same holds for {', '.join(others[:_NAMES])}{more}." if others else ""
        yield f"[yellow]Assumed:[/yellow] {escape(f'{first} {rest}.{same}')}"


def felt_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields k and b of each hand with a closed form, and its margin."""
    for part in prediction.parts:
        if part.alone is not None:
            yield from _felt_lines(prediction, part.alone, part.wanted)


def _felt_lines(prediction: Prediction, felt: Felt, desired: Desired | None) -> Iterator[Line]:
    yield ""
    yield _felt_table(felt, desired)
    if desired is None and (name := correction_for(felt, prediction.scene.device.sensors)):
        units, device = output_units(felt.channel), felt.configuration
        reached = felt.stiffness + device.stiffness, felt.damping + device.friction
        if CORRECTIONS[name].by_sensors:
            sensed = felt_if_sensed(felt)
            reached = sensed.k, sensed.b
        k, b = units(reached[0], "N/m"), units(reached[1], "N·s/m")
        yield f"With `correction: {name}` under `device` the hand would feel k = {k}, b = {b}."
    if felt.reason:
        yield f"No spring and damper is equivalent: {felt.reason}."
    is_in_table = any(one.stiffness_factor == felt.stiffness_factor for one in tightest(prediction, _ROWS))
    if prediction.changes_values:
        yield "" if felt.stable else escape(ways_to_stability(prediction))
    elif not (is_in_table and felt.stable and math.isfinite(felt.stiffness_factor)):
        yield margin_sentence(felt, output_units(felt.channel))


def _felt_table(felt: Felt, desired: Desired | None) -> Table:
    robustness, device, units = robustness_of(felt), felt.configuration, output_units(felt.channel)
    (K, k, own_k, static, noise), (B, b, own_b) = (
        [units.number(one, unit) for one in each]
        for unit, each in (
            ("N/m", (felt.stiffness, felt.k, device.stiffness, robustness.steady_stiffness, robustness.noise_gain)),
            ("N·s/m", (felt.damping, felt.b, device.friction)),
        )
    )
    own = f" (+ {own_k} real)" if device.stiffness else ""
    least, most = (units.number(one, "kg", 3) for one in robustness.stable_masses)
    masses = "none" if math.isnan(robustness.stable_masses[0]) else f"{least} to {most}"
    if math.isinf(robustness.stable_masses[1]):
        masses = f"from {least}" if robustness.stable_masses[0] else "all"
    rows = [
        (
            f"{label}  {units.name(unit)}".rstrip(),
            units.number(getattr(desired, key), unit) if desired and key else "",
            *both,
        )
        for label, unit, key, *both in (
            ("stiffness", "N/m", "k", f"K = {K}{own}", f"k = {k}"),
            ("damping", "N·s/m", "b", f"B = {B} (+ {own_b} real)", f"b = {b}"),
            ("eigenfrequency", "Hz", "frequency_hz", "", number(felt.frequency_hz)),
            ("damping ratio", "", "damping_ratio", "", number(felt.damping_ratio)),
            ("static stiffness", "N/m", "k", "", static),
            ("noise gain", "N/m", "", "", noise),
            ("stable masses", "kg", "", "", masses),
        )
    ]
    return table(f"What the hand feels at {felt.name}", ("", "desired", "simulated", "felt"), rows)


def mode_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields the modes, slowest first; nothing if there are none."""
    if not prediction.modes:
        return
    rows = []
    for mode in prediction.modes[:_ROWS]:
        shares: dict[str, float] = {}  # a structure's points together
        for point, share in zip(prediction.points, mode.participation, strict=True):
            module = point.partition(".")[0]
            shares[module] = shares.get(module, 0.0) + share
        moving = sorted(shares.items(), key=lambda entry: -entry[1])
        names = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in moving[:3] if share > 0.05)
        modulus = abs(mode.pole)
        digits = ".6f" if modulus < _HUGE else ".4g"
        pole = f"{mode.pole.real:{digits}}"
        oscillation = ["–", "–"]  # a real pole has none worth naming
        if mode.pole.imag:
            pole += f" ± {abs(mode.pole.imag):{digits}}j"
            shown = mode.frequency_hz <= 0.5 * prediction.rate  # of a pole that hardly rings it may be beyond
            oscillation = [number(mode.frequency_hz) if shown else "–", number(mode.damping_ratio)]
        # Close to the circle, what is missing from 1 or beyond it.
        size = f"1{modulus - 1.0:+.1e}" if 0.0 < abs(modulus - 1.0) < 1e-5 else f"{modulus:{digits}}"
        rows.append([pole, "1" if modulus == 1.0 else size, *oscillation, names or f"many, most {moving[0][0]}"])
    yield ""
    yield table("Modes", ("pole", "|pole|", "Hz", "damping ratio", "<moves"), rows, _more(len(prediction.modes)))


def _more(count: int) -> str:
    return f"and {count - _ROWS} more; --json lists all" if count > _ROWS else ""


def margin_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields the gain margins of the links, and the method; nothing without links."""
    if not prediction.margins:
        return
    links = tightest(prediction, _ROWS)
    if prediction.stable_as_taken or prediction.at_limit or prediction.verdict_here == SLIDES:
        rows = [(one.name, _factor(one.stiffness_factor), _factor(one.damping_factor)) for one in links]
        title, others = "Gain margins: a link makes the scene unstable at", "have larger margins"
    else:
        rows = [(one.name, _ranges(one.stabilizing_stiffness), _ranges(one.stabilizing_damping)) for one in links]
        signs = ((_NO_FACTOR, "no factor"), (_UNKNOWN, "not computed"))
        legend = ", ".join(f"{sign}: {what}" for sign, what in signs if any(sign in row[1:] for row in rows))
        title = f"For the scene to be stable, multiply one link by{f' ({legend})' if legend else ''}"
        others = "need a larger change"
    left_out = len(prediction.margins) - len(links)
    caption = f"and {left_out} links that {others} or were not computed; --json lists all results"
    yield ""
    yield table(title, ("<link", "stiffness times", "damping times"), rows, caption if left_out else "")
    if prediction.changes_values:
        yield f"These are factors on the simulated values, {INSTALLED}."
    if prediction.margins_method:
        yield f"{prediction.margins_method[0].upper()}{prediction.margins_method[1:]}."


def _factor(value: float) -> str:
    return "any" if math.isinf(value) else number(value, 4)


def _ranges(ranges: tuple[tuple[float, float], ...] | None) -> str:
    """Returns the factors that make an unstable scene stable."""
    words = []
    for least, most in ranges or ():
        to = between(least, most) if math.isfinite(most) else f"{rounded_up(least)} or more"
        words.append(to if least > 0.0 else f"{rounded_down(most)} or less")
    return _UNKNOWN if ranges is None else " or ".join(words) or _NO_FACTOR


def wire_lines(prediction: Prediction, on_wire: Prediction | None, explain: bool) -> Iterator[Line]:
    """Yields the time of an exchange, the delay that results, and k and b at that delay.

    `on_wire`: the result of `predict_on_wire`. `explain`: adds the parts of the time.
    """
    budget, is_real = prediction.wire_time, prediction.wire_of != "none"
    whole = f"{duration(budget.exchange_s)} of {duration(budget.period)}"
    if explain:
        whole = f"{wire_parts(budget)}; {whole} ({100.0 * budget.exchange_s / budget.period:.0f} %)"
    if is_real:
        on = "on a UART an" if prediction.wire_of == "unknown" else "an"
        verdict = "fits" if budget.fits else f"[red]does not fit[/red]: {wire_remedies(budget)}"
        yield f"Wire: {on} exchange takes {whole}: {verdict}. {_delay(budget)}"
    else:
        fits = f"A UART at {budget.baud} baud would {'fit' if budget.fits else '[yellow]not fit[/yellow]'}"
        yield f"Wire: none (the mock). {fits}: {whole}.{f' {_delay(budget)}' if explain else ''}"
    if on_wire is not None and (is_real or explain):
        yield _felt_on_wire(prediction, on_wire)
    if explain and prediction.wire_of in ("port", "unknown"):
        yield (
            "This is counted for a UART. A device with USB of its own (CDC) ignores the baud rate and answers within a "
            "polling interval, 0.125 or 1 ms; the latency timer of a USB converter comes on top and is not counted. "
            "Where most forces of the first 64 samples are late, and the scene is unstable at that delay, a run ends."
        )


def _delay(budget: WireTime) -> str:
    if budget.is_saturated:
        longest = max(budget.bytes_to_host, budget.bytes_to_device)
        return (
            f"A frame of {longest} bytes alone takes longer than a period: frames queue up, and the delay has no end."
        )
    rate = budget.highest_rate_hz
    if budget.fits and math.isinf(rate):
        return "The delay is one sample."
    highest = f"{math.floor(rate) if rate >= 10.0 else rounded_down(rate, 3)} Hz"
    if budget.fits:
        return f"The delay is one sample at rates up to {highest}."
    speed = "" if budget.least_baud is None or budget.baud is None else f" or above {math.ceil(budget.least_baud)} baud"
    return (
        f"Every force misses its deadline: {budget.delay_samples} samples of delay. One sample below {highest}{speed}."
    )


def _felt_on_wire(prediction: Prediction, on_wire: Prediction) -> str:
    """Returns k and b at the delay that results, beside those at the declared delay."""
    sentences = []
    for declared, late in zip(prediction.felt, on_wire.felt, strict=True):
        felt = f"no spring and damper is equivalent: {late.reason}"
        if late.dominant:
            units = prediction.scene.units_of(late.channel)
            before = units.number(declared.k, "N/m"), units.number(declared.b, "N·s/m")
            instead = f" (instead of {', '.join(before)})" if declared.dominant else ""
            felt = f"k = {units(late.k, 'N/m', '.6g')}, b = {units(late.b, 'N·s/m', '.6g')}{instead}"
        delay = f"{late.delay:g} samples in place of {declared.delay:g}"
        sentences.append(f"With a delay of {delay}, at {late.name}: {felt}.")
    verdict = "stable" if on_wire.stable else "[red]unstable[/red]"
    return " ".join([*sentences, f"The scene is then {verdict} (spectral radius {on_wire.spectral_radius:.9g})."])


def force_sentences(scene: Scene, prediction: Prediction) -> Iterator[str]:
    """Yields the bounds of the force after the host dies, and in `hapsim run`."""
    silence = host_silence(prediction.rate)
    lives, watch = f"{silence.time_to_live_samples} samples, and one more", f"{silence.watchdog_samples} samples"
    ends, latches = duration(silence.zero_force_after_s), f"{duration(silence.latched_after_s)} (watchdog of {watch}"
    if scene.device.is_admittance:
        yield (
            f"If the host dies, the device brakes to rest at most {ends} later (the time to live of its last command "
            f"is {lives}). After {latches}, if the device allows it) it latches: it holds for half a second at rest, "
            "and then its torque ends until it is armed again."
        )
    else:
        yield (
            f"If the host dies, the last force acts for at most {ends} (its time to live of {lives}). After {latches}, "
            "if the device allows it) the device latches: zero force until it is armed again. This holds for clock: "
            "device and clock: host."
        )
    bounds, slew = run_bounds(scene), "without a slew limit"
    if math.isfinite(bounds.slew_limit):
        slew = f"with a slew limit of {scene.units(bounds.slew_limit, 'N/s', 'g')}"
    if scene.device.is_admittance:
        yield (
            f"Limits of the {command_limits(scene)}: no command goes faster, or changes its speed faster, and none "
            "leaves device.travel. The scene's force moves the simulated mass:"
        )
    yield (
        f"Force: at most {scene.units(scene.device.force_limit, 'N', 'g')}, {slew}. The force of the first sample "
        f"{_soft_start(bounds.soft_start_s)}. A run ends if the scene gives the hand more than "
        f"{scene.units(bounds.energy_limit, 'J', 'g')}, or keeps swinging or shaking at the force limit "
        "(as defined in hapsim/STABILITY.md)."
    )


def device_sentences(scene: Scene, prediction: Prediction) -> Iterator[str]:
    """Yields the bounds of the force with a device in place of the mock, and the limits of the mock."""
    if scene.device.port is None and scene.device.clock != "lockstep":
        bounds = force_bounds(scene, in_hand=True)
        yield (
            f"These limits apply to the mock. With a device (`--port`), the slew limit is "
            f"{scene.units(bounds.slew_limit, 'N/s', 'g')}, and the force of the first sample "
            f"{_soft_start(bounds.soft_start_s)}."
        )
    if hidden := sign_warning(scene, prediction):
        yield hidden


def _soft_start(seconds: float) -> str:
    return f"ramps up over {duration(seconds)}; later changes act at once" if seconds > 0.0 else "acts at once"


def travel_sentences(scene: Scene) -> Iterator[str]:
    """Yields the limits within which the force is the scene's, and where position 0 is, if the scene says so; once for
    all channels of which the same is true."""
    device, channels, told = scene.device, scene.channels, dict[tuple[str, str], list[int]]()
    for c, origin in enumerate(device.origins(channels)):
        units, hand = scene.units_of(c), scene.hand_of(c)
        if device.travel is not None and c == hand[0]:
            margin = scene.travel_margins[c]
            stiffness, goes = device.force_limit / margin, travel_in_words(scene, c)
            of_travel = (
                f"{goes.removeprefix('from ')}. Outside, the force fades "
                f"to zero within {units(margin, 'm', 'g')} (a stiffness of up to "
                f"{units(stiffness, 'N/m', '.4g')}); a device that goes farther ends the run."
            )
            told.setdefault(("Travel", of_travel), []).extend(hand)
        if device.origin is not None:
            zero = "the device is when it is armed" if origin is None else f"the device says {units(origin, 'm', 'g')}"
            told.setdefault(("Origin", f"position 0 is where {zero}."), []).append(c)
    for (what, text), of in told.items():
        where = f" of channel{'s' * (len(of) > 1)} {listed(of)}" if channels > 1 else ""
        yield f"{what}{where}: {text}"


_NOTICED = 0.01  # of the force limit: a step of the force that a hand begins to notice


def count_sentences(scene: Scene, prediction: Prediction) -> Iterator[str]:
    """Yields what a count of the mock's positions is worth as force, where a hand may notice, and the mock's misses."""
    mock, limit = scene.mock_device, scene.device.force_limit
    for felt, regions in ((part.alone, part.regions) for part in prediction.parts):
        if felt is None:
            continue
        here = [felt, *(one.felt for one in regions)]
        count, units = mock.quantum[felt.channel], scene.units_of(felt.channel)
        stiffness = count * max(one.stiffness for one in here)
        model = felt.configuration.normalised_loop.damper
        share = 0.0 if model.senses else model.of_positions[0]
        damping = count * felt.configuration.rate * share * max(one.damping for one in here)
        if felt.predictor is None and max(stiffness, damping) > _NOTICED * limit:
            yield (
                f"{felt.name}: one count of {units(count, 'm', 3)} is worth {units(stiffness, 'N', 3)} of stiffness "
                f"and {units(damping, 'N', 3)} of damping, of {units(limit, 'N', 'g')}: finer counts, or a filtered or "
                "sensed damper, make it smoother."
            )
    if mock.misses:
        yield f"mock.misses: {mock.misses:.3g} of the forces come too late on this mock, as in no prediction."


RENDERED_S = 2.0
_PARTIALS = 6
_PEAK = 10.0 ** (-6.0 / 20.0)


def partials_sentences(partials: dict[str, tuple[float, ...]]) -> Iterator[str]:
    """Yields the pitches of each pick-up, Hz."""
    for name, pitches in partials.items():
        some = ", ".join(f"{one:.1f}" for one in pitches[:_PARTIALS])
        more = f" and {len(pitches) - _PARTIALS} more" if len(pitches) > _PARTIALS else ""
        rings = f"pitches when released: {some} Hz{more}" if pitches else "no pitch: nothing oscillates"
        yield f"Sound: {name}, {rings}."


def sound_sentences(scene: Scene, peaks: dict[str, float]) -> Iterator[str]:
    """Yields the peak of each pick-up with no hand moving it, and the gain that makes that peak -6 dB."""
    for name, peak in peaks.items():
        pick_up = scene.sound[name]
        if peak == 0.0:
            yield f"Sound: {name} is silent for {RENDERED_S:g} s: nothing moves {pick_up.point} unless a hand does."
        else:
            gain = pick_up.gain * _PEAK / peak
            level = f"{20.0 * math.log10(peak):+.1f} dB"
            yield f"Sound: {name} peaks at {level} in {RENDERED_S:g} s on the mock; gain: {gain:.3g} makes it -6 dB."


def explanation_lines(explanation: Explanation) -> Iterator[Line]:
    """Yields the compiled parts of the scene, and their time."""
    rows = [
        (
            part.name,
            str(part.modules or ""),
            part.compiled_as,
            str(part.bytes),
            "" if math.isnan(part.seconds) else f"{part.seconds * 1e9:.3g}",
        )
        for part in explanation.parts
    ]
    headings = ("<part", "count", "<as", "bytes", "ns")
    yield ""
    yield table("Compiled parts of the scene, each timed alone", headings, rows)
    steps = "" if explanation.substeps == 1 else f", a sample {explanation.substeps} ticks"
    yield (
        f"A tick takes {explanation.seconds * 1e9:.3g} ns{steps}: {explanation.share:.2g} of the sample period on this "
        f"machine. Size: {explanation.points} points, {explanation.bytes} bytes, {explanation.precision} precision."
    )
    most = explanation.most_substeps
    if explanation.substeps > max(most, 1):
        fits = f"at most {most} substeps fit" if most else "not even one fits"
        yield f"[red]That is too long[/red]: {fits} beside an exchange."
    yield f"Not compiled: {len(explanation.absent)} kinds of module that the scene does not use (--json lists them)."
