"""Pictures over time: of a record, of a replay beside it, of the ring-down of a measured hand within the envelope that
was predicted for it, and of what the fit of a device leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED, UNSENT, WITHHELD
from hapsim.recording.trace import Trace
from hapsim.theory.arrays import Floats

if TYPE_CHECKING:
    from hapsim.measuring.identify_device import DeviceIdentification
    from hapsim.prediction import Felt
    from hapsim.replaying.replay import Comparison

_MOST_MARKS = 2000
_MARKS = (
    ("late", "|", LATE_FORCE, 0),
    ("never sent", "x", UNSENT, 0),
    ("withheld, zero sent", "o", WITHHELD, UNSENT),
    ("at its limit", "v", LIMITED, WITHHELD),
    ("positions lost before", "+", BRIDGED, 0),
)
"""Label, marker, and two flags of each mark: on rows with the first flag and without the second, more specific one."""


def seconds_of(trace: Trace) -> NDArray[np.float64]:
    """Returns (N,) s since arming by the device's count of samples, as `hapsim frames` and a run's sentences count."""
    return trace.sample / trace.rate


def marked_rows(trace: Trace) -> dict[str, NDArray[np.intp]]:
    """Returns the rows that are marked, by their label in the legend."""
    return {
        what: np.flatnonzero((trace.flags & flag != 0) & (trace.flags & unless == 0))
        for what, _, flag, unless in _MARKS
    }


def columns_of(trace: Trace) -> dict[str, NDArray[Any]]:
    """Returns the rows drawn, by the names in a data file; `arrived_s` is by the host's clock, since the first row."""
    columns: dict[str, NDArray[Any]] = {
        "time_s": seconds_of(trace),
        "sample": trace.sample,
        "arrived_s": (trace.time_ns - trace.time_ns[:1]) * 1e-9,
        "flags": trace.flags,
    }
    for c in range(trace.position_scale.size):
        columns |= {f"position_m[{c}]": trace.position[:, c], f"force_N[{c}]": trace.force[:, c]}
    return columns


def draw_trace(trace: Trace, title: str, path: Path) -> None:
    """Draws it to a file (.svg, .png or .pdf), with a mark where a force was late, limited, withheld or never sent; in
    the plane with the path of each hand beside it."""
    time, hands = seconds_of(trace), trace.report.in_plane
    with figure_to(path, 13.0 if hands else 8.0, 5.2) as figure:
        beside = ["path"] if hands else []
        axes_of = figure.subplot_mosaic(
            [["upper", *beside], ["lower", *beside]], width_ratios=[8.0, 5.0][: 1 + len(beside)]
        )
        upper, lower = axes_of["upper"], axes_of["lower"]
        upper.sharex(lower)
        upper.tick_params(labelbottom=False)
        units = drawn_in()
        position, force = units.scaled(trace.position, "mm"), units.scaled(trace.force, "N")
        labels = f"position ({units.name('mm')})", f"force ({units.name('N')})"
        for axes, values, label in zip((upper, lower), (position, force), labels, strict=True):
            for c in range(values.shape[1]):
                axes.plot(time, values[:, c], linewidth=1.0, label=f"channel {c}")
            axes.set_ylabel(label)
            axes.margins(x=0.01)
        for (what, marker, *_), marked in zip(_MARKS, marked_rows(trace).values(), strict=True):
            drawn = marked[:: max(1, marked.size // _MOST_MARKS)]
            if marked.size:
                lower.plot(time[drawn], force[drawn, 0], marker, label=f"{what}: {marked.size}", **style.MARK)
        for axes in (upper, lower):
            draw_zero_if_near(axes)
        lower.set_xlabel(f"time since arming (s): sample number / {trace.rate:g} Hz")
        lower.ticklabel_format(axis="x", style="plain", useOffset=False)  # each number can be compared as it is
        upper.set_title(title, fontsize=9)
        if hands:
            _draw_paths(axes_of["path"], position, hands)
        legend_below(figure, 4)


def _draw_paths(axes: Axes, position: Floats, hands: Sequence[tuple[int, int]]) -> None:
    """Draws the path of each hand in the plane, and a mark where it begins. `position`: as the axis shows it."""
    for hand, (x, y) in enumerate(hands, position.shape[1]):
        axes.plot(position[:, x], position[:, y], f"C{hand}", linewidth=1.0, label=f"path of channels {x} and {y}")
        axes.plot(position[:1, x], position[:1, y], **style.PLACE)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"x ({drawn_in().name('mm')})")
    axes.set_ylabel(f"y ({drawn_in().name('mm')})")


def draw_zero_if_near(axes: Axes) -> None:
    """Draws a line at zero where the data come near it; elsewhere the axis would show little else."""
    low, high = axes.get_ylim()
    if low <= 0.0 <= high:
        axes.axhline(0.0, **style.ZERO_LINE)


def replay_columns(found: Comparison) -> dict[str, NDArray[Any]]:
    """Returns what is drawn, row by row, by the names that a data file uses."""
    columns: dict[str, NDArray[Any]] = {"time_s": found.time_s}
    for c in range(found.position.shape[1]):
        columns[f"position_m[{c}]"] = found.position[:, c]
        columns[f"recorded_force_N[{c}]"] = found.recorded[:, c]
        columns[f"replayed_force_N[{c}]"] = found.replayed[:, c]
    return columns


def draw_replay(found: Comparison, title: str, path: Path) -> None:
    """Draws it to a file (.svg, .png or .pdf)."""
    with figure_to(path, 8.0, 5.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        units = drawn_in()
        recorded, replayed = units.scaled(found.recorded, "N"), units.scaled(found.replayed, "N")
        for c in range(found.position.shape[1]):
            of = f" of channel {c}" if found.position.shape[1] > 1 else ""
            upper.plot(found.time_s, units.scaled(found.position[:, c], "mm"), linewidth=1.0, color=f"C{c}")
            lower.plot(found.time_s, recorded[:, c], linewidth=2.2, alpha=0.4, color=f"C{c}", label=f"recorded{of}")
            lower.plot(found.time_s, replayed[:, c], linewidth=0.9, color=f"C{c}", label=f"replayed{of}")
        upper.set_ylabel(f"position ({units.name('mm')})")
        lower.set_ylabel(f"force ({units.name('N')})")
        lower.set_xlabel("time since arming (s)")
        for axes in (upper, lower):
            axes.margins(x=0.01)
            draw_zero_if_near(axes)
        upper.set_title(title, fontsize=9)
        legend_below(figure, 4)


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
    added = (trace.force - trace.asked_force)[:, channel]
    pushed = np.abs(added - np.median(added) if led else added) > _PUSH
    edges = np.flatnonzero(np.diff(~pushed, prepend=False, append=False)).reshape(-1, 2)
    free = [(int(first), int(last)) for first, last in edges if first or last > _SHORTEST]
    return free[0] if free else (pushed.size, pushed.size)


def draw_ring_down(columns: dict[str, Floats], felt: Felt, measured: tuple[float, float], path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf. `measured`: k in N/m and b in N·s/m."""
    from hapsim.chart.hand import described

    names = ("time_s", "position_m", "predicted_envelope_m", "rest_position_m")
    time, position, envelope, rest = (columns[name] for name in names)
    with figure_to(path, 8.0, 4.6) as figure:
        axes, units = figure.add_subplot(), drawn_in()
        if np.isfinite(envelope).all():
            label = f"predicted envelope: k = {units(felt.k, 'N/m', '.5g')}, b = {units(felt.b, 'N·s/m', '.4g')}"
            axes.plot(time, units.scaled(rest + envelope, "mm"), label=label, **style.ENVELOPE)
            axes.plot(time, units.scaled(rest - envelope, "mm"), **style.ENVELOPE)
        label = f"measured: k = {units(measured[0], 'N/m', '.5g')}, b = {units(measured[1], 'N·s/m', '.4g')}"
        axes.plot(time, units.scaled(position, "mm"), "o-" if time.size < 200 else "-", label=label, **style.MOTION)
        middle = float(rest[0]) if rest.size and np.isfinite(rest[0]) else 0.0
        axes.axhline(units.scaled(middle, "mm"), **style.ZERO_LINE)
        axes.set_xlabel("time (s)")
        axes.set_ylabel(f"position of the hand ({units.name('mm')}), at rest at {units(middle, 'mm', 4)}")
        simulated = f"{felt.name}: K = {units(felt.stiffness, 'N/m', '.5g')}, B = {units(felt.damping, 'N·s/m', '.4g')}"
        axes.set_title(f"{simulated}; {described(felt.configuration)}", fontsize=9)
        axes.margins(x=0.01)
        legend_below(figure, 2)


_MOST_POINTS = 20000  # of a picture; its data have all


def residual_columns(found: DeviceIdentification) -> dict[str, Floats]:
    """Returns the rows that the fit used: run, time, position, position residual; and in the rows in the middle of a
    window (NaN elsewhere) the velocity and the force that the model lacks there."""
    motions, lacking = found.motions, found.force_residual
    starts = np.cumsum([0, *(motion.position.size for motion in motions)])
    rows = int(starts[-1])
    run = np.repeat(np.arange(len(motions)), np.diff(starts))
    left, velocity, force = (np.full(rows, np.nan) for _ in range(3))
    for swing, error in zip(found.swings, found.residuals, strict=True):
        first = starts[swing.motion] + swing.first
        left[first : first + swing.rows] = error * found.count_m
    window = starts[lacking.motion] + lacking.row
    velocity[window], force[window] = lacking.velocity, lacking.force
    columns = {
        "run": run.astype(float),
        "time_s": (np.arange(rows) - starts[run]) / found.rate_hz,
        "position_m": np.concatenate([motion.position for motion in motions]) * found.count_m,
        "position_residual_m": left,
        "velocity_m_s": velocity,
        "force_residual_N": force,
    }
    used = np.isfinite(left)
    return {name: column[used] for name, column in columns.items()}


def draw_device_residual(found: DeviceIdentification, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    lacking = found.force_residual
    with figure_to(path, 9.0, 6.4) as figure:
        panels = figure.subplot_mosaic([["time", "time"], ["velocity", "position"]])
        _draw_over_time(panels["time"], found)
        size = float(np.max(np.abs(lacking.force), initial=0.0))
        unit, units = "N" if size > 0.5 else "mN" if size > 5e-4 else "µN", drawn_in()
        force, noise = units.scaled(lacking.force, unit), units.scaled(lacking.noise, unit)
        _draw_forces(panels["velocity"], units.scaled(lacking.velocity, "m/s"), force, noise)
        _draw_forces(panels["position"], units.scaled(lacking.position, "mm"), force, noise)
        panels["velocity"].set_xlabel(f"velocity ({units.name('m/s')})")
        panels["position"].set_xlabel(f"position relative to the start ({units.name('mm')})")
        panels["velocity"].set_ylabel(f"missing force ({units.name(unit)})")
        panels["position"].sharey(panels["velocity"])
        legend_below(figure, 3)
        figure.suptitle(_title(found), fontsize=9)


def _draw_over_time(axes: Axes, found: DeviceIdentification) -> None:
    """Draws the position residuals, each run behind the one before."""
    columns = residual_columns(found)
    begins = np.cumsum([0.0, *(motion.position.size / found.rate_hz for motion in found.motions)])
    time = columns["time_s"] + begins[columns["run"].astype(int)]
    some = slice(None, None, max(1, time.size // _MOST_POINTS))
    unit, units = "µm" if found.residual_m > 2e-8 else "nm", drawn_in()
    axes.plot(time[some], units.scaled(columns["position_residual_m"][some], unit), markersize=1.5, **style.RESIDUAL)
    axes.axhline(0.0, **style.ZERO_LINE)
    axes.set_xlim(0.0, float(begins[-1]))
    top = axes.get_ylim()[1]
    for begin, drive in zip(begins, found.drives, strict=False):
        axes.axvline(float(begin), linestyle=":", **style.ZERO_LINE)
        words = f" K = {units(drive.stiffness, 'N/m', '.3g')}\n B = {units(drive.damping, 'N·s/m', '.2g')}"
        axes.annotate(words, (float(begin), top), ha="left", va="bottom", fontsize=8)
    axes.set_xlabel("time (s), runs in sequence")
    axes.set_ylabel(f"position residual ({units.name(unit)})")


def _draw_forces(axes: Axes, along: Floats, force: Floats, noise: float) -> None:
    """Draws the force that the model lacks in each window, and its mean over the velocity or the position."""
    from hapsim.measuring.device_diagnosis import BINS, binned

    axes.plot(along, force, markersize=2.5, label="one window", **style.RESIDUAL)
    axes.axhspan(-2.0 * noise, 2.0 * noise, color="0.9", zorder=0, label="95 % of noise and rounding")
    if force.size >= 4 * BINS:
        _, middles, means = binned(along, force)
        axes.plot(middles, means, label="mean of each twelfth", **style.MEAN)
    axes.axhline(0.0, **style.ZERO_LINE)


def _title(found: DeviceIdentification) -> str:
    named = (
        ("mass", found.mass, "kg"),
        ("friction", found.friction, "N·s/m"),
        ("stiffness", found.stiffness, "N/m"),
        ("delay", found.delay, "samples"),
        ("dry friction", found.coulomb, "N"),
    )
    units, words = drawn_in(), []
    for name, one, unit in named:
        value = units.rounded(one.value, one.uncertainty, unit)
        words.append(f"{name} {value} ± {units(one.uncertainty, unit, 1)}")
    return f"{', '.join(words[:3])},\n{', '.join(words[3:])}"
