"""measure: excites a hand on its scene, and identifies the spring and damper that the hand feels."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Unpack

import numpy as np

from hapsim.errors import DeviceError, GuardError, UsageError
from hapsim.measuring.measure_trace import Attempt, Measurement, TooLittleMotionError, measure_trace
from hapsim.measuring.measurement_options import (
    SHARE_OF_LIMIT,
    Run,
    RunOptions,
    force_limit,
    largest_push,
    require_above_zero,
    require_device_point,
)
from hapsim.measuring.place import Place, place_of
from hapsim.measuring.trace_quality import silence
from hapsim.recording.trace import Trace
from hapsim.running import Excitation
from hapsim.running.run import run_to_end
from hapsim.scene import Scene, Spring, ViscoElastic
from hapsim.scene.choices import AHEAD
from hapsim.scene.load import SceneSource, as_scene

_SECONDS = 2.0
_LEAST_TICKS, _MOST_TICKS = 2048, 20000
_PUSHES = 40  # in the second half of a measurement; the first is one ring-down
_SHARE_OF_TRAVEL = 0.25
_COUNTS = 2.0**31
_LEAST_ROWS = 32
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
    at: float | None = None,
    duration: float | None = None,
    push: float | None = None,
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

    `run` runs the scene, with `options`: `transport`, `on_progress`, `stop_on_signals` and `unstable` of `hapsim.run`.
    Raises the errors of `run`, and UsageError if too little moves to identify anything, or if no hand can be measured
    at that position. If the device fails or stops by itself after enough was recorded, returns the measurement with
    the error as its `failure`.
    """
    scene, run = as_scene(scene), partial(run, **options)
    require_device_point(scene, channel)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units_of(channel).name("newton"), push=push)
    if duration is None:
        duration = min(max(_SECONDS, _LEAST_TICKS / scene.rate), _MOST_TICKS / scene.rate)
    place = place_of(scene, channel, at)
    if place is not None:
        return _measure_at(run, scene, place, duration, push)
    return _measure_where_it_is(run, scene, channel, duration, push)


def _measure_where_it_is(run: Run, scene: Scene, channel: int, duration: float, push: float | None) -> Measurement:
    """Returns the only run; without a `push` (N) the second, with larger pushes, if the hand moved too little."""
    excitation = pushes(scene, channel, duration, push)
    trace, failure = _recorded(run, scene, excitation, duration)
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
        found = _identified(scene, harder, *_recorded(run, scene, harder, duration))
        unsure = found.k_uncertainty / abs(found.k) if found.k else math.inf
    if found is None or not unsure <= _UNSURE:
        units = scene.units_of(harder.channel)
        limit, first, second = (units(one, "N", 3) for one in (force_limit(scene), pushed, harder.force))
        raise TooLittleMotionError(f"{nothing}, up to the force limit of {limit}; tried: {first} and {second}")
    attempts = (Attempt(pushed, "", math.nan, math.inf), Attempt(harder.force, "", found.k, unsure))
    return replace(found, attempts=attempts)


def _recorded(run: Run, scene: Scene, excitation: Excitation, duration: float) -> tuple[Trace, DeviceError | None]:
    """Runs the excitation for `duration` s. Returns the trace, and the error that ended it early or None. Raises
    DeviceError if too little was recorded."""
    guided = excitation.ticks_before(scene.rate)
    try:
        trace, failure = run(scene, duration=duration + guided / scene.rate, excitation=excitation), None
    except (DeviceError, GuardError) as error:
        recorded = 0 if error.trace is None else error.trace.sample.size
        if excitation.guide is not None and 0 < recorded < guided:
            where = scene.units_of(excitation.channel)(excitation.guide.target, "m")
            error.args = (f"while the hand was led to {where}, by a force besides the scene's: {error}",)
        if isinstance(error, GuardError) or recorded < guided + _LEAST_ROWS:
            raise
        trace, failure = error.trace, error
    return trace, failure


def _identified(scene: Scene, excitation: Excitation, trace: Trace, failure: DeviceError | None) -> Measurement:
    """Identifies a run; of an adaptive correction the second half, with the mass that it has estimated. Raises
    `failure` or UsageError if nothing is identified."""
    device, channel, guide, half = scene.device, excitation.channel, excitation.guide, trace.sample.size // 2
    mass = device.masses(scene.channels)[channel]
    uncertainty = device.mass_uncertainties(scene.channels)[channel]
    estimated = trace.report.estimated_mass_kg
    if channel < len(estimated) and (known := estimated[channel]) is not None:
        mass, uncertainty = known, trace.report.estimated_mass_uncertainty_kg[channel]
    settled = device.correction == "adaptive" and trace.sample.size - half >= _LEAST_ROWS
    try:
        rows = trace.since(half) if settled else trace
        found = measure_trace(rows, mass, channel, uncertainty, pressed=guide is not None)
    except UsageError as nothing:
        if failure is not None:
            raise failure from nothing
        if reason := silence(trace, channel):
            raise UsageError(reason) from nothing
        raise
    return replace(found, failure=failure, push_n=excitation.force, at_m=None if guide is None else guide.target)


def _measure_at(run: Run, scene: Scene, place: Place, duration: float, push: float | None) -> Measurement:
    """Returns the most certain run in which the hand stayed in its region; with a `push` (N) the only run."""
    swing, most, best, least = place.first_swing(scene), place.largest_swing, None, math.inf
    attempts: list[Attempt] = []
    fine = _FINE if scene.device.clock == "lockstep" else _FINE_IN_TIME
    clear = 0.0  # m, the largest swing within the region
    while len(attempts) < _MOST_RUNS:
        excitation = pushes(scene, place.channel, duration, push, place, swing)
        trace, failure = _recorded(run, scene, excitation, duration)
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
        trace = trace.since(guided)
        found = None
        try:
            found = _identified(scene, excitation, trace, failure)
            bent = place.bend(place.swing_in(trace)) * found.k
            found = replace(found, k_uncertainty=math.hypot(found.k_uncertainty, bent))
        except UsageError:
            if push is not None or place.largest_swing > _PLENTY * count_m or silence(trace, place.channel):
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
        raise UsageError(place.too_small(count_m, attempts, best or found))
    return replace(best, attempts=tuple(attempts))


def pushes(
    scene: Scene,
    channel: int,
    duration: float,
    push: float | None,
    place: Place | None = None,
    swing: float = math.inf,
    *,
    larger: float = 1.0,
) -> Excitation:
    """Returns pushes that move the hand clearly, within the device's force, range and travel: `larger` times as far as
    usual. At a `place` they move it by `swing` m, and a push of `push` N lasts one radian of the spring's oscillation.
    """
    device, mock = scene.device, scene.mock_device
    mass, ticks = device.masses(scene.channels)[channel], math.ceil(duration * scene.rate)
    free = 0 if device.correction == "adaptive" else ticks // 2
    every = max(32, (ticks - free) // _PUSHES)
    rests_s = max(free, every) / scene.rate
    # Until the next push even a free mass must stay in the range of its counts. A real device reports its range later.
    range_m = mock.quantum[channel] * _COUNTS if device.port is None else math.inf
    kick = larger * mass * device.scales(scene.channels)[channel].kick
    wanted = kick if push is None else max(kick, push / scene.rate)
    impulse = min(wanted, mass * min(0.05 * range_m / rests_s, _kick_within_travel(scene, channel, rests_s)))
    most = min(larger * largest_push(scene, push), force_limit(scene))
    longest = every // 2
    if place is not None:
        eigen = math.sqrt(max(place.stiffness, 0.0) / mass)  # rad/s
        length = max(1, min(longest, round(scene.rate / eigen))) if eigen > 0.0 else longest
        impulse = min(impulse, swing * max(mass * eigen, place.damping, mass / rests_s))
        force = min(most, impulse * scene.rate / length) if push is None else most
        return Excitation(channel, force, length, every, start=free, first=True, guide=place.guide(scene))
    force = min(most, impulse * scene.rate)
    at_rest = device.port is not None or (
        mock.initial_velocity[channel] == 0.0
        and device.origins(scene.channels)[channel] in (None, mock.initial_position[channel])
    )
    length = longest if impulse * scene.rate > longest * force else max(1, round(impulse * scene.rate / force))
    return Excitation(channel, force, length, every, start=free, first=at_rest)


def _kick_within_travel(scene: Scene, channel: int, rests_s: float) -> float:
    """Returns the velocity in m/s at which the hand uses no more than _SHARE_OF_TRAVEL of device.travel until a spring,
    or else the next push, returns it. Its place of rest within the travel is not known before arming."""
    least, most = scene.device.travels(scene.channels)[channel]
    point = next(name for name, one in scene.device_points.items() if one.channel == channel)
    springs = (one for one in scene.links.values() if point in one.between and isinstance(one, ViscoElastic | Spring))
    stiffness = scene.device.stiffnesses(scene.channels)[channel] + sum(one.stiffness for one in springs)
    swing_s = math.sqrt(scene.device.masses(scene.channels)[channel] / stiffness) if stiffness > 0.0 else math.inf
    return _SHARE_OF_TRAVEL * (most - least) / min(rests_s, swing_s)
