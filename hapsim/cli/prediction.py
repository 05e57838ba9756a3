"""What `hapsim check` tells: stability, what the hand feels, margins, modes, the wire, and what bounds the force."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapsim.cli.correction import show_correction
from hapsim.cli.wire import show_silence, show_wire, slew_warnings
from hapsim.holds import HOLDS
from hapsim.number_format import between, duration, rounded_down, rounded_up
from hapsim.prediction import Desired, Felt, Prediction, Robustness, correction_for, robustness_of
from hapsim.theory import Mode

if TYPE_CHECKING:
    from hapsim.prediction.predict import LinkMargin
    from hapsim.scene import Scene

_NO_FACTOR, _UNKNOWN = "–", "?"
_MARGINAL = 1e-9  # of the spectral radius: a free motion, which rounding places on either side of 1


def show_prediction(out: Console, name: str, scene: Scene, prediction: Prediction, on_wire: Prediction | None) -> None:
    """What `hapsim check` tells. `on_wire`: as `predict_on_wire` gave it."""
    held_back = bool(slew_warnings(scene, prediction))
    title, verdict = f"[bold]{escape(name)}[/bold]", f"at {prediction.rate:g} Hz: {_stability(prediction, held_back)}"
    if len(name) < out.width:
        out.print(title, verdict)
    else:
        out.print(title, soft_wrap=True)  # a path stays whole: it is to be copied
        out.print(verdict)
    out.print(_predicted_for(scene))
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
    late = (
        f"{device.delay:g} {samples} ({duration(device.delay * scene.period)}) of delay" if device.delay else "no delay"
    )
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


def _margin(felt: Felt, in_table: bool) -> str:
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


def number(value: float, digits: int = 6) -> str:
    return f"{value + 0.0:.{digits}g}" if math.isfinite(value) else "–"  # + 0.0: no minus before a zero
