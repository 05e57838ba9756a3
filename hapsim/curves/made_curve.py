"""The curve of a recording for a device, with what the device cannot render, and the scene in which it is felt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import yaml

from hapsim.curves.recording import Recording
from hapsim.curves.thinning import limited, smooth, thinned
from hapsim.errors import UsageError
from hapsim.prediction import Prediction, Region, predict
from hapsim.scene import Branches, Scene, parse_scene
from hapsim.theory.arrays import Floats

_SHARE = 0.01  # of the range of forces: how far from the recording a curve may be if nothing else is said
_NOISES = 2.0  # times the noise, if that is more
_RENDERED = 0.8  # of the stiffness at which the device just starts to buzz
_FACTORS = (1.25, 1.6, 2.5, 4.0, 8.0, 20.0)  # of a damping or a rate that would help
_MOST = 0.9  # of the slopes in such a part are smaller than the one that is said: the others may be noise
_LEAVES = 0.5  # of that distance, by which a limited slope leaves the recording
_COUNTS = 2.0  # of the position: a narrower piece is never met
_TURNING = 0.6  # of the stiffness that a device can render is for the branches; the rest is for crossing between them
_BISECTIONS = 6
_HALVINGS = 60  # of a stiffness, until one is stable
_WIDER = 20  # steps of the distance from the recording, until so few points are enough

LINK = "button"
"""Name of the link that has the curve."""


class Curve(NamedTuple):
    """Points of one branch, or of press and release, at the same distances."""

    x: Floats
    """Distances, m."""
    branches: list[Floats]
    """Forces, N."""
    turn: float | None = None
    """Way over which the force crosses from branch to branch, m."""

    @property
    def slopes(self) -> Floats:
        """Slopes (branches, pieces), N/m."""
        return np.asarray(np.diff(self.branches) / np.diff(self.x))

    @property
    def value(self) -> Any:
        """The value of `force_over_distance`."""
        each = [np.column_stack((self.x, force)).tolist() for force in self.branches]
        turn = {} if self.turn is None else {"turn": self.turn}
        return each[0] if len(each) == 1 else dict(zip(("press", "release"), each, strict=True)) | turn

    @property
    def steepest(self) -> float:
        """Largest slope of the force, N/m, also while it crosses between branches."""
        return float(self.slopes.max()) if len(self.branches) == 1 else Branches(**self.value).steepest

    def turning(self, steepest: float, turn: float | None) -> Curve:
        """Returns the curve with this `turn`; None: 2 % of the range, or more where it would be steeper than this."""
        if len(self.branches) == 1:
            return self
        branches = Branches(**self.value)
        return self._replace(turn=turn or max(branches.width, branches.least_turn(1.0, 0.5, steepest)))


@dataclass(frozen=True)
class Deviation:
    """Distance of a curve from the rows of a recording, N."""

    rms: float
    largest: float
    place: float
    """Distance at which it is largest, m."""
    rows: int


@dataclass(frozen=True)
class Steep:
    """Part of a recording in which the curve is less steep: that leaves room for crossing between branches, too."""

    low: float
    high: float
    slope: float
    """Slope of the recording, N/m."""
    buzzes: bool
    """True if the device would buzz on it."""


@dataclass(frozen=True)
class MadeCurve:
    """A curve, how close it is to the recording, and what is predicted of it."""

    DOCUMENT = (
        "rows=recording.rows strokes=recording.strokes notes=recording.notes distances_m=curve.x "
        "forces_n=curve.branches turn_m=curve.turn within_n=within deviation deviation_rendered=rendered steep "
        "steepest_n_m=steepest damping needed_damping needed_rate_hz=needed_rate stable=prediction.stable regions"
    )

    recording: Recording
    curve: Curve
    within: float
    """Largest distance from the recording without noise where the device can render the slope, N."""
    deviation: Deviation
    """Deviation of the curve from all rows of the recording."""
    rendered: Deviation
    """The same where the device can render the slope."""
    steep: tuple[Steep, ...]
    steepest: float
    """Stiffness that the device can render, N/m, with turns; infinite if the recording has no larger one."""
    damping: float
    """Damping of the scene, N·s/m."""
    needed_damping: float
    """Damping with which the whole recording would be rendered, N·s/m; infinite if none was found."""
    needed_rate: float
    """Rate for the same, Hz."""
    prediction: Prediction

    @property
    def regions(self) -> tuple[Region, ...]:
        """Regions of the hand that have a force."""
        return next(iter(self.prediction.regions.values()), ())

    def felt(self) -> list[Floats]:
        """Returns the stiffness, N/m, that the hand feels in each piece of each branch; that of the curve where nothing
        holds it."""
        each = []
        for slopes in self.curve.slopes:
            x, felt = self.curve.x, []
            for low, high, slope in zip(x, x[1:], slopes, strict=False):
                there = [one for one in self.regions if one.piece.low <= 0.5 * (low + high) <= one.piece.high]
                near = min(there, key=lambda one: abs(one.piece.stiffness - slope), default=None)
                felt.append(near.held.k / near.piece.stiffness * slope if near and near.held else slope)
            each.append(np.array(felt))
        return each


class Maker:
    """Makes curves and scenes for the device of a scene."""

    def __init__(self, base: Scene, recording: Recording) -> None:
        """Raises UsageError: the scene has several hands, or moves otherwise than the recording."""
        base.require_line("a curve is over one")
        if base.channels > 1:
            raise UsageError(f"{base.path or 'the scene'}: found several channels, expected a scene of one")
        if base.units.is_rotary is not (recording.motion == "rotary"):
            own = base.device.motions(1)[0]
            raise UsageError(
                f"{base.path or 'the scene'}: found a {own} device, expected the recording's motion, "
                f"{recording.motion}; --scene names another"
            )
        self.base, self.recording = base, recording
        self.damping = max(0.0, predict(base, with_margins=False).felt[0].damping)

    def text(self, value: Any, damping: float, rate: float, head: str = "") -> str:
        """Returns a scene with a value of `force_over_distance`."""
        device = self.base.device.model_dump(mode="json", exclude_unset=True, exclude_none=True, exclude={"correction"})
        mock = self.base.mock and self.base.mock.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        modules = {
            "hand": {"type": "device", "channel": 0},
            "base": {"type": "ground", "position": 0.0},
            **({"damping": {"type": "damper", "between": ["hand", "base"], "damping": damping}} if damping else {}),
            LINK: {"type": "nonlinear", "between": ["hand", "base"], "force_over_distance": value},
        }
        scene = {"version": 1, "rate": rate, "device": device, **({"mock": mock} if mock else {}), "modules": modules}
        return head + yaml.safe_dump(scene, sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)

    def predict(self, curve: Curve, damping: float | None = None, rate: float | None = None) -> Prediction:
        """Returns the prediction of a curve, with the scene's damping (N·s/m) and rate (Hz) or others."""
        values = self.damping if damping is None else damping, self.base.rate if rate is None else rate
        scene = parse_scene(self.text(curve.value, *values))
        scene._written = self.recording.written
        return predict(scene, with_margins=False)

    def make(self, within: float | None = None, turn: float | None = None, one_branch: bool = False) -> MadeCurve:
        """Returns the curve.

        Args:
            within: how far it may be from the smooth recording, N.
            turn: way over which the force crosses between the branches, m.
            one_branch: whether it is to have the mean of press and release.

        Raises:
            UsageError: the device cannot render any spring.
        """
        x, branches = smooth(self.recording.branches)
        if len(branches) == 2 and self.base.device.law == "board":
            one_branch = True
            self.recording.notes.append("The board of the device follows one branch: the mean of press and release.")
        shared = [(one, (one.x >= x[0]) & (one.x <= x[-1])) for one in self.recording.branches]
        rows = [(one.x[there], one.force[there]) for one, there in shared]
        noise = _deviation(Curve(x, branches), rows).rms
        within = max(_SHARE * float(np.ptp(branches)), _NOISES * noise) if within is None else within
        if len(branches) == 2 and (one_branch or float(np.max(branches[0] - branches[1])) <= within):
            branches = [0.5 * (branches[0] + branches[1])]
        for end in (0, -1):  # beyond it the force is the same: a rest of it would push the hand for ever
            if max(abs(force[end]) for force in branches) <= within:
                branches = [np.where(np.arange(x.size) == end % x.size, 0.0, force) for force in branches]
        smoothed = Curve(x, branches)
        whole = self._thinned(smoothed, within).turning(math.inf, turn)
        curve, rounded, steepest, needed = whole, smoothed, math.inf, (math.nan, math.nan)
        if not (prediction := self.predict(whole)).stable:
            needed = self._needed(whole)
            steepest = _RENDERED * self._steepest(whole)
            for _ in range(_BISECTIONS):
                own = steepest if len(branches) == 1 else _TURNING * steepest
                rounded = Curve(*limited(x, branches, own))
                curve = self._thinned(rounded, within).turning(steepest, turn)
                if (prediction := self.predict(curve)).stable:
                    break
                steepest *= _RENDERED
        steep, off = _steep(smoothed, rounded, within, steepest / _RENDERED), _deviation(curve, rows)
        fair = _deviation(curve, [_outside(of, steep) for of in rows]) if steep else off
        return MadeCurve(self.recording, curve, within, off, fair, steep, steepest, self.damping, *needed, prediction)

    @property
    def narrowest(self) -> float:
        """Width of the narrowest piece that the counts of the device resolve, m."""
        return _COUNTS * max(self.base.mock_device.quantum)

    def _thinned(self, of: Curve, within: float) -> Curve:
        for _ in range(_WIDER):
            try:
                chosen = thinned(of.x, of.branches, within, self.narrowest)
                return Curve(of.x[chosen], [force[chosen] for force in of.branches])
            except UsageError:
                within *= 1.5  # the counts are coarser than what is recorded
        raise UsageError("the counts of the device are coarser than the recording; --scene names another device")

    def _steepest(self, of: Curve) -> float:
        """Returns the largest stiffness up to that of a curve with which the hand is stable, N/m. UsageError: none."""
        line = np.array([-1.0, 1.0]) * float(np.ptp(of.x))

        def is_stable(stiffness: float) -> bool:
            return self.predict(Curve(line, [stiffness * line])).stable

        good = next((stiffness for by in range(_HALVINGS) if is_stable(stiffness := of.steepest * 0.5**by)), 0.0)
        if not good:
            raise UsageError("the device can render no spring: it needs friction, or its scene a damping")
        return self._bisected(good, 2.0 * good, is_stable)

    def _needed(self, of: Curve) -> tuple[float, float]:
        """Returns the damping, N·s/m, and the rate, Hz, with which a curve is stable; infinite if none was found."""

        def least(now: float, is_stable: Callable[[float], bool]) -> float:
            """Returns the least stable multiple of the present value; infinite if none is."""
            tried = [now * by for by in _FACTORS]
            good = next(filter(is_stable, tried), math.inf)
            return (
                good if math.isinf(good) else self._bisected(good, max([now, *tried[: tried.index(good)]]), is_stable)
            )

        return (
            least(self.damping or 1.0, lambda damping: self.predict(of, damping=damping).stable),
            least(self.base.rate, lambda rate: self.predict(of, rate=rate).stable),
        )

    @staticmethod
    def _bisected(good: float, bad: float, is_stable: Callable[[float], bool]) -> float:
        for _ in range(_BISECTIONS):
            middle = math.sqrt(good * bad)
            good, bad = (middle, bad) if is_stable(middle) else (good, middle)
        return good


def _outside(rows: tuple[Floats, Floats], steep: Sequence[Steep]) -> tuple[Floats, Floats]:
    """Returns the rows that are in none of these parts."""
    x, force = rows
    kept = np.all([(x < one.low) | (x > one.high) for one in steep], axis=0)
    return x[kept], force[kept]


def _deviation(curve: Curve, rows: Sequence[tuple[Floats, Floats]]) -> Deviation:
    """Returns how far the rows of each branch are from a curve."""
    places, off = [], []
    for at, (x, force) in enumerate(rows):
        places.append(x)
        off.append(force - np.interp(x, curve.x, curve.branches[min(at, len(curve.branches) - 1)]))
    every, away = np.concatenate(places), np.abs(np.concatenate(off))
    if not every.size:
        return Deviation(0.0, 0.0, math.nan, 0)
    worst = int(np.argmax(away))
    return Deviation(float(np.sqrt(np.mean(away**2))), float(away[worst]), float(every[worst]), every.size)


def _steep(smoothed: Curve, rounded: Curve, within: float, stable: float) -> tuple[Steep, ...]:
    """Returns the parts in which a slope was limited by so much that the curve leaves the recording. `stable`: the
    largest stiffness that does not buzz, N/m."""
    x = smoothed.x
    away = np.zeros(x.size, bool)
    for force, made in zip(smoothed.branches, rounded.branches, strict=True):
        away |= np.abs(np.interp(x, rounded.x, made) - force) > _LEAVES * within
    edges = np.flatnonzero(np.diff(np.concatenate(([False], away, [False])).astype(int)))
    slopes = np.max(np.diff(smoothed.branches) / np.diff(x), axis=0)
    parts = [(max(a - 1, 0), min(b, x.size - 1)) for a, b in edges.reshape(-1, 2).tolist()]
    each = [(float(x[a]), float(x[b]), float(np.quantile(slopes[a:b], _MOST))) for a, b in parts]
    return tuple(Steep(low, high, slope, slope > stable) for low, high, slope in each)
