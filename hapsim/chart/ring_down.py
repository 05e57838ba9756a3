"""The ring-down of a measured hand, within the envelope that was predicted for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.hand import described
from hapsim.prediction import Felt
from hapsim.recording.trace import Trace

_PUSH = 1e-6  # N beyond what the scene asks: a push, not the rounding of the force
_SHORTEST = 16  # samples of a free motion
_DECAYS = 6.0  # time constants that are worth drawing

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RingDown:
    """(N,) samples of one ring-down, SI units."""

    time: Floats
    position: Floats
    envelope: Floats
    """Predicted; one number, fitted to the motion, scales it. NaN if no spring and damper is equivalent."""
    predicted: Floats
    """The predicted motion, its size and phase fitted to the measured one."""

    def columns(self) -> dict[str, Floats]:
        """Returns what is drawn, by the names that a data file uses."""
        return {
            "time_s": self.time,
            "position_m": self.position,
            "predicted_position_m": self.predicted,
            "predicted_envelope_m": self.envelope,
        }


def ring_down(trace: Trace, felt: Felt) -> RingDown:
    """Returns the first free motion in a trace, beside the predicted one."""
    first, last = _first_free_motion(trace, felt.channel)
    poles = felt.configuration.dominant_poles(felt.stiffness, felt.damping)
    decay = -float(np.log(np.max(np.abs(poles))))
    if decay > 0.0:  # not NaN
        last = min(last, first + max(_SHORTEST, int(_DECAYS / decay)))
    y = trace.position[first:last, felt.channel]
    n = np.arange(y.size)
    if not np.isfinite(poles).all():
        return RingDown(n / trace.rate, y, np.full(y.size, np.nan), np.full(y.size, np.nan))
    modes = poles[:, None] ** n
    basis = np.column_stack([modes[0].real, modes[0].imag if poles[0].imag else modes[1].real])
    size, *_ = np.linalg.lstsq(basis, y, rcond=None)
    motion = basis @ size
    envelope = np.hypot(*size) * np.abs(modes[0]) if poles[0].imag else np.abs(motion)
    return RingDown(n / trace.rate, y, envelope, motion)


def _first_free_motion(trace: Trace, channel: int) -> tuple[int, int]:
    """Returns the rows from the first motion on until the next push."""
    pushed = np.abs(trace.force - trace.asked_force)[:, channel] > _PUSH
    if not pushed.any():
        return 0, pushed.size
    if (until := int(np.argmax(pushed))) > _SHORTEST:
        return 0, until
    ends = np.flatnonzero(pushed[:-1] & ~pushed[1:]) + 1
    first = int(ends[0]) if ends.size else pushed.size
    again = np.flatnonzero(pushed[first:])
    return first, first + int(again[0]) if again.size else pushed.size


def draw_ring_down(data: RingDown, felt: Felt, measured: tuple[float, float], path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf. `measured`: k in N/m and b in N·s/m."""
    with figure_to(path, 8.0, 4.6) as figure:
        axes = figure.add_subplot()
        if np.isfinite(data.envelope).all():
            label = f"predicted envelope: k = {felt.k:.5g} N/m, b = {felt.b:.4g} N·s/m"
            axes.plot(data.time, 1e3 * data.envelope, label=label, **style.ENVELOPE)
            axes.plot(data.time, -1e3 * data.envelope, **style.ENVELOPE)
        label = f"measured: k = {measured[0]:.5g} N/m, b = {measured[1]:.4g} N·s/m"
        axes.plot(data.time, 1e3 * data.position, "o-" if data.time.size < 200 else "-", label=label, **style.MOTION)
        axes.axhline(0.0, **style.ZERO_LINE)
        axes.set_xlabel("time (s)")
        axes.set_ylabel("position of the hand (mm)")
        simulated = f"{felt.name}: K = {felt.stiffness:.5g} N/m, B = {felt.damping:.4g} N·s/m"
        axes.set_title(f"{simulated}; {described(felt.configuration)}", fontsize=9)
        axes.margins(x=0.01)
        legend_below(figure, 2)
