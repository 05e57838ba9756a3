"""The ring-down of a measured hand, within the envelope that was predicted for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.hand import described
from hapsim.number_format import number
from hapsim.prediction import Felt
from hapsim.recording.trace import Trace
from hapsim.theory.arrays import Floats

_PUSH = 1e-6  # N beyond what the scene asks: a push, not the rounding of the force
_SHORTEST = 16  # samples of a free motion
_DECAYS = 6.0  # time constants that are worth drawing


def ring_down(trace: Trace, felt: Felt, *, led: bool = False) -> dict[str, Floats]:
    """Returns the first free motion in a trace beside the predicted one, (N,) columns by the names that a data file
    uses. The predicted motion has its size, phase and rest fitted to the measured one, the envelope its size about that
    rest. All are NaN if no spring and damper is equivalent."""
    first, last = _first_free_motion(trace, felt.channel, led)
    poles = felt.configuration.dominant_poles(felt.stiffness, felt.damping)
    decay = -float(np.log(np.max(np.abs(poles))))
    if decay > 0.0:  # not NaN
        last = min(last, first + max(_SHORTEST, int(_DECAYS / decay)))
    y = trace.position[first:last, felt.channel]
    n = np.arange(y.size)
    motion = envelope = rest = np.full(y.size, np.nan)
    if np.isfinite(poles).all():
        modes = poles[:, None] ** n
        basis = np.column_stack([modes[0].real, modes[0].imag if poles[0].imag else modes[1].real])
        *size, middle = np.linalg.lstsq(np.column_stack([basis, np.ones(n.size)]), y, rcond=None)[0]
        rest = np.full(y.size, middle)
        motion = basis @ size
        envelope = np.hypot(*size) * np.abs(modes[0]) if poles[0].imag else np.abs(motion)
        motion = motion + rest
    return {
        "time_s": n / trace.rate,
        "position_m": y,
        "predicted_position_m": motion,
        "predicted_envelope_m": envelope,
        "rest_position_m": rest,
    }


def _first_free_motion(trace: Trace, channel: int, led: bool) -> tuple[int, int]:
    """Returns the rows up to the first push, or if it comes at once, those up to the next one. A hand that was `led`
    to a place is held there by a constant force, which is no push."""
    beside = (trace.force - trace.asked_force)[:, channel]
    pushed = np.abs(beside - np.median(beside) if led else beside) > _PUSH
    edges = np.flatnonzero(np.diff(~pushed, prepend=False, append=False)).reshape(-1, 2)
    free = [(int(first), int(last)) for first, last in edges if first or last > _SHORTEST]
    return free[0] if free else (pushed.size, pushed.size)


def draw_ring_down(columns: dict[str, Floats], felt: Felt, measured: tuple[float, float], path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf. `measured`: k in N/m and b in N·s/m."""
    names = ("time_s", "position_m", "predicted_envelope_m", "rest_position_m")
    time, position, envelope, rest = (columns[name] for name in names)
    with figure_to(path, 8.0, 4.6) as figure:
        axes = figure.add_subplot()
        if np.isfinite(envelope).all():
            label = f"predicted envelope: k = {felt.k:.5g} N/m, b = {felt.b:.4g} N·s/m"
            axes.plot(time, 1e3 * (rest + envelope), label=label, **style.ENVELOPE)
            axes.plot(time, 1e3 * (rest - envelope), **style.ENVELOPE)
        label = f"measured: k = {measured[0]:.5g} N/m, b = {measured[1]:.4g} N·s/m"
        axes.plot(time, 1e3 * position, "o-" if time.size < 200 else "-", label=label, **style.MOTION)
        middle = 1e3 * rest[0] if rest.size and np.isfinite(rest[0]) else 0.0
        axes.axhline(middle, **style.ZERO_LINE)
        axes.set_xlabel("time (s)")
        axes.set_ylabel(f"position of the hand (mm), at rest at {number(middle, 4)} mm")
        simulated = f"{felt.name}: K = {felt.stiffness:.5g} N/m, B = {felt.damping:.4g} N·s/m"
        axes.set_title(f"{simulated}; {described(felt.configuration)}", fontsize=9)
        axes.margins(x=0.01)
        legend_below(figure, 2)
