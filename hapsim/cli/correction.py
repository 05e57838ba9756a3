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
        out.print(_modes(prediction))
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
