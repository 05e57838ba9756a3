"""What a correction does, and what it cannot do, as `hapsim check` tells it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from hapsim.prediction import Desired, Prediction
    from hapsim.prediction.correction import Remedies

_EXACT = 1e-6  # errors below are none to anybody
_ROWS = 12


def show_correction(out: Console, prediction: Prediction) -> None:
    """Nothing, without a correction."""
    rendering = prediction.rendering
    if rendering is None or rendering.kind is None:
        return
    for desired in prediction.desired:
        out.print(_reached(desired, rendering.kind.name))
        out.print(_masses(desired))
    if prediction.coupled and prediction.desired_modes:
        out.print()
        out.print(_modes(prediction))
    for note in rendering.notes:
        out.print(f"[yellow]Not corrected:[/yellow] {escape(note)}.")


def _reached(desired: Desired, name: str) -> str:
    if desired.error < _EXACT:
        return f"Correction {name}: {desired.name} feels what is desired."
    if desired.remedies is None:
        off = f"off by {desired.error:.1%} at most" if math.isfinite(desired.error) else "far off at some of them"
        return f"Correction {name}: over the masses that it may have, {desired.name} feels what is desired, {off}."
    off = f", off by {desired.error:.1%}" if math.isfinite(desired.error) else ""
    return (
        f"[yellow]Correction {name} does not reach what is desired at {desired.name}[/yellow]: simulated is what comes "
        f"nearest{off}. {_what_would(desired.remedies)}"
    )


def _what_would(remedies: Remedies) -> str:
    ways = []
    if remedies.rate_hz is not None:
        ways.append(f"a rate of {remedies.rate_hz:.4g} Hz or more")
    if remedies.delay_samples is not None:
        ways.append(f"a delay of {remedies.delay_samples:.3g} samples or less")
    if remedies.friction is not None:
        ways.append(f"{remedies.friction:.4g} N·s/m or more of real friction in place of simulated damping")
    if remedies.predictor:
        ways.append("correction: predictor")
    if not ways:
        return "No higher rate (up to 64 times), shorter delay, real friction or predictor alone makes it reachable."
    return f"It is reached by {'; or '.join(ways)}."


def _masses(desired: Desired) -> str:
    least, most = desired.stable_masses
    if math.isnan(least):
        return "The loop is stable at no mass near the declared one."
    if least == 0.0 and math.isinf(most):
        return "It stays stable from a thirtieth of the mass to thirty times it."
    low = "less than a thirtieth" if least == 0.0 else f"{least:.3g} kg"
    return f"It stays stable for a mass from {low} to {'thirty times it' if math.isinf(most) else f'{most:.3g} kg'}."


def _modes(prediction: Prediction) -> Table:
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
