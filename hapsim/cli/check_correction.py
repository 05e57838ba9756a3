"""Lines of `hapsim check` about a correction: its error, and how accurately the device must be known for it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rich.markup import escape

from hapsim.cli.output import Line, table
from hapsim.number_format import duration, percent, rounded_up
from hapsim.prediction import Desired, Prediction, predict
from hapsim.prediction.correction import CORRECTIONS, GOOD
from hapsim.prediction.felt_alone import SHARES, errors_by_mass
from hapsim.prediction.linear import with_device
from hapsim.units import Units

if TYPE_CHECKING:
    from hapsim.prediction.correction import Remedies

_ROWS = 12  # of a table
_EXACT, _SMALL = 1e-6, 1e-3  # relative errors of a correction that are no error, and a small one


def tolerance_sentences(prediction: Prediction, shares: Sequence[float]) -> Iterator[str]:
    """Yields the masses, frictions and delays for which the error of a correction stays within these shares; nothing
    without a correction."""
    if prediction.rendering is None:
        return
    for part in prediction.parts:
        for one in part.tolerances(shares):
            units = prediction.scene.units_of(part.channels[0])
            mass, friction = _within(units, one.mass, "kg"), _within(units, one.friction, "N·s/m")
            delay = _within(units, one.delay, "samples")
            yield (
                f"{escape(part.names[0])} feels what is desired within {percent(one.share)} where its mass is "
                f"{mass}, its friction {friction}, or the delay {delay}"
            )


def _within(units: Units, span: tuple[float, float], unit: str) -> str:
    least, most = span
    return f"{units(least, unit, rounded_up)} or more" if math.isinf(most) else units.between(least, most, unit)


def correction_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields the error of a correction, and its desired modes; nothing without a correction."""
    rendering = prediction.rendering
    if rendering is None or rendering.kind is None:
        return
    for desired in prediction.desired:
        yield _reached_sentence(desired, rendering.kind.name, prediction)
    if prediction.coupled and prediction.desired_modes:
        modes = prediction.desired_modes
        more = f"and {len(modes) - _ROWS} more; --json has them all" if len(modes) > _ROWS else ""
        rows = [(f"{mode.frequency_hz:.6g}", f"{mode.damping_ratio:.6g}") for mode in modes[:_ROWS]]
        title = "Desired modes (the scene in continuous time)"
        yield ""
        yield table(title, ("Hz", "damping ratio"), rows, more)
    yield from _steady_sentences(prediction, rendering.kind.name)
    yield from tolerance_sentences(prediction, SHARES)
    if rendering.kind.name == "predictor":
        poles = predict(with_device(prediction.scene, correction="poles"), with_margins=False)
        for part in poles.parts:
            for one in part.tolerances(SHARES[:1]):
                mass, name = _within(prediction.scene.units_of(part.channels[0]), one.mass, "kg"), escape(part.names[0])
                yield f"With correction: poles {name} would feel it within {percent(one.share)} for {mass}"
    for note in rendering.notes:
        yield f"[yellow]Of the correction:[/yellow] {escape(note)}."


def _steady_sentences(prediction: Prediction, name: str) -> Iterator[str]:
    """Yields the stiffness that steady pushes meet, for tied hands that meet another one than desired."""
    parts = () if prediction.network.point_mass.size else prediction.parts  # beside masses the motion has another k
    for one in (row for part in parts if part.alone is None for row in part.rows if not row.of):
        if abs(one.static_stiffness - one.desired_k) > _SMALL * abs(one.desired_k):
            units = prediction.scene.units_at(one.hand)
            meets, k = units(one.static_stiffness, "N/m"), units.number(one.desired_k, "N/m")
            yield (
                f"Correction {name}: a steady push on {escape(one.hand)} meets {meets}, not {k}: of hands tied "
                "to others only the motion is corrected."
            )


def unreached_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields the error for each hand at which a correction does not reach the desired spring and damper."""
    for desired in prediction.desired:
        if not desired.reached and prediction.rendering is not None and prediction.rendering.kind is not None:
            yield _reached_sentence(desired, prediction.rendering.kind.name, prediction)


def _reached_sentence(desired: Desired, name: str, prediction: Prediction) -> str:
    """Returns the error of a correction at one hand, and its remedies."""
    steady, units = "", prediction.scene.units_of(desired.channel)
    if abs(desired.steady_stiffness - desired.k) > _EXACT * abs(desired.k):
        meets, k = units(desired.steady_stiffness, "N/m", ".6g"), units.number(desired.k, "N/m")
        steady = f" A steady push meets {meets}, not {k}."
    if desired.error < _EXACT:
        return f"Correction {name}: {desired.name} swings as desired.{steady}"
    if desired.name in prediction.regions:
        return (
            f"Correction {name}: what {desired.name} feels in its region is {100.0 * desired.error:.1f} % off what is "
            f"desired. Contacts are corrected; tables, detents and clicks keep the scene's values.{steady}"
        )
    if CORRECTIONS[name].by_sensors:
        return _sensed_sentence(desired, name, prediction)
    if desired.remedies is None:
        off = f"{100.0 * desired.error:.1f} % off at most" if desired.error >= _SMALL else "less than 0.1 % off"
        off = off if math.isfinite(desired.error) else "not a spring and damper's at some of them"
        return (
            f"Correction {name}: over the masses of its span, what {desired.name} feels is {off}; the table is of the "
            f"middle of the span.{steady}"
        )
    off = f", {100.0 * desired.error:.1f} % off" if math.isfinite(desired.error) else ""
    return (
        f"[yellow]Correction {name} does not reach what is desired at {desired.name}[/yellow]: simulated is what comes "
        f"nearest{off}. {_what_would(desired.remedies, units)}"
    )


def _sensed_sentence(desired: Desired, name: str, prediction: Prediction) -> str:
    """Returns the errors of a correction that leaves the links their values, by mass, and when to take another."""
    felt = next(one for one in prediction.felt if one.name == desired.name)
    errors = errors_by_mass(felt, desired.k, desired.b)
    own, half, twice = (f"{100.0 * one:.2g} %" if math.isfinite(one) else "no spring and damper" for one in errors)
    sentence = (
        f"Correction {name}: what {desired.name} feels is {own} off what is desired; with half its mass {half}, with "
        f"twice {twice}."
    )
    if max(errors) <= GOOD:
        return sentence
    device, ahead_s = felt.configuration, felt.configuration.seen_ahead_s
    K, B = felt.stiffness * ahead_s**2 / device.mass, felt.damping * ahead_s / device.mass
    return (
        f"[yellow]{sentence}[/yellow] It suits scenes with a small K τ²/m and B τ/m; with τ = {duration(ahead_s)} "
        f"ahead they are {K:.2g} and {B:.2g} here. Take correction: predictor if the mass is known, or adaptive with a "
        "span of masses."
    )


def _what_would(remedies: Remedies, units: Units) -> str:
    friction = None if remedies.friction is None else units(remedies.friction, "N·s/m", 4)
    ways = (
        (remedies.rate_hz, "a rate of {:.4g} Hz or more, with a delay of as many samples"),
        (remedies.delay_samples, "a delay of {:.3g} samples or less"),
        (friction, "{} or more of real friction in place of simulated damping"),
        (remedies.predictor or None, "correction: predictor"),
    )
    if helpful := [text.format(value) for value, text in ways if value is not None]:
        return f"It is reached by {'; or '.join(helpful)}."
    return "No higher rate (up to 64 times), shorter delay, real friction or predictor alone makes it reachable."
