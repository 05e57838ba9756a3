"""identify_servo: commands a chirp to a device in admittance, and finds its servo, its delay and the handle's mass.

The simulated mass, on a soft spring to the home position, is pushed so that it moves in a chirp: at each frequency as
far as travel, speed, acceleration and force allow. The device gets that motion as commands. Both are recorded, so that
neither the mass nor a force of the hand matters. Over whole periods of the chirp the ratio of positions and commands at
each of its frequencies is the servo's response; what differs from period to period is noise. It is fitted by a servo of
second order that holds its commands from n + delay on, and by a device that follows in straight lines from sample to
sample. The better one counts. With no hand on the handle, the sensed force is that of the mass beyond the sensor: its
sign shows whether the sensor is connected the right way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Unpack

import numpy as np
from scipy.optimize import least_squares

from hapsim.errors import UsageError
from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.measuring import measurement_options
from hapsim.measuring.converters import Complexes, Converters, Floats
from hapsim.measuring.device_fit import Estimate
from hapsim.measuring.device_motion import Bounds, Drive, sampled_motion, scene_of
from hapsim.measuring.identify_device import asked_of
from hapsim.measuring.trace_quality import ROUNDING
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace
from hapsim.running.session_options import PeriodicExcitation
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource

SECONDS = 6.0
"""Default duration of the chirps, s."""

_PERIOD_S, _TAPER = 1.0, 0.1
_LOWEST_HZ, _HIGHEST = 2.0, 0.4  # the latter: of the rate
_TRAVEL, _OF_LIMITS = 0.4, 0.5  # of the travel, and of speed, acceleration and force
_HOLD_HZ, _SETTLES_S = 0.5, 0.1  # of the soft spring; with more simulated damping it is stiffer, so that it settles
_REST_S, _FEWEST = 0.1, 3  # periods
_USED = 2e-3  # of the strongest line: weaker ones are not fitted
_BANDWIDTHS_HZ, _DELAYS = (5.0, 20.0, 60.0, 150.0, 400.0), (0.2, 1.0, 2.0, 3.0)  # where the fit begins
_MOST_DELAY = 20.0
_SIMPLER = 2.0  # times what a servo leaves, at most, for a device that follows exactly


@dataclass(frozen=True, kw_only=True)
class ServoIdentification:
    """The identified servo on one channel. SI units."""

    channel: int
    bandwidth: Estimate | None
    """Natural frequency, Hz; None if the device follows exactly, in straight lines."""
    damping: Estimate | None
    """Damping ratio; likewise."""
    delay: Estimate
    """Samples, as `device.delay`."""
    handle_mass: Estimate
    """Mass beyond the force sensor, kg; below 0: the sensor has the wrong sign."""
    error: float
    """Rms of the response that the fit leaves, relative to the commands."""
    lines: int
    """Fitted frequencies,"""
    lowest_hz: float
    highest_hz: float
    periods: int
    peak_m: float
    """Largest distance from the home position."""
    rate_hz: float
    bounds: Bounds
    traces: tuple[Trace, ...] = field(repr=False, compare=False)


class _Response(NamedTuple):
    """The response at the fitted frequencies: z = exp(j w T), positions over commands, its standard deviation, and the
    number of periods."""

    z: Complexes
    ratio: Complexes
    noise: Floats
    periods: int


class _Fit(NamedTuple):
    """The best values of a model, their uncertainties, the rms of what it leaves relative to the commands, and the sum
    of the squares of that over the noise."""

    values: Floats
    unsure: Floats
    error: float
    left: float


def identify_servo(source: SceneSource, **options: Unpack[measurement_options.PushOptions]) -> ServoIdentification:
    """Commands chirps to the device of a scene in admittance on a channel, without the scene's modules.

    Options as those of `identify_device`: `force` bounds the force on the simulated mass, `travel` the motion. Raises
    the errors of `run`, and UsageError if the record shows no servo.
    """
    scene, channel, bounds, duration, run = asked_of(source, options)
    if not scene.device.is_admittance:
        raise UsageError("device.mode: found impedance, expected admittance: `identify_device` finds mass and friction")
    periods = math.floor((SECONDS if duration is None else duration) / _PERIOD_S + 1e-6)
    if periods < _FEWEST + 1:
        raise UsageError(f"duration: found {duration:g} s, expected at least {(_FEWEST + 1) * _PERIOD_S:g} s")
    scene = _let_go(scene)
    with one_thread():
        rest = run(scene_of(scene, bounds, channel, None, 0.0), duration=_REST_S)
        home = float(np.median(rest.position[:, channel]))
        mass, damping = (of(scene.channels)[channel] for of in (scene.device.masses, scene.device.frictions))
        spring = max(mass * (2.0 * math.pi * _HOLD_HZ) ** 2, damping / _SETTLES_S)
        held = scene_of(scene, bounds, channel, Drive(spring, 0.0, bounds.force, 1), home)
        forces = _forces(scene, bounds, channel, spring)
        trace = run(held, duration=periods * _PERIOD_S, excitation=PeriodicExcitation(channel, forces))
        return _identified(scene, bounds, channel, trace, round(_PERIOD_S * scene.rate), home)


def _let_go(scene: Scene) -> Scene:
    """Returns a scene whose mock no hand holds or pushes; its mass stays, which is the handle's too."""
    if scene.mock is None:
        return scene
    hand = scene.mock.hand.model_copy(update={"force": 0.0, "stiffness": 0.0, "damping": 0.0})
    return scene.model_copy(update={"mock": scene.mock.model_copy(update={"hand": hand})})


def _forces(scene: Scene, bounds: Bounds, channel: int, spring: float) -> Floats:
    """Returns the forces (N) of a period, which move the simulated mass in the chirp."""
    device, samples, period = scene.device, round(_PERIOD_S * scene.rate), scene.period
    mass, damping = device.masses(scene.channels)[channel], device.frictions(scene.channels)[channel]
    time = np.arange(samples) / samples
    ratio = _HIGHEST * scene.rate / _LOWEST_HZ
    hz = _LOWEST_HZ * ratio**time
    turn = 2.0 * math.pi * _LOWEST_HZ * _PERIOD_S / math.log(ratio) * (ratio**time - 1.0)
    w = 2.0 * math.pi * hz
    limits = (
        _TRAVEL * bounds.travel * np.ones(samples),
        _OF_LIMITS * device.speed_limits(scene.channels)[channel] / w,
        _OF_LIMITS * device.acceleration_limits(scene.channels)[channel] / w**2,
        _OF_LIMITS * bounds.force / np.abs(spring - mass * w**2 + 1j * damping * w),
    )
    ends = np.clip(np.minimum(time, 1.0 - time) / _TAPER, 0.0, 1.0)
    way = np.minimum.reduce(limits) * (0.5 - 0.5 * np.cos(np.pi * ends)) * np.sin(turn)
    before, after = np.roll(way, 1), np.roll(way, -1)
    moved = mass * (after - 2.0 * way + before) / period**2 + damping * (way - before) / period + spring * way
    return np.clip(moved, -bounds.force, bounds.force)


def _identified(
    scene: Scene, bounds: Bounds, channel: int, trace: Trace, samples: int, home: float
) -> ServoIdentification:
    position, command, force = (one[:, channel] for one in (trace.position, trace.command, trace.sensed["hand_force"]))
    if trace.report.lost_frames or np.any(trace.flags & (LATE_FORCE | UNSENT)):
        raise UsageError(
            "positions were lost or commands were late: nothing was identified. `hapsim doctor` reports what would help"
        )
    kept = position.size // samples - 1  # the first one settles
    if kept < _FEWEST:
        raise UsageError("stopped before enough was recorded: nothing was identified")
    spectra = [np.fft.rfft(one[-kept * samples :].reshape(kept, samples), axis=1) for one in (command, position, force)]
    commanded, moved, sensed = spectra
    at = np.flatnonzero(np.abs(commanded.mean(0)) > _USED * np.abs(commanded.mean(0)).max())
    at = at[at > 0]
    strength = np.abs(commanded.mean(0)[at])
    ratio = moved.mean(0)[at] / commanded.mean(0)[at]
    unlike = moved[:, at] - ratio * commanded[:, at]
    count = float(trace.position_scale[channel]) * ROUNDING * math.sqrt(2.0 * samples)
    noise = np.sqrt((np.mean(np.abs(unlike) ** 2, axis=0) + count**2) / kept) / strength
    seen = _Response(np.exp(2j * np.pi * at / samples), ratio, noise, kept)
    if np.linalg.norm(ratio * strength) < 0.1 * np.linalg.norm(strength):
        raise UsageError("the handle does not follow: is its servo on, and the position sensor connected?")
    bandwidth, damping, delay, error = _fitted(seen, scene.rate, scene.device.delay)
    mass = _handle_mass(sensed.mean(0)[at], moved.mean(0)[at], seen.z, scene.rate)
    return ServoIdentification(
        channel=channel,
        bandwidth=bandwidth,
        damping=damping,
        delay=delay,
        handle_mass=mass,
        error=error,
        lines=at.size,
        lowest_hz=float(at[0]) * scene.rate / samples,
        highest_hz=float(at[-1]) * scene.rate / samples,
        periods=kept,
        peak_m=float(np.abs(position - home).max()),
        rate_hz=scene.rate,
        bounds=bounds,
        traces=(trace,),
    )


def _handle_mass(force: Complexes, position: Complexes, z: Complexes, rate: float) -> Estimate:
    """Returns the mass that the force sensor shows, kg: f = -m times the second difference of the positions."""
    pushed = (2.0 - z - 1.0 / z) * rate**2 * position
    mass = float(np.real(np.vdot(pushed, force)) / np.real(np.vdot(pushed, pushed)))
    left = np.linalg.norm(force - mass * pushed) / math.sqrt(max(force.size - 1, 1))
    return Estimate(mass, float(left / np.linalg.norm(pushed)))


def servo_response(z: Complexes, period: float, bandwidth: float, damping: float, delay: float) -> Complexes:
    """Returns the response at exp(j w T) of the positions x[n] to commands that are computed at sample n and held from
    n + delay on, by a servo of this bandwidth, Hz, and damping ratio."""
    w = 2.0 * math.pi * bandwidth * period
    return w**2 * sampled_motion(2.0 * damping * w, w**2, delay, Converters("zoh", "ideal")).response(z)


def straight_response(z: Complexes, delay: float) -> Complexes:
    """Returns the same of a device that is at the command for n - delay at sample n, in straight lines between."""
    whole, part = math.floor(delay), delay % 1.0
    return z ** float(-whole - 1) * (1.0 - part + part / z)


def _fitted(seen: _Response, rate: float, declared: float) -> tuple[Estimate | None, Estimate | None, Estimate, float]:
    """Returns bandwidth, damping, delay and the relative error of the better fit."""
    period = 1.0 / rate

    def servo(values: Floats) -> Complexes:
        return servo_response(seen.z, period, math.exp(values[0]), math.exp(values[1]), values[2])

    def straight(values: Floats) -> Complexes:
        return straight_response(seen.z, values[0])

    delays = sorted({*_DELAYS, declared})
    high = math.log(rate)
    begins = [np.array([math.log(hz), 0.0, one]) for hz in _BANDWIDTHS_HZ if hz < rate for one in delays]
    curved = _best(seen, servo, begins, ([math.log(0.1), -3.0, 0.0], [high, 3.0, _MOST_DELAY]))
    line = _best(seen, straight, [np.array([one]) for one in delays], ([0.0], [_MOST_DELAY]))
    if line.left < _SIMPLER * curved.left:
        return None, None, Estimate(float(line.values[0]), float(line.unsure[0])), line.error
    values, unsure = [*np.exp(curved.values[:2]), curved.values[2]], curved.unsure * [*np.exp(curved.values[:2]), 1.0]
    bandwidth, damping, delay = (Estimate(float(one), float(off)) for one, off in zip(values, unsure, strict=True))
    return bandwidth, damping, delay, curved.error


def _best(
    seen: _Response, model: Callable[[Floats], Complexes], begins: list[Floats], limits: tuple[list[float], list[float]]
) -> _Fit:

    def left(values: Floats) -> Floats:
        off = (model(values) - seen.ratio) / seen.noise
        return np.concatenate([off.real, off.imag])

    inside = [np.clip(one, np.add(limits[0], 1e-6), np.subtract(limits[1], 1e-6)) for one in begins]
    nearest = sorted(inside, key=lambda one: float(np.sum(left(one) ** 2)))[:4]
    fit = min((least_squares(left, one, bounds=limits, x_scale="jac") for one in nearest), key=lambda one: one.cost)
    freedom = max(fit.fun.size - fit.x.size, 1)
    spread = np.linalg.pinv(fit.jac.T @ fit.jac) * max(2.0 * fit.cost / freedom, 1.0)
    error = float(np.sqrt(np.mean(np.abs(model(fit.x) - seen.ratio) ** 2)))
    return _Fit(fit.x, np.sqrt(np.diag(spread)), error, float(fit.cost))
