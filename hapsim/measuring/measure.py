"""measure: excites a hand on its scene, and identifies the spring and damper that the hand feels."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from hapsim.errors import DeviceError, UsageError
from hapsim.loop.ring import LIMITED
from hapsim.measuring.measure_admittance import measure_admittance
from hapsim.measuring.measure_plane import measure_in_plane
from hapsim.measuring.measure_trace import Attempt, Measurement, TooLittleMotionError, measure_trace
from hapsim.measuring.measurement_options import (
    SHARE_OF_LIMIT,
    Run,
    RunOptions,
    force_limit,
    require_pushable,
)
from hapsim.measuring.place import Place, place_of, place_on_branch
from hapsim.measuring.pushes import LEAST_ROWS, duration_of, pushes, recorded
from hapsim.measuring.trace_quality import explained, silence
from hapsim.recording.trace import Trace
from hapsim.running import Excitation
from hapsim.running.motors import as_limited
from hapsim.running.run import run_to_end
from hapsim.scene import Scene
from hapsim.scene.choices import AHEAD
from hapsim.scene.input_states import with_mock_inputs_on
from hapsim.scene.load import SceneSource, as_scene

_MOST_RUNS = 5
_FINE, _FINE_IN_TIME = 2e-6, 1e-4  # relative uncertainty of k and b that is enough, in virtual and in real time
_UNSURE = 0.1  # the largest relative uncertainty of k that is reported
_PLENTY = 1e5  # counts: if the hand may swing farther, the counts are not why nothing is identified
_LARGER = 1.5  # times the push: a smaller increase is not worth another run
_CLEAR_COUNTS = 80.0  # of a second run, after one with too little motion


def measure(
    scene: SceneSource,
    *,
    channel: int = 0,
    at: float | tuple[float, float] | None = None,
    duration: float | None = None,
    push: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> Any:
    """Excites a hand and identifies the spring and damper that it feels: a `Measurement` by `measure_on_line`, or in a
    scene with space: 2 a `HandsMeasurement` of both coordinates by `measure_in_plane`, which have the arguments. With
    mode: admittance an `AdmittanceMeasurement` of the mass and damping, by `measure_admittance`."""
    scene = as_scene(scene)
    if scene.device.is_admittance:
        if at is not None:
            raise UsageError(f"at: found {at}, expected none with mode: admittance: mock.hand.position rests the hand")
        return measure_admittance(with_mock_inputs_on(scene), channel, duration, push, run, **options)
    by_space: Any = measure_on_line
    if scene.space > 1:
        if at is not None and not isinstance(at, tuple):
            raise UsageError(f"at: found {at:g}, expected (x, y) in a scene with space: 2")
        by_space = measure_in_plane
    elif isinstance(at, tuple):
        raise UsageError(f"at: found {at[0]:g},{at[1]:g}, expected one position in a scene with one coordinate")
    return by_space(scene, channel=channel, at=at, duration=duration, push=push, run=run, **options)


def measure_on_line(
    scene: SceneSource,
    *,
    channel: int = 0,
    at: float | None = None,
    duration: float | None = None,
    push: float | None = None,
    branch: str | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> Measurement:
    """Excites the hand on `channel` and identifies the spring and damper that it feels.

    During the first half of `duration` (s) the motion decays once, from the mock's initial state or from a push of a
    device at rest. Then pushes follow, so that a motion of a few samples is recorded many times. `push`: the largest
    force of a push, N [default: a quarter of the force limit; if the hand moves too little, a second run pushes
    harder]. An adaptive correction is pushed all the time. Its second half is identified, with the mass that it has
    estimated.

    `at`: the position in m, from the scene's position 0. The hand is led there first, in 4 to 9 s more, and a constant
    force then holds it. A scene with contacts, tables, detents or dry friction is always measured at a position
    [default: where the hand rests, or is held nearest to position 0]. Up to 5 runs then find the best push: it begins
    just above the noise, grows for less uncertainty, and halves if the hand left its region. With `push` there is one
    run. The measurement's `attempts` list the runs.

    `branch`: "press" or "release": k and b are those of a hand that slides along this branch of its curve with two.
    The pushes are so large that it does, and only the samples on the branch are identified. Else it is measured stuck
    between the branches.

    `run` runs the scene, with `options`: `transport`, `on_progress`, `stop_on_signals` and `unstable` of `hapsim.run`.
    Raises the errors of `run`, and UsageError if too little moves to identify anything, or if no hand can be measured
    at that position. If the device fails or stops by itself after enough was recorded, returns the measurement with
    the error as its `failure`.
    """
    scene = with_mock_inputs_on(as_scene(scene))
    require_pushable(scene, [channel], duration, push)
    scene, run = as_limited(scene, [channel], push, run, options)
    duration = duration_of(scene, duration)
    place = place_of(scene, channel, at) if branch is None else place_on_branch(scene, channel, at, branch)
    if place is not None:
        return _measure_at(run, scene, place, duration, push)
    return _measure_where_it_is(run, scene, channel, duration, push)


def _measure_where_it_is(run: Run, scene: Scene, channel: int, duration: float, push: float | None) -> Measurement:
    """Returns the only run; without a `push` (N) the second, with larger pushes, if the hand moved too little."""
    excitation = pushes(scene, channel, duration, push)
    trace, failure = recorded(run, scene, excitation, duration)
    try:
        return _identified(scene, excitation, trace, failure)
    except TooLittleMotionError as nothing:
        moved = float(np.ptp(trace.position_counts[:, channel].astype(float)))
        larger = min(_CLEAR_COUNTS / max(moved, 1.0), 1.0 / SHARE_OF_LIMIT)
        harder = pushes(scene, channel, duration, push, larger=larger)
        before, now = (one.force * one.ticks for one in (excitation, harder))
        if push is not None or trace.report.ending != "done" or now <= _LARGER * before:
            raise
        return _repeated(run, scene, duration, excitation.force, harder, nothing)


def _repeated(
    run: Run, scene: Scene, duration: float, pushed: float, harder: Excitation, nothing: TooLittleMotionError
) -> Measurement:
    """Returns the run with `harder` pushes, after `nothing` was identified with pushes of `pushed` N."""
    found, unsure = None, math.inf
    with suppress(TooLittleMotionError):
        found = _identified(scene, harder, *recorded(run, scene, harder, duration))
        unsure = found.k_uncertainty / abs(found.k) if found.k else math.inf
    if found is None or not unsure <= _UNSURE:
        units = scene.units_of(harder.channel)
        limit, first, second = (units(one, "N", 3) for one in (force_limit(scene), pushed, harder.force))
        raise TooLittleMotionError(f"{nothing}, up to the force limit of {limit}; tried: {first} and {second}")
    attempts = (Attempt(pushed, "", math.nan, math.inf), Attempt(harder.force, "", found.k, unsure))
    return replace(found, attempts=attempts)


def _identified(scene: Scene, excitation: Excitation, trace: Trace, failure: DeviceError | None) -> Measurement:
    """Identifies a run; of an adaptive correction the second half, with the mass that it has estimated. Raises
    `failure` or UsageError if nothing is identified."""
    device, channel, guide, half = scene.device, excitation.channel, excitation.guide, trace.sample.size // 2
    mass = device.masses(scene.channels)[channel]
    uncertainty = device.mass_uncertainties(scene.channels)[channel]
    estimated = trace.report.estimated_mass_kg
    if channel < len(estimated) and (known := estimated[channel]) is not None:
        mass, uncertainty = known, trace.report.estimated_mass_uncertainty_kg[channel]
    settled = device.correction == "adaptive" and trace.sample.size - half >= LEAST_ROWS
    with explained(trace, channel, failure):
        rows = trace.since(half) if settled else trace
        found = measure_trace(rows, mass, channel, uncertainty, pressed=guide is not None)
    return replace(found, failure=failure, push_n=excitation.force, at_m=None if guide is None else guide.target)


def _measure_at(run: Run, scene: Scene, place: Place, duration: float, push: float | None) -> Measurement:
    """Returns the most certain run in which the hand stayed in its region; with a `push` (N) the only run."""
    swing, most, best, least = place.first_swing(scene), place.expected_swing, None, math.inf
    attempts: list[Attempt] = []
    fine = _FINE if scene.device.clock == "lockstep" else _FINE_IN_TIME
    clear, limited = 0.0, 0  # m, the largest swing within the region; most samples of a run at the force limit
    while len(attempts) < _MOST_RUNS:
        excitation = pushes(scene, place.channel, duration, push, place, swing)
        trace, failure = recorded(run, scene, excitation, duration)
        guided = excitation.ticks_before(scene.rate)
        if trace.sample.size <= guided:
            raise UsageError("the run was stopped before the hand was at its place: nothing was measured")
        count_m = float(trace.position_scale[place.channel])
        try:
            place.require_arrival(trace.position[:guided, place.channel], count_m)
        except UsageError as elsewhere:
            if failure is None:
                raise
            raise failure from elsewhere
        place, bent = place.unbent(trace.position[:guided, place.channel])
        rows, trace = place.rows(scene, trace, guided), trace.since(guided)
        limited = max(limited, int(np.count_nonzero(trace.flags & LIMITED)))
        found = None
        try:
            found = replace(_identified(scene, excitation, rows, failure), trace=trace)
            bent += place.bend(place.swing_in(trace)) * found.k
            found = replace(found, k_uncertainty=math.hypot(found.k_uncertainty, bent))
        except UsageError:
            is_plenty = not place.branch and place.largest_swing > _PLENTY * count_m
            if push is not None or is_plenty or silence(trace, place.channel):
                raise
        noise_m = max(count_m, 0.0 if found is None else found.residual_m)
        left = place.left_by(trace, noise_m, scene.device.correction in AHEAD)
        unsure = math.inf if found is None or not found.dominant else place.share_unknown(found)
        attempts.append(Attempt(excitation.force, left, math.nan if found is None else found.k, unsure))
        if push is not None or not place.has_regions or failure is not None or trace.report.ending != "done":
            best, least = found, 0.0
            break
        if left:
            most = wanted = 0.5 * swing
        else:
            wanted = min(swing * place.growth(swing, unsure / fine, unsure), most)
            clear = max(clear, swing)
            if unsure < least:
                best, least = found, unsure
        if wanted < _LARGER * clear:
            break
        swing = wanted
    if best is None or least > _UNSURE:
        raise UsageError(place.too_small(count_m, attempts, best or found, limited))
    return replace(best, attempts=tuple(attempts))
