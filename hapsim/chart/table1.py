"""The paper's Table 1 as an experiment: two springs are one spring in either world, but not across the interface.

A real mass is coupled with springs that are real, simulated, or one of each (Florens et al., §3). What each coupling
swings at is predicted, and measured on the mock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.chart.figure import figure_to
from hapsim.chart.hand import Hand
from hapsim.errors import UsageError
from hapsim.measuring.measure import measure
from hapsim.prediction.correction import CORRECTIONS
from hapsim.prediction.correction.element import element_for
from hapsim.progress import Progress
from hapsim.scene import Device, DevicePoint, Ground, Initial, Mock, Scene, ViscoElastic
from hapsim.theory import Configuration

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hapsim.scene.choices import CorrectionName

_FLICK = 0.1  # m/s
_ROOM = 16.0  # range of the position counts, over how far the flick swings the mass
_COUNTS = 2.0**31
_SWINGS = 20.0
_NOTHING = 1e-9  # per cent: rounding
_LEAST_TICKS, _MOST_TICKS = 2048, 20000
_WORDS = {
    "I": "a real spring $k$",
    "II": "a simulated spring $K$",
    "III": "two real springs, $2k$",
    "IV": "two simulated springs, $2K$",
    "V": "one of each, $k$ and $K$",
}
#: What each would swing as if the two kinds of spring were one.
_REAL = {"I": "I", "II": "I", "III": "III", "IV": "III", "V": "III"}


@dataclass(frozen=True)
class Coupling:
    """A real mass with its springs, SI units."""

    numeral: str
    """Of Table 1."""
    configuration: Configuration
    """Real springs and real dampers are its own stiffness and friction."""
    K: float
    B: float
    correction: CorrectionName
    predicted_hz: float
    """Eigenfrequency."""
    measured_hz: float
    """Eigenfrequency; NaN where the motion is not that of a spring and damper."""
    uncertainty_hz: float
    """Standard uncertainty that the identification states for it."""

    @property
    def off_by(self) -> float:
        """Measured less predicted, relative."""
        return self.measured_hz / self.predicted_hz - 1.0


@dataclass(frozen=True)
class Table1:
    """The five couplings, by their numerals."""

    couplings: dict[str, Coupling]
    configuration: Configuration
    """The loop of all of them, without real springs."""
    k: float
    """The real spring, N/m."""
    K: float
    """The simulated spring that swings the mass as the real one does, N/m."""

    def relative(self, numeral: str) -> float:
        """Predicted frequency over that of I."""
        return self.couplings[numeral].predicted_hz / self.couplings["I"].predicted_hz

    def error(self, numeral: str) -> float:
        """Predicted frequency over that of real springs alone, less 1: what the interface adds."""
        return self.couplings[numeral].predicted_hz / self.couplings[_REAL[numeral]].predicted_hz - 1.0

    def columns(self) -> dict[str, list[Any]]:
        """What is drawn, by the names that a data file uses: a row a coupling."""
        every = self.couplings.values()
        return {
            "coupling": [one.numeral for one in every],
            "real_stiffness_N_per_m": [one.configuration.stiffness for one in every],
            "real_friction_Ns_per_m": [one.configuration.friction for one in every],
            "K_N_per_m": [one.K for one in every],
            "B_Ns_per_m": [one.B for one in every],
            "predicted_Hz": [one.predicted_hz for one in every],
            "measured_Hz": [one.measured_hz for one in every],
            "uncertainty_Hz": [one.uncertainty_hz for one in every],
            "measured_off_by": [one.off_by for one in every],
            "relative_to_I": [self.relative(one.numeral) for one in every],
            "beyond_real_springs": [self.error(one.numeral) for one in every],
        }


def table1(
    hand: Hand,
    *,
    as_scene: bool,
    correction: CorrectionName = "none",
    on_progress: Callable[[Progress], None] | None = None,
) -> Table1:
    """The five couplings of one hand, each predicted and each run on the mock.

    Args:
        hand: gives the mass, the rate and the spring: its K, or where none is simulated its device's own spring k;
            where both are there, the device's is left out.
        as_scene: with the hold, the delay, the sampling and the damping that the hand has; the real spring then comes
            with the real damper that the hand feels. Otherwise as the paper supposes: a force impulse at once, ideal
            sampling, no damping.
        correction: with one, nothing is tuned: K is to be felt as a real spring k = K is, alone or beside others.

    Raises:
        UsageError: there is no spring, or one of the couplings has no frequency below half the rate.
        DeviceError: the mock failed.
    """
    configuration, K, B, k, b = _tuned(hand, as_scene) if correction == "none" else _as_written(hand, as_scene)
    b0 = configuration.friction
    if 2.0 * b - b0 < 0.0:
        raise UsageError(
            f"{hand.name} feels b = {b:.4g} N·s/m, less than half of its real friction of {b0:.4g}: no real "
            "damper does that; leave out --as-scene, or give more damping"
        )
    built = {
        "I": (k, b, 0.0, 0.0),
        "II": (0.0, b0, K, B),
        "III": (2.0 * k, 2.0 * b - b0, 0.0, 0.0),
        "IV": (0.0, b0, 2.0 * K, 2.0 * B),
        "V": (k, b, K, B),
    }
    planned = {
        numeral: _predicted(
            numeral, replace(configuration, stiffness=k_real, friction=b_real), K_there, B_there, correction
        )
        for numeral, (k_real, b_real, K_there, B_there) in built.items()
    }
    return Table1({numeral: _measured(one, on_progress) for numeral, one in planned.items()}, configuration, k, K)


def _tuned(hand: Hand, as_scene: bool) -> tuple[Configuration, float, float, float, float]:
    """(configuration without springs, K, B, k, b) with which couplings I and II swing alike."""
    own = hand.configuration
    configuration, damping = _loop(hand, as_scene)
    if hand.stiffness > 0.0:
        K, B = hand.stiffness, damping
        k, b = (float(value) for value in configuration.equivalent(K, B))
    elif own.stiffness > 0.0:
        k, b = own.stiffness, configuration.friction + damping
        K, B = (float(value) for value in configuration.simulated(k, b))
    else:
        raise _no_spring(hand)
    if not (math.isfinite(k) and math.isfinite(K)):
        raise UsageError(
            f"{hand.name}: no real and simulated spring swing alike here; K is {hand.stiffness:g} N/m, m/T² is "
            f"{own.stiffness_unit:g} N/m"
        )
    return configuration, K, B, k, b if as_scene else 0.0


def _as_written(hand: Hand, as_scene: bool) -> tuple[Configuration, float, float, float, float]:
    """The same for a corrected loop: the real spring and damper are those that the scene asks for."""
    configuration, damping = _loop(hand, as_scene)
    K = hand.stiffness if hand.stiffness > 0.0 else hand.configuration.stiffness
    if not K > 0.0:
        raise _no_spring(hand)
    return configuration, K, damping, K, configuration.friction + damping


def _loop(hand: Hand, as_scene: bool) -> tuple[Configuration, float]:
    """(what all couplings have in common, without springs; the simulated damping)"""
    own = hand.configuration
    if as_scene:
        return replace(own, stiffness=0.0), hand.damping
    return Configuration(own.mass, own.rate, delay=0.0, hold="impulse"), 0.0


def _no_spring(hand: Hand) -> UsageError:
    return UsageError(f"{hand.name}: found no spring, expected a link with a stiffness above 0, or one of the device")


def _predicted(numeral: str, configuration: Configuration, K: float, B: float, correction: CorrectionName) -> Coupling:
    k = float(configuration.equivalent(K, B)[0])
    if correction != "none" and K > 0.0:
        kind = CORRECTIONS[correction]
        total = configuration.stiffness + K, configuration.friction + B
        span = configuration.mass, configuration.mass
        element = element_for(kind, configuration, span, total)
        loop = kind.closed(configuration, configuration, element.observer)
        k = float(loop.equivalent(element.stiffness, element.damping)[0])
    frequency = math.sqrt(k / configuration.mass) / (2.0 * math.pi) if k > 0.0 else math.nan
    if not frequency < 0.5 * configuration.rate:
        raise UsageError(
            f"coupling {numeral} of Table 1 would not swing below half the rate as a mass on a spring does: "
            f"its real spring is {configuration.stiffness:.4g} N/m, its simulated one {K:.4g} N/m, and m/T² is "
            f"{configuration.stiffness_unit:.4g} N/m. Write a smaller stiffness, or a higher rate"
        )
    return Coupling(numeral, configuration, K, B, correction, frequency, math.nan, math.nan)


def _measured(coupling: Coupling, on_progress: Callable[[Progress], None] | None) -> Coupling:
    """Measured on the mock, in virtual time."""
    rate = coupling.configuration.rate
    ticks = min(max(_LEAST_TICKS, _SWINGS * rate / coupling.predicted_hz), _MOST_TICKS)
    found = measure(_scene_of(coupling), duration=ticks / rate, on_progress=on_progress)
    if found.failure is not None:
        raise found.failure
    uncertainty = 0.5 * found.k_uncertainty / found.k * found.frequency_hz
    return replace(coupling, measured_hz=found.frequency_hz, uncertainty_hz=uncertainty)


def _scene_of(coupling: Coupling) -> Scene:
    """The scene of one coupling, on a mock as fine as its numbers are."""
    c = coupling.configuration
    swing = _FLICK / (2.0 * math.pi * coupling.predicted_hz)
    quantum = _ROOM * swing / _COUNTS
    stiffest = coupling.K + c.mass * (2.0 * math.pi * coupling.predicted_hz) ** 2
    limit = _ROOM * (stiffest * swing + coupling.B * _FLICK)
    return Scene(
        version=1,
        rate=c.rate,
        device=Device(
            clock="lockstep",
            mass=c.mass,
            friction=c.friction,
            stiffness=c.stiffness,
            delay=c.delay,
            hold=c.hold,
            sampling=c.sampling,  # type: ignore[arg-type]
            force_limit=limit,
            correction=coupling.correction,
        ),
        mock=Mock(initial=Initial(velocity=_FLICK), quantum=quantum),
        modules={
            "hand": DevicePoint(channel=0),
            "ground": Ground(),
            "spring": ViscoElastic(
                between=("hand", "ground"),
                stiffness=coupling.K,
                damping=coupling.B,
                damper=c.damper,  # type: ignore[arg-type]
                cutoff=c.cutoff,
            ),
        },
    )


def draw_table1(data: Table1, title: str, path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    with figure_to(path, 6.5, 3.5) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1.25, 1.0])
        figure.suptitle(title, fontsize=10)
        _draw_frequencies(left, data)
        _draw_errors(right, data)
        figure.legend(loc="outside lower center", ncols=3, frameon=False, columnspacing=1.5)


def _draw_frequencies(axes: Axes, data: Table1) -> None:
    first = data.couplings["I"].predicted_hz
    rows = range(len(data.couplings))
    predicted = [one.predicted_hz / first for one in data.couplings.values()]
    _draw_bars(axes, predicted, [one.measured_hz / first for one in data.couplings.values()], labelled=True)
    axes.set_yticks(rows, [f"{numeral}  {_WORDS[numeral]}" for numeral in data.couplings])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 2.1 * max(predicted))
    axes.set_xticks([0.5 * i for i in range(round(2.0 * max(predicted)) + 1)])
    axes.set_xlabel("frequency, relative to I")
    for row, one in zip(rows, data.couplings.values(), strict=True):
        words = f"{one.predicted_hz / first:.5f}\n{_difference(one.off_by)}"
        axes.annotate(words, (predicted[row], row), (9, 0), textcoords="offset points", va="center", fontsize=9)


def _draw_errors(axes: Axes, data: Table1) -> None:
    errors = [100.0 * data.error(numeral) for numeral in data.couplings]
    measured = [
        100.0 * (one.measured_hz / data.couplings[_REAL[numeral]].measured_hz - 1.0)
        for numeral, one in data.couplings.items()
    ]
    _draw_bars(axes, errors, measured, labelled=False)
    axes.axvline(0.0, color="black", linewidth=0.8)
    low, high = min(errors), max(errors)
    room = 0.8 * (high - low) or 1.0  # for the numbers beside the bars
    axes.set_xlim(low - (room if low < -_NOTHING else 0.1 * room), high + room)
    axes.set_xlabel("beyond real springs  (%)")
    for row, error in enumerate(errors):
        side = 1 if error > -_NOTHING else -1
        style: dict[str, Any] = {"va": "center", "ha": "left" if side > 0 else "right", "fontsize": 9}
        words = f"{error:+.3g}" if abs(error) > _NOTHING else "0"
        axes.annotate(words, (error, row), (9 * side, 0), textcoords="offset points", **style)


def _draw_bars(axes: Axes, predicted: list[float], measured: list[float], *, labelled: bool) -> None:
    rows = range(len(predicted))
    style = {"height": 0.55, "facecolor": "0.85", "edgecolor": "0.4", "linewidth": 0.6}
    axes.barh(rows, predicted, label="predicted" if labelled else "", **style)  # type: ignore[arg-type]
    axes.plot(measured, rows, "d", color="black", markersize=5, label="measured on the mock" if labelled else "")


def _difference(off_by: float) -> str:
    """How far the measurement is from the prediction."""
    return f"off by {off_by:+.0e}".replace("e-0", "e-").replace("-", "−") if math.isfinite(off_by) else "not measured"
