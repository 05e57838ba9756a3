"""measure_ports: pushes each of the hands that links tie across devices, and identifies what they feel of each other.

Each device samples by a clock of its own, so the free motion of one hand is known at other times than that of another.
The others' positions are interpolated, by a cubic spline through their samples, to the times of the hand that is
pushed. Then they are those of hands on one device (`measure_hands`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from hapsim.errors import UsageError
from hapsim.measuring.converters import Floats
from hapsim.measuring.measure_hands import (
    SECONDS,
    HandsMeasurement,
    free_motions,
    identify_free_motions,
    linked_to,
    repeated_pushes,
    with_noise,
)
from hapsim.measuring.measurement_options import require_above_zero
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace
from hapsim.running.motors import as_limited
from hapsim.running.run import run, traces_to_end
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene
from hapsim.scene.scaled_links import energy_weights

_SHARE_UNSTEADY = 0.02  # of the motion apart


@dataclass(frozen=True)
class PortsMeasurement:
    """k and b of hands on several devices.

    Attributes:
        hands: names of the device points.
        masses: of these, (n,) kg.
        found: k and b, in the order of the hands.
        weights: (n,) of their energies, of a link with a gain (scene/scaled_links.py).
    """

    hands: tuple[str, ...]
    masses: Floats
    found: HandsMeasurement
    weights: Floats

    @property
    def tie(self) -> dict[str, tuple[float, float]]:
        """k in N/m and b in N·s/m of one spring and damper on the reduced mass of two hands, each with its standard
        uncertainty: what they feel when they move apart."""
        weighted = self.weights / self.weights[0]
        masses = weighted * self.masses
        apart = masses[::-1] * (1.0, -1.0) / masses.sum()
        weights = np.outer(weighted * apart, apart)
        of = {"k": (self.found.k, self.found.k_uncertainty), "b": (self.found.b, self.found.b_uncertainty)}
        return {
            name: (float(np.sum(weights * value)), float(np.linalg.norm(weights * unsure)))
            for name, (value, unsure) in of.items()
        }


def measure_ports(
    scene: SceneSource, *, duration: float | None = None, push: float | None = None, **options: Any
) -> PortsMeasurement:
    """Pushes the hands that links tie across devices, one after the other, while all devices record.

    `duration`: seconds for each hand [default: 4]; `push`: largest force, N; `options`: of `hapsim.start`. Raises its
    errors, and UsageError if no hands are tied across devices, or if their motion does not show springs and dampers.
    """
    scene = as_scene(scene)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units.name("newton"), push=push)
    hands, seconds = tied_hands(scene), SECONDS if duration is None else duration
    points = {name: scene.device_points[name] for name in hands}
    if len({scene.units_at(hand).is_rotary for hand in hands}) > 1:
        raise UsageError("found linear and rotary hands, expected hands of one motion; measure each by its --device")
    traces, segments = list[Trace](), list[Floats]()
    for number, point in enumerate(points.values()):
        port, at_port = str(point.of), scene.at_port(str(point.of))
        limited, _ = as_limited(at_port, [point.channel], push, run, options | {"on_warning": None})
        excitation = repeated_pushes(limited, point.channel, seconds, push)
        options |= {"duration": seconds, "excitation": {port: excitation}}
        found = traces_to_end(with_noise(scene, number), **options)
        traces += found.values()
        rows = on_one_clock(found, port, [(str(one.of), one.channel) for one in points.values()])
        motions = free_motions(rows, excitation, at_port.device.delay, list(range(len(hands))))
        segments += [_at_rate(one, rows.rate, scene.rate) for one in motions]
    every_mass = {port: scene.at_port(port).device.masses(scene.at_port(port).channels) for port in scene.ports}
    masses = np.array([every_mass[str(one.of)][one.channel] for one in points.values()])
    of_hands = energy_weights(scene)
    weights = np.array([of_hands.get(hand, 1.0) for hand in hands])
    with one_thread():
        channels = tuple(range(len(hands)))
        measured = identify_free_motions(
            segments,
            np.diag(masses),
            scene.rate,
            _is_held(scene, hands),
            channels,
            tuple(traces),
            weights,
            floor=_unsteady(segments),
        )
    return PortsMeasurement(hands, masses, measured, weights)


def _unsteady(segments: list[Floats]) -> float:
    """Returns what the drift of the clocks' phases may change of the hands' motion, m: k by some 0.1 %, so that one
    free motion has not quite the poles of the next."""
    apart = np.concatenate([np.diff(one - one.mean(axis=0), axis=1) for one in segments])
    return _SHARE_UNSTEADY * float(np.sqrt(np.mean(np.square(apart))))


def tied_hands(scene: Scene) -> tuple[str, ...]:
    """Returns the device points that links tie across devices. Raises UsageError if there are none, or several such
    groups."""
    groups = list[tuple[str, ...]]()
    for name in scene.device_points:
        reached = linked_to(scene, {name})
        group = tuple(one for one in scene.device_points if one in reached)
        if len({scene.device_points[one].of for one in group}) > 1 and group not in groups:
            groups.append(group)
    if len(groups) != 1:
        found = "; ".join(" and ".join(one) for one in groups) or "none"
        raise UsageError(f"found hands that links tie across devices: {found}; expected one group of them")
    return groups[0]


def _is_held(scene: Scene, hands: tuple[str, ...]) -> bool:
    """Returns True if something holds these hands at a place of rest."""
    at_ports = (scene.at_port(str(scene.device_points[one].of)) for one in hands)
    springs = [max(one.device.stiffnesses(one.channels)) for one in at_ports]
    return bool(linked_to(scene, {*hands}) & scene.grounds.keys()) or max(springs) > 0.0


def on_one_clock(traces: Mapping[str, Trace], port: str, hands: list[tuple[str, int]]) -> Trace:
    """Returns the trace of a port with the positions of these hands, (port, channel) each, at the times of its own
    rows, in m. Its rate is that of its device by the host's clock."""
    times = {name: _times(one) for name, one in traces.items()}
    first, last = max(one[0] for one in times.values()), min(one[-1] for one in times.values())
    of = traces[port]
    kept = (times[port] >= first) & (times[port] <= last)
    at, flags, columns = times[port][kept], of.flags[kept].copy(), list[Floats]()
    for name, channel in hands:
        columns.append(CubicSpline(times[name], traces[name].position[:, channel])(at))
        flags |= traces[name].flags[np.minimum(np.searchsorted(times[name], at), times[name].size - 1)]
    sample = of.sample[kept]
    rate = float(sample[-1] - sample[0]) / float(at[-1] - at[0])
    rows = {name: getattr(of, name)[kept] for name in ("sample", "time_ns", "force_counts", "asked_force")}
    each: Any = np.column_stack(columns)
    return replace(of, rate=rate, flags=flags, position_counts=each, position_scale=np.ones(len(hands)), **rows)


def _at_rate(motion: Floats, found: float, wanted: float) -> Floats:
    """Returns a motion that was sampled at one rate as it is at another, Hz."""
    count = len(motion)
    at = np.arange(int((count - 1) * wanted / found) + 1) / wanted
    return np.asarray(CubicSpline(np.arange(count) / found, motion)(at)) if count > 1 else motion


def _times(trace: Trace) -> Floats:
    """Returns the times of a trace's rows on the clock that all ports share, s."""
    if trace.report.virtual_time:
        return np.asarray(trace.time_ns * 1e-9)
    return np.asarray(trace.time_s + 1e-9 * trace.timeline.start_ns)
