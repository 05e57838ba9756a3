"""The paper's Table 1 as an experiment: two springs are one spring in either world, but not across the interface.

A real mass is coupled with springs that are real, simulated, or one of each (Florens et al., §3). What each coupling
swings at is predicted, and measured on the mock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.errors import UsageError
from hapsim.loop.counts import Progress
from hapsim.measuring.measure import measure_on_line as measure
from hapsim.number_format import short
from hapsim.prediction.correction import CORRECTIONS
from hapsim.prediction.correction.element import element_for
from hapsim.scene import Device, DevicePoint, Ground, Initial, Mock, Scene, ViscoElastic
from hapsim.scene.choices import CorrectionName
from hapsim.theory import Configuration
from hapsim.units import Units

_FLICK = 0.1  # m/s
_ROOM = 16.0  # range of the position counts, over how far the flick swings the mass
_COUNTS = 2.0**31
_SWINGS = 20.0
_NOTHING = 1e-6  # per cent: rounding, and the identification's own error
_ROUNDED = 1e-12  # of m/T: a damping that is rounding
_LEAST_SPAN = 0.02  # per cent: less is not magnified
_LEAST_TICKS, _MOST_TICKS = 2048, 20000
_FREQUENCIES = ("predicted_hz", "measured_hz")
_WORDS = {
    "I": "a real spring $k$",
    "II": "a simulated spring $K$",
    "III": "two real springs, $2k$",
    "IV": "two simulated springs, $2K$",
    "V": "one of each, $k$ and $K$",
}
# The real springs that each would equal if both kinds of spring were one.
_REAL = {"I": "I", "II": "I", "III": "III", "IV": "III", "V": "III"}


@dataclass(frozen=True)
class Coupling:
    """A real mass with its springs, SI units."""

    numeral: str  # of Table 1
    configuration: Configuration  # real springs and real dampers are its own stiffness and friction
    K: float
    B: float
    correction: CorrectionName
    predicted_hz: float  # eigenfrequency
    measured_hz: float = math.nan
    """Eigenfrequency; NaN if the motion is not that of a spring and damper."""
    uncertainty_hz: float = math.nan  # standard uncertainty that the identification states for it

    @property
    def off_by(self) -> float:
        """Measured less predicted, relative."""
        return self.measured_hz / self.predicted_hz - 1.0


@dataclass(frozen=True)
class Table1:
    """The five couplings, by their numerals."""

    couplings: dict[str, Coupling]
    configuration: Configuration  # the loop of all of them, without real springs
    k: float  # the real spring, N/m
    K: float  # the simulated spring that swings the mass as the real one does, N/m

    def relative(self, numeral: str) -> float:
        """Returns the predicted frequency over that of I."""
        return self.couplings[numeral].predicted_hz / self.couplings["I"].predicted_hz

    def error(self, numeral: str, what: str = "predicted_hz") -> float:
        """Returns a coupling's frequency over that of real springs alone, less 1: what the interface adds."""
        one, real = self.couplings[numeral], self.couplings[_REAL[numeral]]
        return float(getattr(one, what) / getattr(real, what) - 1.0)

    def columns(self) -> dict[str, list[Any]]:
        """Returns what is drawn, by the names that a data file uses: a row for each coupling."""
        every = self.couplings.values()
        return {
            "coupling": list(self.couplings),
            "real_stiffness_N_per_m": [one.configuration.stiffness for one in every],
            "real_friction_Ns_per_m": [one.configuration.friction for one in every],
            "K_N_per_m": [one.K for one in every],
            "B_Ns_per_m": [one.B for one in every],
            "predicted_Hz": [one.predicted_hz for one in every],
            "measured_Hz": [one.measured_hz for one in every],
            "uncertainty_Hz": [one.uncertainty_hz for one in every],
            "measured_off_by": [one.off_by for one in every],
            "relative_to_I": list(map(self.relative, self.couplings)),
            "beyond_real_springs": list(map(self.error, self.couplings)),
        }


def table1(
    hand: Hand,
    *,
    as_scene: bool,
    correction: CorrectionName = "none",
    on_progress: Callable[[Progress], None] | None = None,
) -> Table1:
    """Returns the five couplings of one hand, each predicted and each run on the mock.

    Args:
        hand: gives the mass, the rate and the spring: its simulated K, or if it has none its device's own spring.
        as_scene: with the hand's hold, delay, sampling and damping; the real spring then comes with the real damper
            that the hand feels. Otherwise as the paper supposes: a force impulse at once, ideal sampling, no damping.
        correction: with one, nothing is tuned: K is to be felt as a real spring k = K is, alone or beside others.

    Raises:
        UsageError: there is no spring, the law is on the board, or one of the couplings has no frequency below half the
            rate.
        DeviceError: the mock failed.
    """
    if hand.configuration.steps > 1:
        raise UsageError("device.law: found board, expected host: the springs of Table 1 are simulated by the host")
    configuration, K, B, k, b = _springs(hand, as_scene, corrected=correction != "none")
    b0 = configuration.friction
    if 2.0 * b - b0 < 0.0:
        felt, real = hand.units(b, "N·s/m", ".4g"), hand.units(b0, "N·s/m", ".4g")
        raise UsageError(
            f"{hand.name} feels b = {felt}, less than half of its real friction of {real}: "
            "no real damper does that; omit --as-scene, or give more damping"
        )
    built = {
        "I": (k, b, 0.0, 0.0),
        "II": (0.0, b0, K, B),
        "III": (2.0 * k, 2.0 * b - b0, 0.0, 0.0),
        "IV": (0.0, b0, 2.0 * K, 2.0 * B),
        "V": (k, b, K, B),
    }
    planned = [
        _predicted(numeral, replace(configuration, stiffness=k, friction=b), K, B, correction, hand.units)
        for numeral, (k, b, K, B) in built.items()
    ]
    return Table1({one.numeral: _measured(one, on_progress) for one in planned}, configuration, k, K)


def _springs(hand: Hand, as_scene: bool, corrected: bool) -> tuple[Configuration, float, float, float, float]:
    """Returns (configuration without springs, K, B, k, b) with which couplings I and II swing alike. In a corrected
    loop the real spring and damper are those that the scene asks for."""
    own, damping = hand.configuration, hand.damping if as_scene else 0.0
    loop = replace(own, stiffness=0.0) if as_scene else Configuration(own.mass, own.rate, delay=0.0, hold="impulse")
    simulated = hand.stiffness > 0.0
    K = k = hand.stiffness if simulated else own.stiffness
    if not K > 0.0:
        raise UsageError(
            f"{hand.name}: found no spring, expected a link with a stiffness above 0, or one of the device"
        )
    B, b = damping, loop.friction + damping
    if corrected:
        return loop, K, B, k, b
    if simulated:
        k, b = map(float, loop.equivalent(K, B))
    else:
        K, B = map(float, loop.simulated(k, b))
        B *= _ROUNDED * loop.damping_unit < B
    if not (math.isfinite(k) and math.isfinite(K)):
        raise UsageError(
            f"{hand.name}: no real and simulated spring swing alike here; K is "
            f"{hand.units(hand.stiffness, 'N/m', 'g')}, m/T² is {hand.units(own.stiffness_unit, 'N/m', 'g')}"
        )
    return loop, K, B, k, b if as_scene else 0.0


def _predicted(
    numeral: str, configuration: Configuration, K: float, B: float, correction: CorrectionName, units: Units
) -> Coupling:
    k = float(configuration.equivalent(K, B)[0])
    if correction != "none" and K > 0.0:
        kind = CORRECTIONS[correction]
        total = configuration.stiffness + K, configuration.friction + B
        element = element_for(kind, configuration, (configuration.mass, configuration.mass), total)
        loop = kind.closed(configuration, configuration, element.observer)
        k = float(loop.equivalent(element.stiffness, element.damping)[0])
    frequency = math.sqrt(k / configuration.mass) / (2.0 * math.pi) if k > 0.0 else math.nan
    if not frequency < 0.5 * configuration.rate:
        raise UsageError(
            f"coupling {numeral} of Table 1 would not swing below half the rate as a mass on a spring does: "
            f"its real spring is {units(configuration.stiffness, 'N/m', '.4g')}, its simulated one "
            f"{units(K, 'N/m', '.4g')}, and m/T² is "
            f"{units(configuration.stiffness_unit, 'N/m', '.4g')}. Write a smaller stiffness, or a higher rate"
        )
    return Coupling(numeral, configuration, K, B, correction, frequency)


def _measured(coupling: Coupling, on_progress: Callable[[Progress], None] | None) -> Coupling:
    """Measures a coupling on the mock, in virtual time."""
    rate = coupling.configuration.rate
    ticks = min(max(_LEAST_TICKS, _SWINGS * rate / coupling.predicted_hz), _MOST_TICKS)
    found = measure(_scene_of(coupling), duration=ticks / rate, on_progress=on_progress)
    if found.failure is not None:
        raise found.failure
    uncertainty = 0.5 * found.k_uncertainty / found.k * found.frequency_hz
    return replace(coupling, measured_hz=found.frequency_hz, uncertainty_hz=uncertainty)


def _scene_of(coupling: Coupling) -> Scene:
    """Returns the scene of one coupling, on a mock with counts fine enough for its numbers."""
    c = coupling.configuration
    swing = _FLICK / (2.0 * math.pi * coupling.predicted_hz)
    stiffest = coupling.K + c.mass * (2.0 * math.pi * coupling.predicted_hz) ** 2
    device = {name: getattr(c, name) for name in ("mass", "friction", "stiffness", "delay", "hold", "sampling")}
    limit = _ROOM * (stiffest * swing + coupling.B * _FLICK)
    spring: Any = {"stiffness": coupling.K, "damping": coupling.B, "damper": c.damper, "cutoff": c.cutoff}
    return Scene(
        version=1,
        rate=c.rate,
        device=Device(clock="lockstep", force_limit=limit, correction=coupling.correction, **device),
        mock=Mock(initial=Initial(velocity=_FLICK), quantum=_ROOM * swing / _COUNTS),
        modules={
            "hand": DevicePoint(channel=0),
            "ground": Ground(),
            "spring": ViscoElastic(between=("hand", "ground"), **spring),
        },
    )


def draw_table1(data: Table1, title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    numerals, every = list(data.couplings), list(data.couplings.values())
    with figure_to(path, 6.9, 3.7) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1.25, 1.0])
        figure.suptitle(title.replace("; ", "\n"), fontsize=9)  # in one line it is wider than the figure
        bars, dots = ([getattr(one, what) / every[0].predicted_hz for one in every] for what in _FREQUENCIES)
        off = [
            f"off by {short(float(f'{one.off_by:.0e}'))}" if math.isfinite(one.off_by) else "not measured"
            for one in every
        ]
        _draw_bars(left, bars, dots, [f"{bar:.5f}\n{by}" for bar, by in zip(bars, off, strict=True)])
        left.set_yticks(range(len(bars)), [f"{one}  {_WORDS[one]}" for one in numerals])
        left.invert_yaxis()
        left.set(xlim=(0.0, 2.1 * max(bars)), xlabel="frequency, relative to I")
        bars, dots = ([100.0 * data.error(one, what) for one in numerals] for what in _FREQUENCIES)
        bars = [bar if abs(bar) > _NOTHING else 0.0 for bar in bars]
        _draw_bars(right, bars, dots, [f"{bar:+.3g}" if bar else "0" for bar in bars])
        right.axvline(0.0, color="black", linewidth=0.8)
        low, high = min(0.0, *bars), max(0.0, *bars)
        span = max(high - low, _LEAST_SPAN)
        right.set_xlim(low - (0.8 if low < 0.0 else 0.1) * span, high + 0.8 * span)
        right.set_xlabel("beyond real springs  (%)")
        legend_below(figure, 3)


def _draw_bars(axes: Axes, predicted: list[float], measured: list[float], words: list[str]) -> None:
    """Draws a row for each coupling, with words at the end of its bar."""
    rows = range(len(predicted))
    bars = axes.barh(rows, predicted, label="predicted", **style.BAR)
    axes.plot(measured, rows, label="measured on the mock", **style.MEASURED_BAR)
    axes.bar_label(bars, words, padding=9, fontsize=9)
