"""The ring-down of a measured hand, with the envelope that was predicted for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hapsim.chart.figure import save_figure
from hapsim.chart.hand import described
from hapsim.prediction import Felt
from hapsim.recording.trace import Trace

_PUSH = 1e-6  # N beyond what the scene asks: a push, not the rounding of the force
_DECAYS = 6.0  # time constants that are worth drawing


@dataclass(frozen=True)
class RingDown:
    """N samples of one ring-down, SI units."""

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    envelope: NDArray[np.float64]
    """Predicted; scaled to the motion by one number, its size at the beginning."""
    predicted: NDArray[np.float64]
    """The predicted motion itself, its size and phase fitted to the measured one."""

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """What is drawn, by the names that a data file uses."""
        return {
            "time_s": self.time,
            "position_m": self.position,
            "predicted_position_m": self.predicted,
            "predicted_envelope_m": self.envelope,
        }


def ring_down(trace: Trace, felt: Felt) -> RingDown:
    """The first free motion in a trace, beside the one predicted for it."""
    position = trace.position[:, felt.channel]
    first, last = _first_free_motion(trace, felt.channel)
    poles = felt.configuration.dominant_poles(felt.stiffness, felt.damping)
    if np.all(np.isfinite(poles)):
        decay = -np.log(np.max(np.abs(poles)))
        if decay > 0:
            last = min(last, first + max(16, int(_DECAYS / decay)))
    y = position[first:last]
    n = np.arange(y.size)
    predicted, envelope = _fitted(y, n, poles)
    return RingDown(n / trace.rate, y, envelope, predicted)


def _fitted(
    y: NDArray[np.float64], n: NDArray[np.int64], poles: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(motion, envelope) of the predicted poles with the size that fits y best; NaN where there are none."""
    if not np.all(np.isfinite(poles)):
        return np.full(y.size, np.nan), np.full(y.size, np.nan)
    modes = poles[:, None] ** n
    basis = np.column_stack([modes[0].real, modes[0].imag if poles[0].imag else modes[1].real])
    size, *_ = np.linalg.lstsq(basis, y, rcond=None)
    motion = basis @ size
    envelope = np.hypot(*size) * np.abs(modes[0]) if poles[0].imag else np.abs(motion)
    return motion, envelope


def _first_free_motion(trace: Trace, channel: int) -> tuple[int, int]:
    """From the first motion on until the next push."""
    pushed = np.flatnonzero(np.abs(trace.force - trace.asked_force)[:, channel] > _PUSH)
    if pushed.size == 0:
        return 0, trace.sample.size
    if pushed[0] > 16:
        return 0, int(pushed[0])
    ends = np.flatnonzero(np.diff(pushed) > 1)
    first = int(pushed[ends[0]] if ends.size else pushed[-1]) + 1
    return first, int(pushed[ends[0] + 1]) if ends.size else trace.sample.size


def draw_ring_down(data: RingDown, felt: Felt, measured: tuple[float, float], path: Path) -> None:
    """Draws it. `measured`: k in N/m and b in N·s/m. The ending of `path` chooses SVG, PNG or PDF."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    milli = 1e3
    if np.all(np.isfinite(data.envelope)):
        label = f"predicted envelope: k = {felt.k:.5g} N/m, b = {felt.b:.4g} N·s/m"
        axes.plot(data.time, milli * data.envelope, "--", color="black", linewidth=1.4, label=label)
        axes.plot(data.time, -milli * data.envelope, "--", color="black", linewidth=1.4)
    label = f"measured: k = {measured[0]:.5g} N/m, b = {measured[1]:.4g} N·s/m"
    few = data.time.size < 200
    axes.plot(data.time, milli * data.position, "o-" if few else "-", ms=3, color="0.45", lw=1.2, label=label)
    axes.axhline(0.0, color="black", linewidth=0.5)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("position of the hand (mm)")
    simulated = f"{felt.name}: K = {felt.stiffness:.5g} N/m, B = {felt.damping:.4g} N·s/m"
    axes.set_title(f"{simulated}; {described(felt.configuration)}", fontsize=9)
    figure.legend(
        loc="outside lower left", ncols=2, frameon=False, fontsize=9
    )  # a ring that grows leaves no room inside
    axes.margins(x=0.01)
    save_figure(figure, path)
