"""Impedances over frequency: desired and rendered (Florens et al., Figure 2), and measured over both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.errors import UsageError
from hapsim.prediction import Prediction
from hapsim.prediction.predict_impedance import PredictedImpedance, predict_impedance
from hapsim.scene import Scene
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network.impedance import spring_and_damper

if TYPE_CHECKING:
    from hapsim.measuring.measure_impedance import MeasuredImpedance

_POINTS = 400
_MOST_IN_A_MATRIX = 6
_BELOW_EIGENFREQUENCY, _BELOW_NYQUIST = 20.0, 1000.0  # where the picture begins; the second if nothing swings
_POINTS_OF_TRANSPARENCY = 1200
AGREES = 0.05
"""Share of the felt impedance by which what is rendered may differ from it, to agree with it."""
_DRIFTS = 1e-6  # of the rate: what swings more slowly drifts
_SHARP = 0.3  # damping ratio of a resonance that points some hundredths apart would miss
_ABOUT = np.array([-10.0, -3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0, 10.0])  # of its damping ratio


class Measured(NamedTuple):
    """A measured impedance (n,) in N·s/m at frequencies in Hz, with the radii of its circles."""

    frequency: Floats
    value: Complexes
    uncertainty: Floats


class Curves(NamedTuple):
    """One impedance at frequencies (n,) in Hz, N·s/m."""

    frequency: Floats
    desired: Complexes
    rendered: Complexes
    measured: Measured | None = None
    felt: Complexes | None = None


def phase(impedance: Complexes) -> Floats:
    """Returns degrees, followed from the lowest frequency on: the phase of a late force goes on turning."""
    return np.asarray(np.degrees(np.unwrap(np.angle(impedance))))


def draw_sizes(axes: Axes, curves: Curves) -> None:
    """Draws the size, on a logarithmic scale unless all of it is zero."""
    _set_up(axes)
    sizes = np.abs([curves.desired, curves.rendered])
    axes.plot(curves.frequency, sizes[0], label="desired", **style.DESIRED)
    if curves.felt is not None and np.isfinite(curves.felt).all():
        axes.plot(curves.frequency, np.abs(curves.felt), label="felt: the real spring and damper", **style.FELT)
    predicted = "rendered" if curves.measured is None else "predicted"
    axes.plot(curves.frequency, sizes[1], label=predicted, **style.RENDERED)
    if sizes.any():
        axes.set_yscale("log")
    if curves.measured is not None:
        found = curves.measured
        label = "measured, 99.9 % for all together"
        axes.errorbar(found.frequency, np.abs(found.value), found.uncertainty, label=label, **style.MEASURED)
        if sizes.any():  # a circle that reaches down to 0 would squeeze all else
            axes.set_ylim(0.5 * float(np.min(sizes[sizes > 0.0])), 2.0 * float(np.max(sizes)))


def draw_phases(axes: Axes, curves: Curves) -> None:
    """Draws the phase, and shades what lies outside of -90 to 90 degrees, where the scene gives the hand energy."""
    _set_up(axes)
    axes.set_xlabel("frequency  (Hz)")
    desired, rendered = phase(curves.desired), phase(curves.rendered)
    axes.plot(curves.frequency, desired, **style.DESIRED)
    if curves.felt is not None:
        axes.plot(curves.frequency, phase(curves.felt), **style.FELT)
    axes.plot(curves.frequency, rendered, **style.RENDERED)
    if curves.measured is not None:
        found = curves.measured
        near = np.interp(found.frequency, curves.frequency, rendered)  # on this turn
        at = near + np.degrees(np.angle(found.value * np.exp(-1j * np.radians(near))))
        radius = np.degrees(np.arcsin(np.minimum(1.0, found.uncertainty / np.abs(found.value))))
        axes.errorbar(found.frequency, at, radius, **style.MEASURED)
    low = 45.0 * math.floor(min(-90.0, np.min(desired), np.min(rendered)) / 45.0 - 0.2)
    high = 45.0 * math.ceil(max(0.0, np.max(desired), np.max(rendered)) / 45.0 + 0.2)
    axes.yaxis.set_major_locator(MultipleLocator(90.0 if high - low <= 900.0 else 360.0))
    # A phase that goes on turning comes back into the band, a turn further down.
    for centre in 360.0 * np.arange(math.floor((low + 90.0) / 360.0), 2):
        ends = max(low, centre - 270.0), min(high, centre - 90.0)
        axes.axhspan(*ends, label="outside of −90° to 90°: the scene gives energy", **style.NOT_PASSIVE)
    axes.set_ylim(low, high)


def _set_up(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.margins(x=0.02)
    axes.grid()


def columns(predicted: PredictedImpedance, measured: MeasuredImpedance) -> dict[str, list[Any]]:
    """Returns every number, a row for each frequency and each pair of device points, forces before velocities."""
    at = list(np.ndindex(*predicted.desired.shape))
    found: dict[str, list[Any]] = {
        "frequency_Hz": [predicted.frequency[k] for k, _, _ in at],
        "force_at": [predicted.names[i] for _, i, _ in at],
        "velocity_at": [predicted.names[j] for _, _, j in at],
    }

    def add(name: str, values: Complexes) -> None:
        found[f"{name}_re_Ns_per_m"] = values.real.ravel().tolist()
        found[f"{name}_im_Ns_per_m"] = values.imag.ravel().tolist()

    add("desired", predicted.desired)
    for name in ("device", "rendered", "closed_loop"):
        circles = getattr(measured, name)
        add(f"{name}_predicted", getattr(predicted, name))
        add(f"{name}_measured", circles.value)
        found[f"{name}_uncertainty_Ns_per_m"] = circles.uncertainty.ravel().tolist()
    return found


def draw_impedance(
    scene: Scene, predicted: PredictedImpedance, measured: MeasuredImpedance, place: int | None, path: Path
) -> None:
    """Draws size and phase at the device point at ``place``, rendered and in the closed loop; without a ``place``, for
    several device points, the sizes of the whole rendered matrix. The ending of `path` is .svg, .png or .pdf."""
    frequency = np.geomspace(predicted.frequency[0], predicted.frequency[-1], _POINTS)
    dense = predict_impedance(scene, frequency, as_read=True)
    draw = _draw_matrix if place is None and 1 < len(predicted.names) <= _MOST_IN_A_MATRIX else _draw_one
    draw(dense, measured, place or 0, path)


def _draw_one(dense: PredictedImpedance, measured: MeasuredImpedance, i: int, path: Path) -> None:
    titles = {"rendered": "rendered by the scene", "closed_loop": "closed loop, the device with it"}
    with figure_to(path, 9.5, 5.8) as figure:
        panels = figure.subplots(2, 2, sharex=True, height_ratios=[1.15, 1.0])
        figure.suptitle(f"Impedance at {dense.names[i]}, channel {measured.channels[i]}")
        for (name, title), (upper, lower) in zip(titles.items(), panels.T, strict=True):
            curves = _curves(name, dense, measured, (i, i))
            upper.set_title(title)
            draw_sizes(upper, curves)
            draw_phases(lower, curves)
        panels[0, 0].set_ylabel(f"|force / velocity|  ({drawn_in().name('N·s/m')})")
        panels[1, 0].set_ylabel("phase  (degrees)")
        legend_below(figure, 2, handlelength=2.6)


def _draw_matrix(dense: PredictedImpedance, measured: MeasuredImpedance, _: int, path: Path) -> None:
    names = dense.names
    with figure_to(path, 1.5 + 2.9 * len(names), 1.4 + 2.3 * len(names)) as figure:
        panels = figure.subplots(len(names), len(names), sharex=True)
        figure.suptitle(f"Rendered impedance  ({drawn_in().name('N·s/m')})")
        for i, j in np.ndindex(len(names), len(names)):
            axes: Any = panels[i, j]
            axes.set_title(f"force at {names[i]}, velocity at {names[j]}")
            draw_sizes(axes, _curves("rendered", dense, measured, (i, j)))
        for axes in panels[-1]:
            axes.set_xlabel("frequency  (Hz)")
        legend_below(figure, 2, handlelength=2.6)


def _curves(name: str, dense: PredictedImpedance, measured: MeasuredImpedance, at: tuple[int, int]) -> Curves:
    here, circles = (slice(None), *at), getattr(measured, name)
    desired = dense.desired[here] + (dense.ideal_device[here] if name == "closed_loop" else 0.0)
    found = Measured(measured.frequency, _shown(circles.value[here]), _shown(circles.uncertainty[here]))
    return Curves(dense.frequency, _shown(desired), _shown(getattr(dense, name)[here]), found)


def _shown(impedance: Any) -> Any:
    """Returns an impedance in the unit of the figure that is drawn."""
    return drawn_in().scaled(impedance, "N·s/m")


@dataclass(frozen=True)
class Transparency:
    """Force over velocity of one hand, N·s/m (n,), defined as by `hapsim measure --impedance`: desired is the scene's
    continuous impedance, rendered what the sampled, held and late loop presents at the device, felt the real spring and
    damper of the hand's own motion (the extended transparency of Florens et al., §2.2), the others being held. The
    device's own mass, friction and spring are in none of them."""

    rate: float  # Hz
    frequency: Floats  # Hz, (n,), up to just below the Nyquist frequency
    desired: Complexes
    rendered: Complexes
    felt: Complexes
    """NaN if no spring and damper is equivalent."""
    eigenfrequency: float
    """Hz, of the hand on what it feels; NaN if no spring and damper is equivalent."""

    def columns(self) -> dict[str, Floats]:
        """Returns what is drawn, by the names that a data file uses."""
        found = {"frequency_Hz": self.frequency}
        for name in ("desired", "rendered", "felt"):
            impedance = getattr(self, name)
            k, b = spring_and_damper(self.frequency, impedance)
            found |= {f"{name}_Ns_per_m": np.abs(impedance), f"{name}_phase_deg": phase(impedance)}
            found |= {f"{name}_k_N_per_m": k, f"{name}_b_Ns_per_m": b}
        return found

    def active_bands_hz(self) -> list[tuple[float, float]]:
        """Returns bands (from, to) in Hz in which the scene gives the hand energy instead of taking it: Re Z < 0."""
        return self._bands_below_zero(self.rendered.real)

    def agreeing_bands_hz(self) -> list[tuple[float, float]]:
        """Returns bands (from, to) in Hz in which what is rendered is the real spring and damper to within `AGREES`."""
        return self._bands_below_zero(np.abs(self.rendered - self.felt) - AGREES * np.abs(self.felt))

    def _bands_below_zero(self, values: Floats) -> list[tuple[float, float]]:
        # Between two frequencies the values are nearly straight.
        f, step = self.frequency, np.diff(values)
        edges = np.flatnonzero(np.diff(values < 0.0, prepend=False, append=False))
        crossings = f[:-1] - values[:-1] * np.diff(f) / np.where(step == 0.0, 1.0, step)
        at = np.concatenate([[f[0]], crossings, [0.5 * self.rate]])
        return [(low, high) for low, high in at[edges].reshape(-1, 2).tolist()]


def transparency(hand: Hand) -> Transparency:
    """Returns the impedances of one hand, for the K and B that are simulated for it."""
    rate, eigenfrequency = hand.configuration.rate, hand.eigenfrequency()
    frequency = _frequencies(rate, eigenfrequency, _POINTS_OF_TRANSPARENCY)
    k, b = hand.felt()
    desired = _spring(*hand.desired, frequency)
    felt = _spring(k - hand.configuration.stiffness, b - hand.configuration.friction, frequency)
    scene_alone = replace(hand.configuration, friction=0.0, stiffness=0.0)
    rendered = scene_alone.impedance(hand.stiffness, hand.damping, frequency)
    return Transparency(rate, frequency, desired, rendered, felt, eigenfrequency)


def _spring(stiffness: float, damping: float, frequency: Floats) -> Complexes:
    return np.asarray(stiffness / (2j * np.pi * frequency) + damping, complex)


def transparency_in(prediction: Prediction, name: str, eigenfrequency: float) -> Transparency:
    """Returns the impedances at a device point of a scene, whatever it moves. `eigenfrequency`: Hz, of the hand there;
    NaN for none. Raises UsageError where what is rendered is not worked out."""
    scene = prediction.scene
    eigenfrequency = eigenfrequency if eigenfrequency > _DRIFTS * scene.rate else math.nan
    about = [
        mode for mode in prediction.modes if mode.damping_ratio < _SHARP and mode.frequency_hz > _DRIFTS * scene.rate
    ]
    widths = 1.0 + np.outer([mode.damping_ratio for mode in about], _ABOUT)
    resonances = (np.array([mode.frequency_hz for mode in about])[:, None] * widths).ravel()
    frequency = np.union1d(_frequencies(scene.rate, eigenfrequency, _POINTS), resonances)
    frequency = frequency[(frequency > 0.0) & (frequency < 0.5 * scene.rate)]
    found = predict_impedance(scene, frequency)
    at = found.names.index(name)
    if np.isnan(found.rendered[:, at, at]).all():
        raise UsageError(f"{name}: {found.assumptions[-1]}")
    device, count = scene.device, scene.channels
    channel = scene.device_points[name].channel
    part = prediction.part_on(channel)
    i = part.names.index(name) if part else 0
    k, b = (float(one[i, i]) for one in part.felt[:2]) if part else (math.nan, math.nan)
    felt = _spring(k - device.stiffnesses(count)[channel], b - device.frictions(count)[channel], frequency)
    rendered = found.rendered[:, at, at]
    return Transparency(scene.rate, frequency, found.desired[:, at, at], rendered, felt, eigenfrequency)


def _frequencies(rate: float, eigenfrequency: float, points: int) -> Floats:
    nyquist = 0.5 * rate
    lowest = eigenfrequency / _BELOW_EIGENFREQUENCY if eigenfrequency > 0.0 else nyquist / _BELOW_NYQUIST
    return np.geomspace(lowest, nyquist, points, endpoint=False)


def draw_transparency(data: Transparency, title: str, path: Path) -> None:
    """Draws size and phase, and the spring and damper of the same force, to a file: .svg, .png or .pdf."""
    curves = Curves(data.frequency, _shown(data.desired), _shown(data.rendered), felt=_shown(data.felt))
    with figure_to(path, 9.5, 5.6) as figure:
        panels = figure.subplots(2, 2, sharex=True, height_ratios=[1.15, 1.0])
        figure.suptitle(title)
        draw_sizes(panels[0, 0], curves)
        draw_phases(panels[1, 0], curves)
        panels[0, 0].set_ylabel(f"|force / velocity|  ({drawn_in().name('N·s/m')})")
        panels[1, 0].set_ylabel("phase  (degrees)")
        units = drawn_in()
        each = [
            (units.scaled(k, "N/m"), units.scaled(b, "N·s/m"))
            for k, b in (spring_and_damper(data.frequency, one) for one in (data.desired, data.felt, data.rendered))
        ]
        for axes, label, part in zip(
            panels[:, 1], (f"k  ({units.name('N/m')})", f"b  ({units.name('N·s/m')})"), (0, 1), strict=True
        ):
            _set_up(axes)
            # Linear near the desired value. Beyond it, resonances and values below 0 are drawn logarithmically.
            level = float(np.median(np.abs(each[0][part])))
            linear_to = 10.0 ** math.ceil(math.log10(level)) if level > 0.0 else 1.0
            if np.nanmax(np.abs([one[part] for one in each])) > linear_to:
                axes.set_yscale("symlog", linthresh=linear_to)
            for one, look in zip(each, (style.DESIRED, style.FELT, style.RENDERED), strict=True):
                axes.plot(data.frequency, one[part], **look)
            if axes.get_yscale() == "symlog":  # no ticks crowded around 0
                (low, high), ticks = axes.get_ylim(), axes.get_yticks()
                axes.set_yticks([at for at in ticks if low <= at <= high and not 0.0 < abs(at) < 0.5 * linear_to])
            axes.set_ylabel(label)
        for i, (low, high) in enumerate(data.agreeing_bands_hz()):
            label = "" if i else f"felt and rendered agree within {AGREES:.0%}"
            for axes in panels.flat:
                axes.axvspan(low, high, label=label, **style.AGREES)
        panels[1, 1].set_xlabel("frequency  (Hz)")
        panels[0, 0].set_title("impedance")
        panels[0, 1].set_title("the same as a spring and a damper")
        if math.isfinite(data.eigenfrequency):
            label = f"eigenfrequency of the hand, {data.eigenfrequency:.4g} Hz"
            for axes in panels.flat:
                axes.axvline(data.eigenfrequency, label=label, **style.EIGENFREQUENCY)
        legend_below(figure, 2, handlelength=2.6)
