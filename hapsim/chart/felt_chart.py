"""Accuracy of the felt k and b over the desired ones, with each correction and with the law on the board, and the
tolerance to device errors.

The theory alone is used. The desired K T²/m has a logarithmic axis, the desired damping ratio a linear one, and every
point of that plane counts alike. Below: the share that is felt, over the true mass and over the delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.prediction.correction import CORRECTIONS, felt_error
from hapsim.prediction.correction.kind import Observer, pole_of_push
from hapsim.prediction.felt_alone import SHARES, Tolerances
from hapsim.prediction.linear import by_board, configuration_of
from hapsim.scene import Scene
from hapsim.scene.choices import AHEAD
from hapsim.theory import Configuration
from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.interface import BoardLaw

DRAWN = ("none", "poles", "predictor", "sensed")
"""Corrections in the picture; an adaptive one that knows its mass is a predictor."""
BOARD = "board"
"""The force law on the board, without a correction."""
WITHIN = (0.01, 0.05, 0.1)
OF_SHARES = 0.05
"""The felt error within which a point counts in the curves."""

_LEAST, _MOST, _MOST_RATIO = 1e-4, 2.0, 1.5
_POINTS, _POINTS_OF_A_SHARE = (144, 72), (60, 30)
_POINTS_OF_A_DRIVEN_SHARE = 30, 15  # whose answers to an impulse are compared at each point
_CLOSE = np.array([1.005, 1.01, 1.02, 1.03, 1.045, 1.065, 1.1, 1.15, 1.22, 1.3, 1.4, 1.5, 1.65, 1.8, 2.0])
_MASSES = np.concatenate([1.0 / _CLOSE[::-1], [1.0], _CLOSE])
_DELAYS = np.linspace(0.0, 3.0, 13)
_ON_THE_CIRCLE = 1e-9
_COLUMNS = (
    *("panel", "correction", "K_T2_per_m", "damping_ratio"),
    *("mass_ratio", "delay_samples", "error_or_share", "outcome"),
)


class Outcome(IntEnum):
    """The result for a desired (k, b)."""

    WITHIN_1 = 0
    WITHIN_5 = 1
    WITHIN_10 = 2
    FURTHER_OFF = 3
    OUT_OF_REACH = 4
    """No (K, B) is felt so; hapsim simulates the nearest. It counts as further off than 10 %."""
    UNSTABLE = 5
    NOT_ASKED = 6
    """The device itself has more friction, or more of a spring. It does not count."""


_WORDS = (
    *("within 1 %", "within 5 %", "within 10 %", "further off", "out of reach"),
    *("unstable", "less than the device's own"),
)


@dataclass(frozen=True)
class DesiredPlane:
    """Desired values, the middles of equal cells."""

    kappa: Floats  # (n,): K T²/m, the device's own included
    ratio: Floats  # (m,): damping ratio, the device's own included

    @classmethod
    def of_cells(cls, columns: int, rows: int) -> DesiredPlane:
        """Returns the plane that is drawn, in columns by rows of cells."""
        along = (np.arange(columns) + 0.5) / columns
        return cls(_LEAST * (_MOST / _LEAST) ** along, _MOST_RATIO * (np.arange(rows) + 0.5) / rows)

    def desired(self, configuration: Configuration) -> tuple[Floats, Floats]:
        """Returns (k, b), (n, m), in N/m and N·s/m."""
        k = self.kappa[:, None] * configuration.stiffness_unit + 0.0 * self.ratio
        return k, 2.0 * self.ratio * np.sqrt(k * configuration.mass)

    def asked(self, configuration: Configuration) -> Bools:
        """Returns (n, m): True if a scene can reach it by adding a spring and a damper to this device."""
        k, b = self.desired(configuration)
        return (k >= configuration.stiffness) & (b >= configuration.friction)


@dataclass(frozen=True)
class FeltPlane:
    """The result of one correction over a plane."""

    error: Floats
    """(n, m): as of ``felt_error``; infinite if no spring and damper is equivalent, or none can be simulated."""
    outcome: Any  # (n, m), of Outcome

    def share(self, within: float) -> float:
        """Returns the part of what can be asked for that is felt within this error; NaN if nothing can."""
        asked = self.outcome != Outcome.NOT_ASKED
        return float(np.mean(self.error[asked] <= within)) if asked.any() else float("nan")


@dataclass(frozen=True)
class FeltChart:
    """The picture's numbers; corrections by their names."""

    hand: Hand
    plane: DesiredPlane
    felt: dict[str, FeltPlane]
    mass_ratio: Floats  # true mass over the declared one
    against_mass: dict[str, Floats]  # shares within OF_SHARES
    delay: Floats  # samples
    against_delay: dict[str, Floats]
    limit: float  # the share that any controller could have felt: what swings below half the rate

    @property
    def operating_point(self) -> tuple[float, float] | None:
        """(K T²/m, damping ratio) of what the scene asks for; None if it asks for no spring."""
        c = self.hand.configuration
        k, b = self.hand.stiffness + c.stiffness, self.hand.damping + c.friction
        return (k / c.stiffness_unit, b / (2.0 * np.sqrt(k * c.mass))) if k > 0.0 else None

    def columns(self) -> dict[str, list[Any]]:
        """Returns what is drawn, by the names that a data file uses: a row for each number."""
        rows: list[tuple[Any, ...]] = []
        for name, felt in self.felt.items():
            for (i, j), error in np.ndenumerate(felt.error):
                outcome = Outcome(felt.outcome[i, j]).name.lower()
                rows.append(("plane", name, self.plane.kappa[i], self.plane.ratio[j], "", "", error, outcome))
        for name in self.felt:
            of_masses = zip(self.mass_ratio, self.against_mass[name], strict=True)
            of_delays = zip(self.delay, self.against_delay[name], strict=True)
            rows += [("mass", name, "", "", mass, "", share, "") for mass, share in of_masses]
            rows += [("delay", name, "", "", "", delay, share, "") for delay, share in of_delays]
        return dict(zip(_COLUMNS, map(list, zip(*rows, strict=True)), strict=True))

    def summary(self) -> dict[str, Any]:
        """Returns what scripts read."""
        return {
            "share": {name: {f"{within:g}": one.share(within) for within in WITHIN} for name, one in self.felt.items()},
            "out_of_reach": {n: float(np.mean(one.outcome == Outcome.OUT_OF_REACH)) for n, one in self.felt.items()},
            "limit": self.limit,
            "against_mass": {"mass_ratio": self.mass_ratio, **self.against_mass},
            "against_delay": {"delay_samples": self.delay, **self.against_delay},
        }


def felt_chart(hand: Hand, board: BoardLaw = BoardLaw(10, 1, 10)) -> FeltChart:  # noqa: B008
    """Returns what the hand feels of the plane, and how that share depends on its true mass and on the delay. `board`:
    the loop of a board with the law."""
    declared = hand.configuration
    cells = _POINTS_OF_A_DRIVEN_SHARE if declared.drive.inner else _POINTS_OF_A_SHARE
    plane, coarse = DesiredPlane.of_cells(*_POINTS), DesiredPlane.of_cells(*cells)
    ways, ratios = drawn_for(declared), _MASSES[_MASSES * declared.mass > declared.drive.motor_mass]
    of_masses = [(declared, replace(declared, mass=declared.mass * ratio)) for ratio in ratios]
    of_delays = [(late, late) for late in (replace(declared, delay=delay) for delay in _DELAYS)]

    def shares(cases: list[tuple[Configuration, Configuration]]) -> dict[str, Floats]:
        """Returns the share of the plane by each way, over cases of (declared, true) loops."""
        found = {
            name: [felt_by(name, *case, coarse).share(OF_SHARES) for case in cases] for name in ways if name != BOARD
        }
        if BOARD in ways:  # the wire's delay is none of the board's loop
            masses = {true.mass: felt_by(BOARD, declared, true, coarse, board) for _, true in cases}
            found |= {BOARD: [masses[true.mass].share(OF_SHARES) for _, true in cases]}
        return {name: np.array(each) for name, each in found.items()}

    return FeltChart(
        hand=hand,
        plane=plane,
        felt={name: felt_by(name, declared, declared, plane, board) for name in ways},
        mass_ratio=ratios,
        against_mass=shares(of_masses),
        delay=_DELAYS,
        against_delay=shares(of_delays),
        limit=limit_of(declared, plane),
    )


def drawn_for(device: Configuration) -> tuple[str, ...]:
    """Returns the ways that the device can have: one mass that is moved at once has all of them."""
    return tuple(name for name in DRAWN if name not in AHEAD) if device.drive.inner else (*DRAWN, BOARD)


def felt_by(
    way: str,
    declared: Configuration,
    true: Configuration,
    plane: DesiredPlane,
    board: BoardLaw | None = None,
) -> FeltPlane:
    """Returns what a correction, or the law on the ``board``, makes of the plane of the ``declared`` mass, on a device
    that has the ``true`` one."""
    k, b = plane.desired(declared)
    asked = plane.asked(declared)
    kind = CORRECTIONS.get(way)
    if way == BOARD and board is not None:
        true = by_board(true, board)
    K, B = k - declared.stiffness, b - declared.friction
    if kind is not None and not kind.by_sensors:
        K, B = kind.seen_by_theory(declared).simulated(k, b)
    had = asked & np.isfinite(K) & np.isfinite(B)
    error, radius = np.full(k.shape, np.inf), np.zeros(k.shape)
    poles = pole_of_push(declared, k, b)
    for pole in np.unique(poles):
        cells = had & (poles == pole)
        observer = Observer(float(pole), static=k[cells] - declared.stiffness)
        loop = true if kind is None else kind.closed(true, declared, observer)
        here, *felt = loop.solved(K[cells], B[cells])
        radius[cells] = np.abs(here[..., 0])
        error[cells] = felt_error((felt[0], felt[1]), (k[cells], b[cells]), true.mass)
    conditions = [~asked, ~had, radius > 1.0 + _ON_THE_CIRCLE]
    outcomes = [Outcome.NOT_ASKED, Outcome.OUT_OF_REACH, Outcome.UNSTABLE]
    return FeltPlane(error, np.select(conditions, outcomes, np.searchsorted(WITHIN, error)))


def limit_of(declared: Configuration, plane: DesiredPlane) -> float:
    """Returns the share of the plane that any controller could have felt.

    In its samples, a motion at half the rate or above looks like a slower one, so no controller can render it.
    """
    k, b = plane.desired(declared)
    asked = plane.asked(declared)
    swing = np.sqrt(np.maximum(k / declared.mass - (0.5 * b / declared.mass) ** 2, 0.0))
    return float(np.mean(swing[asked] < np.pi * declared.rate)) if asked.any() else float("nan")


def draw_felt(chart: FeltChart, title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    with figure_to(path, 8.8, 5.8) as figure:
        figure.suptitle(f"Accuracy of the felt stiffness and damping   {title}", fontsize=9)
        above, below = np.asarray(figure.subfigures(2, 1, height_ratios=[1.26, 1.0])).tolist()
        panels = above.subplots(1, len(chart.felt), sharex=True, sharey=True)
        for axes, name in zip(panels, chart.felt, strict=True):
            _draw_plane(axes, chart, name)
        panels[0].set_ylabel("desired damping ratio")
        shown = np.unique([felt.outcome for felt in chart.felt.values()])
        handles = [
            Patch(
                facecolor=style.OUTCOMES[outcome],
                edgecolor=style.HATCH,
                linewidth=0.5,
                hatch=style.OUTCOME_HATCHES.get(Outcome(outcome).name),
                label=_WORDS[outcome],
            )
            for outcome in shown
        ]
        # Two rows where one would be wider than the figure.
        legend_below(above, 4 if len(handles) > 5 else len(handles), handles=handles)
        left, right = below.subplots(1, 2, sharey=True)
        _draw_shares(left, chart.mass_ratio, chart.against_mass, "true mass / declared mass")
        _draw_shares(right, chart.delay, chart.against_delay, "delay  (samples)")
        label = f"limit of any controller, {100.0 * chart.limit:.0f} %"
        limit = right.axhline(100.0 * chart.limit, label=label, color="0.4", linewidth=0.8, zorder=0.9)
        right.xaxis.set_major_formatter("{x:g}")
        left.set_xscale("log", base=2)
        left.set_xticks([0.5, 0.7, 1.0, 1.4, 2.0], ["0.5", "0.7", "1", "1.4", "2"])
        left.set_ylabel(f"share felt within {100.0 * OF_SHARES:.0f} %")
        legend_below(below, 6, handles=[*left.get_lines(), limit])


def _draw_plane(axes: Axes, chart: FeltChart, name: str) -> None:
    plane, felt = chart.plane, chart.felt[name]
    colours: Any = {"cmap": ListedColormap(style.OUTCOMES), "vmin": -0.5, "vmax": len(Outcome) - 0.5}
    axes.set_xscale("log")
    axes.pcolormesh(plane.kappa, plane.ratio, felt.outcome.T, rasterized=True, linewidth=0, **colours)
    for outcome, hatch in style.OUTCOME_HATCHES.items():
        here = (felt.outcome == Outcome[outcome]).T.astype(float)
        if here.any() and min(here.shape) > 1:
            drawn = axes.contourf(plane.kappa, plane.ratio, here, levels=[0.5, 1.5], colors="none", hatches=[hatch])
            drawn.set(edgecolor=style.HATCH, linewidth=0.0)
    axes.set(xlim=(_LEAST, _MOST), ylim=(0.0, _MOST_RATIO))
    axes.set(title=f"{'law' if name == BOARD else 'correction'}: {name}", xlabel="desired $K\\,T^2/m$")
    shares = "\n".join(f"{100.0 * felt.share(within):.0f} % within {100.0 * within:.0f} %" for within in WITHIN)
    axes.text(0.965, 0.96, shares, transform=axes.transAxes, va="top", ha="right", **style.SHARES)
    point = chart.operating_point
    if point is not None and _LEAST <= point[0] <= _MOST and point[1] <= _MOST_RATIO:
        axes.plot(*point, **style.OPERATING_POINT | {"markersize": 6})


def _draw_shares(axes: Axes, x: Floats, shares: dict[str, Floats], label: str) -> None:
    for name, share in shares.items():
        axes.plot(x, 100.0 * share, label=name, **style.CORRECTIONS[name])
    axes.set(xlabel=label, xlim=(x[0], x[-1]), ylim=(0.0, 108.0))
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid()


OVER = ("device.mass", "device.friction", "device.delay")
_LABELS = {
    "device.mass": "true mass / declared mass",
    "device.friction": "true friction  (‹N·s/m›)",
    "device.delay": "true delay  (samples)",
}
_TRUE_VALUES = 121
_MOST_PER_CENT = 30.0  # per cent that are drawn


@dataclass(frozen=True)
class ToleranceChart:
    """Relative errors of k and b (n,) over true values (n,) of a quantity of `OVER`, by correction; NaN if unstable."""

    over: str
    true: Floats  # of the mass as a share of the declared one
    k_error: dict[str, Floats]
    b_error: dict[str, Floats]
    within: dict[str, list[tuple[float, float] | None]]
    """The least and the most of that quantity by correction, within each of `SHARES`; None if the desired values are
    not felt."""

    def columns(self) -> dict[str, Any]:
        """Returns what is drawn, by the names that a data file uses."""
        of_k = {f"{name}_k_error": error for name, error in self.k_error.items()}
        return {self.over: self.true} | of_k | {f"{name}_b_error": error for name, error in self.b_error.items()}


def tolerance_chart(scene: Scene, name: str, over: str) -> ToleranceChart:
    """Returns it for the hand at a device point whose links all end on grounds. UsageError for another, or where
    `over` is none of `OVER`."""
    if over not in OVER:
        raise UsageError(f"--over: found {over}, expected one of {', '.join(OVER)}")
    field, true = over.removeprefix("device."), np.zeros(0)
    errors: tuple[dict[str, Floats], dict[str, Floats]] = ({}, {})
    within = {}
    drawn = [one for one in drawn_for(configuration_of(scene, scene.device_points[name].channel)) if one != BOARD]
    for correction in drawn:
        device = scene.device.model_copy(update={"correction": correction})
        prediction = predict(scene.model_copy(update={"device": device}), with_margins=False)
        felt, wanted = next((one.hand, one.asked) for one in prediction.parts if one.names == (name,) and one.hand)
        declared = felt.configuration
        there_is = getattr(declared, field)
        true = {
            "device.mass": np.geomspace(0.4, 4.0, _TRUE_VALUES),
            "device.friction": np.linspace(0.0, max(4.0 * there_is, 1.0), _TRUE_VALUES),
            "device.delay": np.linspace(0.0, there_is + 2.0, _TRUE_VALUES),
        }[over]
        for of_one in errors:
            of_one[correction] = np.full(true.size, np.nan)
        unit = declared.mass if over == "device.mass" else 1.0
        for i, value in enumerate((unit * true).tolist()):
            there = replace(felt, configuration=replace(declared, **{field: value}))
            if there.stable:
                for of_one, found, asked in zip(errors, (there.k, there.b), wanted, strict=True):
                    of_one[correction][i] = found / asked - 1.0
        tolerances = Tolerances(felt, *wanted)
        within[correction] = [tolerances.of(field, share) for share in SHARES]
    return ToleranceChart(over, true, *errors, within)


def draw_tolerance(chart: ToleranceChart, title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    with figure_to(path, 7.4, 4.0) as figure:
        figure.suptitle(f"Tolerance to errors in the device's parameters   {title}", fontsize=9)
        panels = figure.subplots(1, 2, sharey=True)
        true = drawn_in().scaled(chart.true, "N·s/m") if chart.over == "device.friction" else chart.true
        for axes, errors, label in zip(panels, (chart.k_error, chart.b_error), ("k", "b"), strict=True):
            for share in SHARES:
                axes.axhspan(-100.0 * share, 100.0 * share, **style.WITHIN)
            for name, error in errors.items():
                axes.plot(true, 100.0 * error, label=name, **style.CORRECTIONS[name])
            axes.set(title=f"relative error of the felt {label}", xlabel=drawn_in().filled(_LABELS[chart.over]))
            axes.set(xlim=(true[0], true[-1]), ylim=(-_MOST_PER_CENT, _MOST_PER_CENT))
            axes.yaxis.set_major_formatter("{x:+.0f} %")
            axes.grid()
            if chart.over == "device.mass":
                axes.set_xscale("log", base=2)
                axes.set_xticks([0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0], ["0.5", "0.7", "1", "1.4", "2", "2.8", "4"])
        legend_below(figure, 3)
